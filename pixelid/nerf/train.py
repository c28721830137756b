"""Training: batches of chains, rendered, filtered by the pixel, compared with the events.

State is explicit: `start → step → step …`; a state written to disk and read back continues with the same numbers.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from pixelid.nerf import parallel
from pixelid.nerf.camera import Camera, sub_pixel_directions
from pixelid.nerf.field import Field
from pixelid.nerf.gauge import Gauge
from pixelid.nerf.intervals import CHAIN, Chains, Intervals, chains
from pixelid.nerf.losses import Weights, amplifier_drift, changes, terms, total, unexplained, variance_left
from pixelid.nerf.pixel import Bandwidth, Pixel
from pixelid.nerf.pixel_maps import PixelMaps
from pixelid.nerf.render import Rays
from pixelid.nerf.scan import respond
from pixelid.nerf.trajectory import Trajectory
from pixelid.stages.circuit import Circuit

MOST_CELLS = (32, 160)  # per side
# Of `--steps auto`.  The default recipe (1200 steps of 320 chains) was chosen on scenes of 64 × 64 pixels with some
# 1e5 changes: the same batch per change and as many looks at each, within what a training may take.
VISITS = 60
BATCH_SHARE = 320 / 1e5
SMALLEST_BATCH, LARGEST_BATCH = 320, 4096
STEPS = (600, 30_000)
DEPARTURES = 0.1  # learning rate of single pixels' thresholds, in their standard deviations, over the grid's
EPSILON = 1e-3  # least radiance, dark current included, in the unit of the views (the paper's)


@dataclass(frozen=True)
class Recipe:
    """How to train.

    iterations: steps, 0 for as many as the data ask for;  batch: chains per step (over all processes), 0 likewise;
    vertices: grid sizes, each for an equal share of the steps (empty: `for_sensor` chooses);  rate, last_rate: learning
    rate, decaying exponentially;  weights: λ;  roughness: λ of the grid's total variation;  emptiness: λ of the mean
    log density, which clears what no event asks for;  level: λ of the mean log radiance when the gauge needs it;
    engine: of `render` and `respond`;  supersample: rays per pixel and side
    """

    iterations: int = 1200
    batch: int = 320
    vertices: tuple[int, ...] = ()
    rate: float = 0.1
    last_rate: float = 0.01
    weights: Weights = dataclasses.field(default_factory=Weights)
    roughness: float = 0.0
    emptiness: float = 0.01
    level: float = 10.0
    engine: str = "auto"
    supersample: int = 1
    seed: int = 0

    def for_sensor(self, width: int) -> Recipe:
        """The recipe with grid sizes for a sensor `width` pixels wide: about one cell per pixel in the end."""
        cells = min(max(width, MOST_CELLS[0]), MOST_CELLS[1])
        return self if self.vertices else self.with_cells(cells)

    def with_cells(self, cells: int) -> Recipe:
        """The recipe that ends with so many cells per side."""
        return dataclasses.replace(self, vertices=tuple(max(cells * k // 4, 1) + 1 for k in (2, 3, 4)))

    def for_data(self, changes: int) -> Recipe:
        """The recipe with steps and batch for so many changes of light, where they were left open.

        Batches grow with the data up to `LARGEST_BATCH`; steps are as many as show every change `VISITS` times.
        """
        batch = self.batch or int(np.clip(changes * BATCH_SHARE, SMALLEST_BATCH, LARGEST_BATCH))
        wanted = math.ceil(VISITS * changes / (CHAIN * batch) / 100) * 100
        steps = self.iterations or int(np.clip(wanted, *STEPS))
        return dataclasses.replace(self, batch=batch, iterations=steps)

    def vertices_at(self, iteration: int) -> int:
        """The grid size in use at a step."""
        stage = min(iteration * len(self.vertices) // max(self.iterations, 1), len(self.vertices) - 1)
        return self.vertices[stage]

    def rate_at(self, iteration: int) -> float:
        """The learning rate of a step."""
        return self.rate * (self.last_rate / self.rate) ** (iteration / max(self.iterations, 1))


@dataclass(frozen=True)
class Problem:
    """What is reconstructed from.

    training, held_out: intervals;  camera: of the sensor;  channel: (pixels,);  dark: (C,) added to the field's
    radiance;  circuit: of the pixel;  gauge: what pins the radiance unit;  low, high: the box;  maps: how the pixels
    depart from the circuit, None where they do not
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

    def pixels_as_dict(self, pixel: Pixel) -> dict[str, Any]:
        """The entry "pixels" of reconstruction.json: thresholds and bandwidth over the sensor, and who was left out."""
        hot = self.maps.hot if self.maps is not None else np.zeros(0, np.int64)
        on, off = pixel.threshold_spread()
        return {
            "threshold_spread": {"on": on, "off": off},
            "thresholds_trained": pixel.departures.requires_grad,
            "bandwidth_mapped": pixel.maps.bandwidth is not None,
            "hot": {"count": len(hot), "xy": [[int(k % self.camera.width), int(k // self.camera.width)] for k in hot]},
        }


@dataclass
class State:
    """Everything that a step reads and changes.

    inside: (pixels · rays, 3) directions in the camera frame, a pixel's together;  diverged: whether a loss was NaN or
    infinite; the state is then that before the step, and no further step is made
    """

    field: Field
    pixel: Pixel
    optimiser: torch.optim.Optimizer
    inside: np.ndarray
    iteration: int
    rays: int = 0
    history: list[dict[str, float]] = dataclasses.field(default_factory=list)
    diverged: bool = False

    @property
    def finite(self) -> bool:
        """Whether no step diverged and the field holds numbers only."""
        values = (self.field.grid, self.field.log_background, self.pixel.factors, self.pixel.departures)
        return not self.diverged and all(bool(torch.isfinite(value).all()) for value in values)


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
        free_background=gauge.free_background, level=float(np.exp(gauge.level.mean())),
    ).to(device)  # fmt: skip
    pixel = Pixel(problem.circuit, bandwidth, problem.maps).to(device)
    inside = sub_pixel_directions(problem.camera, recipe.supersample)
    return State(scene, pixel, optimiser_of(scene, pixel, recipe), inside, 0)


def optimiser_of(scene: Field, pixel: Pixel, recipe: Recipe) -> torch.optim.Optimizer:
    """Adam over the grid, the background when it is free, and what of the pixel is trained."""
    groups: list[dict[str, Any]] = [{"params": [scene.grid], "lr": recipe.rate, "share": 1.0}]
    if scene.log_background.requires_grad:
        groups.append({"params": [scene.log_background], "lr": recipe.rate, "share": 0.1})
    if pixel.factors.requires_grad:
        groups.append({"params": [pixel.factors], "lr": recipe.rate, "share": 0.2})
    if pixel.departures.requires_grad:
        groups.append({"params": [pixel.departures], "lr": recipe.rate, "share": DEPARTURES})
    return torch.optim.Adam(groups, betas=(0.9, 0.99), eps=1e-15, fused=True)


def sample_rays(problem: Problem, inside: np.ndarray, batch: Chains, rng: np.random.Generator) -> Rays:
    """The rays of all samples of a batch, a sample's together; all of a chain start at one offset."""
    each, length = len(inside) // len(problem.channel), np.diff(batch.first)
    pixel = np.repeat(np.repeat(batch.pixel, length), each)
    sub = np.tile(np.arange(each), len(batch.t))
    origins, directions = problem.trajectory.rays(np.repeat(batch.t, each), inside[pixel * each + sub])
    offsets = np.repeat(rng.random(len(length), dtype=np.float32), length * each)
    return Rays(origins, directions, problem.channel[pixel], offsets)


def predict(problem: Problem, state: State, batch: Chains, rng: np.random.Generator, engine: str = "auto"):
    """(change (runs, CHAIN), level (n,), log radiance (n,)) of a batch."""
    rays = sample_rays(problem, state.inside, batch, rng)
    radiance = state.field(rays, engine)[0].reshape(len(batch.t), -1).mean(dim=1)
    dark = torch.as_tensor(problem.dark[problem.channel[np.repeat(batch.pixel, np.diff(batch.first))]])
    u = torch.log((radiance.double() + dark.to(radiance.device)).clamp(min=EPSILON))
    later = state.pixel.longer_dead_time if state.pixel.moves[-1] else None
    circuit, drift = problem.circuit, None
    if circuit.leak_hz or circuit.leak_hz_per_radiance:
        on_threshold = state.pixel.thresholds[0]
        drift = amplifier_drift(u, batch.t, on_threshold, circuit.leak_hz, circuit.leak_hz_per_radiance)
    if not state.pixel.filtering:
        return changes(u, u, batch, None, later, drift), u, u
    dynamics = state.pixel.dynamics_at(batch.pixel)
    midpoint = circuit.linearisation == "midpoint"
    level, output = respond(u, dynamics, batch.t, batch.first, midpoint=midpoint, engine=engine)
    cutoff = dynamics[..., 6:7] if state.pixel.has_amplifier_pole else None
    return changes(level, output, batch, cutoff, later, drift), level, u


def draw(problem: Problem, state: State, from_: Intervals, runs: int, rng: np.random.Generator) -> Chains:
    """A batch of chains from random intervals."""
    bandwidth = state.pixel.bandwidth
    samples = bandwidth.samples if state.pixel.filtering else 1
    slowest = state.pixel.slowest(float(np.maximum(problem.dark, EPSILON).min()))
    return chains(from_, rng.integers(0, len(from_.starts), runs), samples, slowest, rng)


def step(problem: Problem, recipe: Recipe, state: State) -> dict[str, float]:
    """One step of training, in place; what it measured.  A loss that is no number changes nothing but `diverged`."""
    wanted = recipe.vertices_at(state.iteration)
    if wanted != state.field.vertices:
        state.field.refine(wanted)
        state.optimiser = optimiser_of(state.field, state.pixel, recipe)
    for group in state.optimiser.param_groups:
        group["lr"] = recipe.rate_at(state.iteration) * group["share"]
    rng = np.random.default_rng([recipe.seed, parallel.rank(), state.iteration])  # nothing to carry between steps
    batch = draw(problem, state, problem.training, max(recipe.batch // parallel.world(), 1), rng)
    change, level, _ = predict(problem, state, batch, rng, recipe.engine)
    thresholds = state.pixel.thresholds_at(batch.pixel)
    parts = terms(change, level, batch, *thresholds)
    loss = total(parts, recipe.weights)
    if recipe.roughness > 0:
        loss = loss + recipe.roughness * state.field.roughness()
    if recipe.emptiness > 0:
        loss = loss + recipe.emptiness * state.field.grid[..., 0].clamp(min=-6).mean()
    if problem.gauge.kind == "level":
        loss = loss + recipe.level * _off_level(problem, state, recipe.engine, rng)
    if state.pixel.factors.requires_grad or state.pixel.departures.requires_grad:
        left = variance_left(change, batch, *thresholds)
        loss = loss + state.pixel.penalty(left) / max(len(problem.training.starts), 1)
    measured = {"loss": float(loss.detach()), **{name: float(value.detach()) for name, value in parts.items()}}
    if not math.isfinite(parallel.average(measured["loss"])):
        state.diverged = True
        return measured
    state.optimiser.zero_grad(set_to_none=True)
    loss.backward()
    parallel.average_gradients(p for group in state.optimiser.param_groups for p in group["params"])
    state.optimiser.step()
    state.iteration += 1
    state.rays += len(batch.t) * recipe.supersample**2
    if state.iteration % 16 == 0 and state.iteration >= 64:
        state.field.look_for_empty_blocks()
    return measured


def _off_level(
    problem: Problem, state: State, engine: str, rng: np.random.Generator, number: int = 512
) -> torch.Tensor:
    """Squared distance of the mean log light over random rays from that of the reference views.

    Dark current is part of the light: below it the events say nothing, and a mean of logs would be full of it.
    """
    views = problem.gauge.reference
    assert views is not None  # a gauge of this kind has them
    which = rng.integers(0, len(views), number)
    x, y = rng.integers(0, views.camera.width, number), rng.integers(0, views.camera.height, number)
    channel = rng.integers(0, len(problem.dark), number)
    inside = views.camera.directions(np.column_stack([x, y]))
    directions = np.einsum("nij,nj->ni", views.rotation[which], inside).astype(np.float32)
    rays = Rays(views.position[which].astype(np.float32), directions, channel, rng.random(number, dtype=np.float32))
    radiance, _ = state.field(rays, engine)
    floor = np.maximum(problem.dark, EPSILON)[channel]
    target = torch.as_tensor(np.log(views.images[which, y, x, channel] + floor), device=radiance.device)
    return (torch.log(radiance.double() + torch.as_tensor(floor, device=radiance.device)) - target).mean() ** 2


def held_out_residual(problem: Problem, state: State, runs: int = 512) -> float:
    """What is left unexplained of held-out chains (see `unexplained`).

    Args:
        problem: whose held-out pixels are asked.
        state: of the training.
        runs: how many chains, the same ones every time.

    Returns:
        Root mean square of what is left, as a share of what the events say; 1 would be no scene.
    """
    if len(problem.held_out.starts) == 0:
        return math.nan
    rng = np.random.default_rng(1)
    with torch.no_grad():
        batch = draw(problem, state, problem.held_out, runs, rng)
        change, _, _ = predict(problem, state, batch, rng)
        thresholds = (x.cpu().numpy() for x in state.pixel.thresholds_at(batch.pixel))
    return unexplained(change.cpu().numpy(), batch, *thresholds)


def train(
    problem: Problem, recipe: Recipe, state: State, until: int | None = None,
    report: Callable[[State, dict[str, float]], None] = lambda state, measured: None,
) -> State:  # fmt: skip
    """Train until the recipe is done, or a step diverges.

    Args:
        problem: what is reconstructed from.
        recipe: how.
        state: where to begin; it is changed in place.
        until: stop at this step; by default the recipe's last.
        report: called after each step with the state and what the step measured.

    Returns:
        The state given.
    """
    while state.iteration < (recipe.iterations if until is None else until) and not state.diverged:
        report(state, step(problem, recipe, state))
    return state
