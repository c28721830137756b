"""What a scene seen through a pixel says of the changes between events: rays, response, change."""

from __future__ import annotations

import numpy as np
import torch

from pixelid.nerf.events.intervals import Chains, Intervals, chains
from pixelid.nerf.events.quiet import LAGS, Pairs, draw_pairs
from pixelid.nerf.field.render import Rays
from pixelid.nerf.pixel.model import Pixel
from pixelid.nerf.pixel.past import past_of
from pixelid.nerf.pixel.scan import respond
from pixelid.nerf.training.losses import amplifier_drift, changes
from pixelid.nerf.training.state import Problem, State

EPSILON = 1e-3  # least radiance, dark current included, in the unit of the views (the paper's)


def _samples(batch: Chains, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(times, pixels, offsets of the rays), (n,) each, of the samples of a batch; a chain's rays have one offset."""
    length = np.diff(batch.first)
    offsets = np.repeat(rng.random(len(length), dtype=np.float32), length)
    return batch.t, np.repeat(batch.pixel, length), offsets


def _rays_at(problem: Problem, state: State, t: np.ndarray, pixel: np.ndarray, offsets: np.ndarray) -> Rays:
    """The rays of pixels (n,) at times t (n,); offsets: (n,) of `Rays`."""
    return Rays(*state.poses.rays(t, state.inside[pixel]), problem.channel[pixel], offsets)


def light(
    problem: Problem, state: State, batch: Chains, rng: np.random.Generator, pairs: Pairs | None = None,
) -> tuple[torch.Tensor, torch.Tensor]:  # fmt: skip
    """(log radiance (n,) at the samples of a batch, at both ends of pairs (k, 2)), rendered in one go."""
    t, pixel, offsets = _samples(batch, rng)
    if pairs is not None:
        shared = np.repeat(rng.random(len(pairs.t), dtype=np.float32), 2)
        t, pixel = np.concatenate([t, pairs.t.ravel()]), np.concatenate([pixel, np.repeat(pairs.pixel, 2)])
        offsets = np.concatenate([offsets, shared])
    radiance = state.field(_rays_at(problem, state, t, pixel, offsets))[0]
    dark = torch.as_tensor(problem.dark[problem.channel[pixel]])
    u = torch.log((radiance.double() + dark.to(radiance.device)).clamp(min=EPSILON))
    return u[: len(batch.t)], u[len(batch.t) :].reshape(-1, 2)


def predict(problem: Problem, state: State, batch: Chains, rng: np.random.Generator):
    """(change (runs, CHAIN), level (n,), log radiance (n,)) of a batch."""
    u, _ = light(problem, state, batch, rng)
    return *response(problem, state, batch, u), u


def response(problem: Problem, state: State, batch: Chains, u: torch.Tensor):
    """(change (runs, CHAIN), level (n,)) of a batch whose samples have log radiance u (n,)."""
    pixel = state.pixel
    later = pixel.addition("refractory") if pixel.adds_to("refractory") else None
    leaks, drift = [pixel.strength(name) for name in ("leak", "parasitic_photocurrent")], None
    if any(leak.requires_grad or leak != 0 for leak in leaks):
        drift = amplifier_drift(u, batch.t, pixel.thresholds[0], *leaks)
    level, output, cutoff = u, u, None
    if pixel.filtering:
        dynamics = pixel.dynamics_at(batch.pixel)
        midpoint = problem.circuit.linearisation == "midpoint"
        level, output = respond(u, dynamics, batch.t, batch.first, midpoint=midpoint)
        cutoff = dynamics[..., 6:7] if pixel.has_amplifier_pole else None
    change = changes(level, output, batch, cutoff, later, drift)
    return change - _moved_thresholds(problem, pixel, batch), level


def _moved_thresholds(problem: Problem, pixel: Pixel, batch: Chains) -> torch.Tensor:
    """(runs, CHAIN) by how much more is to be crossed than stretches say, through thresholds that are trained."""
    on, off = pixel.thresholds
    moved = torch.zeros(batch.rise.shape, dtype=torch.float64, device=on.device)
    for name, tilt in problem.tilts.items():
        rise, fall = (torch.as_tensor(column[batch.which], device=on.device) for column in (tilt.rise, tilt.fall))
        moved = moved + pixel.addition(name) * (rise * on - fall * off)
    return moved


def draw(problem: Problem, state: State, from_: Intervals, runs: int, rng: np.random.Generator) -> Chains:
    """A batch of chains from random intervals."""
    return chains_at(problem, state, from_, rng.integers(0, len(from_.starts), runs), rng)


def draw_quiet(problem: Problem, state: State, number: int, rng: np.random.Generator) -> Pairs | None:
    """Pairs of times at which nothing fired, None where something always does."""
    if number == 0 or len(problem.quiet.until) == 0:
        return None
    lag = LAGS / state.pixel.slowest(_darkest(problem)) if state.pixel.filtering else 0.0
    return draw_pairs(problem.quiet, number, lag, rng)


def _darkest(problem: Problem) -> float:
    """The least light that any pixel sees."""
    return float(np.maximum(problem.dark, EPSILON).min())


def chains_at(problem: Problem, state: State, from_: Intervals, starts, rng: np.random.Generator) -> Chains:
    """The chains that begin at `starts` (runs,), indices into `from_.starts`, with samples as the pixel asks."""

    def light(t: np.ndarray, pixel: np.ndarray) -> np.ndarray:
        return _radiance_at(problem, state, t, pixel)

    samples = state.pixel.bandwidth.samples if state.pixel.filtering else 1
    rate, points = past_of(state.pixel, from_, starts, samples, _darkest(problem), problem.crossing_s, light)
    return chains(from_, starts, samples, rate, rng, points)


def _radiance_at(problem: Problem, state: State, t: np.ndarray, pixel: np.ndarray) -> np.ndarray:
    """(n,) radiance, dark current included, that pixels (n,) see at times (n,); nothing is trained by it."""
    with torch.no_grad():
        rays = _rays_at(problem, state, t, pixel, np.full(len(t), 0.5, np.float32))
        radiance = state.field(rays)[0]
    return radiance.cpu().numpy().astype(float) + problem.dark[problem.channel[pixel]]
