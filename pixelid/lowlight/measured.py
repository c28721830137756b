"""Bandwidth and step time as events show them, without fitting dynamics.

*Sweep.*  Over one cycle a pixel whose signal swings by A emits n events of a polarity.  It stands a random part of a
threshold away from the extremes when it turns, at both ends, so that E n = A/C − 1 for A ≥ C:

    A ≈ (n + 1) C        gain = A / (swing of ln L)        −3 dB frequency: where gain falls through 1/√2 for good

averaged over pixels and both polarities (leak adds to ON what it takes from OFF).

*Steps.*  Signed events × threshold after an edge, summed over edges and pixels, over their sum at the end of the hold;
step time is when that passes 63.2 %, from the middle of the light's edge.  An edge that reverses the one before
starts, by the same argument, one threshold late on average: one threshold is added.

*Dead time ρ.*  What the signal does during it is lost, and so is the amplifier's lag 1/ωd: at release its output
starts from the follower's, ahead of where it would have been (docs/model.md).  Both count as ρ.  Between two events of
one polarity, Δt apart, the signal moves by C in Δt − ρ; so such an interval counts C Δt/(Δt − ρ).  A recording in which
that more than doubles the sum is refused.

Intervals are percentiles of 300 bootstrap samples over pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pixelid.lowlight.response import LEVEL
from pixelid.lowlight.stimulus import Steps, Sweep
from pixelid.recordings.events import Events

SURE_SD = 4.0  # standard deviations of sums of random signs: what follows no light exceeds them once in 1e4
BOOTSTRAPS = 300
SMALLEST_SWING = 3.0  # thresholds; below, counts do not resolve a fall to 71 %


@dataclass(frozen=True)
class Measured:
    """One number from one recording.

    quantity: "bandwidth_hz" | "step_time_s";  value, interval_95: None where not measurable, and `why` says so
    x, y: the curve behind it, gain over frequency [Hz] or response over time [s]
    """

    quantity: str
    value: float | None
    interval_95: tuple[float, float] | None
    why: str
    x: np.ndarray
    y: np.ndarray


def measure(
    events: Events, light: Sweep | Steps, on_threshold: float, off_threshold: float, dead_s: float = 0.0
) -> Measured:
    """Bandwidth of a sweep, step time of steps; thresholds in log radiance; dead_s: see above."""
    pixels, pixel = np.unique(events.pixel, return_inverse=True)
    changes = _signal_changes(events, on_threshold, off_threshold, dead_s)
    quantity = "bandwidth_hz" if isinstance(light, Sweep) else "step_time_s"
    if not len(pixels):
        return _not(quantity, "no events")
    if changes.sum() > 2.0 * np.where(events.p == 1, on_threshold, off_threshold).sum():
        return _not(quantity, "the pixels spend most of the time between events in dead time")
    if isinstance(light, Sweep):
        return _bandwidth(events, changes, pixel, len(pixels), light, on_threshold, off_threshold)
    return _step_time(events, changes, pixel, len(pixels), light, on_threshold, off_threshold)


def _signal_changes(events: Events, on: float, off: float, dead: float) -> np.ndarray:
    """(n,) change of log radiance, without sign, from each event to where the next one of its polarity starts."""
    order = np.lexsort((events.t, events.pixel))
    t, p, pixel = events.t[order] * 1e-9, events.p[order], events.pixel[order]
    follows = (pixel[1:] == pixel[:-1]) & (p[1:] == p[:-1])
    interval = np.diff(t)
    lost = np.where(follows, dead / np.maximum(interval - dead, 0.25 * interval + 1e-9), 0.0)
    out = np.empty(len(t))
    out[order] = np.where(p == 1, on, off) * (1.0 + np.append(lost, 0.0))
    return out


def _bandwidth(events: Events, changes, pixel, pixels: int, light: Sweep, on: float, off: float) -> Measured:
    if light.swing < SMALLEST_SWING * max(on, off):
        return _not("bandwidth_hz", f"the light swings by less than {SMALLEST_SWING:g} thresholds")
    cycle = np.searchsorted(light.edges_s, events.t * 1e-9, side="right") - 1
    cycles = len(light.edges_s) - 1
    inside = (cycle >= 0) & (cycle < cycles)
    swings = np.full((pixels, cycles), on + off)  # of both polarities
    np.add.at(swings, (pixel[inside], cycle[inside]), changes[inside])
    gains = 0.5 * swings / light.swing
    if not _follow(events, cycle, inside, light):
        return _not("bandwidth_hz", "no events follow the light")
    logs = np.log(light.frequency_hz)
    bins_per_decade = 8
    label = np.floor((logs - logs.min()) * bins_per_decade / np.log(10)).astype(int)
    _, label = np.unique(label, return_inverse=True)
    size = np.bincount(label)
    x = np.bincount(label, logs) / size
    per_pixel = np.stack([np.bincount(label, row) / size for row in gains])
    y = per_pixel.mean(axis=0)
    value = _falls_through(x, y)
    if isinstance(value, str):
        return Measured("bandwidth_hz", None, None, value, np.exp(x), y)
    draws = [_falls_through(x, per_pixel[chosen].mean(axis=0)) for chosen in _resampled(pixels)]
    return Measured("bandwidth_hz", value, *_interval(draws, pixels), np.exp(x), y)


def _follow(events: Events, cycle: np.ndarray, inside: np.ndarray, light: Sweep) -> bool:
    """Whether ON less OFF events have a phase in the slowest quarter of the cycles."""
    slow = inside & np.isin(cycle, np.argsort(light.frequency_hz)[: max(len(light.frequency_hz) // 4, 1)])
    begin, end = light.edges_s[cycle[slow]], light.edges_s[cycle[slow] + 1]
    wave = np.exp(2j * np.pi * (events.t[slow] * 1e-9 - begin) / (end - begin))
    return bool(np.abs(np.where(events.p[slow] == 1, wave, -wave).sum()) > SURE_SD * np.sqrt(slow.sum()))


def _falls_through(x: np.ndarray, y: np.ndarray) -> float | str:
    """Frequency where y over log frequency x last falls through 1/√2, or why it does not."""
    above = np.flatnonzero(y >= np.sqrt(0.5))
    if len(above) == 0:
        return f"below −3 dB already at the lowest frequency, {np.exp(x[0]):.3g} Hz"
    k = int(above[-1])
    if k == len(x) - 1:
        return f"above −3 dB up to the highest frequency, {np.exp(x[-1]):.3g} Hz"
    share = (y[k] - np.sqrt(0.5)) / (y[k] - y[k + 1])
    return float(np.exp(x[k] + share * (x[k + 1] - x[k])))


def _step_time(events: Events, changes, pixel, pixels: int, light: Steps, on: float, off: float) -> Measured:
    chosen = np.abs(light.change) >= SMALLEST_SWING * max(on, off)
    if not chosen.any():
        return _not("step_time_s", f"no step is larger than {SMALLEST_SWING:g} thresholds")
    hold = float((light.after_s - light.middle_s)[chosen].min())
    seconds = events.t * 1e-9
    edge = np.searchsorted(light.before_s, seconds, side="right") - 1
    inside = (edge >= 0) & (seconds <= light.after_s[-1])
    inside[inside] &= chosen[edge[inside]]
    at, which = edge[inside], pixel[inside]
    size = np.where(events.p[inside] == 1, 1.0, -1.0) * changes[inside] * np.sign(light.change[at])
    since = seconds[inside] - light.middle_s[at]
    reverses = np.append(False, np.sign(light.change[1:]) != np.sign(light.change[:-1])) & chosen
    late = np.where(light.change > 0, on, off)[reverses].sum()
    first = float((light.before_s - light.middle_s)[chosen].min())
    grid = np.linspace(first, hold, 801)
    responses = np.full((pixels, len(grid)), late)
    for i in range(pixels):
        mine = which == i
        order = np.argsort(since[mine])
        total = np.concatenate([[0.0], np.cumsum(size[mine][order])])
        responses[i] += total[np.searchsorted(since[mine][order], grid, side="right")]
    if size.sum() <= SURE_SD * np.sqrt(np.sum(size**2)):
        return _not("step_time_s", "no events follow the steps")
    y = responses.sum(axis=0) / responses[:, -1].sum()
    if y[np.searchsorted(grid, 0.75 * hold)] < 0.95:
        why = f"the response is still moving when the next step comes, {hold:.3g} s later"
        return Measured("step_time_s", None, None, why, grid, y)
    if y[np.searchsorted(grid, 0.0)] >= LEVEL:
        return Measured("step_time_s", None, None, "the response is there before the light: check clocks", grid, y)
    draws: list[float | str] = []
    for picked in _resampled(pixels):
        again = responses[picked].sum(axis=0)
        draws.append(_reaches(grid, again / again[-1]))
    return Measured("step_time_s", _reaches(grid, y), *_interval(draws, pixels), grid, y)


def _reaches(grid: np.ndarray, y: np.ndarray) -> float:
    """When y over the grid first reaches `LEVEL`."""
    k = max(int(np.argmax(y >= LEVEL)), 1)
    rise = y[k] - y[k - 1]
    return float(grid[k - 1] + (grid[k] - grid[k - 1]) * ((LEVEL - y[k - 1]) / rise if rise > 0 else 0.0))


def _resampled(pixels: int):
    return np.random.default_rng(0).integers(0, max(pixels, 1), (BOOTSTRAPS if pixels > 1 else 0, pixels))


def _interval(draws: list[float | str], pixels: int) -> tuple[tuple[float, float] | None, str]:
    numbers = [value for value in draws if not isinstance(value, str)]
    if pixels < 2 or len(numbers) < 0.9 * BOOTSTRAPS:
        return None, "no interval: " + ("a single pixel" if pixels < 2 else "many bootstrap samples give no value")
    low, high = np.percentile(numbers, [2.5, 97.5])
    return (float(low), float(high)), ""


def _not(quantity: str, why: str) -> Measured:
    return Measured(quantity, None, None, why, np.empty(0), np.empty(0))
