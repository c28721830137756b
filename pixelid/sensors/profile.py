"""Per-pixel thresholds and bandwidth of one tile, all pixels at once.

The light is the same for every pixel, so one trajectory serves them all.  For a given bandwidth the event-time
likelihood (docs/model.md, "Likelihoods") is Gaussian in a pixel's threshold: with z_k the level at event k and
w_k = 1/s_k²,

    threshold of (pixel, polarity) = Σ w z / Σ w,   variance 1/Σ w,

and integrating it out under a flat prior leaves the pixel's log-likelihood of the bandwidth alone.  So the bandwidth is
scanned on one grid for all pixels, and each pixel (or block of pixels) picks its own maximum on the spline through its
values.  The threshold's variance then gains (d threshold / d bandwidth)² · variance of the bandwidth.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from pixelid.errors import InputError
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.model import Model
from pixelid.recordings.recording import Recording
from pixelid.sensors.tiles import block_index

FLAT = 3.0  # relative sd of the prior on a pixel's threshold: flat beside any mismatch of a real sensor
REACH = 1.2  # half width of the scan in log bandwidth
COARSE = 13  # points of the first scan, which says where the tile's pixels lie
FINE = 40  # spline points per grid step


@dataclass(frozen=True)
class Plan:
    """What to estimate.  model: the population's fit;  bandwidth: the parameter mapped, "" for thresholds alone;
    block: side of the groups of pixels that share one bandwidth;  width: of the sensor.
    """

    model: Model
    bandwidth: str
    block: int
    width: int

    def check(self) -> None:
        """Raise InputError for a model or a parameter that cannot be mapped."""
        if "threshold_noise" not in self.model.effects:
            raise InputError(f"model {self.model.name}: maps need threshold_noise in the model")
        if self.bandwidth:
            parameter = self.model.parameter(self.bandwidth)
            if parameter.transform != "log" or "threshold" in self.bandwidth:
                raise InputError(f"--bandwidth {self.bandwidth}: expected a cutoff or rate on a log scale")


Estimates = Mapping[str, np.ndarray]


def estimate_tile(plan: Plan, recordings: list[Recording]) -> Estimates:
    """Log estimates and standard errors of one tile.

    pixel: (n,) flat index of pixels with events;  events: (n,);  unexplained: (n,) of them without a cause in the
    model;  on, off: (n,) log thresholds, NaN where unseen;  on_sd, off_sd: (n,) their standard errors
    block: (m,) flat block index;  bandwidth, bandwidth_sd: (m,) log of the parameter.  A bandwidth at the edge of the
    scan is NaN: the pixel's events do not hold it.
    """
    if sum(len(r.events) for r in recordings) == 0:
        return _nothing()
    try:
        likelihood = EventTimes([replace(r, sensor="") for r in recordings])
    except InputError:
        return _nothing()
    block, member = np.unique(
        block_index(likelihood.pixel_keys.astype(np.int64), plan.width, plan.block), return_inverse=True
    )
    grid = np.linspace(-REACH, REACH, COARSE) if plan.bandwidth else np.zeros(1)
    value, mean, weight, unexplained = _scan(plan, likelihood, grid)
    best, best_sd = _peaks(grid, _sums(value, member, len(block)))
    resolved = np.isfinite(best)
    points = 25  # points of the second, across where they lie
    if resolved.any() and plan.bandwidth:
        margin = np.minimum(4.0 * best_sd[resolved], 0.25 * REACH)
        low, high = (best[resolved] - margin).min(), (best[resolved] + margin).max()
        if high - low < 1.5 * REACH or best_sd[resolved].min() < 0.2 * (grid[1] - grid[0]):
            grid = np.linspace(low - 0.01, high + 0.01, points)
            value, mean, weight, unexplained = _scan(plan, likelihood, grid)
            again, again_sd = _peaks(grid, _sums(value, member, len(block)))
            best, best_sd = np.where(resolved, again, np.nan), np.where(resolved, again_sd, np.inf)
    pixel = likelihood.pixel_keys.astype(np.int64)
    at, sd = best[member], best_sd[member]
    known = np.isfinite(at)
    nearest = np.abs(grid[:, None] - np.where(known, at, 0.0)).argmin(axis=0)
    z, slope, w = _along(grid, mean, weight, np.where(known, at, 0.0))
    variance = 1.0 / np.maximum(w, 1e-300) + (slope * np.where(known, sd, 0.0)[:, None]) ** 2
    seen = (w > 0) & (z > 0)
    log = np.where(seen, np.log(np.where(seen, z, 1.0)), np.nan)
    log_sd = np.where(seen, np.sqrt(variance) / np.where(seen, z, 1.0), np.inf)
    centre = np.log(plan.model.values[plan.bandwidth]) if plan.bandwidth else np.nan
    return {
        "pixel": pixel,
        "events": np.bincount(likelihood.pixel, minlength=len(pixel)),
        "unexplained": unexplained[nearest, np.arange(len(pixel))],
        "off": log[:, 0], "off_sd": log_sd[:, 0], "on": log[:, 1], "on_sd": log_sd[:, 1],
        "block": block, "bandwidth": centre + best, "bandwidth_sd": best_sd,
    }  # fmt: skip


def _scan(
    plan: Plan, likelihood: EventTimes, grid: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Log-likelihood (points, n), thresholds, weights (points, n, 2; OFF first), events without a cause (points, n)."""
    scanned = [likelihood.terms(_circuit(plan, float(step))) for step in grid]
    return (
        np.array([terms.per_pixel for terms in scanned]),
        np.array([terms.weighted_mean.reshape(-1, 2) for terms in scanned]),
        np.array([terms.weight_sum.reshape(-1, 2) for terms in scanned]),
        np.array([np.bincount(likelihood.pixel, t.unexplained, len(likelihood.pixel_keys)) for t in scanned]),
    )


