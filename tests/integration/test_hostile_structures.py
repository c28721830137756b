"""Files of which one field is hostile, files damaged in bytes, and folders that are not what they should be, in every
command: `PIXELID_MUTANTS=10 pytest -m slow` takes so many of each pair of file and command.
"""

import os
import random
import shutil
from pathlib import Path
from types import SimpleNamespace

import fuzz
import mutants
import numpy as np
import pytest
import structures
from processes import Outcome, import_everything
from structures import CASES, LEFT_OVERS

SEED, EACH = 20, 2
MANY = int(os.environ.get("PIXELID_MUTANTS", "5"))
SHARED = Path(os.environ.get("PIXELID_SHARED", Path(__file__).parents[3] / "shared")) / "bad_files"
PLAIN = [case for case in CASES if not case.heavy and not case.computed]
FILES = sorted({case.file for case in PLAIN})


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """Good files of every kind that takes no computing."""
    folder = tmp_path_factory.mktemp("structures") / "here"
    folder.mkdir()
    structures.prepare_plain(folder)
    words = "render result_reconstruction --out out --frames 1 --size 4 4 --quiet"  # whose kernels are compiled here:
    assert structures.run_here(words.split(), folder, 600.0).code == 0  # that takes longer than an answer may
    shutil.rmtree(folder / "out")
    return folder


