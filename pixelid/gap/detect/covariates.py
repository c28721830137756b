"""Where an event stands: the cells in which residuals are summed.

Every factor sorts the events into cells by things known before the event came: recording, polarity, the polarity
before, and, of the moment when the model expected it, the time since the last event, the place in the recording, log
radiance, speed of the change.  (Sorted by when it did come, late events would gather in the cells of long waits, and a
true model would look wrong there.)
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pixelid.figures.words import between
from pixelid.gap.detect.residuals import Residuals, expected_log_rate
from pixelid.likelihood.event_times import EventTimes
from pixelid.stages.circuit import Circuit
from pixelid.stimuli.pixel_lights import PixelLights, log_radiance_at

# Slices per recording and polarity: some 400 cells in all, a few dozen events each in the smallest sessions.
TIMES, WAITS, LIGHTS, SPEEDS = 8, 5, 5, 4
# Of the logarithm of speeds, either way, at random.  Expected times are known to first order, so how fast a change was
# expected to be errs a little, by what the event was late or early.  Where many speeds are nearly the same (at a limit
# of the slew) cells would else be cut by that, and a true model look wrong.  0.01 to 0.1 do alike.
SPEED_BLUR = 0.05
BLUR_SEED = 1  # not that of what residuals draw at the end of a silence: cells would be sorted by the residuals
SAME_LEVEL = 1.5  # factor between mean radiances that count as one level: illuminances are usually decades apart
POLARITY = ("OFF", "ON")
ROWS, COLUMNS = ("top", "middle", "bottom"), ("left", "centre", "right")  # of the rectangle whose light is known


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


def sort_events(
    likelihood: EventTimes, circuit: Circuit, residual: Residuals, like: Sequence[Factor] = ()
) -> list[Factor]:
    """All factors of a likelihood's events.

    circuit: the model behind the residuals
    like: factors of other pixels in the same recordings, whose cells are to be used; else quantiles make new ones
    """
    on = (likelihood.sign > 0).astype(np.int64)
    before = (np.concatenate([iv.previous_sign for iv in likelihood.intervals]) > 0).astype(np.int64)
    where = likelihood.recording_of_event
    names = [r.name for r in likelihood.recordings]
    last = np.concatenate([iv.previous_s for iv in likelihood.intervals])
    time = np.maximum(likelihood.time_s - residual.late, last)
    parts = np.split(time, np.cumsum([len(iv) for iv in likelihood.intervals])[:-1])
    pairs = zip(likelihood.recordings, likelihood.intervals, parts, strict=True)
    light = np.concatenate([log_radiance_at(r.stimulus, iv.pixel, t) for r, iv, t in pairs if r.stimulus is not None])
    level, level_names = _levels(likelihood)
    pair = 2 * on + before
    pair_labels = tuple(f"{POLARITY[p]} after {POLARITY[b]}" for p in (0, 1) for b in (0, 1))
    factors = [
        Factor("the previous event's polarity", pair, pair_labels),
        _crossed("the previous event's polarity", level[where], level_names, pair, pair_labels),
        _crossed("the previous event's polarity", where, names, pair, pair_labels),
    ]
    if not all(r.stimulus is None or r.stimulus.full_field for r in likelihood.recordings):
        factors.append(_place(likelihood, time))
    speed = expected_log_rate(likelihood, circuit, residual)
    speed += np.random.default_rng(BLUR_SEED).uniform(-SPEED_BLUR, SPEED_BLUR, len(speed))
    home = 2 * where + on
    home_labels = [f"{POLARITY[p]} in {name}" for name in names for p in (0, 1)]
    for name, value, slices, words in (
        ("time in the recording", time, TIMES, "at {:.3g}–{:.3g} s".format),
        ("time since the last event", time - last, WAITS, _after_the_last),
        ("log radiance", light, LIGHTS, lambda low, high: f"at radiance {np.exp(low):.3g}–{np.exp(high):.3g}"),
        ("speed of the change", speed, SPEEDS, "at log speed {:.3g}–{:.3g}".format),
    ):
        known = next((f.cuts for f in like if f.name == name), None)
        cuts = _cuts(home, len(home_labels), value, slices) if known is None else known
        factors.append(_sliced(name, home, home_labels, value, cuts, words))
    return factors


def _levels(likelihood: EventTimes) -> tuple[np.ndarray, list[str]]:
    """((recordings,) radiance level of each recording, names): recordings within a factor `SAME_LEVEL` share one."""
    lights = [
        np.maximum(r.stimulus.average().radiance, 1e-300) for r in likelihood.recordings if r.stimulus is not None
    ]
    typical = np.array([float(np.exp(np.mean(np.log(light)))) for light in lights])
    order = np.argsort(typical)
    new = np.concatenate([[0], np.cumsum(np.diff(np.log(typical[order])) > np.log(SAME_LEVEL))])
    level = np.empty(len(typical), np.int64)
    level[order] = new
    units = {r.stimulus.unit for r in likelihood.recordings if r.stimulus is not None}
    unit = f" {units.pop()}" if len(units) == 1 and not units & {"relative", "shape"} else ""
    return level, [f"radiance about {typical[level == k].mean():.3g}{unit}" for k in range(int(new[-1]) + 1)]


def _place(likelihood: EventTimes, time: np.ndarray) -> Factor:
    """Where on the sensor, in each half of each recording: there light of pixels' own may be wrong.

    By place alone a map shows nothing, as every pixel's thresholds are its own.
    """
    lights = [r.stimulus for r in likelihood.recordings if r.stimulus is not None]
    known = [np.argwhere(light.of_pixel >= 0) for light in lights if isinstance(light, PixelLights)]
    lit = np.concatenate(known or [np.zeros((1, 2), np.int64)])  # (k, 2) rows and columns; the same in every pool
    flat, where = likelihood.flat_pixels[likelihood.pixel], likelihood.recording_of_event
    widths = np.array([r.events.width for r in likelihood.recordings])
    tiles = []
    for place, edges, names in zip(np.divmod(flat, widths[where]), lit.T, (ROWS, COLUMNS), strict=True):
        span = int(np.ptp(edges)) + 1
        tiles.append(np.clip((place - edges.min()) * len(names) // span, 0, len(names) - 1))
    middle = np.array([0.5 * (light.start_s + light.end_s) for light in lights])
    half = (time > middle[where]).astype(np.int64)
    labels = tuple(
        f"{row} {column} in the {part} half of {r.name}"
        for r in likelihood.recordings
        for part in ("first", "second")
        for row in ROWS
        for column in COLUMNS
    )
    cell = ((2 * where + half) * len(ROWS) + tiles[0]) * len(COLUMNS) + tiles[1]
    return Factor("place on the sensor", cell, labels)


def _crossed(name, outer, outer_names, inner, inner_labels) -> Factor:
    cell = outer * len(inner_labels) + inner
    return Factor(name, cell, tuple(f"{a}, {o}" for o in outer_names for a in inner_labels))


def _cuts(home, homes, value, parts) -> tuple[np.ndarray, ...]:
    """Quantiles of `value` within each home; from −∞ to ∞ where nothing happens."""
    cuts = []
    for h in range(homes):
        inside = value[home == h]
        edges = np.unique(np.quantile(inside, np.linspace(0, 1, parts + 1))) if len(inside) else np.array([])
        cuts.append(edges if len(edges) > 1 else np.array([-np.inf, np.inf]))
    return tuple(cuts)


def _after_the_last(first_s: float, last_s: float) -> str:
    return f"{between(first_s, last_s)} after the last event"


def _sliced(name, home, home_labels, value, cuts, words) -> Factor:
    """`value` cut at the given edges within each home; what lies beyond them counts to the outermost slices.

    words: what to say of two edges
    """
    cell = np.empty(len(value), np.int64)
    labels: list[str] = []
    for h, (label, edges) in enumerate(zip(home_labels, cuts, strict=True)):
        inside = np.flatnonzero(home == h)
        which = np.clip(np.searchsorted(edges, value[inside], side="right") - 1, 0, len(edges) - 2)
        cell[inside] = len(labels) + which
        labels += [f"{label}, {words(a, b)}" for a, b in itertools.pairwise(edges)]
    return Factor(name, cell, tuple(labels), cuts)
