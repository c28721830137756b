"""Give every command files that nobody should trust, in place of good ones.

A file comes from `mutants.py`, well-formed but for one hostile field, or is damaged in bytes by `fuzz.py`.  It goes to
each command that reads such a file (`CASES`, `LEFT_OVERS`).  `complaint` judges the answers; what lies with the file
must be as it was, byte for byte.
"""

from __future__ import annotations

import contextlib
import io
import os
import random
import shutil
import signal
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import fuzz_targets
from mutants import Mutant, content
from processes import Hang, Outcome, limited, run

import pixelid.cli.main
from pixelid.errors import printable

CPU_S, MOST_CPU_S = 5.0, 60  # of an answer that refuses; before a run is ended that computes: the longest takes 14
MOST_BYTES = 6 << 30  # at most at once, the imports' 0.6 GiB included
MOST_CHARACTERS = 1100  # of a line
NETS = ("this is a bug", "Traceback", "Warning", "escaped:")
MODELS = Path(__file__).resolve().parents[1] / "models"
DATA = Path(__file__).resolve().parent / "data"
RESULTS = ("fit.json", "gap.json", *(file.name for file in sorted((DATA / "results").glob("*.json"))))
FEW = "--fix alpha=61110 --fix beta=1851 --fix sf_cutoff_hz=50 --fix diff_cutoff_hz=1000 --fix refractory_s=0.001"
COMPUTED = ("latency/", "noisefit/", "result_sensor/m", "eds/", "tumvie/")
HEAVY = ("--align auto", "gap ", "conform ", "compare ", "lowlight ", "fit ", "sensor ", "reconstruct ", "design ",
         "latency latency", "noise noise.csv --out")  # fmt: skip


