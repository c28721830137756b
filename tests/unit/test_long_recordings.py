"""Recordings in parts give what they give whole: readers, crops, inspection, alignment, writing; EVT 2.1."""

import tracemalloc
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pixelid.cli.main import main
from pixelid.errors import InputError
from pixelid.inspection.health import inspect
from pixelid.inspection.intervals import Intervals, pixel_intervals
from pixelid.recordings import (
    Events,
    Recording,
    columns,
    decoded,
    evt,
    hdf5,
    metadata,
    npz,
    open_recording,
    raw,
    text,
    write_recording,
)
from pixelid.recordings import parts as in_parts
from pixelid.recordings import reading as opening
from pixelid.recordings.alignment import Alignment, aligned, sample_to_align
from pixelid.recordings.columns import RepeatCounter
from pixelid.recordings.crop import Crop
from pixelid.recordings.kept import kept_of, seconds_looked_at
from pixelid.recordings.parts import LongRecording, joined
from pixelid.recordings.reading_child import recordings_of
from pixelid.recordings.triggers import Triggers
from pixelid.stimuli.stimulus import Stimulus

WIDTH, HEIGHT = 12, 9


def in_pieces(monkeypatch, events: int) -> None:
    """Let every reader take so many events at once."""
    places = ((npz, "PART_EVENTS"), (hdf5, "PIECE"), (text, "LINES_AT_ONCE"), (evt, "WORDS_AT_ONCE"),
              (columns, "PART_EVENTS"), (decoded, "PART_EVENTS"), (raw, "WHOLE_EVENTS"))  # fmt: skip
    for module, name in places:
        monkeypatch.setattr(module, name, events)


SECONDS = 3.0


