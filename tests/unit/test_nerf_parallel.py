"""Several processes: how they meet, and that another number of them continues no other run."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from pixelid.nerf.pixel.model import Bandwidth
from pixelid.nerf.training import parallel
from pixelid.nerf.training.checkpoint import run_identity
from pixelid.nerf.training.recipe import Recipe
from tests.unit.test_nerf_search import CIRCUIT


@pytest.mark.parametrize(("device", "backend", "chosen"), [("cpu", "gloo", []), ("cuda", "nccl", [3])])
def test_the_device_says_how_processes_meet(monkeypatch, device, backend, chosen):
    """Work on the CPU goes by gloo where there is CUDA too; ranks on CUDA have a GPU each."""
    met, gpus = [], []
    monkeypatch.setenv("WORLD_SIZE", "4")
    monkeypatch.setenv("LOCAL_RANK", "3")
    monkeypatch.setattr(torch.distributed, "is_initialized", lambda: False)
    monkeypatch.setattr(torch.distributed, "init_process_group", met.append)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 4)
    monkeypatch.setattr(torch.cuda, "set_device", gpus.append)
    parallel.join(device)
    assert (met, gpus) == ([backend], chosen)


def test_another_number_of_processes_is_another_run(monkeypatch):
    """Each draws its own share of every batch."""
    nothing = np.zeros(3)
    gauge = SimpleNamespace(kind="free", background=nothing)
    problem = SimpleNamespace(gauge=gauge, low=nothing, high=nothing, circuit=CIRCUIT, dark=nothing, near=0.0)

    def mark() -> str:
        return run_identity(problem, Recipe(), Bandwidth(), {})  # type: ignore[arg-type]

    alone = mark()
    assert mark() == alone
    problem.near = 0.5
    assert mark() != alone
    problem.near = 0.0
    assert mark() == alone
    monkeypatch.setenv("WORLD_SIZE", "2")
    assert mark() != alone
