"""Give files that nobody should trust to every command that takes a file: `python tests/replay.py FOLDER`.

Each file goes into each slot of each command (`SLOTS`): as a recording, a light, a model, a recipe, a menu, a table, a
file of a result or of a dataset.  The command runs in a process of its own, forked from one in which everything is
imported.  An answer is wrong when it is a traceback, the last net's "this is a bug", a crash, more than three lines,
control characters, another exit code than 0, 1 or 2 (1 only with a result), more than `CPU_S` to refuse or
`MOST_CPU_S` to compute, more than `MOST_BYTES`, or when something is left that was not there and is no result.
"""

from __future__ import annotations

import argparse
import json
import random
import shutil
import sys
import tempfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))
from fuzz import damaged
from processes import Outcome, import_everything, run

from pixelid.errors import printable

CPU_S, MOST_CPU_S = 5.0, 30  # beyond imports and compilation: of an answer, and before the process is ended
MOST_BYTES = 6 << 30  # at most at once, the imports' 0.6 GiB included
NETS = ("this is a bug", "Traceback", "Warning", "escaped:")
MODELS = Path(__file__).resolve().parents[1] / "models"
DATA = Path(__file__).resolve().parent / "data"
RECORDINGS, LIGHTS = (".h5", ".npz", ".csv", ".txt"), (".toml", ".h5", ".npz", ".csv", ".txt")
RESULTS = ("fit.json", "gap.json", *(file.name for file in sorted((DATA / "results").glob("*.json"))))
FEW = "--fix alpha=61110 --fix beta=1851 --fix sf_cutoff_hz=50 --fix diff_cutoff_hz=1000 --fix refractory_s=0.001"


@dataclass(frozen=True)
class Slot:
    """A place for a file: the command's words, where {file} is the file, and {out} what it writes.

    `place` is where the file is copied to, relative to the folder; empty: it stays under its own suffix.  `suffixes`
    are of the files that are expected there.
    """

    words: str
    place: str = ""
    suffixes: tuple[str, ...] = ()

    def meant_for(self, file: Path) -> bool:
        """Whether files of this kind are what the command expects there."""
        return file.suffix in (self.suffixes or (Path(self.place).suffix,))


def _result(name: str) -> str:
    """The folder of a result, and the place of one of its files."""
    return f"result_{name.partition('.')[0]}/{name}"


