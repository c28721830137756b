"""Models, recipes, stimuli, tables and results that nobody should trust: refused in one line that names the file."""

import os
import random
import shutil
import sys
from pathlib import Path

import fuzz
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pixelid.arrays import load_arrays
from pixelid.cli.main import main
from pixelid.documents import MOST_BYTES, read_json, read_toml
from pixelid.errors import InputError

SHARED = Path(os.environ.get("PIXELID_SHARED", Path(__file__).parents[3] / "shared")) / "bad_files"
READERS = {
    "fitdir": "fit.json", "report": "fit.json", "reportgap": "gap.json", "menu": "menu", "model": "model",
    "pool": "pool recipe", "recipe": "recipe",
}  # fmt: skip
CORPUS = sorted(file for folder in READERS for file in SHARED.glob(f"{folder}/*"))
DEEP = "[" * 100_000


@pytest.fixture(scope="module")
def beside(tmp_path_factory):
    """The folder in which damaged files lie beside those that they name."""
    return tmp_path_factory.mktemp("beside")


@pytest.fixture(scope="module")
def targets(beside):
    return fuzz.targets(beside)


RESULTS = sorted(file.name for file in (Path(__file__).parents[1] / "data" / "results").iterdir())
NAMES = (
    "model", "recipe", "stimulus", "light table", "menu", "pool recipe", "rate table", "latency table", "noise table",
    "light .npy", "light .npz", *RESULTS, "fit.json", "gap.json", "recording .h5", "recording .npz", "recording .csv",
    "recording .raw", "recording .aedat", "recording .dat", "foreign text", "foreign .npz", "foreign .npy",
    "foreign light", "colmap cameras.txt", "colmap images.txt", "colmap cameras.bin", "colmap images.bin", "biases",
    "recording aedat4 raw", "recording aedat4 lz4",
    "recording aedat4 zstd", "recording evt2", "recording evt3", "recording evt2.1", "recording mat",
    "recording mat packed", "recording prophesee h5", "recording dsec h5", "recording bag", "recording db3",
    "recording mcap", "kept chain", "kept tile", "kept fits", "kept checkpoint", "scene raw_events.npz",
    "scene camera_poses.npz", "scene camera_calibration.npz", "scene renderer_params.npz", "scene views/a.png",
    "scene views/transforms_val.json", "field.npz",
)  # fmt: skip


def test_every_parser_is_listed(targets):
    assert tuple(targets) == NAMES


@pytest.mark.parametrize("name", NAMES)
def test_good_files_are_read(targets, beside, name, capsys):
    target = targets[name]
    for content in target.originals:
        path = beside / f"good{target.suffix}"
        path.write_bytes(content)
        assert target.call(path) != 2, capsys.readouterr().err


@pytest.mark.parametrize("path", CORPUS, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_files_that_broke_it_once(targets, path):
    assert not fuzz.complaint(targets[READERS[path.parent.name]], path)


@settings(max_examples=5, deadline=None, derandomize=True)
@given(seed=st.integers(0, 1 << 32))
@pytest.mark.parametrize("name", NAMES)
def test_damaged_files(targets, beside, name, seed):
    target, chance = targets[name], random.Random(seed)
    path = beside / f"damaged{target.suffix}"
    path.write_bytes(fuzz.damaged(chance.choice(target.originals), chance))
    assert not fuzz.complaint(target, path)


def test_the_judge_sees_what_is_wrong(tmp_path, monkeypatch):
    def says(text):
        return lambda path: print(text, file=sys.stderr) or 2

    def raises(path):
        raise KeyError("a")

    def hangs(path):
        while True:
            pass

    monkeypatch.setattr(fuzz, "CPU_S", 0.05)
    wrong = {"last net": says("pixelid: unexpected KeyError: this is a bug"), "three lines": says("a\nb\nc\nd"),
             "KeyError": raises, "took": hangs, "exit code 1": lambda path: 1}  # fmt: skip
    for what, call in wrong.items():
        assert what in fuzz.complaint(fuzz.Target("x", "", (), call), tmp_path)
    assert not fuzz.complaint(fuzz.Target("x", "", (), says("pixelid: x: missing")), tmp_path)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (f"a = {DEEP}", "open brackets"),
        ("a." * 100_000 + "a = 1", "parts"),
        (f"a = {'9' * 5000}", "not valid TOML"),
        (f"a = {1 << 63}", "64 bits"),
        ("a = [", "not valid TOML"),
        ('"\\u001b" = 1', "control characters"),
        ("#" * (MOST_BYTES["TOML"] + 1), "at most 2 MiB"),
    ],
)
def test_toml_beyond_the_limits(tmp_path, text, says):
    (tmp_path / "a.toml").write_text(text)
    with pytest.raises(InputError, match=says) as refused:
        read_toml(tmp_path / "a.toml")
    assert str(tmp_path / "a.toml") in str(refused.value)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (DEEP, "too deeply"),
        ('{"a": ' * 100 + "1" + "}" * 100, "deep"),
        (f'{{"a": {"9" * 5000}}}', "not valid JSON"),
        ('{"a": NaN}', "NaN"),
        ('{"a": -Infinity}', "Infinity"),
        ("[1]", "object"),
        ('{"a": 1e999, "b": 123456789012345678901234567890}', "64 bits"),
    ],
)
def test_json_beyond_the_limits(tmp_path, text, says):
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(InputError, match=says):
        read_json(tmp_path / "a.json")


