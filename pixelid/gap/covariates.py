"""Where an event stands: the cells in which residuals are summed.

Every factor sorts the events into cells by things known without looking at the residual: recording, polarity, the
polarity before, time since the last event, place in the recording, log radiance, speed of the change.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pixelid.gap.residuals import Residuals
from pixelid.likelihood.event_times import EventTimes

TIMES, WAITS, LIGHTS, SPEEDS = 8, 5, 5, 4  # cells per recording and polarity
POLARITY = ("OFF", "ON")


@dataclass(frozen=True)
class Factor:
    """One way to sort events into cells.

    name: what sorts them;  cell: (n,) cell of each event;  labels: what each cell is, in words
    cuts: where a sliced factor cuts each home (recording and polarity);  () for the others
    """

    name: str
    cell: np.ndarray
    labels: tuple[str, ...]
    cuts: tuple[np.ndarray, ...] = ()


def factors(likelihood: EventTimes, residual: Residuals, like: Sequence[Factor] = ()) -> list[Factor]:
    """All factors of a likelihood's events.

    like: factors of other pixels in the same recordings, whose cells are to be used; else quantiles make new ones
    """
    on = (likelihood.sign > 0).astype(np.int64)
    before = (np.concatenate([iv.previous_sign for iv in likelihood.intervals]) > 0).astype(np.int64)
    where = likelihood.recording_of_event
    names = [r.name for r in likelihood.recordings]
    wait = np.concatenate([iv.time_s - iv.previous_s for iv in likelihood.intervals])
    light = np.concatenate(
        [_log_light(r, iv) for r, iv in zip(likelihood.recordings, likelihood.intervals, strict=True)]
    )
    level, level_names = _levels(likelihood)
    pair = 2 * on + before
    pair_labels = tuple(f"{POLARITY[p]} after {POLARITY[b]}" for p in (0, 1) for b in (0, 1))
    found = [
        Factor("the previous event's polarity", pair, pair_labels),
        _crossed("the previous event's polarity", level[where], level_names, pair, pair_labels),
        _crossed("the previous event's polarity", where, names, pair, pair_labels),
    ]
    home = 2 * where + on
    home_labels = [f"{POLARITY[p]} in {name}" for name in names for p in (0, 1)]
    for name, value, parts, words in (
        ("time in the recording", likelihood.time_s, TIMES, "at {:.3g}–{:.3g} s"),
        ("time since the last event", wait, WAITS, "{:.3g}–{:.3g} s after the last event"),
        ("log radiance", light, LIGHTS, "at log radiance {:.3g}–{:.3g}"),
        ("speed of the change", residual.log_rate, SPEEDS, "at log speed {:.3g}–{:.3g}"),
    ):
        known = next((f.cuts for f in like if f.name == name), None)
        cuts = _cuts(home, len(home_labels), value, parts) if known is None else known
        found.append(_sliced(name, home, home_labels, value, cuts, words))
    return found


def _log_light(recording, intervals) -> np.ndarray:
    """(n,) log radiance of the stimulus at each event."""
    stimulus = recording.stimulus
    return np.interp(intervals.time_s, stimulus.t, np.log(np.maximum(stimulus.radiance, 1e-300)))


def _levels(likelihood: EventTimes) -> tuple[np.ndarray, list[str]]:
    """((recordings,) radiance level of each recording, names): recordings within a factor 1.5 share one."""
    lights = [np.maximum(r.stimulus.radiance, 1e-300) for r in likelihood.recordings if r.stimulus is not None]
    typical = np.array([float(np.exp(np.mean(np.log(light)))) for light in lights])
    order = np.argsort(typical)
    new = np.concatenate([[0], np.cumsum(np.diff(np.log(typical[order])) > np.log(1.5))])
    level = np.empty(len(typical), np.int64)
    level[order] = new
    return level, [f"radiance about {typical[level == k].mean():.3g}" for k in range(int(new[-1]) + 1)]


def _crossed(name, outer, outer_names, inner, inner_labels) -> Factor:
    cell = outer * len(inner_labels) + inner
    return Factor(name, cell, tuple(f"{a}, {o}" for o in outer_names for a in inner_labels))


def _cuts(home, homes, value, parts) -> tuple[np.ndarray, ...]:
    """Quantiles of `value` within each home; from −∞ to ∞ where nothing happens."""
    found = []
    for h in range(homes):
        inside = value[home == h]
        edges = np.unique(np.quantile(inside, np.linspace(0, 1, parts + 1))) if len(inside) else np.array([])
        found.append(edges if len(edges) > 1 else np.array([-np.inf, np.inf]))
    return tuple(found)


def _sliced(name, home, home_labels, value, cuts, words) -> Factor:
    """`value` cut at the given edges within each home; what lies beyond them counts to the outermost slices."""
    cell = np.empty(len(value), np.int64)
    labels: list[str] = []
    for h, (label, edges) in enumerate(zip(home_labels, cuts, strict=True)):
        inside = np.flatnonzero(home == h)
        which = np.clip(np.searchsorted(edges, value[inside], side="right") - 1, 0, len(edges) - 2)
        cell[inside] = len(labels) + which
        labels += [f"{label}, {words.format(a, b)}" for a, b in itertools.pairwise(edges)]
    return Factor(name, cell, tuple(labels), cuts)
