"""Several processes, each with its share of every batch: what `torchrun` starts.  One process needs none of this."""

from __future__ import annotations

import os
from collections.abc import Iterable

import numpy as np
import torch


def launched() -> bool:
    """Whether `torchrun` started this process among others."""
    return int(os.environ.get("WORLD_SIZE", "1")) > 1


def join(device: str) -> None:
    """Meet the other processes, when there are any: by gloo on "cpu", by NCCL on "cuda", each on a GPU of its own."""
    if launched() and not torch.distributed.is_initialized():
        if device == "cuda":
            torch.cuda.set_device(int(os.environ.get("LOCAL_RANK", "0")) % torch.cuda.device_count())
        torch.distributed.init_process_group("nccl" if device == "cuda" else "gloo")


def leave() -> None:
    """Part from them."""
    if torch.distributed.is_available() and torch.distributed.is_initialized():
        torch.distributed.destroy_process_group()


def rank() -> int:
    """Which process this is; 0 when alone."""
    return int(os.environ.get("RANK", "0")) if launched() else 0


def world() -> int:
    """How many there are."""
    return int(os.environ.get("WORLD_SIZE", "1")) if launched() else 1


def average(value: float) -> float:
    """The mean of a number over the processes: NaN for all when it is NaN for one."""
    if not (launched() and torch.distributed.is_initialized()):
        return value
    device = "cuda" if torch.distributed.get_backend() == "nccl" else "cpu"
    total = torch.tensor(value, dtype=torch.float64, device=device)
    torch.distributed.all_reduce(total)
    return float(total) / world()


def agreed(values: np.ndarray) -> np.ndarray:
    """What the first process has of numbers that all have, to rounding."""
    if not (launched() and torch.distributed.is_initialized()):
        return values
    device = "cuda" if torch.distributed.get_backend() == "nccl" else "cpu"
    own = torch.tensor(values, dtype=torch.float64, device=device)
    torch.distributed.broadcast(own, 0)
    return own.cpu().numpy()


def average_gradients(parameters: Iterable[torch.Tensor]) -> None:
    """Replace every gradient by its mean over the processes."""
    if not (launched() and torch.distributed.is_initialized()):
        return
    for parameter in parameters:
        if parameter.grad is None:
            parameter.grad = torch.zeros_like(parameter)
        torch.distributed.all_reduce(parameter.grad)
        parameter.grad /= world()