def test_byte_order_marks_and_line_ends_are_read_and_control_characters_left_out(tmp_path):
    (tmp_path / "a").write_bytes(b'\xef\xbb\xbfa = "x\\u001b[1m\\u202ey"\r\nb = """\r\n1.2 [[[ {"""\r\n')
    assert read_toml(tmp_path / "a") == {"a": "x[1my", "b": "1.2 [[[ {"}
    (tmp_path / "b").write_bytes(b'\xef\xbb\xbf{"a": "x\\u001b[1m\\ud800"}')
    assert read_json(tmp_path / "b") == {"a": "x[1m"}
    (tmp_path / "c").write_bytes(b'a = "\xff"')
    with pytest.raises(InputError, match="UTF-8"):
        read_toml(tmp_path / "c")


@pytest.mark.parametrize("place", ["/dev/zero", "/dev/stdin", "fifo", "folder", "missing", "loop"])
def test_what_is_no_regular_file(tmp_path, place, capsys):
    os.mkfifo(tmp_path / "fifo")
    (tmp_path / "folder").mkdir()
    (tmp_path / "loop").symlink_to("loop")
    link = tmp_path / "link.toml"
    link.symlink_to(place if place.startswith("/") else tmp_path / place)
    out = str(tmp_path / "out")
    for words in (
        ["models", str(link)],
        ["fit", str(link), "--out", out],
        ["rates", str(link), "--out", out],
        ["simulate", "dvs128", "--stimulus", str(link), "--out", f"{out}.h5"],
        ["design", "dvs128", "--menu", str(link), "--out", out],
    ):
        assert main(words) == 2
        said = capsys.readouterr().err
        assert said.count("\n") == 1
        assert "bug" not in said
    for file in ("fit.json", "gap.json"):
        (tmp_path / "result").mkdir()
        (tmp_path / "result" / file).symlink_to(link)
        assert main(["report", str(tmp_path / "result")]) == 2
        shutil.rmtree(tmp_path / "result")


def test_a_page_takes_no_pictures_from_elsewhere(tmp_path):
    folder = tmp_path / "fit"
    folder.mkdir()
    shutil.copy(Path(fuzz.__file__).parents[1] / "tests/data/fit.json", folder)
    (tmp_path / "secret.png").write_bytes(b"secret")
    (folder / "a.png").symlink_to(tmp_path / "secret.png")
    os.mkfifo(folder / "b.png")
    (folder / "c.svg").write_bytes(b"\xff\xff")
    (folder / "d.svg").write_text("<svg>" * 5000 + "</svg>" * 5000)
    (folder / "e.svg").write_text('<svg width="1.2.3"/>')
    assert main(["report", str(folder), "--quiet"]) == 0
    page = (folder / "report.html").read_text()
    assert "c2VjcmV0" not in page
    assert page.count("is not a drawing that can be read") == 3


def test_archives_that_unpack_to_more_than_memory_holds(tmp_path, monkeypatch):
    import numpy as np

    np.savez_compressed(tmp_path / "a.npz", t=np.zeros(1 << 20))
    monkeypatch.setattr("pixelid.arrays.MOST_BYTES", 1 << 20)
    with pytest.raises(InputError, match="at most"):
        load_arrays(tmp_path / "a.npz")


def test_an_archive_of_an_unknown_version(targets, beside):
    content = targets["light .npz"].originals[0]
    at = content.index(b"PK\x01\x02")
    (beside / "v.npz").write_bytes(content[: at + 6] + b"\x5c" + content[at + 7 :])
    assert not fuzz.complaint(targets["light .npz"], beside / "v.npz")
