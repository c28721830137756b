"""Files that nobody should trust: every reader answers in one plain line, and the process lives on."""

import json
import os
import struct
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mutants import declared_png

from pixelid.arrays import load_arrays
from pixelid.errors import InputError
from pixelid.model.files import save_model
from pixelid.model.shipped import find_model
from pixelid.recordings import Events, Recording, open_recording, write_recording
from pixelid.recordings.pictures import read_picture
from pixelid.stimuli import frames as sampled
from pixelid.stimuli.files import load_stimulus
from pixelid.stimuli.shapes import steps

SHARED = Path(os.environ.get("PIXELID_SHARED", Path(__file__).parents[3] / "shared")) / "bad_files"
CORPUS = sorted(f for f in SHARED.glob("*/*") if f.suffix in (".h5", ".npz", ".csv", ".txt")) if SHARED.exists() else []


def answer(path: Path) -> str:
    """What is said of a file; nothing when it can be read."""
    try:
        open_recording(path)
    except InputError as error:
        said = str(error)
    else:
        return ""
    assert len(said.splitlines()) <= 2
    return said


@pytest.mark.parametrize("path", CORPUS, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_files_that_broke_it_once(path):
    answer(path)


@pytest.fixture(scope="module")
def originals(tmp_path_factory):
    """format → the bytes of a small recording of it."""
    folder, rng = tmp_path_factory.mktemp("originals"), np.random.default_rng(0)
    t = np.sort(rng.integers(0, 700_000_000, 60))
    events = Events.from_columns(t, rng.integers(0, 4, 60), rng.integers(0, 4, 60), rng.integers(0, 2, 60), 4, 4)
    recording = Recording(events, steps(20.0, duration_s=0.8), "a", "b", attributes={"biases": {"diff": 80}})
    for suffix in (".h5", ".npz", ".csv"):
        write_recording(recording, folder / f"a{suffix}")
    words = [0x8000, 0x600A, 0xA201, 0x0005, 0x2807, 0x6014, 0xA200, 0x601E, 0x3864, 0x4005]
    raw = b"% evt 3.0\n% geometry 640x480\n% end\n" + np.array(words, "<u2").tobytes()
    return {suffix: (folder / f"a{suffix}").read_bytes() for suffix in (".h5", ".npz", ".csv")} | {".raw": raw}


@settings(max_examples=25, deadline=None, derandomize=True)
@given(data=st.data())
@pytest.mark.parametrize("suffix", [".h5", ".npz", ".csv", ".raw"])
def test_mutated_files(originals, tmp_path_factory, suffix, data):
    content = bytearray(originals[suffix])
    for _ in range(data.draw(st.integers(1, 5))):
        place = data.draw(st.integers(0, len(content) - 1))
        patch = data.draw(st.binary(min_size=0, max_size=8))
        content[place : place + data.draw(st.integers(0, 64))] = patch
        if not content:
            break
    path = tmp_path_factory.mktemp("mutated") / f"m{suffix}"
    path.write_bytes(content)
    answer(path)


def test_a_crashing_decoder_is_one_line_and_the_next_file_is_read(tmp_path, monkeypatch):
    from pixelid.recordings import isolated

    (tmp_path / "crash.py").write_text("import os\ndef opened(path, options):\n    os.abort()\n")
    (tmp_path / "loop.py").write_text("def opened(path, options):\n    while True: pass\n")
    (tmp_path / "greedy.py").write_text("def opened(path, options):\n    return bytearray(1 << 40)\n")
    events = Events.from_columns([1], [0], [0], [1], 1, 1)
    write_recording(Recording(events), tmp_path / "good.npz")
    child = (
        "import json, sys; sys.path[:] = json.loads(sys.argv[1])\nimport pixelid.recordings.reading_child as i\n"
        f"sys.path.insert(0, {str(tmp_path)!r})\n"
        "i.READERS |= dict(crash='crash', loop='loop', greedy='greedy')\ni.serve()"
    )
    monkeypatch.setattr(isolated, "START", child)
    monkeypatch.setattr(isolated, "CPU_S", 1.0)
    isolated._CHILD.stop()
    try:
        for reader, says in (("crash", "crash"), ("loop", "took more than"), ("greedy", "memory")):
            with pytest.raises(InputError, match=says):
                isolated.read_isolated(reader, tmp_path / "good.npz")
            assert len(isolated.read_isolated("npz", tmp_path / "good.npz").events) == 1
    finally:
        isolated._CHILD.stop()


READERS_OF_TESTS = """
import json, sys; sys.path[:] = json.loads(sys.argv[1])
import pixelid.recordings.reading_child as i
sys.path.insert(0, FOLDER)
i.READERS |= dict(slow="slow", hangs="hangs")
i.serve()
"""


@pytest.fixture
def readers(tmp_path, monkeypatch):
    """A child that reads slowly, and one that waits for what never comes."""
    from pixelid.recordings import isolated

    slow = "import time\nfrom pixelid.recordings.npz import opened as read\n"
    slow += "def opened(path, options):\n    end = time.process_time() + 0.5\n"
    slow += "    while time.process_time() < end: pass\n    return read(path, options)\n"
    (tmp_path / "slow.py").write_text(slow)
    (tmp_path / "hangs.py").write_text("import threading\ndef opened(path, options):\n    threading.Event().wait()\n")
    write_recording(Recording(Events.from_columns([1], [0], [0], [1], 1, 1)), tmp_path / "good.npz")
    monkeypatch.setattr(isolated, "START", READERS_OF_TESTS.replace("FOLDER", repr(str(tmp_path))))
    monkeypatch.setattr(isolated, "LOOK_S", 0.05)
    monkeypatch.setattr(isolated, "CPU_S", 2.0)
    isolated._CHILD.stop()
    yield isolated
    isolated._CHILD.stop()


def test_a_child_that_gets_no_turn_is_no_damaged_file(readers, tmp_path):
    """It is stopped for longer than one that hangs is waited for: what it computes counts, not the time that passes."""
    import signal
    import threading
    import time

    def hold():
        while readers._CHILD._process is None:
            time.sleep(0.01)
        for _ in range(4):
            readers._CHILD._process.send_signal(signal.SIGSTOP)
            time.sleep(1.5)
            readers._CHILD._process.send_signal(signal.SIGCONT)
            time.sleep(0.05)

    holding = threading.Thread(target=hold)
    holding.start()
    assert len(readers.read_isolated("slow", tmp_path / "good.npz").events) == 1
    holding.join()


def test_a_child_that_waits_for_nothing_is_ended(readers, tmp_path):
    with pytest.raises(InputError, match="hung"):
        readers.read_isolated("hangs", tmp_path / "good.npz")


def test_hdf5_that_leads_out_of_the_file(tmp_path):
    secret = tmp_path / "secret.h5"
    with h5py.File(secret, "w") as file:
        file["x"] = np.arange(10)
    (tmp_path / "secret.bin").write_bytes(bytes(80))
    for kind in ("link", "soft", "through", "storage", "virtual", "huge"):
        path = tmp_path / f"{kind}.h5"
        with h5py.File(path, "w") as file:
            group = file.create_group("events")
            for name in "typ":
                group[name] = np.zeros(10, np.int64)
            if kind == "link":
                group["x"] = h5py.ExternalLink("secret.h5", "/x")
            elif kind == "soft":  # within the file, which is no danger and no column
                group["x"] = h5py.SoftLink("/events/y")
                group["nowhere"] = h5py.SoftLink("/gone")
            elif kind == "through":
                group["x"] = h5py.SoftLink("/away/x")
                file["away"] = h5py.ExternalLink("secret.h5", "/")
            elif kind == "storage":
                group.create_dataset("x", (10,), "<i8", external=[(str(tmp_path / "secret.bin"), 0, 80)])
            elif kind == "virtual":
                layout = h5py.VirtualLayout((10,), "<i8")
                layout[:] = h5py.VirtualSource(str(secret), "x", (10,))
                group.create_virtual_dataset("x", layout)
            else:
                group.create_dataset("x", (1 << 40,), "<i8", chunks=(1 << 16,))
        assert {"soft": "expected columns", "through": "away"}.get(kind, "events/x") in answer(path)


@pytest.mark.parametrize("name", ["a.csv", "a.raw", "a.h5", "a.npz", "light.csv"])
def test_files_of_holes_are_refused_at_once(tmp_path, name):
    """What was never written takes no place on the disk, and hours to read."""
    path = tmp_path / name
    path.write_text("t,radiance\n" if name == "light.csv" else "t,x,y,p\n")
    os.truncate(path, 1 << 40)
    with pytest.raises(InputError, match=r"sparse|at most|GiB"):
        load_stimulus(path) if name == "light.csv" else open_recording(path)
    os.truncate(path, 1 << 20)
    with pytest.raises(InputError):
        load_stimulus(path) if name == "light.csv" else open_recording(path)


def test_what_is_no_regular_file(tmp_path):
    os.mkfifo(tmp_path / "pipe.h5")
    for path in (tmp_path / "pipe.h5", Path("/dev/zero"), Path("/dev/null"), tmp_path):
        assert answer(path)
        with pytest.raises(InputError):
            load_stimulus(path)


def test_pictures_that_declare_more_than_they_hold(tmp_path):
    (tmp_path / "good.png").write_bytes(declared_png(3, 2, b"\0\1\2\3" * 2))
    np.testing.assert_array_equal(read_picture(tmp_path / "good.png"), [[1, 2, 3]] * 2)
    tiff = b"II*\0\x08\0\0\0\x04\0" + b"".join(
        struct.pack("<HHII", tag, 4, 1, value) for tag, value in ((256, 1 << 31), (257, 1 << 31), (273, 8), (279, 9))
    )
    bombs = {
        "wide.png": declared_png(1 << 30, 1 << 30, b"\0"), "short.png": declared_png(13_000, 13_000, b"\0" * 100),
        "bomb.png": declared_png(60_000, 60_000, b"\0" * 10**6), "huge.tif": tiff + bytes(4), "empty.jpg": b"",
        "text.bmp": b"BM",
        "pickle.npy": b"\x93NUMPY\x01\x00v\x00{'descr': '|O', 'fortran_order': False, 'shape': (9, 9), }",
    }  # fmt: skip
    for name, content in bombs.items():
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=name):
            read_picture(tmp_path / name)
    (tmp_path / "frames").mkdir()
    for name in ("wide.png", "short.png"):
        (tmp_path / "frames" / name).write_bytes(bombs[name])
    (tmp_path / "frames" / "timestamps.txt").write_text("0.0\n0.5\n")
    with pytest.raises(InputError, match=r"short\.png"):
        load_stimulus(tmp_path / "frames")
    (tmp_path / "video.mp4").write_bytes(b"\0\0\0\x18ftypmp42" + bytes(100))
    with pytest.raises(InputError, match=r"video\.mp4"):
        load_stimulus(tmp_path / "video.mp4")