def made(n=20_000, seed=0, tick_ns=1000) -> Recording:
    """Poisson pixels that a 100 Hz lamp modulates, with a hot pixel, repeats, trigger edges and light."""
    rng = np.random.default_rng(seed)
    t = rng.uniform(0, SECONDS, 3 * n)
    t = np.sort(t[rng.random(len(t)) < 0.5 + 0.5 * np.sin(2 * np.pi * 100 * t)][:n])
    n = len(t)
    pixel = rng.integers(0, WIDTH * HEIGHT, n)
    pixel[rng.random(n) < 0.2] = 30
    t_ns = (t * 1e9 / tick_ns).astype(np.int64) * tick_ns
    p = rng.integers(0, 2, n)
    again = rng.choice(n, 50, replace=False)
    order = np.argsort(np.concatenate([t_ns, t_ns[again]]), kind="stable")
    columns = (np.concatenate([c, c[again]])[order] for c in (t_ns, pixel % WIDTH, pixel // WIDTH, p))
    events = Events.from_columns(*columns, WIDTH, HEIGHT, tick_ns=tick_ns)
    light = Stimulus.from_arrays([0, 1, SECONDS], [1.0, 2.0, 3.0], "lux", "linear")
    triggers = Triggers.from_columns([10_000_000, 900_000_000], [True, False], [1, 1])
    return Recording(events, light, "c", "s", attributes={"a": 1}, triggers=triggers)


def repeated(events: Events) -> int:
    """How many events repeat an earlier one."""
    return len(events) - len(set(zip(*(getattr(events, name).tolist() for name in "txyp"), strict=True)))


def long_of(recording: Recording, size=777) -> LongRecording:
    """The recording in parts of `size` events."""
    e = recording.events
    head = replace(recording, events=Events.empty(e.width, e.height, e.tick_ns), triggers=None)

    def read():
        for k in range(0, len(e), size):
            edges = recording.triggers if k == 0 else None
            yield replace(head, events=e.select(np.s_[k : k + size]), triggers=edges)

    return LongRecording(head, read)


def same(found: Recording, expected: Recording) -> None:
    for name in "txyp":
        np.testing.assert_array_equal(getattr(found.events, name), getattr(expected.events, name))
    assert (found.events.width, found.events.height) == (expected.events.width, expected.events.height)
    assert found.events.tick_ns == expected.events.tick_ns
    assert (found.condition, found.attributes) == (expected.condition, expected.attributes)
    assert (found.triggers is None) == (expected.triggers is None)
    if found.triggers is not None:
        np.testing.assert_array_equal(found.triggers.t, expected.triggers.t)
    assert (found.stimulus is None) == (expected.stimulus is None)
    if found.stimulus is not None:
        np.testing.assert_array_equal(found.stimulus.t, expected.stimulus.t)


def read_whole(reader, path):
    head, *parts = recordings_of(reader, path)
    return joined(head, parts)


@pytest.mark.parametrize(("suffix", "reader"), [(".h5", "hdf5"), (".npz", "npz"), (".csv", "text")])
def test_readers_in_parts(tmp_path, monkeypatch, suffix, reader):
    path = tmp_path / f"a{suffix}"
    write_recording(made(), path)
    whole = read_whole(reader, path)
    in_pieces(monkeypatch, 777)
    head, *parts = recordings_of(reader, path)
    assert len(parts) > 20
    same(joined(head, parts), whole)


def test_a_size_that_is_not_stated_is_found_before_the_parts(tmp_path, monkeypatch):
    e = made().events
    np.savez(tmp_path / "a.npz", t=e.t // 1000, x=e.x, y=e.y, p=e.p)
    rows = zip(*(c.tolist() for c in (e.t // 1000, e.x, e.y, e.p)), strict=True)
    (tmp_path / "a.txt").write_text("\n".join(" ".join(map(str, row)) for row in rows))
    in_pieces(monkeypatch, 777)
    for reader, name in (("npz", "a.npz"), ("text", "a.txt")):
        head, *parts = recordings_of(reader, tmp_path / name)
        assert len(parts) > 20
        same(joined(head, parts), read_whole(reader, tmp_path / name))


def test_camera_files_in_parts(tmp_path, monkeypatch, shared):
    for name in ("gen41_saturated.evt3.raw", "davis346_aps.aedat4", "davis240_boxes.aedat"):
        reader = "aedat2" if name.endswith(".aedat") else "decoded"
        path = shared / "recordings" / name
        whole = read_whole(reader, path)
        in_pieces(monkeypatch, 10_000)
        head, *parts = recordings_of(reader, path)
        assert len(parts) > 3
        same(joined(head, parts), whole)
        monkeypatch.undo()


def test_errors_count_from_the_first_part(tmp_path, monkeypatch):
    e = made().events
    t = e.t // 1000
    t[5000] = t[4999] - 1
    np.savez(tmp_path / "a.npz", t=t, x=e.x, y=e.y, p=e.p)
    for size in (1 << 20, 777, 5000):
        in_pieces(monkeypatch, size)
        with pytest.raises(InputError, match="event 5000 is earlier than event 4999"):
            list(recordings_of("npz", tmp_path / "a.npz"))


def test_repeats_are_counted_across_parts():
    events = made().events
    coarse = replace(events, t=events.t // 10**8 * 10**8)
    for some in (events, coarse):
        for size in (1, 100, 5000):
            counter = RepeatCounter()
            found = sum(
                counter.add(some.select(np.s_[k : k + size])) for k in range(0, 4000 if size == 1 else len(some), size)
            )
            assert found == repeated(some if size > 1 else some.select(np.s_[:4000]))


def test_a_file_joined_to_itself_is_refused_in_parts(tmp_path, monkeypatch):
    import h5py

    write_recording(made(), tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        del file["events"].attrs["duplicates"]
    in_pieces(monkeypatch, 777)
    with pytest.raises(InputError, match="found duplicates"):
        list(recordings_of("hdf5", tmp_path / "a.h5"))


@pytest.mark.parametrize(
    "crop",
    [
        Crop(roi=(2, 1, 8, 7)), Crop(time_s=(0.5, 1.25)), Crop(pixels=5), Crop(without_hot_pixels=True),
        Crop((0, 0, 9, 9), (0.1, 2.0), 7, True),
    ],
)  # fmt: skip
def test_crops(crop):
    recording = made()
    found = crop.applied(long_of(recording), seed=3)
    same(replace(joined(found.head, found.read()), triggers=recording.triggers), crop.applied(recording, 3))


def test_what_cuts_of_cuts_have_kept():
    first = Crop((0, 0, 8, 8), (0.5, 2.0), 20, True).applied(made(), 3)
    second = Crop((4, 2, 12, 9), (1.0, 3.0), without_hot_pixels=True)
    once = kept_of(first)
    assert (once.roi, once.hot_pixels, once.pixels, once.time_s) == ((0, 0, 8, 8), 1, 20, (0.5, 2.0))
    part = second.applied(first)
    twice = kept_of(part)
    x, y = np.unique(first.events.pixel) % WIDTH, np.unique(first.events.pixel) // WIDTH
    assert twice.count == np.count_nonzero((x >= 4) & (y >= 2))
    assert (twice.roi, twice.time_s) == ((4, 2, 8, 8), (1.0, 2.0))
    assert seconds_looked_at(part) == (1.0, 2.0)
    long = second.applied(long_of(first))
    assert kept_of(long.head) == twice
    assert kept_of(Crop(without_hot_pixels=True).applied(made())).count == WIDTH * HEIGHT - 1
    with pytest.raises(InputError, match="roi: expected part of 0,0,8,8"):
        Crop((9, 0, 12, 9)).applied(first)
    with pytest.raises(InputError, match=r"time: expected part of 0\.5:2"):
        Crop(time_s=(2.5, 3.0)).applied(first)


def test_what_was_kept_moves_with_the_clock():
    recording = Crop(time_s=(0.5, 2.0)).applied(made())
    assert recording.stimulus is not None
    moved = aligned(recording, recording.stimulus, Alignment(0.25, "given"))
    np.testing.assert_allclose(kept_of(moved).time_s, (0.25, 1.75))


@pytest.mark.parametrize(
    ("told", "says"),
    [
        ("all of it", "region"),
        ({"roi": [0, 0, 12, 9]}, "hot_pixels"),
        ({"roi": [0, 0, 13, 9], "hot_pixels": 0, "pixels": None, "time_s": None}, "roi: expected a region of 12 x 9"),
        ({"roi": [0, 0, 2, 2], "hot_pixels": 0, "pixels": 5, "time_s": None}, "pixels: expected"),
        ({"roi": [0, 0, 2, 2], "hot_pixels": 0, "pixels": None, "time_s": [2, 1]}, "time_s: expected from < to"),
    ],
)
def test_a_damaged_note_of_a_cut_is_refused(told, says):
    with pytest.raises(InputError, match=f"attribute crop.*{says}"):
        kept_of(replace(made(), attributes={"crop": told}))


def test_time_since_the_first_event():
    """On a clock that shows 1.6e9 s, where a double holds a quarter of a microsecond."""
    recording = made()
    start = int(recording.events.t[0])
    later = replace(recording, events=replace(recording.events, t=recording.events.t + 1_600_000_000 * 10**9 - start))
    cut = Crop(time_s=(0.0, 0.05), from_first=True)
    kept = cut.applied(replace(later, stimulus=None)).events
    assert len(kept) == np.count_nonzero(recording.events.t < start + 50_000_000)
    assert kept.t[0] == 1_600_000_000 * 10**9
    long = cut.applied(long_of(replace(later, stimulus=None)))
    same(joined(long.head, long.read()), cut.applied(replace(later, stimulus=None)))


def test_nothing_left_and_a_wrong_region_are_refused():
    long = long_of(made())
    with pytest.raises(InputError, match="within the sensor of 12 x 9"):
        Crop(roi=(0, 0, 99, 9)).applied(long)
    with pytest.raises(InputError, match=r"no event is left of \d+, from 0\.\d+ to \d\.\d+ s"):
        joined(long.head, Crop(time_s=(5.0, 6.0)).applied(long).read())


def close(found, expected, path=""):
    if isinstance(expected, dict):
        assert found.keys() == expected.keys()
        for key in expected:
            close(found[key], expected[key], f"{path}.{key}")
    elif isinstance(expected, list | tuple):
        assert len(found) == len(expected), path
        for a, b in zip(found, expected, strict=True):
            close(a, b, path)
    elif isinstance(expected, float):
        # the dead time spreads intervals over their tick at random, and their order differs
        assert found == pytest.approx(expected, rel=0.02 if "dead_time" in path else 1e-5), path
    else:
        assert found == expected, path


def test_inspection_in_parts():
    recording = made()
    whole = inspect(recording).to_dict()
    for name in ("lines", "hot_pixels", "duplicates", "ceiling"):
        assert whole[name]
    for size in (777, 50_000):
        close(inspect(long_of(recording, size)).to_dict(), whole)


def test_long_light_is_transformed_in_segments(monkeypatch):
    from pixelid.inspection import lines

    monkeypatch.setattr(lines, "MAX_BINS", 1 << 14)
    recording = made()
    whole = inspect(recording).to_dict()["lines"]
    assert whole[0]["frequency_hz"] == pytest.approx(100, abs=0.3)
    close(inspect(long_of(recording)).to_dict()["lines"], whole)


def test_a_random_share_of_the_intervals_is_kept():
    events = made().events
    some = Intervals(WIDTH * HEIGHT, most=2000)
    for part in long_of(made()).read():
        some.add(part.events)
    every = pixel_intervals(events)
    assert some.count == len(every)
    assert len(some.intervals) <= 2000
    assert some.share == 2.0 ** round(np.log2(some.share))
    assert len(some.intervals) == pytest.approx(some.share * len(every), rel=0.15)
    assert np.median(some.intervals) == pytest.approx(np.median(every), rel=0.2)
    assert set(some.intervals.tolist()) <= set(every.tolist())


@pytest.mark.parametrize("suffix", [".h5", ".csv", ".npz"])
@pytest.mark.parametrize("late_ns", [0, 1])
def test_written_in_parts(tmp_path, suffix, late_ns):
    recording = made()
    t = recording.events.t.copy()
    t[-1] += late_ns  # no whole microsecond, after microseconds have been written
    recording = replace(recording, events=replace(recording.events, t=t))
    write_recording(recording, tmp_path / f"whole{suffix}")
    write_recording(long_of(recording), tmp_path / f"parts{suffix}")
    same(open_recording(tmp_path / f"parts{suffix}"), open_recording(tmp_path / f"whole{suffix}"))


@pytest.mark.parametrize("in_parts_too", [False, True])
def test_npz_in_pieces_is_what_numpy_writes(tmp_path, monkeypatch, in_parts_too):
    monkeypatch.setattr(npz, "PART_EVENTS", 777)
    recording, told = made(), []
    npz.write(
        long_of(recording, 1000) if in_parts_too else recording,
        tmp_path / "a.npz",
        lambda what, done: told.append(done),
    )
    e, light = recording.events, recording.stimulus
    told_by_numpy = {"t": e.t, "x": e.x, "y": e.y, "p": e.p, "stimulus_t": light.t, "stimulus_radiance": light.radiance}
    np.savez_compressed(tmp_path / "b.npz", metadata=np.array(metadata.to_json(recording)), **told_by_numpy)
    with np.load(tmp_path / "a.npz") as found, np.load(tmp_path / "b.npz") as expected:
        assert found.files == expected.files
        for name in expected.files:
            assert found[name].dtype == expected[name].dtype
            np.testing.assert_array_equal(found[name], expected[name])
    assert told == sorted(told)
    assert told[-1] == 1.0
    assert [path.name for path in sorted(tmp_path.iterdir())] == ["a.npz", "b.npz"]


@pytest.mark.parametrize("suffix", [".npz", ".csv"])
def test_memory_does_not_grow_with_what_is_written(tmp_path, monkeypatch, suffix):
    monkeypatch.setattr(npz, "PART_EVENTS", 1 << 14)
    recording, peaks = made(20_000), []
    for times in (2, 10):

        def read(times=times):
            for k in range(times):
                yield replace(recording, events=replace(recording.events, t=recording.events.t + k * 4 * 10**9))

        tracemalloc.start()
        write_recording(LongRecording(recording, read), tmp_path / f"{times}{suffix}")
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.2 * peaks[0]


def test_a_part_that_cannot_be_read_leaves_no_npz(tmp_path):
    long = long_of(made())

    def read():
        yield from list(long.read())[:3]
        raise InputError("the file ends here")

    with pytest.raises(InputError, match="ends here"):
        write_recording(LongRecording(long.head, read), tmp_path / "a.npz")
    assert not list(tmp_path.iterdir())


def test_aligned_in_parts():
    recording, light = made(), Stimulus.from_arrays([0, 1, 2], [1.0, 2.0, 1.0], "lux", "linear")
    alignment = Alignment(0.25, "given", rate_error=2e-5)
    found = aligned(long_of(recording), light, alignment)
    same(joined(found.head, found.read()), aligned(recording, light, alignment))
    with pytest.raises(InputError, match="no event lies within the light"):
        aligned(long_of(recording), light, Alignment(50.0, "given"))
    sample = sample_to_align(long_of(recording))
    assert sample.events.t[0] == recording.events.t[0]
    np.testing.assert_array_equal(sample.triggers.t, recording.triggers.t)


def test_commands_on_a_long_file(tmp_path, monkeypatch, capsys):
    recording = made()
    write_recording(recording, tmp_path / "a.h5")
    light = tmp_path / "light.csv"
    light.write_text("t_s,radiance_lux\n0,1\n1,2\n2,1\n")
    assert main(["inspect", str(tmp_path / "a.h5"), "--json", "--quiet"]) == 0
    whole = capsys.readouterr().out
    monkeypatch.setattr(opening, "LONG_BYTES", 0)
    monkeypatch.setattr(in_parts, "WHOLE_EVENTS", 1000)
    assert isinstance(opening.open_cropped(tmp_path / "a.h5", Crop()), LongRecording)
    assert main(["inspect", str(tmp_path / "a.h5"), "--json", "--quiet"]) == 0
    found = capsys.readouterr().out
    assert len(found) == pytest.approx(len(whole), rel=0.01)
    for words in ([], ["--roi", "0,0,5,5"], ["--stimulus", str(light), "--align", "trigger"]):
        assert main(["convert", str(tmp_path / "a.h5"), str(tmp_path / "b.h5"), "--overwrite", *words]) == 0
        said = capsys.readouterr().out
        monkeypatch.setattr(opening, "LONG_BYTES", 1 << 30)
        assert main(["convert", str(tmp_path / "a.h5"), str(tmp_path / "c.h5"), "--overwrite", *words]) == 0
        assert capsys.readouterr().out.replace("c.h5", "b.h5") == said
        same(open_recording(tmp_path / "b.h5"), open_recording(tmp_path / "c.h5"))
        monkeypatch.setattr(opening, "LONG_BYTES", 0)
    assert main(["inspect", str(tmp_path / "a.h5"), "--time", "7:8"]) == 2
    assert "no event is left" in capsys.readouterr().err


def evt21(path, events, header="% evt 2.1\n% geometry 640x480\n% end\n", swapped=False, start_us=0) -> None:
    """Write (t µs, x of the first pixel, y, polarity, mask) as words of EVT 2.1."""
    words, high = [], None
    for t, x, y, p, mask in events:
        if t >> 6 != high:
            high = t >> 6
            words.append(0x8 << 60 | (high & 0xFFFFFFF) << 32)
        words.append(p << 60 | (t & 63) << 54 | x << 43 | y << 32 | mask)
    data = np.array(words, "<u8")
    if swapped:
        data = data.view("<u4").reshape(-1, 2)[:, ::-1].copy()
    path.write_bytes(header.encode() + data.tobytes())


VECTORS = [(1000, 32, 5, 1, 0b1011), (1003, 64, 7, 0, 1 << 31), (5000, 0, 2, 1, 3), (5000, 608, 479, 0, 1 << 31 | 1)]
PIXELS = [(1000, 32, 5, 1), (1000, 33, 5, 1), (1000, 35, 5, 1), (1003, 95, 7, 0), (5000, 0, 2, 1), (5000, 1, 2, 1),
          (5000, 608, 479, 0), (5000, 639, 479, 0)]  # fmt: skip


@pytest.mark.parametrize("swapped", [False, True])
@pytest.mark.parametrize(
    "header",
    ["% evt 2.1\n% geometry 640x480\n% end\n", "% format EVT21;height=480;width=640\n% end\n", "% evt 2.1\n% Gen3 \n"],
)
def test_evt21(tmp_path, header, swapped):
    evt21(tmp_path / "a.raw", VECTORS, header, swapped)
    e = open_recording(tmp_path / "a.raw").events
    assert (e.width, e.height) == (640, 480)
    assert list(zip((e.t // 1000).tolist(), e.x.tolist(), e.y.tolist(), e.p.tolist(), strict=True)) == PIXELS


def test_the_clock_of_evt21_rolls_over(tmp_path):
    late = (1 << 34) - 50
    evt21(tmp_path / "a.raw", [(late + k * 40, k, 1, 1, 1) for k in range(6)])
    t = open_recording(tmp_path / "a.raw").events.t // 1000
    np.testing.assert_array_equal(t, late + 40 * np.arange(6))


@settings(max_examples=60, deadline=None, derandomize=True)
@given(data=st.binary(min_size=0, max_size=200), swapped=st.booleans())
def test_any_bytes_of_evt21_are_answered(tmp_path_factory, data, swapped):
    path = tmp_path_factory.mktemp("evt21") / "a.raw"
    evt21(path, VECTORS, swapped=swapped)
    path.write_bytes(path.read_bytes() + data)
    with suppress(InputError):
        events = read_whole("decoded", path).events
        assert (np.diff(events.t) >= 0).all()
        assert (events.x < 640).all()


def test_recordings_of_one_camera_keep_the_same_pixels():
    """Chosen among those of each recording, fifty of 400 and of 399 had sixteen in common."""
    rng, kept = np.random.default_rng(0), []
    for silent in (None, 7):
        pixel = np.setdiff1d(np.arange(400), [] if silent is None else [silent])
        t = np.sort(rng.integers(0, 10**9, len(pixel)))
        events = Events.from_columns(t, pixel % 20, pixel // 20, pixel % 2, 20, 20)
        kept.append(set(Crop(pixels=50).applied(Recording(events)).events.pixel.tolist()))
    assert len(kept[0]) == len(kept[1]) == 50
    assert len(kept[0] & kept[1]) >= 49
    assert Crop(pixels=5).with_(Crop(time_s=(0.0, 1.0), from_first=True)) == Crop(
        None, (0.0, 1.0), 5, False, True
    )  # fmt: skip