def _result(name: str) -> str:
    """The folder of a result, and the place of one of its files."""
    return f"result_{name.partition('.')[0]}/{name}"


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
        reads(model, "models {file}", "models {file} --json",
              "simulate {file} --stimulus chirp --out out.h5 --pixels 2",
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
    reads("rates.csv", "rates {file} --out out", "rates {file} --out out --unit kev/s --data .")
    reads("biases.csv", "rates {file} --bias-law --out out")
    reads("static_noise_pos_161lux.npy", "inspect static_noise_pos_161lux.npy static_noise_neg_161lux.npy --out out")
    for name in RESULTS:
        folder, _, _ = _result(name).partition("/")
        reads(_result(name), f"report {folder}")
    reads("result_fit/fit.json", "models result_fit", "export result_fit --to esim --out out.txt",
          "lowlight result_fit --out out", "design result_fit --out out --draws 1 --pixels 2",
          "simulate result_fit --stimulus chirp --out out.h5 --pixels 2",
          "noise noise.csv --predict --model result_fit --out out",
          "latency latency.csv --predict --model result_fit --out out", "sensor four.h5 --model result_fit --out out",
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
LEFT_OVERS = [  # of interrupted runs, and files of kinds without mutants; only damaged bytes go there
    Case("out.tiles/0.npz", "sensor four.h5 --model dvs128 --out out --bootstrap 0"),
    Case(".out.fits", "gap four.h5 --model dvs128 --out out"),
    Case("state.pt", "reconstruct scene --out out --steps 2 --cells 8 --checkpoint state.pt"),
    Case("result_fit/posterior.json", "report result_fit"), Case("a.bag", "dataset esim a.bag out"),
    Case("eds/calibration.yaml", "dataset eds eds out"),
]  # fmt: skip
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


NOISE = "lux,ON_events_per_s_per_px,OFF_events_per_s_per_px\n1,2.5,0.1\n10,0.5,0.05\n100,0.125,0.02\n1000,0.1,0.01\n"


def prepare(folder: Path) -> None:
    """Write every good file into an empty folder: with those of `prepare_plain` sequences of cameras, and results."""
    sys.path.insert(0, str(Path(__file__).resolve().parent / "integration"))
    import test_nerf_published as published

    from pixelid.nerf.synthetic import make_dataset

    prepare_plain(folder)
    truth = published.as_simulated(
        make_dataset(folder / "hard", "hard", seed=3, side=published.SIDE, revolutions=1.0, frames_per_turn=300)
    )
    published.write_eds(folder / "eds", truth)
    published.write_tumvie(folder / "tumvie", truth)
    shutil.rmtree(folder / "hard")
    shutil.rmtree(folder / "result_sensor")
    for words in ("latency latency.csv --out latency", "noise noise.csv --out noisefit",
                  "sensor four.h5 --model dvs128 --bootstrap 2 --out result_sensor"):  # fmt: skip
        done = run(words.split(), folder)
        assert done.code in (0, 1), done.said


def prepare_plain(folder: Path) -> None:
    """Write the good files that no command has to make into an empty folder."""
    list(fuzz_targets._scenes(folder))
    write_results(folder)
    (folder / "noise.csv").write_text(NOISE)
    _write_plain(folder)


def write_results(folder: Path) -> None:
    """A folder per kind of result, `field.npz` being there already."""
    for name in RESULTS:
        result = folder / _result(name)
        result.parent.mkdir()
        shutil.copy(DATA / name if (DATA / name).exists() else DATA / "results" / name, result)
        shutil.copy(MODELS / "dvs128.toml", result.parent / "model.toml")
    shutil.copy(folder / "field.npz", folder / "result_reconstruction")


def _write_plain(folder: Path) -> None:
    import numpy as np

    for name, text in LIGHTS.items():
        (folder / f"{name}.toml").write_text(f"[stimulus]\n{text}\n")
    (folder / "light.csv").write_text("time_ms,radiance_lux\n# unit: lux\n0,10\n100,11.5\n200,12\n600,11\n")
    t = np.linspace(0, 0.6, 20)
    np.save(folder / "light.npy", np.stack([t, 20 + np.cos(9 * t)]))
    np.savez(folder / "light.npz", t=t, radiance=20 + np.cos(9 * t), unit=np.array("lux"))
    write_recordings(folder)
    shutil.copy(MODELS / "dvs128.toml", folder)
    shutil.copy(MODELS / "gen31.toml", folder / "latent.toml")
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


def run_here(words: Sequence[str], folder: Path, cpu_s: float) -> Outcome:
    """Run the command line in this process, which spares a fork; for what is refused, or done at once."""
    out, err, home, began = io.StringIO(), io.StringIO(), os.getcwd(), time.process_time()
    os.chdir(folder)
    try:
        with limited(cpu_s), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = pixelid.cli.main.main(list(words))
    except Hang:
        code = -signal.SIGXCPU
    except (Exception, SystemExit) as error:
        code = 99
        print(f"escaped: {error!r}", file=err)
    finally:
        os.chdir(home)
    return Outcome(code, err.getvalue(), {}, out.getvalue(), time.process_time() - began)


def answer(folder: Path, case: Case, mutant: Mutant, cpu_s: int = MOST_CPU_S) -> tuple[Outcome, str]:
    """How a command answers a mutant, and what is wrong with that."""
    place = folder / case.file
    good = place.read_bytes() if place.exists() else None
    place.parent.mkdir(exist_ok=True)
    place.write_bytes(content(mutant))
    before = fingerprints(folder)
    try:
        words = [*case.words.split(), *(["--quiet"] if case.heavy or len(mutant[0]) % 2 else [])]
        outcome = run(words, folder, cpu_s=cpu_s) if case.heavy else run_here(words, folder, cpu_s)
        said = complaint(case.words, outcome, before, fingerprints(folder))
    finally:
        remove_new(folder, before)
        place.unlink(missing_ok=True)
        if good is not None:
            place.write_bytes(good)
    return outcome, said


def complaint(words: str, outcome: Outcome, before: Prints, after: Prints, most_s: float = CPU_S) -> str:
    """What is wrong with the answer to the words of a command; empty when nothing is.

    That is a traceback, the last net's "this is a bug", a crash, more than three lines, control characters, another
    exit code than 0, 1 or 2 (1 only with a result), too much time or memory, something changed, and something left
    that was not there and is no result.
    """
    command, code, said = words.split()[0], outcome.code, outcome.said
    if code == -signal.SIGXCPU and any(word in words for word in HEAVY):  # accepted, and at work
        return ""
    if any(net in said for net in NETS):
        return f"not foreseen: {said[-400:]}"
    if code not in (0, 1, 2):
        return f"exit code {code}: {said[:300]}"
    if len(said.splitlines()) > 3 or any(len(line) > MOST_CHARACTERS for line in said.splitlines()):
        return f"more than three lines: {said[:300]}"
    if code == 2 and not said.strip():
        return "exit code 2 and not a word"
    if printable(said + outcome.printed) != said + outcome.printed:
        return "control characters"
    page = {f"{words.split()[1]}/report.html"} if command == "report" else set()
    old, now = set(before) | page, set(after) | page
    kept = ("out", ".out.fits", "state.pt")  # of runs that may be continued
    if [name for name in now - old if not name.startswith(kept)] or (code == 2 and now != old):
        return f"left: {sorted(now ^ old)[:3]}"
    if code == 1 and now == old and command != "check":
        return f"exit code 1 without a result: {said[:300]}"
    if outcome.bytes > MOST_BYTES:
        return f"took {outcome.bytes >> 20} MiB"
    same = [name for name in before.keys() & after.keys() - page if not name.startswith(kept)]
    if spoiled := [name for name in same if before[name] != after[name]]:
        return f"changed: {spoiled[:3]}"
    return f"took {outcome.cpu_s:.1f} s" if code == 2 and outcome.cpu_s > most_s else ""


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