def _sums(value: np.ndarray, member: np.ndarray, blocks: int) -> np.ndarray:
    """(points, blocks) sums of the pixels' log-likelihoods (points, n)."""
    sums = np.zeros((blocks, len(value)))
    np.add.at(sums, member, value.T)
    return sums.T


def _circuit(plan: Plan, step: float):
    values = plan.model.values
    if plan.bandwidth:
        values = {**values, plan.bandwidth: values[plan.bandwidth] * float(np.exp(step))}
    return plan.model.circuit(values).with_(mismatch=FLAT)


def _peaks(grid: np.ndarray, value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(position, standard error) (m,) of the maximum of each column of value (points, m); NaN, inf at the edges."""
    if len(grid) == 1:
        return np.zeros(value.shape[1]), np.zeros(value.shape[1])
    from scipy.interpolate import CubicSpline

    spline = CubicSpline(grid, value)
    fine = np.linspace(grid[0], grid[-1], FINE * (len(grid) - 1) + 1)
    k = spline(fine).argmax(axis=0)
    inside = (k > 0) & (k < len(fine) - 1)
    at, columns = fine[k], np.arange(value.shape[1])
    bend, tilt = spline(fine, 2)[k, columns], spline(fine, 1)[k, columns]
    inside &= bend < 0
    safe = np.where(inside, bend, -1.0)
    step = grid[1] - grid[0]
    at = at - np.clip(tilt / safe, -step / FINE, step / FINE)
    return np.where(inside, at, np.nan), np.where(inside, 1.0 / np.sqrt(-safe), np.inf)


def _along(grid, mean, weight, at) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(threshold, its slope, weight) (n, 2) at each pixel's own bandwidth."""
    if len(grid) == 1:
        return mean[0], np.zeros_like(mean[0]), weight[0]
    from scipy.interpolate import CubicSpline

    step = grid[1] - grid[0]
    k = np.clip(((at - grid[0]) / step).astype(int), 0, len(grid) - 2)
    n, x = np.arange(len(at)), (np.clip(at, grid[0], grid[-1]) - grid[k])[:, None]
    c = CubicSpline(grid, mean).c[:, k, n]
    f = x / step
    w = (1 - f) * weight[k, n] + f * weight[k + 1, n]
    return ((c[0] * x + c[1]) * x + c[2]) * x + c[3], (3 * c[0] * x + 2 * c[1]) * x + c[2], w


def _nothing() -> Estimates:
    whole, real = np.empty(0, np.int64), np.empty(0)
    return {
        "pixel": whole, "events": whole, "unexplained": real, "off": real, "off_sd": real, "on": real, "on_sd": real,
        "block": whole, "bandwidth": real, "bandwidth_sd": real,
    }  # fmt: skip
