"""Prophesee's RAW and DAT files: words written here, bit by bit, and what a clock may do in them."""

from pathlib import Path

import numpy as np
import pytest

from pixelid.errors import InputError
from pixelid.recordings.parts import joined
from pixelid.recordings.reading_child import recordings_of

SIZE = "% geometry 640x480\n% end\n"
EVENTS = [(1000, 32, 5, 1), (1003, 95, 7, 0), (5000, 0, 2, 1), (5000, 639, 479, 0)]  # t µs, x, y, p


def read(path):
    head, *parts = recordings_of("decoded", path)
    return joined(head, parts)


def evt2(path: Path, events, edges=()) -> Path:
    """EVT 2.0; a word for the high part of the time ahead of every event."""
    words = []
    for t, x, y, p in sorted([*events, *((t, None, number, up) for t, number, up in edges)], key=lambda row: row[0]):
        words.append(0x8 << 28 | (t >> 6) & 0xFFFFFFF)
        low = (t & 63) << 22
        words.append(0xA << 28 | low | y << 8 | p if x is None else p << 28 | low | x << 11 | y)
    path.write_bytes(f"% evt 2.0\n{SIZE}".encode() + np.array(words, "<u4").tobytes())
    return path


def time3(t: int) -> list[int]:
    return [0x8000 | (t >> 12) & 0xFFF, 0x6000 | t & 0xFFF]


def evt3(path: Path, words) -> Path:
    path.write_bytes(f"% evt 3.0\n{SIZE}".encode() + np.array(words, "<u2").tobytes())
    return path


def singles(events) -> list[int]:
    """Words of EVT 3.0, an event by itself."""
    return [word for t, x, y, p in events for word in (*time3(t), y, 0x2000 | p << 11 | x)]


