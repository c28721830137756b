"""Checkpoints of a reconstruction that cannot be written."""

from unittest.mock import MagicMock

import numpy as np
import pytest
import torch

from pixelid.errors import OutputError
from pixelid.nerf import checkpoint


def test_a_write_that_fails_is_said_and_the_old_checkpoint_stays(tmp_path, monkeypatch):
    """PyTorch's stream raises RuntimeError, and says nothing of the disk."""
    file = tmp_path / "field.ckpt"
    file.write_bytes(b"old")

    def fails(document, path):
        path.write_bytes(b"half")
        raise RuntimeError("basic_ios::clear: iostream error")

    monkeypatch.setattr(torch, "save", fails)
    state = MagicMock()
    state.field.occupied, state.field.bricks.index = np.zeros(3, bool), np.zeros(3, np.int32)
    with pytest.raises(OutputError, match=r"field\.ckpt: cannot be written"):
        checkpoint.save(file, state, "")
    assert file.read_bytes() == b"old"
    assert [path.name for path in tmp_path.iterdir()] == ["field.ckpt"]
