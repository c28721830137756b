"""Noise of a still scene from histograms of each pixel's intervals: leak, parasitic photocurrent or noise.

A file holds, per pixel, how many intervals x between its successive events of one polarity had 1/x below the upper
edge of each bin, edges at 1, 2, …, 9 per decade from 1 mHz to 90 kHz.  (There are 72 edges, 71 bins; the 72nd number is
0 and means nothing.  That column j counts up to edge j + 1, not up to edge j, shows where decades meet: read the other
way the density would jump tenfold there and only there.)  Times, order and the length of the recording are not in it.

The length still shows: a pixel with n intervals of mean m has covered (n + 1) m, give or take.  Regular intervals are a
leak's, irregular ones noise; leak adds to ON only, noise shows in both polarities (Nozaki & Delbruck, IEEE TED 2017;
Graça, McReynolds & Delbruck, CVPRW 2023).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pixelid.errors import InputError
from pixelid.inspection.leak_by_light import LeakByLight, leak_by_light
from pixelid.inspection.renewal import CVS, Slow, SlowPixels, paces
from pixelid.recordings.events import Events

EDGES_HZ = np.outer(10.0 ** np.arange(-3, 5), np.arange(1, 10)).ravel()
EDGES_S = 1.0 / EDGES_HZ[::-1]  # of intervals, rising
FEWEST = 10  # intervals of a pixel whose own pace and regularity are taken
FEWEST_PIXELS = 20
REGULAR = 0.4  # cv below which intervals are called regular: between a leak's 0.1 and noise's 0.7 and more
NAME = re.compile(r"(?P<polarity>pos|neg)_(?P<light>[0-9.]+)(?P<kilo>k?)lux$")

Value = tuple[float, float, float]  # value, 95 % interval


@dataclass(frozen=True)
class IntervalCounts:
    """counts: (pixels, bins) intervals per bin of `EDGES_S` (rising), nominal lux, polarity "ON" | "OFF"."""

    name: str
    polarity: str
    lux: float
    counts: np.ndarray


@dataclass(frozen=True)
class Condition:
    """What one polarity at one light shows.

    duration_s: of the recording, from pixels with `FEWEST` intervals or more;  None with fewer than 20 such pixels
    duration_at_least_s: the longest sum of a pixel's shortest possible intervals
    fast: how many pixels have `FEWEST` intervals or more;  fast_share: of all intervals that is theirs
    rate_hz: of the median pixel;  cv: of a pixel's own intervals;  None where too few
    cv_of_poisson: of Poisson pixels with the same numbers of events, found the same way
    slow: the fit to pixels with few intervals, for which rate_hz and cv are then quoted;  None where most are fast
    second_event_hz: where nothing repeats, the rate below which it must lie (95 %)
    kind: "regular" | "irregular" | "silent"
    """

    name: str
    polarity: str
    lux: float
    pixels: int
    intervals: int
    without_intervals: float
    duration_s: Value | None
    duration_at_least_s: float
    fast: int
    fast_share: float
    rate_hz: Value | None
    cv: Value | None
    cv_of_poisson: float | None
    slow: Slow | None
    second_event_hz: float | None
    kind: str


@dataclass(frozen=True)
class StaticNoise:
    """All conditions, leak against light where two lights have regular ON firing, and sentences."""

    conditions: tuple[Condition, ...]
    by_light: LeakByLight | None
    lux: tuple[float, float] | None
    findings: tuple[str, ...]
    unknown: tuple[str, ...]


def read_interval_counts(path: Path) -> IntervalCounts:
    """One file `…_pos_161lux.npy`; InputError for anything else."""
    match = NAME.search(path.stem)
    if match is None:
        raise InputError(f"{path}: expected a name ending in pos_ or neg_ and the light, as pos_161lux.npy")
    try:
        raw = np.load(path, allow_pickle=False)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except (OSError, ValueError, EOFError):
        raise InputError(f"{path}: not a readable .npy array") from None
    if not isinstance(raw, np.ndarray) or raw.ndim < 2 or raw.shape[-1] != len(EDGES_HZ):
        raise InputError(f"{path}: expected an array of shape (…, {len(EDGES_HZ)}), found {np.shape(raw)}")
    if raw.dtype.kind not in "iuf" or not np.isfinite(raw).all():
        raise InputError(f"{path}: expected finite counts")
    below = raw.reshape(-1, len(EDGES_HZ))[:, :-1]
    counts = np.diff(below, axis=1, prepend=0)
    if (counts < 0).any() or (raw[..., -1] != 0).any() or (counts != np.rint(counts)).any():
        raise InputError(f"{path}: expected whole numbers that rise along the last axis, its last entry 0")
    lux = float(match["light"]) * (1000.0 if match["kilo"] else 1.0)
    return IntervalCounts(path.stem, {"pos": "ON", "neg": "OFF"}[match["polarity"]], lux, counts[:, ::-1].astype(int))


def interval_counts(events: Events, polarity: int, lux: float = 0.0, name: str = "") -> IntervalCounts:
    """The same of events: intervals between a pixel's successive events of one polarity (1 ON, 0 OFF), binned."""
    chosen = events.p == polarity
    t, pixel = events.t[chosen], events.pixel[chosen]
    order = np.argsort(pixel, kind="stable")
    same = np.diff(pixel[order]) == 0
    interval, owner = np.diff(t[order])[same] * 1e-9, pixel[order][1:][same]
    at = np.searchsorted(EDGES_S, interval, side="right") - 1
    inside = (at >= 0) & (at < len(EDGES_S) - 1)
    counts = np.zeros((events.width * events.height, len(EDGES_S) - 1), int)
    np.add.at(counts, (owner[inside], at[inside]), 1)
    return IntervalCounts(name, "ON" if polarity else "OFF", lux, counts)


