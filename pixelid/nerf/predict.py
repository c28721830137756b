"""What a scene seen through a pixel says of the changes between events: rays, response, change."""

from __future__ import annotations

import numpy as np
import torch

from pixelid.nerf.intervals import Chains, Intervals, chains
from pixelid.nerf.losses import amplifier_drift, changes
from pixelid.nerf.pixel import Pixel
from pixelid.nerf.render import Rays
from pixelid.nerf.scan import respond
from pixelid.nerf.state import Problem, State

EPSILON = 1e-3  # least radiance, dark current included, in the unit of the views (the paper's)


def sample_rays(problem: Problem, state: State, batch: Chains, rng: np.random.Generator) -> Rays:
    """The rays of all samples of a batch, a sample's together; all of a chain start at one offset."""
    inside, length = state.inside, np.diff(batch.first)
    each = len(inside) // len(problem.channel)
    pixel = np.repeat(np.repeat(batch.pixel, length), each)
    sub = np.tile(np.arange(each), len(batch.t))
    origins, directions = state.poses.rays(np.repeat(batch.t, each), inside[pixel * each + sub])
    offsets = np.repeat(rng.random(len(length), dtype=np.float32), length * each)
    return Rays(origins, directions, problem.channel[pixel], offsets)


def predict(problem: Problem, state: State, batch: Chains, rng: np.random.Generator, engine: str = "auto"):
    """(change (runs, CHAIN), level (n,), log radiance (n,)) of a batch."""
    rays = sample_rays(problem, state, batch, rng)
    radiance = state.field(rays, engine)[0].reshape(len(batch.t), -1).mean(dim=1)
    dark = torch.as_tensor(problem.dark[problem.channel[np.repeat(batch.pixel, np.diff(batch.first))]])
    u = torch.log((radiance.double() + dark.to(radiance.device)).clamp(min=EPSILON))
    pixel = state.pixel
    later = pixel.addition("refractory") if pixel.adds_to("refractory") else None
    leaks, drift = [pixel.strength(name) for name in ("leak", "parasitic_photocurrent")], None
    if any(leak.requires_grad or leak != 0 for leak in leaks):
        drift = amplifier_drift(u, batch.t, pixel.thresholds[0], *leaks)
    level, output, cutoff = u, u, None
    if pixel.filtering:
        dynamics = pixel.dynamics_at(batch.pixel)
        midpoint = problem.circuit.linearisation == "midpoint"
        level, output = respond(u, dynamics, batch.t, batch.first, midpoint=midpoint, engine=engine)
        cutoff = dynamics[..., 6:7] if pixel.has_amplifier_pole else None
    change = changes(level, output, batch, cutoff, later, drift)
    return change - _moved_thresholds(problem, pixel, batch), level, u


def _moved_thresholds(problem: Problem, pixel: Pixel, batch: Chains) -> torch.Tensor:
    """(runs, CHAIN) by how much more is to be crossed than the stretches say, through trained `OF_EVENTS`."""
    on, off = pixel.thresholds
    moved = torch.zeros(batch.rise.shape, dtype=torch.float64, device=on.device)
    for name, tilt in problem.tilts.items():
        rise, fall = (torch.as_tensor(column[batch.which], device=on.device) for column in (tilt.rise, tilt.fall))
        moved = moved + pixel.addition(name) * (rise * on - fall * off)
    return moved


def draw(problem: Problem, state: State, from_: Intervals, runs: int, rng: np.random.Generator) -> Chains:
    """A batch of chains from random intervals."""
    return chains_at(problem, state, from_, rng.integers(0, len(from_.starts), runs), rng)


def chains_at(problem: Problem, state: State, from_: Intervals, starts, rng: np.random.Generator) -> Chains:
    """The chains that begin at `starts` (runs,), indices into `from_.starts`, with samples as the pixel asks."""
    samples = state.pixel.bandwidth.samples if state.pixel.filtering else 1
    slowest = state.pixel.slowest(float(np.maximum(problem.dark, EPSILON).min()))
    return chains(from_, starts, samples, slowest, rng)
