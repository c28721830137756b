"""Give every command well-formed files of which one field is hostile: `python tests/structures.py --each 10`.

`mutants.py` makes the files; each goes, in place of a good one, to each command that reads such a file (`CASES`), in a
process forked from one in which everything is imported.  `replay.complaint` judges the answers; what lies beside must
be as it was, byte for byte.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))
import fuzz_targets
import replay
from mutants import Mutant, content, mutants
from processes import Outcome, import_everything, run

import pixelid.cli.main

CPU_S, MOST_CPU_S = 5.0, 60  # of an answer that refuses; before a run is ended that computes: the longest takes 14
FEW = replay.FEW
COMPUTED = ("latency/", "noisefit/", "result_sensor/m", "eds/", "tumvie/")
HEAVY = ("--align auto", "gap ", "conform ", "compare ", "lowlight ", "fit ", "sensor ", "reconstruct ", "design ",
         "latency latency", "noise noise.csv --out")  # fmt: skip


@dataclass(frozen=True)
class Case:
    """A good file, its place in the folder, and the words of a command that reads it there."""

    file: str
    words: str

    @property
    def heavy(self) -> bool:
        """Whether it computes for seconds when it is not refused."""
        return any(word in self.words for word in HEAVY)

    @property
    def computed(self) -> bool:
        """Whether its good file is the result of a command, not one of `prepare_plain`."""
        return self.file.startswith(COMPUTED)

    @property
    def command(self) -> str:
        """The first word."""
        return self.words.split()[0]


def _cases() -> list[Case]:
    found: list[Case] = []

    def reads(file: str, *words: str) -> None:
        found.extend(Case(file, text.format(file=file)) for text in words)

    for recording in ("four.h5", "four.npz", "four.csv"):
        reads(recording, "inspect {file} --out out", "convert {file} out.h5", "convert {file} out.csv",
              "convert {file} out.npz --roi 0,0,2,2 --time 0:0.5 --pixels 2", "convert {file} out.h5 --stimulus chirp",
              "convert {file} out.h5 --stimulus chirp --align auto",
              "simulate dvs128 --stimulus {file} --out out.h5 --pixels 2")  # fmt: skip
    for recording in ("four.h5",):
        reads(recording, "inspect {file} --json", "fit {file} --model dvs128 --out out " + FEW,
              "gap {file} --model dvs128 --out out",
              "conform {file} --model dvs128 --out out",
              "compare {file} --model dvs128 --model dvs128_low_light --out out",
              "sensor {file} --model dvs128 --out out --bootstrap 2 --tile 2", "noise {file} --out out",
              "flicker {file} --out out --groups 2x2", "lowlight dvs128 {file} --out out",
              "design dvs128 --out out --recorded {file} --draws 1 --pixels 2",
              "convert {file} out.h5 --stimulus sensor", "convert {file} out.h5 --stimulus chirp --align trigger",
              )  # fmt: skip
    for camera in ("dsec.h5", "prophesee.h5"):
        reads(camera, "inspect {file} --out out", "convert {file} out.h5", "noise {file} --out out")
    reads("measured.h5", "convert {file} out.h5 --stimulus sensor")
    for light in ("light.csv", "light.npy", "light.npz"):
        reads(light, "simulate dvs128 --stimulus {file} --out out.h5 --pixels 2",
              "convert four.h5 out.h5 --stimulus {file}", "convert four.h5 out.h5 --stimulus {file} --align auto",
              "convert four.h5 out.h5 --stimulus {file} --align first-event")  # fmt: skip
    for light in ("sine.toml", "steps.toml", "chirp.toml", "grating.toml", "samples.toml", "file.toml"):
        reads(light, "simulate dvs128 --stimulus {file} --out out.h5 --pixels 2")
    for model in ("dvs128.toml", "rich.toml"):
        reads(model, "models {file}", "simulate {file} --stimulus chirp --out out.h5 --pixels 2",
              "fit four.h5 --model {file} --out out " + FEW,
              "compare four.h5 --model {file} --model dvs128_low_light --out out",
              "sensor four.h5 --model {file} --out out --bootstrap 0",
              "noise noise.csv --predict --model {file} --out out",
              "flicker four.h5 --model {file} --out out --groups 1x1", "lowlight {file} --out out",
              "design {file} --out out --draws 1 --pixels 2", "export {file} --to v2e --out out.yaml",
              "export {file} --to dvs-voltmeter --out out.json", "export {file} --to iebcs --out out.json",
              "export {file} --to esim --out out.txt", "export {file} --to deblur-e-nerf --out out.npz",
              "gap four.h5 --model {file} --out out", "conform four.h5 --model {file} --out out",
              "reconstruct scene --fit {file} --out out --steps 2 --cells 8")  # fmt: skip
    reads("latent.toml", "latency latency.csv --predict --model {file} --out out", "lowlight {file} --out out",
          "latency latency.csv --model {file} --out out")  # fmt: skip
    reads("recipe.toml", "fit {file} --out out")
    reads("menu.toml", "design dvs128 --menu {file} --out out --draws 1 --pixels 2")
    reads("pool.toml", "rates {file} --out out")
    reads("pool.npz", "rates pool.toml --out out")
    reads("latency.toml", "latency {file} --out out")
    reads("latency.csv", "latency {file} --out out", "latency {file} --predict --model gen31 --out out",
          "lowlight gen31 --latency {file} --out out", "latency latency.toml --out out")  # fmt: skip
    reads("noise.csv", "noise {file} --out out", "noise {file} --predict --model dvs128 --out out")
    reads("rates.csv", "rates {file} --out out")
    reads("biases.csv", "rates {file} --bias-law --out out")
    reads("static_noise_pos_161lux.npy", "inspect static_noise_pos_161lux.npy static_noise_neg_161lux.npy --out out")
    for name in replay.RESULTS:
        folder, _, _ = replay._result(name).partition("/")
        reads(replay._result(name), f"report {folder}")
    reads("result_fit/fit.json", "models result_fit", "export result_fit --to esim --out out.txt",
          "lowlight result_fit --out out", "design result_fit --out out --draws 1 --pixels 2",
          "simulate result_fit --stimulus chirp --out out.h5 --pixels 2",
          "noise noise.csv --predict --model result_fit --out out", "sensor four.h5 --model result_fit --out out",
          "fit four.h5 --model result_fit --out out " + FEW,
          "compare four.h5 --model result_fit --model dvs128_low_light --out out",
          "reconstruct scene --fit result_fit --out out --steps 2 --cells 8")  # fmt: skip
    reads("result_fit/model.toml", "models result_fit", "lowlight result_fit --out out", "report result_fit",
          "export result_fit --to esim --out out.txt",
          "reconstruct scene --fit result_fit --out out --steps 2 --cells 8")  # fmt: skip
    reads("result_gap/gap.json", "reconstruct scene --fit result_gap --out out --steps 2 --cells 8")
    reads("result_gap/model.toml", "report result_gap")
    for name in ("sensor.json", "maps.npz", "model.toml"):
        reads(f"result_sensor/{name}", "reconstruct scene --sensor result_sensor --out out --steps 2 --cells 8",
              "report result_sensor")  # fmt: skip
    for name in ("reconstruction.json", "field.npz"):
        reads(f"result_reconstruction/{name}", "report result_reconstruction",
              "render result_reconstruction --out out --frames 1 --size 4 4")  # fmt: skip
    reads("latency/latency.json", "lowlight latency --out out", "report latency",
          "latency latency.csv --predict --model latency --out out",
          "noise noise.csv --predict --model latency --out out")  # fmt: skip
    reads("latency/model.toml", "lowlight latency --out out", "latency latency.csv --predict --model latency --out out")
    reads("noisefit/noise.json", "noise noise.csv --predict --model noisefit --out out", "report noisefit")
    for name in ("raw_events.npz", "camera_poses.npz", "camera_calibration.npz", "renderer_params.npz", "views/a.png",
                 "views/transforms_val.json", "views/transforms_train.json"):  # fmt: skip
        reads(f"scene/{name}", "reconstruct scene --out out --steps 2 --cells 8")
    reads("scene/camera_poses.npz", "render result_reconstruction --views {file} --out out --size 4 4 --frames 2")
    reads("scene/views/transforms_val.json",
          "render result_reconstruction --views {file} --out out --size 4 4 --frames 2")  # fmt: skip
    reads("eds/events.h5", "dataset eds eds out")
    reads("eds/stamped_groundtruth.txt", "dataset eds eds out")
    reads("tumvie/mocap-desk2-events_left.h5", "dataset tumvie tumvie out")
    reads("tumvie/mocap-desk2-vi_gt_data/mocap_data.txt", "dataset tumvie tumvie out")
    reads("tumvie/camera-calibrationA.json", "dataset tumvie tumvie out")
    return found


CASES = _cases()
RICH = """[model]
name = "rich"
photoreceptor = "second_order"
effects = ["source_follower_pole", "differencing_pole", "threshold_mismatch", "threshold_noise", "refractory_period",
           "leak", "dark_current", "shot_noise", "timestamp_quantisation", "hot_pixels", "readout_latency"]
