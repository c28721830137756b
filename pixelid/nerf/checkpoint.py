"""A training state on disk, whole or not at all; read back, training continues with the same numbers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from pixelid.nerf import parallel
from pixelid.nerf.pixel import Bandwidth
from pixelid.nerf.train import Problem, Recipe, State, optimiser_of, start
from pixelid.outputs import set_aside, whole_file

FORMAT = "pixelid-reconstruction-checkpoint"


def run_identity(problem: Problem, recipe: Recipe, bandwidth: Bandwidth, inputs: dict[str, str]) -> str:
    """What must agree between the run that wrote a checkpoint and the one that continues it."""
    pinned = (problem.gauge.kind, problem.gauge.background.tolist(), problem.low.tolist(), problem.high.tolist())
    return repr((recipe, bandwidth, problem.circuit, problem.dark.tolist(), pinned, sorted(inputs.items())))


def save(path: Path, state: State, mark: str) -> None:
    """Write a checkpoint, replacing the one before."""
    document = {
        "format": FORMAT,
        "mark": mark,
        "iteration": state.iteration,
        "rays": state.rays,
        "history": state.history,
        "grid": state.field.grid.detach().cpu(),
        "log_background": state.field.log_background.detach().cpu(),
        "occupied": torch.from_numpy(state.field.occupied),
        "factors": state.pixel.factors.detach().cpu(),
        "departures": state.pixel.departures.detach().cpu(),
        "optimiser": state.optimiser.state_dict(),
    }
    with whole_file(Path(path), overwrite=True) as temporary:
        torch.save(document, temporary)


def load(
    path: Path, problem: Problem, recipe: Recipe, bandwidth: Bandwidth, mark: str, device: str = "cpu"
) -> State | None:
    """The state of a checkpoint; None for a damaged file and for one of another run, which are set aside, and said."""
    try:
        document = torch.load(path, map_location=device, weights_only=True)
        if document["format"] != FORMAT:
            raise KeyError("format")
        foreign = document["mark"] != mark
        state = None if foreign else _restored(document, problem, recipe, bandwidth, device)
    except Exception:  # unpickling fails in many ways, and so does what was pickled otherwise
        _refuse(path, "is no checkpoint of a reconstruction, or damaged", "damaged")
        return None
    if state is None:
        _refuse(path, "is of a run with other data, options or seed", "other")
    return state


def _refuse(path: Path, why: str, suffix: str) -> None:
    """Set the file aside, once where several processes share the work."""
    if parallel.rank() == 0:
        set_aside(path, why, suffix)


def _restored(document: dict, problem: Problem, recipe: Recipe, bandwidth: Bandwidth, device: str) -> State:
    """The state that `save` put down."""
    state = start(problem, recipe, bandwidth, device)
    state.field.grid = torch.nn.Parameter(document["grid"])
    with torch.no_grad():
        state.field.log_background.copy_(document["log_background"])
        state.pixel.factors.copy_(document["factors"])
        state.pixel.departures.copy_(document["departures"])
    state.field.occupied = np.ascontiguousarray(document["occupied"].cpu().numpy())
    state.optimiser = optimiser_of(state.field, state.pixel, recipe)
    state.optimiser.load_state_dict(document["optimiser"])
    state.iteration, state.rays, state.history = document["iteration"], document["rays"], document["history"]
    return state