def test_frames_that_do_not_fit_into_memory(tmp_path, monkeypatch):
    (tmp_path / "frames").mkdir()
    for k in range(3):
        (tmp_path / "frames" / f"{k}.png").write_bytes(declared_png(30, 20, bytes(31 * 20)))
    (tmp_path / "frames" / "timestamps.txt").write_text("0.0\n0.5\n1.0\n")
    assert load_stimulus(tmp_path / "frames").radiance.shape == (4, 20, 30)
    monkeypatch.setattr(sampled, "memory_bytes", lambda: 2 * 2 * 3 * 30 * 20 * 4 - 1)
    with pytest.raises(InputError, match="fit into memory"):
        load_stimulus(tmp_path / "frames")


@pytest.mark.parametrize("value", [[1.0], {"a": 1}, "much"])
def test_a_gap_report_that_cannot_be_shown_is_refused(tmp_path, value):
    """Found by the fuzz: a strength that is no number was only met when the report was printed."""
    from pixelid.gap.result import GapReport

    report = json.loads((Path(__file__).resolve().parents[1] / "data" / "gap.json").read_text())
    save_model(find_model("dvs128"), tmp_path / "model.toml")
    (tmp_path / "gap.json").write_text(json.dumps(report))
    GapReport.load(tmp_path)
    for entry in report["effects"][0]["parameters"].values():
        entry["value"] = value
    (tmp_path / "gap.json").write_text(json.dumps(report))
    with pytest.raises(InputError, match=r"gap\.json"):
        GapReport.load(tmp_path)


def test_a_header_that_is_no_python_is_refused_in_one_line(tmp_path, recwarn):
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (2inf 20), }".ljust(117) + b"\n"
    (tmp_path / "light.npy").write_bytes(b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + bytes(320))
    with pytest.raises(InputError, match="damaged or different"):
        load_arrays(tmp_path / "light.npy")
    assert not recwarn.list
