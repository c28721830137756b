"""Noise of a still scene from histograms of each pixel's intervals: leak, parasitic photocurrent or noise.

The histograms (`interval_counts.py`) do not hold the length of the recording.  It still shows: a pixel with n intervals
of mean m has covered (n + 1) m, give or take.  Regular intervals are a leak's, irregular ones noise; leak adds to ON
only, noise shows in both polarities (Nozaki & Delbruck, IEEE TED 2017; Graça, McReynolds & Delbruck, CVPRW 2023).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from pixelid.errors import InputError
from pixelid.inspection.health import Progress, no_progress
from pixelid.inspection.interval_counts import EDGES_S, IntervalCounts
from pixelid.inspection.leak_by_light import leak_by_light
from pixelid.inspection.renewal import CVS, SlowPixels, paces
from pixelid.inspection.static_noise_result import Condition, StaticNoise, Value
from pixelid.inspection.static_noise_words import findings, unknown

MIN_INTERVALS = 10  # of a pixel whose own pace and regularity are taken
MIN_PIXELS = 20
MAX_REGULAR_CV = 0.4  # of intervals called regular: between a leak's 0.1 and noise's 0.7 and more


def static_noise(
    measured: Sequence[IntervalCounts], seed: int = 0, resamples: int = 100, progress: Progress = no_progress
) -> StaticNoise:
    """What the histograms (of one sensor, the same pixels) say; resampled pixels give the intervals."""
    if not measured:
        raise InputError("no interval histograms to look at")
    if len({len(m.counts) for m in measured}) > 1:
        raise InputError("interval histograms: expected the same pixels in each, found different numbers of pixels")
    # ON and OFF at one light are one recording: its length is taken from whichever shows it better
    lengths = {light: _duration([m for m in measured if m.lux == light], seed) for light in {m.lux for m in measured}}
    judged = []
    for k, m in enumerate(measured):
        progress(m.name, k / (len(measured) + 1))
        judged.append(_condition(m, lengths[m.lux], seed, resamples))
    conditions = tuple(c for c, _ in judged)
    regular = [
        (c, table) for c, table in judged if c.polarity == "ON" and c.kind == "regular" and c.slow and table is not None
    ]
    by_light, lux = None, None
    if len({c.lux for c, _ in regular}) >= 2:
        regular.sort(key=lambda entry: entry[0].lux)
        ends = (regular[0], regular[-1])
        lux = (ends[0][0].lux, ends[1][0].lux)
        tables = (ends[0][1], ends[1][1])
        cv = tuple(c.slow.cv for c, _ in ends if c.slow)
        progress("leak by light", len(measured) / (len(measured) + 1))
        by_light = leak_by_light(tables, lux, (cv[0], cv[1]), seed, resamples)
    return StaticNoise(conditions, by_light, lux, findings(conditions, by_light, lux), unknown(conditions, lux))


def _duration(measured: Sequence[IntervalCounts], seed: int) -> Value | None:
    """Median of (n + 1) m over the pixels with enough intervals, with a bootstrap over them."""
    best = None
    for m in measured:
        fast = m.counts[m.counts.sum(axis=1) >= MIN_INTERVALS]
        if len(fast) < MIN_PIXELS or (best is not None and len(fast) <= len(best)):
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
    fast = m.counts[number >= MIN_INTERVALS]
    least = float((m.counts @ EDGES_S[:-1]).max())
    rate = cv = of_poisson = slow = table = second = None
    if total < MIN_PIXELS:
        kind = "silent"
        if duration is not None:
            second = _rarely(int(np.count_nonzero(number)), len(number), duration[0])
    elif len(fast) >= 0.5 * len(number):
        pace = paces(fast, EDGES_S)
        rng = np.random.default_rng(seed)
        again = [pace.cv_of(rng.integers(0, len(fast), len(fast))) for _ in range(resamples)]
        rate, cv = _median(1.0 / pace.mean_s, seed), (pace.cv, *np.quantile(again, [0.025, 0.975]).tolist())
        of_poisson = paces(_poisson_like(pace.mean_s, fast.sum(axis=1), seed), EDGES_S).cv
        kind = "regular" if cv[0] < MAX_REGULAR_CV else "irregular"
    elif duration is not None:
        table = SlowPixels(m.counts, EDGES_S, duration[0], CVS[CVS < 1.5])
        slow = table.fit()
        rng = np.random.default_rng(seed)
        redone = [table.fit(rng.integers(0, len(table.slow), len(table.slow))) for _ in range(resamples)]
        rate = (slow.rate_hz, *np.quantile([s.rate_hz for s in redone], [0.025, 0.975]).tolist())
        cv = (slow.cv, *np.quantile([s.cv for s in redone], [0.025, 0.975]).tolist())
        kind = "regular" if slow.cv < MAX_REGULAR_CV else "irregular"
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
