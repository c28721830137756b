"""Checkpoints of a reconstruction that cannot be written."""

import errno
import os
from pathlib import Path
from unittest.mock import MagicMock

import numpy as np
import pytest
import torch

from pixelid.errors import OutputError
from pixelid.nerf.training import checkpoint
from pixelid.nerf.training.held_out import Regularisation, Stopping


@pytest.fixture
def state(monkeypatch):
    """A stand-in for a state, of which 100 kB are written."""
    monkeypatch.setattr(checkpoint, "FORMAT", "x" * 100_000)
    state = MagicMock(iteration=1, rays=1, seconds=0.0, history=[], optimiser=MagicMock(state_dict=dict))
    state.field.occupied, state.field.bricks.index = np.zeros(3, bool), np.zeros(3, np.int32)
    state.field.young = np.zeros(3, bool)
    state.stopping, state.regularisation = Stopping(), Regularisation()
    state.field.vertices = 3
    for part in (state.field.grid, state.field.coefficients, state.field.log_background, state.pixel.factors,
                 state.pixel.added, state.pixel.departures, state.poses.offset, state.poses.moved):  # fmt: skip
        part.detach.return_value.cpu.return_value = torch.zeros(3)
    return state


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full")
def test_a_full_disk_is_said_and_the_old_checkpoint_stays(state, tmp_path, monkeypatch):
    """PyTorch's own stream says nothing of the disk."""
    file = tmp_path / "field.ckpt"
    file.write_bytes(b"old")
    make = os.mkdir

    def with_link(path, *mode, **options):  # a temporary folder whose file is on a full disk
        make(path, *mode, **options)
        (Path(path) / "field.ckpt").symlink_to("/dev/full")

    monkeypatch.setattr(os, "mkdir", with_link)
    with pytest.raises(OutputError) as caught:
        checkpoint.save(file, state, "")
    monkeypatch.undo()
    why = os.strerror(errno.ENOSPC)
    assert str(caught.value) == f"{file}: cannot be written ({why}); what was there before is unchanged"
    assert file.read_bytes() == b"old"
    assert [path.name for path in tmp_path.iterdir()] == ["field.ckpt"]


def test_what_is_written_is_what_pytorch_reads(state, tmp_path):
    checkpoint.save(tmp_path / "field.ckpt", state, "mark")
    document = torch.load(tmp_path / "field.ckpt", weights_only=True)
    assert (document["format"], document["mark"], document["vertices"]) == (checkpoint.FORMAT, "mark", 3)
    assert torch.equal(document["grid"], torch.zeros(3))
