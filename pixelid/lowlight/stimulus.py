"""What a recording's light offers: cycles of growing frequency, or steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pixelid.stimuli.drive import knots
from pixelid.stimuli.stimulus import Stimulus

SMALLEST_STEP = 0.2  # log radiance


@dataclass(frozen=True)
class Sweep:
    """Cycles of a periodic light whose frequency changes.

    edges_s: (cycles + 1,) upward crossings of the mean radiance;  swing: peak-to-peak ln L;  radiance: the mean
    """

    edges_s: np.ndarray
    swing: float
    radiance: float

    @property
    def frequency_hz(self) -> np.ndarray:
        """(cycles,) one over each cycle's length."""
        return 1.0 / np.diff(self.edges_s)


@dataclass(frozen=True)
class Steps:
    """Changes between constant lights.

    middle_s, change: (edges,) when ln L is half way, and by how much it changes;  before_s, after_s: (edges,) the
    window of each edge, from its own start to the next one's;  radiance: geometric mean over time
    """

    middle_s: np.ndarray
    change: np.ndarray
    before_s: np.ndarray
    after_s: np.ndarray
    radiance: float


def read_stimulus(stimulus: Stimulus) -> Sweep | Steps | str:
    """The sweep or the steps of a full-field stimulus, or why it is neither."""
    t, index = knots(stimulus)
    radiance = stimulus.radiance[index].astype(float)
    if (radiance <= 0).any():
        return "the light goes to zero, and changes of its logarithm are what is read"
    u = np.log(radiance)
    if np.ptp(u) < SMALLEST_STEP:
        return "the light hardly changes"
    return _sweep(t, radiance) or _steps(t, u) or "the light is neither a frequency sweep nor steps between levels"


def _sweep(t: np.ndarray, radiance: np.ndarray) -> Sweep | None:
    centre = 0.5 * (radiance.max() + radiance.min())
    up = np.flatnonzero((radiance[:-1] < centre) & (radiance[1:] >= centre))
    share = (centre - radiance[up]) / (radiance[up + 1] - radiance[up])
    crossing = t[up] + share * (t[up + 1] - t[up])
    min_cycles = 6
    if len(crossing) < min_cycles:
        return None
    if abs(radiance[0] - centre) < 1e-2 * centre and crossing[0] - t[0] > 0.5 * (crossing[1] - crossing[0]):
        crossing = np.append(t[0], crossing)  # it starts at the mean
    periods = np.diff(crossing)
    if len(periods) < min_cycles or periods.max() < 3 * periods.min():
        return None
    trend = np.corrcoef(np.argsort(np.argsort(periods)), np.arange(len(periods)))[0, 1]
    if abs(trend) < 0.95:  # sampling makes fast cycles uneven
        return None
    return Sweep(crossing, float(np.log(radiance.max() / radiance.min())), float(centre))


def _steps(t: np.ndarray, u: np.ndarray) -> Steps | None:
    gaps = np.diff(t)
    slope = np.abs(np.diff(u)) / np.maximum(gaps, 1e-9)
    moving = slope > 0.01 * slope.max()
    if gaps[~moving].sum() < 0.5 * (t[-1] - t[0]):
        return None
    bounds = np.flatnonzero(np.diff(np.concatenate([[0], moving.astype(int), [0]])))
    first, last = bounds[::2], bounds[1::2]  # knots at which each movement starts and ends
    change = u[last] - u[first]
    drift = np.abs(u[np.append(first, len(u) - 1)] - u[np.append(0, last)])  # while the light should stand still
    if len(first) == 0 or drift.max() > 0.1 * np.ptp(u):
        return None
    keep = np.abs(change) >= SMALLEST_STEP
    first, last, change = first[keep], last[keep], change[keep]
    min_edges = 3
    if len(first) < min_edges:
        return None
    middle = np.empty(len(first))
    for i, (a, b) in enumerate(zip(first, last, strict=True)):
        rising = (u[a : b + 1] - u[a]) / change[i]
        middle[i] = np.interp(0.5, rising, t[a : b + 1])
    mean = float(np.exp((0.5 * (u[1:] + u[:-1]) * gaps).sum() / gaps.sum()))
    return Steps(middle, change, t[first], np.append(t[first][1:], t[-1]), mean)
