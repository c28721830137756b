"""Disks that fail at each step of a command, and kills: the old result stays, the next run gives the same numbers."""

import json
import os
import subprocess
import sys
from pathlib import Path

import faults
import numpy as np
import pytest
from processes import Outcome

from pixelid.recordings import Events, Recording, write_recording

TESTS = str(Path(__file__).resolve().parents[1])
SCRIPT = str(Path(TESTS) / "faults.py")

SURVEY = """
import json, sys
from pathlib import Path
sys.path.insert(0, {tests!r})
import faults
print(json.dumps(faults.faults_of({name!r}, Path("."))))
"""


@pytest.mark.parametrize("name", ["convert to .h5", "convert to .csv", "export"])
def test_a_disk_that_fails_at_each_step(name, tmp_path):
    here = tmp_path / "here"
    here.mkdir()
    t = np.arange(4000) * 1_000_003
    events = Events.from_columns(t, t % 7, t % 5, t % 2, 8, 8)
    write_recording(Recording(events), here / "chirp.h5")
    found = json.loads(preloaded(["-c", SURVEY.format(tests=TESTS, name=name)], here, tmp_path))
    assert found.keys() == faults.FAULTS.keys()
    for fault, entry in found.items():
        assert not entry["complaint"]
        assert entry["refused"] >= 1 or fault in ("link", "truncate")  # what can be done without


def preloaded(words: list[str], folder: Path, aside: Path) -> str:
    """What Python prints in a folder, with calls that can be made to fail."""
    library = faults.compiled(aside)
    if library is None:
        pytest.skip("no C compiler")
    environment = {**os.environ, "LD_PRELOAD": str(library)}
    done = subprocess.run(
        [sys.executable, *words], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_judge_of_faults_sees_what_is_wrong():
    before = {"out": b"old"}
    for code, said, after in (
        (2, "pixelid: out: cannot be written", {"out": b"new"}),
        (2, "pixelid: out: cannot be written", {"out": b"old", "half": b""}),
        (2, "", before),
        (2, "one\ntwo", before),
        (1, "pixelid: unexpected OSError; this is a bug", before),
        (-11, "", before),
        (0, "", {}),
    ):
        assert faults.complaint(Outcome(code, said, {}), before, after)
    assert not faults.complaint(Outcome(2, "pixelid: out: cannot be written", {}), before, before)


@pytest.mark.slow
@pytest.mark.parametrize("name", faults.COMMANDS)
def test_every_command_survives_every_fault(name, tmp_path):
    preloaded([SCRIPT, "--only", name, "--most", "2"], tmp_path, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("name", faults.KILLED)
def test_a_killed_command_goes_on_to_the_same_numbers(name, tmp_path):
    preloaded([SCRIPT, "--only", name, "--kills", "5", "--out", "kills.json"], tmp_path, tmp_path)
    entry = json.loads((tmp_path / "kills.json").read_text())["kills"][name]
    assert entry["kills"] >= 2
    assert entry["equal"] == entry["kills"], entry["complaint"]


@pytest.mark.slow
@pytest.mark.parametrize("name", faults.INTERRUPTED)
def test_ctrl_c_ends_a_command_in_two_seconds(name, tmp_path):
    preloaded([SCRIPT, "--only", name, "--interrupts", "3"], tmp_path, tmp_path)