SLOTS = [
    # as a recording
    *(Slot(words, suffixes=RECORDINGS) for words in (
        "inspect {file} --out {out}", "inspect {file} --json", "convert {file} {out}.h5", "convert {file} {out}.csv",
        "convert {file} {out}.npz --roi 0,0,2,2 --time 0:0.5 --pixels 2", "convert {file} {out}.h5 --stimulus chirp",
        "convert {file} {out}.h5 --stimulus chirp --align auto", "convert {file} {out}.h5 --stimulus sensor",
        "fit {file} --model dvs128 --out {out} " + FEW, "gap {file} --model dvs128 --out {out}",
        "conform {file} --model dvs128 --out {out}", "compare {file} --model dvs128 --model ideal --out {out}",
        "sensor {file} --model dvs128 --out {out} --bootstrap 2 --tile 2", "noise {file} --out {out}",
        "flicker {file} --out {out} --groups 2x2", "lowlight dvs128 {file} --out {out}",
        "design dvs128 --out {out} --recorded {file} --draws 1 --pixels 2",
    )),
    # as a light
    *(Slot(words, suffixes=LIGHTS) for words in (
        "simulate dvs128 --stimulus {file} --out {out}.h5 --pixels 2", "convert good.h5 {out}.h5 --stimulus {file}",
        "convert good.h5 {out}.h5 --stimulus {file} --align first-event",
        "convert good.h5 {out}.h5 --stimulus {file} --align auto",
    )),
    # as a model, a recipe, a menu
    *(Slot(words, suffixes=(".toml",)) for words in (
        "models {file}", "models {file} --json", "simulate {file} --stimulus chirp --out {out}.h5 --pixels 2",
        "fit good.h5 --model {file} --out {out}", "gap good.h5 --model {file} --out {out}",
        "conform good.h5 --model {file} --out {out}", "compare good.h5 --model {file} --model ideal --out {out}",
        "sensor good.h5 --model {file} --out {out}", "flicker good.h5 --model {file} --out {out}",
        "latency latency.csv --predict --model {file} --out {out}",
        "noise noise.csv --predict --model {file} --out {out}",
        "lowlight {file} --out {out}",
        "design {file} --out {out} --draws 1 --pixels 2", "export {file} --to v2e --out {out}.yaml",
        "export {file} --to dvs-voltmeter --out {out}.json", "reconstruct scene --fit {file} --out {out} --steps 2",
        "fit {file} --out {out}", "design dvs128 --menu {file} --out {out} --draws 1 --pixels 2",
    )),
    # as a table
    *(Slot(words, suffixes=(".csv", ".txt")) for words in (
        "latency {file} --out {out}", "latency {file} --predict --model gen31 --out {out}",
        "noise {file} --out {out} --predict --model dvs128", "rates {file} --out {out}",
        "rates {file} --out {out} --unit kev/s --data .",
    )),
    # as a file of a result
    *(Slot(f"report {_result(name).partition('/')[0]}", _result(name)) for name in RESULTS),
    *(Slot(words, _result("fit.json")) for words in (
        "models result_fit", "export result_fit --to esim --out {out}.txt", "lowlight result_fit --out {out}",
        "design result_fit --out {out} --draws 1 --pixels 2",
        "noise noise.csv --predict --model result_fit --out {out}",
        "simulate result_fit --stimulus chirp --out {out}.h5 --pixels 2",
        "sensor good.h5 --model result_fit --out {out}",
        "reconstruct scene --fit result_fit --out {out} --steps 2",
        "latency latency.csv --predict --model result_fit --out {out}",
    )),
    Slot("models result_fit", "result_fit/model.toml"),
    Slot("lowlight result_fit --out {out}", "result_fit/model.toml"),
    Slot("report result_gap", "result_gap/model.toml"),
    Slot("reconstruct scene --fit result_gap --out {out} --steps 2", "result_gap/gap.json"),
    Slot("reconstruct scene --sensor result_sensor --out {out} --steps 2", "result_sensor/sensor.json"),
    Slot("reconstruct scene --sensor result_sensor --out {out} --steps 2", "result_sensor/maps.npz"),
    Slot("report result_sensor", "result_sensor/maps.npz"),
    Slot("report result_fit", "result_fit/posterior.json"),
    Slot("render result_reconstruction --out {out} --frames 1 --size 4 4", "result_reconstruction/reconstruction.json"),
    Slot("render result_reconstruction --out {out} --frames 1 --size 4 4", "result_reconstruction/field.npz"),
    # as what interrupted runs keep
    Slot("sensor good.h5 --model dvs128 --out {out} --bootstrap 0", "out.tiles/0.npz"),
    Slot("gap good.h5 --model dvs128 --out {out}", ".out.fits"),
    Slot("reconstruct scene --out {out} --steps 2 --checkpoint state.pt", "state.pt"),
    # as a file of a dataset
    *(Slot("reconstruct scene --out {out} --steps 2", f"scene/{name}") for name in (
        "raw_events.npz", "camera_poses.npz", "camera_calibration.npz", "renderer_params.npz", "views/a.png",
        "views/transforms_val.json", "views/transforms_train.json",
    )),
    Slot("render result_reconstruction --views {file} --out {out} --size 4 4 --frames 2", suffixes=(".json", ".npz")),
    Slot("dataset esim {file} {out}", suffixes=(".bag",)),
    Slot("dataset eds eds {out}", "eds/events.h5"),
    Slot("dataset eds eds {out}", "eds/stamped_groundtruth.txt"),
    Slot("dataset eds eds {out}", "eds/calibration.yaml"),
    Slot("dataset tumvie tumvie {out}", "tumvie/a-events_left.h5"),
    Slot("dataset tumvie tumvie {out}", "tumvie/mocap_data.txt"),
    Slot("dataset tumvie tumvie {out}", "tumvie/calibrationA.json"),
]  # fmt: skip
NOISE = "lux,ON_events_per_s_per_px,OFF_events_per_s_per_px\n1,2.5,0.1\n10,0.5,0.05\n100,0.125,0.02\n1000,0.1,0.01\n"
LATENCY = "camera,lens,polarity,irradiance_W_m2,bias_config,median,stdev,pixels\nCAM3,f2,1,0.05,0,210,3,100\n"


def prepare(folder: Path) -> None:
    """Write what stands beside the file: a recording, tables, a dataset, sequences of cameras, a folder per result."""
    import fuzz_targets

    sys.path.insert(0, str(Path(__file__).resolve().parent / "integration"))
    import test_nerf_published as published

    from pixelid.nerf.synthetic import make_dataset

    run(["simulate", "dvs128", "--stimulus", "chirp", "--out", "good.h5", "--pixels", "4"], folder)
    (folder / "noise.csv").write_text(NOISE)
    (folder / "latency.csv").write_text(LATENCY)
    list(fuzz_targets._scenes(folder))
    truth = published.as_simulated(
        make_dataset(folder / "hard", "hard", seed=3, side=published.SIDE, revolutions=1.0, frames_per_turn=300)
    )
    published.write_eds(folder / "eds", truth)
    published.write_tumvie(folder / "tumvie", truth)
    shutil.rmtree(folder / "hard")
    write_results(folder)
    shutil.rmtree(folder / "result_sensor")
    words = "sensor good.h5 --model dvs128 --bootstrap 2 --out result_sensor"
    done = run(words.split(), folder)
    assert done.code in (0, 1), done.said


def write_results(folder: Path) -> None:
    """A folder per kind of result, `field.npz` being there already."""
    for name in RESULTS:
        result = folder / _result(name)
        result.parent.mkdir()
        shutil.copy(DATA / name if (DATA / name).exists() else DATA / "results" / name, result)
        shutil.copy(MODELS / "dvs128.toml", result.parent / "model.toml")
    shutil.copy(folder / "field.npz", folder / "result_reconstruction")


