"""Every option and argument of every command, with values that nobody should pass: one to three lines, exit code 2.

The commands get good inputs beside the hostile value, so that what passes the command line meets what computes.
"""

import shutil
from pathlib import Path

import click
import fuzz_targets
import h5py
import numpy as np
import pytest
import structures

from pixelid.cli import options
from pixelid.cli.main import COMMANDS, LazyGroup, cli
from pixelid.recordings import Events, Recording, write_recording
from pixelid.stimuli.stimulus import Stimulus

DATA = Path(__file__).parents[1] / "data"
MOST_S = 20.0  # CPU time of an answer; imports and compilation are in it
MOST_WORK_S = 120.0  # of good inputs beside good options, in commands that fit again and again
GOOD = {  # command → words that run; {out} is free
    "models": "dvs128",
    "inspect": "good.h5 --out {out}",
    "convert": "good.h5 {out}.h5",
    "simulate": "dvs128 --stimulus good.h5 --out {out}.h5 --pixels 1",
    "check": "bench",
    "calibrate": "bench --out {out}",
    "fit": "good.h5 --model dvs128 --out {out}",
    "compare": "good.h5 --model dvs128 --model dvs128_low_light --out {out}",
    "sensor": "good.h5 --model dvs128 --out {out} --bootstrap 0",
    "rates": "rates.csv --out {out}",
    "latency": "latency.csv --out {out} --predict --model gen31",
    "flicker": "good.h5 --out {out} --groups 1x1",
    "noise": "noise.csv --out {out} --predict --model dvs128",
    "biases": "biases.csv --out {out}",
    "lowlight": "dvs128 good.h5 --out {out}",
    "design": "dvs128 --out {out} --pixels 1 --draws 1",
    "stimulus": "chirp --seconds 0.01 --out {out}.csv",
    "gap": "good.h5 --model dvs128 --out {out}",
    "conform": "good.h5 --model dvs128 --out {out}",
    "export": "dvs128 --to v2e --out {out}.yaml",
    "dataset": "eds eds {out}",
    "reconstruct": "scene --out {out} --steps 2 --cells 8 --bandwidth off --box -1 -1 -1 1 1 1",
    "render": "result --out {out} --frames 1 --size 4 4",
    "view": "dvs128 --out {out}.html",
    "report": "result",
    "demo": "--out {out}",
}
NINES = "9" * 5000
NUMBERS = ("-1e999", "nan", "inf", "-inf", "1e999", NINES, f"-{NINES}", "", "0x10", "1,5", "²", "\x1b[2J", "\0", "a b")
HUGE = ("-1", "9223372036854775808", "1e300")  # some numbers may be that
TEXTS = ("", "\0", NINES, "nan", "=", "a=nan", "a=b=c", "\x1b[31mred\u202e", "🎈" * 300, "-", "../..", ",,,")
PATHS = ("", "\0", "x" * 5000, "/dev/zero", "/nonexistent/x", ".")


