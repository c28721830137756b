"""What a reconstruction has come to, on disk, whole or not at all; read back, it continues with the same numbers."""

from __future__ import annotations

import dataclasses
import io
import json
from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import torch

from pixelid.documents import read_text
from pixelid.errors import InputError
from pixelid.nerf.data.calibration import Calibration
from pixelid.nerf.field.bricks import Bricks
from pixelid.nerf.field.radiance import Field, blocks
from pixelid.nerf.pixel.model import Bandwidth
from pixelid.nerf.training import parallel
from pixelid.nerf.training.held_out import Look, Regularisation, Trial
from pixelid.nerf.training.recipe import Recipe
from pixelid.nerf.training.state import Problem, State, learned, optimiser_of, start, take
from pixelid.outputs import set_aside, whole_file

FORMAT = "pixelid-reconstruction-checkpoint-4"
# Before fields lay in bricks, before held-out events chose, while bricks could come back
OLDER = tuple(f"pixelid-reconstruction-checkpoint{number}" for number in ("", "-2", "-3"))


def run_identity(problem: Problem, recipe: Recipe, bandwidth: Bandwidth, inputs: dict[str, str]) -> str:
    """What must agree between the run that wrote a checkpoint and the one that continues it."""
    pinned = (problem.gauge.kind, problem.gauge.background.tolist(), problem.low.tolist(), problem.high.tolist())
    pinned = (*pinned, problem.near) if problem.near else pinned  # without: as before there was one
    told = (recipe, bandwidth, problem.circuit, problem.dark.tolist(), pinned, sorted(inputs.items()))
    return repr((*told, parallel.world()))  # each process draws its own share of a batch


def save(path: Path, state: State, mark: str) -> None:
    """Write a checkpoint, replacing the one before.

    Raises:
        OutputError: it cannot be written; the one before is still there.
    """
    document = {
        "format": FORMAT,
        "mark": mark,
        "iteration": state.iteration,
        "rays": state.rays,
        "seconds": state.seconds,
        "history": state.history,
        **learned(state),
        "stopping": {
            "looks": [(look.iteration, torch.from_numpy(look.losses), look.rows) for look in state.stopping.looks],
            "kept": state.stopping.kept,
            "scene": state.stopping.scene,
        },
        "regularisation": {
            "factor": state.regularisation.factor,
            "trials": [dataclasses.asdict(trial) for trial in state.regularisation.trials],
        },
        "optimiser": state.optimiser.state_dict(),
    }
    packed = io.BytesIO()  # PyTorch's own stream does not say why a write failed
    torch.save(document, packed)
    with whole_file(Path(path), overwrite=True) as temporary:
        temporary.write_bytes(packed.getbuffer())


def load(
    path: Path, problem: Problem, recipe: Recipe, bandwidth: Bandwidth, mark: str, device: str = "cpu"
) -> State | None:
    """The state of a checkpoint; None for a damaged file and for one of another run, which are set aside, and said."""
    try:
        document = torch.load(path, map_location=device, weights_only=True)
        version, foreign = document["format"], document["mark"] != mark
        state = None if foreign or version != FORMAT else _restored(document, problem, recipe, bandwidth, device)
    except Exception:  # unpickling fails in many ways, and so does what was pickled otherwise
        _refuse(path, "is no checkpoint of a reconstruction, or damaged", "damaged")
        return None
    if state is None and str(version) in OLDER:
        _refuse(path, "is of an earlier version of pixelid", "other")
    elif state is None:
        _refuse(path, "is of a run with other data, options or seed", "other")
    return state


def _refuse(path: Path, why: str, suffix: str) -> None:
    """Set the file aside, once where several processes share the work."""
    if parallel.rank() == 0:
        set_aside(path, why, suffix)


def _restored(document: dict, problem: Problem, recipe: Recipe, bandwidth: Bandwidth, device: str) -> State:
    """The state that `save` put down."""
    state = start(problem, recipe, bandwidth, device)
    said, chosen = document["stopping"], document["regularisation"]
    if said["scene"]:
        _bricks(said["scene"], state.field)  # it may be from before the field was refined last
    take(state, _bricks(document, state.field), document)
    state.optimiser = optimiser_of(state.field, state.pixel, state.poses, recipe)
    state.optimiser.load_state_dict(document["optimiser"])
    state.iteration, state.rays, state.history = document["iteration"], document["rays"], document["history"]
    state.seconds = float(document.get("seconds", 0.0))
    looks = [Look(int(at), losses.cpu().numpy(), int(rows)) for at, losses, rows in said["looks"]]
    state.stopping = replace(state.stopping, looks=looks, kept=int(said["kept"]), scene=said["scene"])
    trials = tuple(Trial(**trial) for trial in chosen["trials"])
    state.regularisation = Regularisation(float(chosen["factor"]), trials)
    return state


def _bricks(document: dict, field: Field) -> Bricks:
    """Where the rows of a checkpoint are, whose field may be finer than `field`; ValueError for odd arrays."""
    grid, coefficients, vertices = document["grid"], document["coefficients"], int(document["vertices"])
    bricks = Bricks.of_index(vertices, document["bricks"].cpu().numpy())
    shapes = (bricks.rows, *field.grid.shape[1:]), (bricks.rows, *field.coefficients.shape[1:])
    if vertices < field.vertices or (grid.shape, coefficients.shape) != shapes:
        raise ValueError(f"{vertices} vertices, grid {tuple(grid.shape)}, coefficients {tuple(coefficients.shape)}")
    if document["occupied"].shape != blocks(vertices) or not (grid.isfinite().all() and coefficients.isfinite().all()):
        raise ValueError("occupied, or numbers that are not finite")
    return bricks


def search_file(checkpoint: Path) -> Path:
    """Where the outcome of a search for effects is kept, next to a checkpoint."""
    return checkpoint.with_name(f"{checkpoint.name}.gap.json")


def save_search(
    path: Path, told: Calibration, found: Calibration, trained: tuple[str, ...], gap: Mapping[str, Any], mark: str
) -> None:
    """Write what a search has found."""
    changed = {
        f.name: getattr(found.circuit, f.name)
        for f in fields(found.circuit)
        if getattr(found.circuit, f.name) != getattr(told.circuit, f.name)
        and isinstance(getattr(found.circuit, f.name), float)
    }
    document = {"mark": mark, "circuit": changed, "trained": list(trained), "gap": gap}
    with whole_file(Path(path), overwrite=True) as temporary:
        temporary.write_text(json.dumps(document))


def load_search(path: Path, told: Calibration, mark: str) -> tuple[Calibration, tuple[str, ...], dict[str, Any]] | None:
    """(calibration, what to train, entry "gap") of a finished search; None for a damaged file and for another run's."""
    if not path.exists():
        return None
    try:
        document = json.loads(read_text(path, "JSON"))
        if document["mark"] == mark:
            numbers = {name: float(value) for name, value in document["circuit"].items()}
            found = replace(told, circuit=told.circuit.with_(**numbers))
            return found, tuple(document["trained"]), dict(document["gap"])
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError, InputError):
        _refuse(path, "is no outcome of a search for effects, or damaged", "damaged")
        return None
    _refuse(path, "is of a run with other data, options or seed", "other")
    return None