radiance_unit = "fA"

[parameters]
refractory_s = 0.001

[parameters."leak.rate_hz"]
value = 0.2
lower = 0.001
upper = 10.0
free = true
transform = "log"
prior = { mean = 0.1, sd = 1.0 }
unit = "Hz"
source = "s"

[gauge]
q_in = 0.875
A_loop = "0.7 A_amp"
q_mil = 0.015

[[described]]
stage = "comparator"
quantity = "on_threshold"
covariate = "previous_polarity"
form = "constant"
parameters = { strength = -0.04 }
"""
RECIPE = """[fit]
recordings = ["four.h5"]
model = "dvs128"
with = ["leak:rate_hz=0.1"]
without = ["threshold_mismatch"]
fix = ["alpha=61110", "beta=1851", "sf_cutoff_hz=50", "diff_cutoff_hz=1000", "refractory_s=0.001"]
gauge = ["q_in=0.875", "A_loop=0.7 A_amp", "q_mil=0.015"]
between = "auto"
engine = "casadi"
form = "discrete"
seed = 3
roi = [0, 0, 2, 2]
time = [0.0, 0.4]
pixels = 3
without_hot_pixels = false
sample = false
profile = false
"""
MENU = """[[stimulus]]
name = "a"
kind = "steps"
level = 24.0
duration_s = 0.1
[[stimulus]]
name = "b"
kind = "chirp"
level = 24.0
duration_s = 0.1
"""
LIGHTS = {
    "sine": 'kind = "sine"\nlevel = 24.0\nfrequency_hz = 10.0\nduration_s = 0.2\nstart_s = 0.1',
    "steps": 'kind = "steps"\nlevel = 24.0\nhold_s = 0.02\nedge_s = 0.0002\nduration_s = 0.1\ndt = 0.00005\nseed = 1',
    "chirp": 'kind = "chirp"\nlevel = 24.0\nduration_s = 0.1',
    "grating": 'kind = "grating"\nlevel = 24.0\nwidth = 4\nheight = 2\nduration_s = 0.05',
    "samples": 'kind = "samples"\nt = [0.0, 0.1, 0.1001, 0.3]\nradiance = [100.0, 100, 150, 150.0]\nunit = "lux"\n'
    'interpolation = "linear"',
    "file": 'kind = "file"\npath = "light.csv"\nunit = "lux"',
}
LATENCY_ROWS = "camera,lens,polarity,irradiance_W_m2,bias_config,min,median,max,stdev,pixels\n" + "".join(
    f"CAM3,f2,{on},{light},0,{median * 0.8},{median},{median * 1.5},{3},100\n"
    for on in (0, 1)
    for light, median in ((0.006, 900.0), (0.05, 300.0), (0.1, 200.0), (0.4, 110.0))
)


def prepare(folder: Path) -> None:
    """Write every good file into an empty folder."""
    replay.prepare(folder)
    (folder / "good.h5").unlink()
    _write_plain(folder)
    for words in ("latency latency.csv --out latency", "noise noise.csv --out noisefit"):
        done = run(words.split(), folder)
        assert done.code in (0, 1), done.said


def prepare_plain(folder: Path) -> None:
    """Write the good files that no command has to make into an empty folder."""
    list(fuzz_targets._scenes(folder))
    replay.write_results(folder)
    (folder / "noise.csv").write_text(replay.NOISE)
    _write_plain(folder)


def _write_plain(folder: Path) -> None:
    import numpy as np

    for name, text in LIGHTS.items():
        (folder / f"{name}.toml").write_text(f"[stimulus]\n{text}\n")
    (folder / "light.csv").write_text("time_ms,radiance_lux\n# unit: lux\n0,10\n100,11.5\n200,12\n600,11\n")
    t = np.linspace(0, 0.6, 20)
    np.save(folder / "light.npy", np.stack([t, 20 + np.cos(9 * t)]))
    np.savez(folder / "light.npz", t=t, radiance=20 + np.cos(9 * t), unit=np.array("lux"))
    write_recordings(folder)
    shutil.copy(replay.MODELS / "dvs128.toml", folder)
    shutil.copy(replay.MODELS / "gen31.toml", folder / "latent.toml")
    for name, text in (("rich", RICH), ("recipe", RECIPE), ("menu", MENU)):
        (folder / f"{name}.toml").write_text(text)
    chance = np.random.default_rng(0)
    np.savez(folder / "pool.npz", mean=5 + chance.random((2, 4)), spread=np.full((2, 4), 0.1))
    (folder / "pool.toml").write_text(
        '[rates]\ntable = "pool.npz"\nfrequency_hz = [5.0, 12.5, 25.0, 200.0]\nconditions = ["a", "b"]\n'
        'arrays = [{ mean = "mean", spread = "spread", label = "near" }]\n'
    )
    (folder / "latency.csv").write_text(LATENCY_ROWS)
    (folder / "latency.toml").write_text(
        '[latency]\ntables = ["latency.csv"]\ncameras = ["CAM3"]\nname = "n"\nsummary = "s"\n'
    )
    (folder / "rates.csv").write_text("freq_hz,slow,fast\n1,70,80\n5,200,300\n10,300,500\n50,100.5,200\n")
    (folder / "biases.csv").write_text(
        "freq_hz,fo1300,fo1400,fo1477\n1,70,80,90\n5,200,300,320\n10,300,500,600\n50,100.5,200,400\n"
    )
    for sign in ("pos", "neg"):
        below = np.cumsum(chance.integers(0, 3, (50, 72)), axis=1)
        below[:, -1] = 0
        np.save(folder / f"static_noise_{sign}_161lux.npy", below)


def write_recordings(folder: Path) -> None:
    """Four pixels under 0.6 s of changing light, with everything that a recording may hold; files of cameras."""
    import h5py
    import numpy as np

    from pixelid.recordings import Events, Recording, write_recording
    from pixelid.recordings.triggers import Triggers
    from pixelid.stimuli.stimulus import Stimulus

    chance, n = np.random.default_rng(3), 120
    t = np.sort(chance.choice(6 * 10**5, n, replace=False)) * 1000
    x, y, on = (chance.integers(0, 2, n) for _ in range(3))
    events = Events.from_columns(t, x, y, on, 2, 2, tick_ns=1000)
    light = Stimulus.from_arrays(np.linspace(0, 0.6, 30), 20 + chance.random(30), "fA")
    edges = Triggers.from_columns(np.array([10**6, 3 * 10**8]), np.array([1, 0]), np.array([0, 0]))
    recording = Recording(
        events, light, "a", "b", attributes={"biases": {"diff": 80}, "temperature_k": 300.0}, triggers=edges
    )
    for suffix in (".h5", ".npz", ".csv"):
        write_recording(recording if suffix == ".h5" else Recording(events, light, "a", "b"), folder / f"four{suffix}")
    from dataclasses import replace

    pairs = np.arange(40)
    exposures = Events.from_columns(pairs * 10**7, pairs // 2 % 2, pairs // 4 % 2, pairs % 2, 2, 2)
    write_recording(replace(recording, exposures=exposures, stimulus=None), folder / "measured.h5")
    with h5py.File(folder / "prophesee.h5", "w") as file:
        file.attrs["geometry"] = "4x3"
        file["CD/events"] = np.rec.fromarrays(
            [x, y, on, t // 1000], dtype=[("x", "<u2"), ("y", "<u2"), ("p", "<i2"), ("t", "<i8")]
        )
        file["EXT_TRIGGER/events"] = np.array([(1, 500, 6), (0, 900, 6)], [("p", "<i2"), ("t", "<i8"), ("id", "<i2")])
    with h5py.File(folder / "dsec.h5", "w") as file:
        for name, column in (("t", t // 1000), ("x", x), ("y", y), ("p", on)):
            file.create_dataset(f"events/{name}", data=column, compression="gzip", shuffle=True, chunks=(16,))
        file["t_offset"], file["ms_to_idx"] = 1000, np.arange(5)


Prints = dict[str, tuple[int, ...]]


def fingerprints(folder: Path) -> Prints:
    """What every file below a folder is told by: another one in its place, or new content, shows."""
    found = {}
    for here, _, files in os.walk(folder):
        for name in ("", *files):
            status = os.lstat(os.path.join(here, name))
            told = (status.st_ino, status.st_size, status.st_mtime_ns) if name else ()
            found[os.path.relpath(os.path.join(here, name), folder)] = told
    return found


class Hang(BaseException):
    """The CPU time is used up."""


def run_here(words: Sequence[str], folder: Path, cpu_s: float) -> Outcome:
    """Run the command line in this process, which spares a fork; for what is refused, or done at once."""

    def too_long(*_: object) -> None:
        raise Hang

    out, err = io.StringIO(), io.StringIO()
    home, before, began = os.getcwd(), signal.signal(signal.SIGVTALRM, too_long), time.process_time()
    os.chdir(folder)
    signal.setitimer(signal.ITIMER_VIRTUAL, cpu_s)
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = pixelid.cli.main.main(list(words))
    except Hang:
        code = -signal.SIGXCPU
    except (Exception, SystemExit) as error:
        code = 99
        print(f"escaped: {error!r}", file=err)
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
        signal.signal(signal.SIGVTALRM, before)
        os.chdir(home)
    return Outcome(code, err.getvalue(), {}, out.getvalue(), time.process_time() - began)


def put(folder: Path, case: Case, other: bytes) -> bytes:
    """Replace the good file by another; what was there."""
    place = folder / case.file
    good = place.read_bytes()
    place.write_bytes(other)
    return good


def answer(folder: Path, case: Case, mutant: Mutant, cpu_s: int = MOST_CPU_S) -> tuple[Outcome, str]:
    """How a command answers a mutant, and what is wrong with that."""
    good = put(folder, case, content(mutant))
    try:
        before = fingerprints(folder)
        words = [*case.words.split(), *(["--quiet"] if case.heavy or len(mutant[0]) % 2 else [])]
        outcome = run(words, folder, cpu_s=cpu_s) if case.heavy else run_here(words, folder, cpu_s)
        said = complaint(case, outcome, before, fingerprints(folder))
    finally:
        remove_new(folder, before)
        (folder / case.file).write_bytes(good)
    return outcome, said


def complaint(case: Case, outcome: Outcome, before: Prints, after: Prints) -> str:
    """What is wrong with an answer; empty when nothing is."""
    if outcome.code == -signal.SIGXCPU and case.heavy:  # accepted, and at work
        return ""
    page = {f"{case.words.split()[1]}/report.html"} if case.command == "report" else set()
    if said := replay.complaint(outcome, set(before) | page, set(after) | page):
        return said
    spoiled = [name for name in before.keys() & after.keys() - page if before[name] != after[name]]
    if spoiled:
        return f"changed: {spoiled[:3]}"
    return f"took {outcome.cpu_s:.1f} s" if outcome.code == 2 and outcome.cpu_s > CPU_S else ""


def remove_new(folder: Path, before: Prints) -> None:
    """Remove what has come since."""
    for left in set(fingerprints(folder)) - set(before):
        there = folder / left
        if there.is_dir():
            shutil.rmtree(there, ignore_errors=True)
        else:
            there.unlink(missing_ok=True)


def chosen(
    cases: list[Case], made: dict[str, list[Mutant]], each: int, heavy: int, chance: random.Random
) -> list[tuple[Case, Mutant]]:
    """So many mutants of every case, drawn anew for each of them, in any order."""
    found = []
    for case in cases:
        count = min(heavy if case.heavy else each, len(made[case.file]))
        found += [(case, mutant) for mutant in chance.sample(made[case.file], count)]
    chance.shuffle(found)
    return found


def main() -> int:
    """Run the loop of the command line; 1 when an answer was wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--each", type=int, default=10, help="mutants of each case")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--heavy", type=int, default=3, help="of those that compute for seconds")
    parser.add_argument("--only", default="", help="only cases whose file and words contain this")
    parser.add_argument("--log", type=Path, help="a line for every answer")
    parser.add_argument("--prepared", type=Path, help="folder of the good files, made where it does not exist")
    parser.add_argument("--cpu-s", type=int, default=MOST_CPU_S)
    options = parser.parse_args()
    import_everything()
    chance = random.Random(options.seed)
    with tempfile.TemporaryDirectory(dir="/dev/shm" if os.access("/dev/shm", os.W_OK) else None) as name:
        folder = Path(name) / "here"
        folder.mkdir()
        if options.prepared and options.prepared.exists():
            shutil.copytree(options.prepared, folder, dirs_exist_ok=True)
        else:
            prepare(folder)
            if options.prepared:
                shutil.copytree(folder, options.prepared)
        cases = [case for case in CASES if options.only in f"{case.file}: {case.words}"]
        made = {file: mutants(folder / file) for file in {case.file for case in cases}}
        todo = chosen(cases, made, options.each, options.heavy, chance)
        print(f"{len(todo)} of {sum(len(made[case.file]) for case in cases)} mutants of {len(cases)} cases", flush=True)
        counts: Counter[tuple[str, int]] = Counter()
        failures = 0
        log = options.log.open("a") if options.log else None
        for case, mutant in todo:
            began = time.monotonic()
            outcome, said = answer(folder, case, mutant, options.cpu_s)
            counts[case.command, outcome.code] += 1
            words = " ".join(outcome.said.split())
            line = json.dumps(
                [
                    case.file,
                    mutant[0],
                    case.words,
                    outcome.code,
                    round(outcome.cpu_s, 2),
                    outcome.bytes >> 20,
                    words[:400],
                ]
            )
            if log:
                print(line, file=log, flush=True)
            if said:
                failures += 1
                print(f"{case.file} · {mutant[0]} · {case.words} · {said}", flush=True)
            del began
        for (command, code), count in sorted(counts.items()):
            print(f"{command:12s} {code:4d} {count}")
    print(f"{sum(counts.values())} runs, {failures} failures")
    return int(bool(failures))


if __name__ == "__main__":
    sys.exit(main())