def cases(command: str) -> list[tuple[list[str], bool]]:
    """(words to add to those of `GOOD`, whether they must be refused) for every option of a command."""
    group = cli
    assert isinstance(group, LazyGroup)
    found_command = group.get_command(click.Context(group), command)
    assert found_command is not None
    found = []
    for parameter in found_command.params:
        kind = parameter.type
        if isinstance(parameter, click.Argument) or isinstance(kind, click.types.BoolParamType):
            continue
        if command == "calibrate" and parameter.name in options.STATED:
            continue  # `check` has them by the same decorator, and what they leave readable is calibrated for minutes
        if isinstance(kind, click.Path):
            values = [(value, value == "\0") for value in PATHS]
        elif isinstance(kind, click.types.StringParamType):
            values = [(value, False) for value in (*TEXTS, *PATHS)]
        else:
            values = [(value, True) for value in NUMBERS]
            whole = not isinstance(kind, options.Number)
            values += [] if isinstance(kind, click.Choice) else [(v, whole and v != "-1") for v in HUGE]
        found += [([parameter.opts[0], value, *["1"] * (parameter.nargs - 1)], refused) for value, refused in values]
    return found


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with good inputs of every kind."""
    folder = tmp_path_factory.mktemp("options")
    rng, n = np.random.default_rng(3), 200
    t = np.sort(rng.choice(12 * 10**5, n, replace=False)) * 1000
    events = Events.from_columns(
        t, rng.integers(0, 2, n), rng.integers(0, 2, n), rng.integers(0, 2, n), 2, 2, tick_ns=1000
    )
    light = Stimulus.from_arrays(np.linspace(0, 1.2, 50), 20 + rng.random(50), "fA")
    write_recording(Recording(events, light), folder / "good.h5")
    (folder / "rates.csv").write_text("freq_hz,slow,fast\n1,70,80\n5,200,300\n10,300,500\n50,100.5,200\n")
    rows = "".join(f"{code},{1000 / (code + 23) + 5:.2f}\n" for code in range(0, 120, 10))
    (folder / "biases.csv").write_text(f"bias_refr,dead_time_us\n{rows}")
    (folder / "noise.csv").write_text("lux,ON_events_per_s_per_px,OFF_events_per_s_per_px\n1,2.5,0.1\n10,0.5,0.05\n")
    rows = "CAM3,f2,1,0.05,0,210,3,100\n"
    (folder / "latency.csv").write_text(f"camera,lens,polarity,irradiance_W_m2,bias_config,median,stdev,pixels\n{rows}")
    list(fuzz_targets._scenes(folder))
    write_sequence(folder / "eds")
    (folder / "bench").mkdir()
    shutil.copy(folder / "good.h5", folder / "bench")
    (folder / "result").mkdir()
    shutil.copy(DATA / "results" / "reconstruction.json", folder / "result")
    shutil.copy(folder / "field.npz", folder / "result")
    return folder


def write_sequence(folder: Path) -> None:
    """A sequence as EDS publishes it: a camera of 4 × 4 pixels that stands still for a second."""
    folder.mkdir()
    t = np.arange(0, 10**6, 10**4)
    with h5py.File(folder / "events.h5", "w") as file:
        file["t"], file["x"], file["y"], file["p"] = t, t // 10**4 % 4, t // 10**5 % 4, t // 10**4 % 2
    (folder / "stamped_groundtruth.txt").write_text("".join(f"{s} 0 0 0 0 0 0 1\n" for s in (0.0, 0.5, 1.0)))
    camera = "cam1:\n  intrinsics: [4.0, 4.0, 1.5, 1.5]\n  resolution: [4, 4]\n"
    (folder / "camchain.yaml").write_text(camera)


def answer(words: list[str], place: Path, most_s: float = MOST_S) -> int:
    """The exit code; wrong answers fail here."""
    before = structures.fingerprints(place)
    outcome = structures.run_here([*words, "--quiet"], place, most_s)
    after = structures.fingerprints(place)
    structures.remove_new(place, before)
    assert not structures.complaint(" ".join(words), outcome, before, after, most_s), (words, outcome.said)
    assert outcome.code != 2 or outcome.said.startswith("pixelid: ")
    return outcome.code


def test_every_command_has_words():
    assert GOOD.keys() == COMMANDS.keys()


@pytest.mark.parametrize("command", GOOD)
def test_what_is_no_number_and_no_choice(command, place):
    good = GOOD[command].format(out="out").split()
    for words, refused in cases(command):
        if refused:
            assert answer([command, *good, *words], place) == 2, words


@pytest.mark.slow
@pytest.mark.parametrize("command", [name for name in GOOD if name not in ("demo", "flicker")])
def test_the_words_run(command, place):
    words = [command, *GOOD[command].format(out="out").split()]
    assert answer(words, place, MOST_WORK_S) in (0, 1)


@pytest.mark.slow
@pytest.mark.parametrize("command", [name for name in GOOD if name != "demo"])  # which takes minutes, whatever its seed
def test_texts_and_huge_numbers(command, place):
    good, most_s = GOOD[command].format(out="out").split(), MOST_WORK_S  # the first call may compile
    for words, refused in cases(command):
        if not refused:
            answer([command, *good, *words], place, most_s)
            most_s = MOST_S