def complaint(outcome: Outcome, before: set[str], after: set[str]) -> str:
    """What is wrong with an answer; empty when nothing is."""
    if any(net in outcome.said for net in NETS):
        return f"not foreseen: {outcome.said[-400:]}"
    if outcome.code not in (0, 1, 2):
        return f"exit code {outcome.code}: {outcome.said[:300]}"
    if len(outcome.said.splitlines()) > 3:
        return f"more than three lines: {outcome.said[:300]}"
    if outcome.code == 2 and not outcome.said.strip():
        return "exit code 2 and not a word"
    if printable(outcome.said + outcome.printed) != outcome.said + outcome.printed:
        return "control characters"
    new = {name for name in after - before if not name.startswith(("out", ".out.fits", "state.pt"))}
    if new or (outcome.code == 2 and after != before):
        return f"left: {sorted(after ^ before)[:3]}"
    if outcome.code == 1 and after == before:
        return f"exit code 1 without a result: {outcome.said[:300]}"
    if outcome.bytes > MOST_BYTES:
        return f"took {outcome.bytes >> 20} MiB"
    return ""


def names(folder: Path) -> set[str]:
    """Every file below a folder."""
    return {str(file.relative_to(folder)) for file in folder.rglob("*")}


def replay(file: Path, slot: Slot, folder: Path) -> tuple[Outcome, str]:
    """How the command of a slot answers a file, and what is wrong with that."""
    place = folder / (slot.place or f"file{file.suffix}")
    aside = folder.parent / "aside"
    if place.exists():
        shutil.move(place, aside)
    place.parent.mkdir(exist_ok=True)
    shutil.copyfile(file, place)
    before = names(folder)
    page = folder / slot.words.split()[1] / "report.html"
    outcome = run([*slot.words.format(file=place.name, out="out").split(), "--quiet"], folder, cpu_s=MOST_CPU_S)
    if slot.words.startswith("report "):  # writes into the folder
        before -= {str(page.relative_to(folder))}
        page.unlink(missing_ok=True)
    said = complaint(outcome, before, names(folder))
    for left in (*folder.glob("out*"), *folder.glob(".out*"), *folder.glob("state.pt.*")):
        shutil.rmtree(left) if left.is_dir() else left.unlink()
    place.unlink(missing_ok=True)
    if aside.exists():
        shutil.move(aside, place)
    return outcome, said


def main() -> int:
    """Run the loop of the command line; 1 when an answer was wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="+", type=Path, help="files, and folders of them")
    parser.add_argument("--only", default="", help="only slots whose words contain this")
    parser.add_argument("--relatives", type=int, default=0, help="also so many damaged copies of each file")
    parser.add_argument("--share", type=float, default=1.0, help="of slots that expect another kind of file")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, default=Path("replay-failures"), help="folder for files answered wrongly")
    parser.add_argument("--out", type=Path, help="JSON file for the counts")
    options = parser.parse_args()
    files = [f for given in options.files for f in (sorted(given.rglob("*.*")) if given.is_dir() else [given])]
    import_everything()
    chance, codes = random.Random(options.seed), Counter()
    slow: dict[str, float] = {}
    failures: dict[str, list[str]] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "here"
        folder.mkdir()
        prepare(folder)
        for file in files:
            for relative in range(options.relatives + 1):
                tried = file
                if relative:
                    tried = Path(name) / f"relative{file.suffix}"
                    tried.write_bytes(damaged(file.read_bytes(), chance))
                for slot in SLOTS:
                    left_out = not slot.meant_for(file) and chance.random() > options.share
                    if options.only not in slot.words or left_out:
                        continue
                    outcome, said = replay(tried, slot, folder)
                    codes[outcome.code] += 1
                    slow[slot.words] = max(slow.get(slot.words, 0.0), outcome.cpu_s)
                    if outcome.cpu_s > CPU_S and outcome.code == 2:
                        said = said or f"took {outcome.cpu_s:.1f} s"
                    if said:
                        print(
                            f"{file.parent.name}/{file.name} {relative} · {slot.words} [{slot.place}] · {said}",
                            flush=True,
                        )
                        failures.setdefault(slot.words, []).append(said)
                        options.keep.mkdir(parents=True, exist_ok=True)
                        kept = f"{SLOTS.index(slot)}_{file.parent.name}_{file.stem}_{relative}{file.suffix}"
                        shutil.copyfile(tried, options.keep / kept)
    found = {"files": len(files), "relatives": options.relatives, "runs": sum(codes.values()), "codes": codes}
    found["failures"] = sum(map(len, failures.values()))
    print(json.dumps(found, indent=1))
    for words, seconds in sorted(slow.items(), key=lambda item: -item[1])[:12]:
        print(f"{seconds:6.1f} s  {words}")
    if options.out is not None:
        options.out.write_text(json.dumps(found, indent=1) + "\n")
    return int(bool(failures))


if __name__ == "__main__":
    sys.exit(main())