def static_noise(measured: Sequence[IntervalCounts], seed: int = 0, resamples: int = 100) -> StaticNoise:
    """What the histograms (of one sensor, the same pixels) say; resampled pixels give the intervals."""
    if not measured:
        raise InputError("no interval histograms to look at")
    if len({len(m.counts) for m in measured}) > 1:
        raise InputError("interval histograms: expected the same pixels in each, found different numbers of pixels")
    # ON and OFF at one light are one recording: its length is taken from whichever shows it better
    lengths = {light: _duration([m for m in measured if m.lux == light], seed) for light in {m.lux for m in measured}}
    found = [_condition(m, lengths[m.lux], seed, resamples) for m in measured]
    conditions = tuple(c for c, _ in found)
    regular = [
        (c, table) for c, table in found if c.polarity == "ON" and c.kind == "regular" and c.slow and table is not None
    ]
    by_light, lux = None, None
    if len({c.lux for c, _ in regular}) >= 2:
        regular.sort(key=lambda entry: entry[0].lux)
        ends = (regular[0], regular[-1])
        lux = (ends[0][0].lux, ends[1][0].lux)
        tables = (ends[0][1], ends[1][1])
        cv = tuple(c.slow.cv for c, _ in ends if c.slow)
        by_light = leak_by_light(tables, lux, (cv[0], cv[1]), seed, resamples)
    from pixelid.inspection.static_noise_words import findings, unknown

    return StaticNoise(conditions, by_light, lux, findings(conditions, by_light, lux), unknown(conditions, lux))


def _duration(measured: Sequence[IntervalCounts], seed: int) -> Value | None:
    """Median of (n + 1) m over the pixels with enough intervals, with a bootstrap over them."""
    best = None
    for m in measured:
        fast = m.counts[m.counts.sum(axis=1) >= FEWEST]
        if len(fast) < FEWEST_PIXELS or (best is not None and len(fast) <= len(best)):
            continue
        best = fast
    if best is None:
        return None
    return _median((best.sum(axis=1) + 1) * paces(best, EDGES_S).mean_s, seed)


def _median(x: np.ndarray, seed: int) -> Value:
    rng = np.random.default_rng(seed)
    again = np.median(x[rng.integers(0, len(x), (400, len(x)))], axis=1)
    low, high = np.quantile(again, [0.025, 0.975])
    return float(np.median(x)), float(low), float(high)


def _condition(
    m: IntervalCounts, duration: Value | None, seed: int, resamples: int
) -> tuple[Condition, SlowPixels | None]:
    number = m.counts.sum(axis=1)
    total = int(number.sum())
    fast = m.counts[number >= FEWEST]
    least = float((m.counts @ EDGES_S[:-1]).max())
    rate = cv = of_poisson = slow = table = second = None
    if total < FEWEST_PIXELS:
        kind = "silent"
        if duration is not None:
            second = _rarely(int(np.count_nonzero(number)), len(number), duration[0])
    elif len(fast) >= 0.5 * len(number):
        pace = paces(fast, EDGES_S)
        rng = np.random.default_rng(seed)
        again = [pace.cv_of(rng.integers(0, len(fast), len(fast))) for _ in range(resamples)]
        rate, cv = _median(1.0 / pace.mean_s, seed), (pace.cv, *np.quantile(again, [0.025, 0.975]).tolist())
        of_poisson = paces(_poisson_like(pace.mean_s, fast.sum(axis=1), seed), EDGES_S).cv
        kind = "regular" if cv[0] < REGULAR else "irregular"
    elif duration is not None:
        table = SlowPixels(m.counts, EDGES_S, duration[0], CVS[CVS < 1.5])
        slow = table.fit()
        rng = np.random.default_rng(seed)
        redone = [table.fit(rng.integers(0, len(table.slow), len(table.slow))) for _ in range(resamples)]
        rate = (slow.rate_hz, *np.quantile([s.rate_hz for s in redone], [0.025, 0.975]).tolist())
        cv = (slow.cv, *np.quantile([s.cv for s in redone], [0.025, 0.975]).tolist())
        kind = "regular" if slow.cv < REGULAR else "irregular"
    else:
        kind = "silent"
    condition = Condition(
        m.name, m.polarity, m.lux, len(number), total, float(np.mean(number == 0)), duration, least, len(fast),
        float(fast.sum() / max(total, 1)), rate, cv, of_poisson, slow, second, kind,
    )  # fmt: skip
    return condition, table


def _rarely(repeating: int, pixels: int, duration: float) -> float:
    """The Poisson rate per pixel below which it must lie (95 %) when so few pixels show a second event."""
    from scipy.optimize import brentq
    from scipy.stats import binom

    def excess(log_rate: float) -> float:
        mean = np.exp(log_rate) * duration
        return float(binom.cdf(repeating, pixels, 1.0 - (1.0 + mean) * np.exp(-mean)) - 0.05)

    root: Any = brentq(excess, np.log(1e-6 / duration), np.log(10.0 / duration))
    return float(np.exp(root))


def _poisson_like(mean: np.ndarray, number: np.ndarray, seed: int) -> np.ndarray:
    """Counts of Poisson pixels with the same numbers of intervals and the same paces."""
    rng = np.random.default_rng(seed)
    owner = np.repeat(np.arange(len(mean)), number)
    at = np.searchsorted(EDGES_S, rng.exponential(mean[owner]), side="right") - 1
    inside = (at >= 0) & (at < len(EDGES_S) - 1)
    counts = np.zeros((len(mean), len(EDGES_S) - 1), int)
    np.add.at(counts, (owner[inside], at[inside]), 1)
    return counts