@pytest.mark.parametrize("file", FILES)
def test_one_hostile_field(file, plain):
    chance = random.Random(f"{SEED} {file}")
    made = mutants.mutants(plain / file)
    for case in (case for case in PLAIN if case.file == file):
        for mutant in chance.sample(made, EACH):
            _, said = structures.answer(plain, case, mutant)
            assert not said, (mutant[0], case.words, said)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Good files of every kind."""
    folder = tmp_path_factory.mktemp("whole") / "here"
    folder.mkdir()
    import_everything()
    structures.prepare(folder)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.words} {case.file}")
def test_many_hostile_fields_in_every_command(case, whole):
    chance = random.Random(f"{SEED} {case.file} {case.words}")
    made = mutants.mutants(whole / case.file)
    for mutant in chance.sample(made, min(MANY, len(made))):
        _, said = structures.answer(whole, case, mutant)
        assert not said, (mutant[0], said)


@pytest.mark.slow
@pytest.mark.parametrize("case", [*CASES, *LEFT_OVERS], ids=lambda case: f"{case.words} {case.file}")
def test_no_file_breaks_a_command(case, whole):
    """A third of the files of this kind that broke a command once, each damaged as well, and some of other kinds."""
    chance = random.Random(f"{case.file} {case.words}")
    files = sorted(SHARED.glob("*/*")) or sorted(structures.DATA.rglob("*.json"))
    meant = [file for file in files if file.suffix == Path(case.file).suffix]
    for file in [*chance.sample(meant, (len(meant) + 2) // 3), *chance.sample(files, 3)]:
        for tried in (file.read_bytes(), fuzz.damaged(file.read_bytes(), chance)):
            _, said = structures.answer(whole, case, (file.name, tried))
            assert not said, (file, said)


def test_the_judge_of_answers_sees_what_is_wrong():
    old = {"good.h5": (1,)}
    for code, said, after in (
        (2, "", old),
        (2, "pixelid: a\nb\nc\nd", old),
        (2, "pixelid: a: missing", {**old, "out": ()}),
        (2, "pixelid: a: missing", {"good.h5": (2,)}),
        (1, "pixelid: a: missing", old),
        (0, "", {**old, "half": ()}),
        (1, "pixelid: unexpected OSError; this is a bug", old),
        (-11, "", old),
        (2, "pixelid: \x1b[2J", old),
    ):
        assert structures.complaint("fit a --out out", Outcome(code, said, {}), old, after)
    assert not structures.complaint("fit a --out out", Outcome(2, "pixelid: a: missing", {}), old, old)
    assert not structures.complaint("fit a --out out", Outcome(1, "", {}), old, {**old, "out": ()})


# what stands in place of a file: name → how it is made
def _loop(path: Path) -> None:
    path.symlink_to(path.name)


PLACES = {"folder": Path.mkdir, "pipe": os.mkfifo, "loop": _loop, "dangling": lambda path: path.symlink_to("nowhere"),
          "empty": Path.touch, "nulls": lambda path: path.write_bytes(bytes(100))}  # fmt: skip


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("file", FILES)
def test_something_else_in_place_of_a_file(file, place, plain):
    aside = plain.parent / "aside"
    shutil.move(plain / file, aside)
    try:
        PLACES[place](plain / file)
        case = next(case for case in PLAIN if case.file == file)
        before = structures.fingerprints(plain)
        outcome = structures.run_here([*case.words.split(), "--quiet"], plain, structures.MOST_CPU_S)
        said = structures.complaint(case.words, outcome, before, structures.fingerprints(plain))
        structures.remove_new(plain, before)
        assert not said, said
        if place not in ("loop", "dangling") and case.command not in ("report", "render"):  # which take folders
            assert outcome.code == 2
    finally:
        here = plain / file
        here.rmdir() if here.is_dir() and not here.is_symlink() else here.unlink()
        shutil.move(aside, here)


def _frames(folder: Path, pictures: dict[str, bytes], stamps: str | None = "0\n0.1\n0.2\n") -> None:
    folder.mkdir()
    for name, content in pictures.items():
        (folder / name).write_bytes(content)
    if stamps is not None:
        (folder / "timestamps.txt").write_text(stamps)


def _grey(height: int = 4, width: int = 4, channels: int = 1, kind: type = np.uint8) -> bytes:
    return mutants.png(np.full((height, width, channels), 100, kind))


THREE = {f"{k}.png": _grey() for k in range(3)}
FRAMES = {  # → (how they are made, whether light can be made of them)
    "good": (lambda f: _frames(f, THREE), True),
    "1 × 1": (lambda f: _frames(f, dict.fromkeys(THREE, _grey(1, 1))), True),
    "16 bits": (lambda f: _frames(f, dict.fromkeys(THREE, _grey(kind=np.uint16))), True),
    "alpha": (lambda f: _frames(f, dict.fromkeys(THREE, _grey(channels=4))), True),
    "no rows": (lambda f: _frames(f, dict.fromkeys(THREE, _grey(height=0))), False),
    "one of another size": (lambda f: _frames(f, {**THREE, "2.png": _grey(5, 4)}), False),
    "one cut off": (lambda f: _frames(f, {**THREE, "2.png": _grey()[:-30]}), False),
    "no times": (lambda f: _frames(f, THREE, ""), False),
    "too many times": (lambda f: _frames(f, THREE, "0\n1\n2\n3\n"), False),
    "times that fall": (lambda f: _frames(f, THREE, "0\n2\n1\n"), False),
    "times that stand": (lambda f: _frames(f, THREE, "0\n0\n0\n"), False),
    "a time that is none": (lambda f: _frames(f, THREE, "0\nnan\n2\n"), False),
    "words for times": (lambda f: _frames(f, THREE, "a\nb\nc\n"), False),
    "one frame": (lambda f: _frames(f, {"0.png": _grey()}, "0\n"), False),
    "no timestamps": (lambda f: _frames(f, THREE, None), False),
    "no pictures": (lambda f: _frames(f, {}), False),
    "a folder among them": (lambda f: (_frames(f, THREE), (f / "3.png").mkdir()), True),
    "times in a folder": (lambda f: (_frames(f, THREE, None), (f / "timestamps.txt").mkdir()), False),
}


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """What videos need is compiled, which takes longer than an answer may."""
    folder = tmp_path_factory.mktemp("compiled")
    _frames(folder / "frames", THREE)
    words = "simulate dvs128 --stimulus frames --out out.h5 --quiet"
    assert structures.run_here(words.split(), folder, 600.0).code == 0


@pytest.mark.parametrize("frames", FRAMES)
@pytest.mark.usefixtures("compiled")
def test_folders_of_frames(frames, tmp_path):
    make, good = FRAMES[frames]
    make(tmp_path / "frames")
    before = structures.fingerprints(tmp_path)
    words = "simulate dvs128 --stimulus frames --out out.h5 --quiet"
    outcome = structures.run_here(words.split(), tmp_path, structures.MOST_CPU_S)
    said = structures.complaint(words, outcome, before, structures.fingerprints(tmp_path))
    assert not said, said
    assert outcome.code == (0 if good else 2), outcome.said


THEMSELVES = {  # file → (its text, a command that reads it)
    "light.toml": ('[stimulus]\nkind = "file"\npath = "light.toml"\n',
                   "simulate dvs128 --stimulus light.toml --out o.h5"),
    "dark.toml": ('[stimulus]\nkind = "file"\npath = ".."\n', "simulate dvs128 --stimulus dark.toml --out o.h5"),
    "null.toml": ('[stimulus]\nkind = "file"\npath = "a\\u0000b"\n', "simulate dvs128 --stimulus null.toml --out o.h5"),
    "recipe.toml": ('[fit]\nrecordings = ["recipe.toml"]\nmodel = "recipe.toml"\n', "fit recipe.toml --out o"),
    "none.toml": ('[fit]\nrecordings = []\nmodel = "dvs128"\n', "fit none.toml --out o"),
    "pool.toml": ('[rates]\ntable = "pool.toml"\nfrequency_hz = [1.0]\nconditions = ["a"]\narrays = [{ mean = "a", '
                  'spread = "a" }]\n', "rates pool.toml --out o"),
    "latency.toml": ('[latency]\ntables = ["latency.toml"]\ncameras = ["a"]\nname = "a"\nsummary = "a"\n',
                     "latency latency.toml --out o"),
    "static_noise_pos_1.2.3lux.npy": ("", "inspect static_noise_pos_1.2.3lux.npy"),
}  # fmt: skip


@pytest.mark.parametrize("file", THEMSELVES)
def test_files_that_name_themselves_or_nothing(file, tmp_path):
    text, words = THEMSELVES[file]
    (tmp_path / file).write_text(text)
    before = structures.fingerprints(tmp_path)
    outcome = structures.run_here(words.split(), tmp_path, structures.MOST_CPU_S)
    said = structures.complaint(words, outcome, before, structures.fingerprints(tmp_path))
    assert not said, said
    assert outcome.code == 2


OUTS = {  # command that reads {file} → the file
    "inspect {file} --out {out}": "four.h5", "convert {file} {out}": "four.h5",
    "simulate dvs128 --stimulus {file} --out {out}": "four.h5", "fit {file} --model dvs128 --out {out}": "four.h5",
    "fit four.h5 --model {file} --out {out}": "dvs128.toml", "fit {file} --out {out}": "recipe.toml",
    "compare {file} --model dvs128 --model photoreceptor --out {out}": "four.h5",
    "gap {file} --model dvs128 --out {out}": "four.h5", "conform {file} --model dvs128 --out {out}": "four.h5",
    "sensor {file} --model dvs128 --out {out}": "four.h5", "flicker {file} --out {out}": "four.h5",
    "noise {file} --out {out}": "noise.csv", "latency {file} --out {out}": "latency.csv",
    "rates {file} --out {out}": "rates.csv", "biases {file} --out {out}": "rates.csv",
    "lowlight {file} --out {out}": "dvs128.toml",
    "lowlight gen31 --latency {file} --out {out}": "latency.csv", "design {file} --out {out}": "dvs128.toml",
    "design dvs128 --menu {file} --out {out}": "menu.toml", "design dvs128 --recorded {file} --out {out}": "four.h5",
    "export {file} --to v2e --out {out}": "dvs128.toml", "reconstruct {file} --out {out}": "scene",
    "reconstruct scene --fit {file} --out {out}": "dvs128.toml", "render {file} --out {out}": "result_reconstruction",
    "dataset eds {file} {out}": "scene",
}  # fmt: skip


@pytest.mark.parametrize("words", OUTS)
def test_outputs_in_place_of_inputs_and_of_what_is_not_ours(words, plain):
    """The input itself, what is above it, a folder of somebody else, a file of that name, below a file."""
    mine = plain / "mine"
    mine.mkdir(exist_ok=True)
    (mine / "diary.txt").write_text("dear diary")
    file = OUTS[words]
    for out in (file, f"./{file}", str(plain / file), ".", "..", "mine", "four.h5/x", "noise.csv/x.h5", "mine/../mine"):
        before = structures.fingerprints(plain)
        told = [*words.format(file=file, out=out).split(), "--overwrite", "--quiet"]
        outcome = structures.run_here(told, plain, structures.MOST_CPU_S)
        after = structures.fingerprints(plain)
        assert outcome.code == 2, (told, outcome.said)
        assert before == after, told
        assert not structures.complaint(words, outcome, before, after)


@pytest.mark.parametrize(
    "name", ["../../outside", "/tmp/outside", "..", ".", "file", "allow_pickle", "a\\b", "é" * 300]
)
def test_names_of_models_and_cameras_lead_nowhere(name, tmp_path):
    """A model's name and a camera's label become names of files; `np.savez` takes some names for its own arguments."""
    from pixelid.arrays import load_arrays
    from pixelid.compare.compare import Comparison
    from pixelid.model.shipped import find_model
    from pixelid.tables.latency.result import _own_folder

    folder = tmp_path / "result"
    folder.mkdir()
    model, written = find_model("ideal"), []
    contender = SimpleNamespace(held_out=np.zeros(3), result=SimpleNamespace(model=model, write=written.append))
    Comparison.write_companions(SimpleNamespace(contenders={name: contender}), folder)  # type: ignore[arg-type]
    assert list(load_arrays(folder / "held_out.npz")) == [name]
    (toml,) = folder.glob("*.toml")
    assert [place.parent for place in written] == [folder / "fits"]
    assert toml.parent == folder
    assert list(tmp_path.iterdir()) == [folder]
    first = _own_folder(folder, name)
    first.mkdir()
    assert first.resolve().parent == folder
    assert _own_folder(folder, name) != first
