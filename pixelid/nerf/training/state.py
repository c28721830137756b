"""What training works on, and everything that it reads and changes."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import torch

from pixelid.nerf.data.camera import Camera
from pixelid.nerf.data.trajectory import Trajectory
from pixelid.nerf.effects.additions import ADDITIONS, Tilt, threshold_factor
from pixelid.nerf.events.gauge import Gauge, time_resolution
from pixelid.nerf.events.intervals import Intervals
from pixelid.nerf.events.quiet import NOTHING, Quiet
from pixelid.nerf.field.bricks import Bricks
from pixelid.nerf.field.radiance import Field
from pixelid.nerf.pixel.maps import PixelMaps
from pixelid.nerf.pixel.model import Bandwidth, Pixel
from pixelid.nerf.training.held_out import Regularisation, Stopping, looked_at
from pixelid.nerf.training.poses import Poses
from pixelid.nerf.training.recipe import Recipe
from pixelid.stages.circuit import Circuit

HARMONICS_RATE = 0.3  # learning rate of the harmonics over the grid's
POSES = 0.3  # learning rate of what moves the poses, in standard deviations of its prior, over the grid's


@dataclass(frozen=True)
class Problem:
    """What is reconstructed from.

    training, held_out: intervals;  camera: of the sensor;  channel: (pixels,);  dark: (C,) added to the field's
    radiance;  circuit: of the pixel;  gauge: what pins the radiance unit;  low, high: the box;  maps: how the pixels
    depart from the circuit, None where they do not;  tilts: of `additions.tilts`, for what is trained;  shortest: s,
    between two events of one pixel;  quiet: where and when nothing fired, of the pixels that training sees;  near:
    distance from the camera before which nothing is;  crossing_s: s in which the image moves by a pixel (a cell, where
    cells are larger) where it is fastest, 0 where that does not matter
    """

    training: Intervals
    held_out: Intervals
    trajectory: Trajectory
    camera: Camera
    channel: np.ndarray
    dark: np.ndarray
    circuit: Circuit
    gauge: Gauge
    low: np.ndarray
    high: np.ndarray
    maps: PixelMaps | None = None
    tilts: Mapping[str, Tilt] = dataclasses.field(default_factory=dict)
    shortest: float = 0.0
    quiet: Quiet = NOTHING
    near: float = 0.0
    crossing_s: float = 0.0

    def values(self, pixel: Pixel) -> dict[str, float]:
        """The numbers in use (`Pixel.values`), the thresholds those of the typical event and pixel.

        Strengths in thresholds per second (leak, parasitic photocurrent) stay what they are in ln L per second.
        """
        values, factor = pixel.values(), threshold_factor(self.tilts, pixel.addition)
        on, off = (factor * math.exp(log) for log in pixel.expected.mean(dim=0).tolist())
        counted = ((addition.parameter, 1 / on) for addition in ADDITIONS.values() if addition.in_thresholds)
        for name, by in (("on_threshold", on), ("off_threshold", off), *counted):
            if name in values:
                values[name] *= by
        return values

    @cached_property
    def time_resolution_s(self) -> float:
        """What an offset between the clocks of poses and events must have to show (`gauge.time_resolution`)."""
        return time_resolution(self.trajectory, self.camera, self.low, self.high)

    def pixels_as_dict(self, pixel: Pixel) -> dict[str, Any]:
        """The entry "pixels" of reconstruction.json: thresholds and bandwidth over the sensor, and who was left out."""
        hot = self.maps.hot if self.maps is not None else np.zeros(0, np.int64)
        on, off = pixel.threshold_spread()
        return {
            "threshold_spread": {"on": on, "off": off},
            "thresholds_trained": pixel.departures.requires_grad,
            "bandwidth_mapped": pixel.maps.bandwidth is not None and pixel.filtering,
            "hot": {"count": len(hot), "xy": [[int(k % self.camera.width), int(k // self.camera.width)] for k in hot]},
        }


@dataclass
class State:
    """Everything that a step reads and changes.

    inside: (pixels, 3) directions in the camera frame;  diverged: whether a loss was NaN or
    infinite; the state is then that before the step, and no further step is made;  seconds: of training, with what was
    before an interruption;  stopping,
    regularisation: what held-out events have said of both
    """

    field: Field
    pixel: Pixel
    poses: Poses
    optimiser: torch.optim.Optimizer
    inside: np.ndarray
    iteration: int
    rays: int = 0
    seconds: float = 0.0
    history: list[dict[str, float]] = dataclasses.field(default_factory=list)
    diverged: bool = False
    stopping: Stopping = dataclasses.field(default_factory=Stopping)
    regularisation: Regularisation = dataclasses.field(default_factory=Regularisation)

    @property
    def finite(self) -> bool:
        """Whether no step diverged and the field holds numbers only."""
        values = (self.pixel.factors, self.pixel.added, self.pixel.departures, self.poses.offset, self.poses.moved)
        finite = all(bool(torch.isfinite(value).all()) for value in values)
        return not self.diverged and self.field.finite and finite


def start(problem: Problem, recipe: Recipe, bandwidth: Bandwidth, device: str = "cpu") -> State:
    """The state before the first step.

    Args:
        problem: what is reconstructed from.
        recipe: with the seed, and the vertices to begin with.
        bandwidth: the pixel's filter.
        device: "cpu" or "cuda".

    Returns:
        An untrained field and pixel, with their optimiser.
    """
    torch.manual_seed(recipe.seed)
    gauge = problem.gauge
    scene = Field(
        problem.low, problem.high, recipe.vertices_at(0), len(problem.dark), gauge.background,
        free_background=gauge.free_background, level=gauge.start, degree=recipe.degree, near=problem.near,
        unbounded=recipe.unbounded,
    ).to(device)  # fmt: skip
    pixel = Pixel(problem.circuit, bandwidth, problem.maps).to(device)
    inside = problem.camera.all_directions()
    poses = Poses(problem.trajectory, recipe.refinement).to(device)
    stopping = Stopping(looked_at(recipe.last_stage, recipe.iterations) if len(problem.held_out.starts) else ())
    return State(scene, pixel, poses, optimiser_of(scene, pixel, poses, recipe), inside, 0, stopping=stopping)


def learned(state: State) -> dict[str, Any]:
    """All that training has made of field, pixel and poses, on the CPU; tensors may be the state's own."""
    scene = state.field
    return {
        "vertices": scene.vertices, "bricks": torch.from_numpy(scene.bricks.index),
        "occupied": torch.from_numpy(scene.occupied),
        "grid": scene.grid.detach().cpu(), "coefficients": scene.coefficients.detach().cpu(),
        **{name: values.detach().cpu() for name, values in _beside_rows(state).items()},
    }  # fmt: skip