def rows(path: Path):
    e = read(path).events
    return list(zip((e.t // 1000).tolist(), e.x.tolist(), e.y.tolist(), e.p.tolist(), strict=True))


def test_evt2(tmp_path):
    path = evt2(tmp_path / "a.raw", EVENTS, edges=[(1002, 6, 1), (6000, 0, 0)])
    assert rows(path) == EVENTS
    edges = read(path).triggers
    assert edges is not None
    found = list(zip(edges.t.tolist(), edges.channel.tolist(), edges.rising.tolist(), strict=True))
    assert found == [(1_002_000, 6, True), (6_000_000, 0, False)]


def test_evt3_vectors_and_edges(tmp_path):
    """A vector moves its first column on; rows, columns and times stay until they are said anew."""
    words = [*time3(1000), 5, 0x3800 | 32, 0x4000 | 0b1011, 0x5000 | 1 << 7, 0xA601, 0x6000 | 1001, 0x2000 | 7]
    path = evt3(tmp_path / "a.raw", words)
    assert rows(path) == [(1000, 32, 5, 1), (1000, 33, 5, 1), (1000, 35, 5, 1), (1000, 51, 5, 1), (1001, 7, 5, 0)]
    edges = read(path).triggers
    assert edges is not None
    assert (edges.t.tolist(), edges.channel.tolist(), edges.rising.tolist()) == ([1_000_000], [6], [True])


def test_what_comes_before_the_first_time_is_left_out(tmp_path):
    assert rows(evt3(tmp_path / "a.raw", [5, 0x2000 | 9, 0x6001, *singles(EVENTS)])) == EVENTS
    path = evt2(tmp_path / "b.raw", EVENTS)
    whole = path.read_bytes()
    start = whole.index(b"% end\n") + 6
    path.write_bytes(whole[:start] + np.array([1 << 28], "<u4").tobytes() + whole[start:])
    assert rows(path) == EVENTS


@pytest.mark.parametrize("missing_us", [0, 5000, 6_000_000])
def test_the_clock_of_evt3_rolls_over_whatever_is_missing_there(tmp_path, missing_us):
    """A wrap that was seen only where the high part fell by all of its range froze 17 s of a recording."""
    wrap = 1 << 24
    half = missing_us // 2
    t = np.r_[np.arange(wrap - half - 200_000, wrap - half, 1000), np.arange(wrap + half + 1, wrap + 2**23, 1000)]
    e = read(evt3(tmp_path / "a.raw", singles([(int(k), 1, 1, 1) for k in t]))).events
    np.testing.assert_array_equal(e.t // 1000, t)


def test_the_clock_of_evt2_rolls_over(tmp_path):
    late = (1 << 34) - 50
    assert [t for t, *_ in rows(evt2(tmp_path / "a.raw", [(late + 40 * k, k, 1, 1) for k in range(6)]))] == [
        late + 40 * k for k in range(6)
    ]


def test_a_clock_that_falls_is_refused(tmp_path):
    """Not taken for a rollover, of hours, nor hidden by holding the time."""
    reset = [(t, 1, 1, 1) for t in (1_000_000, 1_500_000, 0, 500_000)]
    high_too_low = [(t, 1, 1, 1) for t in (1_000_000, 999_900, 1_000_100)]
    for events in (reset, high_too_low):
        files = [evt3(tmp_path / "c.raw", singles(events)), dat(tmp_path / "d.dat", events)]
        words = [w for t, x, y, p in events for w in (0x8 << 28 | t >> 6, p << 28 | (t & 63) << 22 | x << 11 | y)]
        unsorted = tmp_path / "b.raw"
        unsorted.write_bytes(f"% evt 2.0\n{SIZE}".encode() + np.array(words, "<u4").tobytes())
        for path in (unsorted, *files):
            with pytest.raises(InputError, match="timestamps must not decrease"):
                read(path)


def test_a_time_that_runs_ahead_without_events_delays_none(tmp_path):
    """Sensors say a time of their own now and then, some µs ahead of the events that follow."""
    words = [*singles([(1000, 1, 1, 1)]), *time3(1011), 0x6000 | 1001, 0x2000 | 2, 0x6000 | 1012, 0x2000 | 3]
    assert [t for t, *_ in rows(evt3(tmp_path / "a.raw", words))] == [1000, 1001, 1012]


def test_damaged_words(tmp_path):
    path = evt3(tmp_path / "a.raw", singles(EVENTS))
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(InputError, match="found 1 bytes left over"):
        read(path)
    evt3(path, [0x9000] * 20)
    with pytest.raises(InputError, match="found none in 20"):
        read(path)
    path.write_bytes(b"% evt 4.0\n% end\n" + bytes(40))
    with pytest.raises(InputError, match=r"expected EVT 2.0, 2.1 or 3.0 in the header, found 4\.0"):
        list(recordings_of("decoded", path))


def dat(path: Path, events, kind=12) -> Path:
    words = [word for t, x, y, p in events for word in (t & 0xFFFFFFFF, p << 28 | y << 14 | x)]
    head = b"% Version 2\n% Height 480\n% Width 640\n" + bytes([kind, 8])
    path.write_bytes(head + np.array(words, "<u4").tobytes())
    return path


def test_dat(tmp_path):
    late = [(t + (1 << 32) - 2000, *others) for t, *others in EVENTS]  # rolls over within
    assert rows(dat(tmp_path / "a.dat", EVENTS)) == EVENTS
    assert rows(dat(tmp_path / "b.dat", late)) == late
    with pytest.raises(InputError, match="expected events of 8 bytes, kind 12"):
        read(dat(tmp_path / "c.dat", EVENTS, kind=14))


@pytest.mark.parametrize("version", ["evt2", "evt3"])
def test_a_second_decoder_says_the_same(tmp_path, version):
    """faery writes and reads; where times only rise the two agree."""
    from faery.extension import evt

    chance, n = np.random.default_rng(0), 20_000
    packet = np.zeros(n, [("t", "<u8"), ("x", "<u2"), ("y", "<u2"), ("on", "?")])
    packet["t"], packet["on"] = np.cumsum(chance.integers(0, 2000, n)), chance.integers(0, 2, n)
    packet["x"], packet["y"] = chance.integers(0, 640, n), chance.integers(0, 480, n)
    with evt.Encoder(tmp_path / "a.raw", version, False, (640, 480), True) as encoder:
        encoder.write({"events": packet})
    columns = (packet[name].astype(int).tolist() for name in ("t", "x", "y", "on"))
    assert rows(tmp_path / "a.raw") == list(zip(*columns, strict=True))
