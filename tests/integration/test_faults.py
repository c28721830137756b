"""Disks that fail at each step of a command, and kills: the old result stays, the next run gives the same numbers."""

import sys
from pathlib import Path

import numpy as np
import pytest

from pixelid.recordings import Events, Recording, write_recording

sys.path.insert(0, str(Path(__file__).parents[1]))
import faults


@pytest.mark.parametrize("name", ["convert to .h5", "convert to .csv", "export"])
def test_a_disk_that_fails_at_each_step(name, tmp_path):
    t = np.arange(4000) * 1_000_003
    events = Events.from_columns(t, t % 7, t % 5, t % 2, 8, 8)
    write_recording(Recording(events), tmp_path / "chirp.h5")
    found = faults.faults_of(name, tmp_path)
    assert found.keys() == {"full disk", "fsync", "rename", "mkdir"}
    for entry in found.values():
        assert not entry["complaint"]
        assert entry["refused"] >= 1


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
        assert faults.complaint(faults.Outcome(code, said, {}), before, after)
    assert not faults.complaint(faults.Outcome(2, "pixelid: out: cannot be written", {}), before, before)


@pytest.mark.slow
@pytest.mark.parametrize("name", faults.COMMANDS)
def test_every_command_survives_every_fault(name, tmp_path):
    faults.prepare(tmp_path)
    assert not [entry["complaint"] for entry in faults.faults_of(name, tmp_path).values() if entry["complaint"]]


@pytest.mark.slow
@pytest.mark.parametrize("name", faults.KILLED)
def test_a_killed_command_goes_on_to_the_same_numbers(name, tmp_path):
    faults.prepare(tmp_path)
    entry = faults.kills_of(name, tmp_path, 5, seed=1)
    assert entry["kills"] >= 2
    assert entry["equal"] == entry["kills"], entry["complaint"]