def take(state: State, bricks: Bricks, values: Mapping[str, Any]) -> None:
    """Let a state be what `learned` has written down, in place, its optimiser aside; bricks: those of the values."""
    state.field.hold(bricks, values["grid"], values["coefficients"])
    with torch.no_grad():
        for name, own in _beside_rows(state).items():
            own.copy_(values[name])
    state.field.occupied = np.array(values["occupied"].cpu().numpy(), order="C")


def _beside_rows(state: State) -> dict[str, torch.Tensor]:
    """What training moves in addition to the rows of the field."""
    return {
        "log_background": state.field.log_background, "factors": state.pixel.factors, "added": state.pixel.added,
        "departures": state.pixel.departures, "offset": state.poses.offset, "moved": state.poses.moved,
    }  # fmt: skip


def follow(state: State) -> None:
    """Let the field's bricks follow the scene; what the optimiser has noted of those that stay stays."""
    before = state.field.grid, state.field.coefficients
    source = state.field.follow()
    if source is None:
        return
    kept = torch.as_tensor(np.maximum(source, 0), device=state.field.grid.device)
    new = torch.as_tensor(source < 0, device=state.field.grid.device)
    for old, now in zip(before, (state.field.grid, state.field.coefficients), strict=True):
        for group in state.optimiser.param_groups:
            group["params"] = [now if p is old else p for p in group["params"]]
        noted = state.optimiser.state.pop(old, None)
        if noted is None:
            continue
        for name in ("exp_avg", "exp_avg_sq"):
            noted[name] = noted[name][kept]
            noted[name][new] = 0.0
        state.optimiser.state[now] = noted


def optimiser_of(scene: Field, pixel: Pixel, poses: Poses, recipe: Recipe) -> torch.optim.Optimizer:
    """Adam over the grid, the background when it is free, and what of the pixel and the poses is trained."""
    groups: list[dict[str, Any]] = [{"params": [scene.grid], "lr": recipe.rate, "share": 1.0}]
    if scene.coefficients.requires_grad:
        groups.append({"params": [scene.coefficients], "lr": recipe.rate, "share": HARMONICS_RATE})
    if scene.log_background.requires_grad:
        groups.append({"params": [scene.log_background], "lr": recipe.rate, "share": 0.1})
    groups += [
        {"params": [values], "lr": recipe.rate, "share": 0.2}
        for values in (pixel.factors, pixel.added)
        if values.requires_grad
    ]
    departures = 0.4  # learning rate of single pixels' thresholds, in their standard deviations, over the grid's
    if pixel.departures.requires_grad:
        groups.append({"params": [pixel.departures], "lr": recipe.rate, "share": departures})
    groups += [
        {"params": [values], "lr": recipe.rate, "share": POSES}
        for values in (poses.offset, poses.moved)
        if values.requires_grad
    ]
    return torch.optim.Adam(groups, betas=(0.9, 0.99), eps=1e-15, fused=True)
