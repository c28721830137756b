"""Intervals between successive noise events of a pixel, counted in recordings, and what a circuit predicts of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

EDGES_S = np.geomspace(1e-6, 1e4, 241)  # 24 bins a decade
CENTRES_S = np.sqrt(EDGES_S[1:] * EDGES_S[:-1])
PAIRS = (("on_on", "on_off"), ("off_on", "off_off"))  # polarity before, and after
COARSE, LEAST_SHARE = 3, 1e-5  # bins in one of the histogram, and what one must hold to be in it


@dataclass(frozen=True)
class MeasuredIntervals:
    """The intervals of one recording.

    Attributes:
        name, radiance: Of the recording.
        counts: (groups, 2, 2, bins) in bins of `EDGES_S`, by the polarities of the events before and after, ON first.
        seen_s: How long it is: longer intervals are not seen, others the more seldom the longer they are.
    """

    name: str
    radiance: float
    counts: np.ndarray
    seen_s: float

    def compared(self, shares: np.ndarray | None) -> dict[str, Any]:
        """What noise.json says of them and predicted shares (2, 2, bins); None: not predicted."""
        found = _shares(self.counts.sum(0))
        expected = None if shares is None else _shares(shares * np.clip(1.0 - CENTRES_S / self.seen_s, 0.0, 1.0))
        expected = expected if expected is not None and expected.any() else None  # all too long to be seen
        far, error = (None, None) if expected is None else self._distance(found, expected)
        return {
            "file": self.name,
            "radiance": self.radiance,
            "count": int(self.counts.sum()),
            "median_s": {"measured": _median(found), "predicted": None if expected is None else _median(expected)},
            "shares": {
                PAIRS[i][j]: {
                    "measured": float(found[i, j].sum()),
                    "predicted": None if expected is None else float(expected[i, j].sum()),
                }
                for i in range(2) for j in range(2)
            },
            "distance": far,
            "distance_error": error,
            "histogram": _histogram(found, expected),
        }  # fmt: skip

    def _distance(self, found: np.ndarray, expected: np.ndarray) -> tuple[float, float | None]:
        """Largest difference of the shares of intervals that are shorter (Kolmogorov), of all pairs of polarities, and
        its standard error from how groups of pixels differ; None where only one has intervals."""
        off = np.abs(np.cumsum(found - expected, axis=2))
        place = np.unravel_index(int(np.argmax(off)), off.shape)
        own = self.counts.sum((1, 2, 3))
        groups = self.counts[own > 0]
        if len(groups) < 2:
            return float(off[place]), None
        shorter = np.cumsum(groups, axis=3)[(slice(None), *place)] / own[own > 0]
        return float(off[place]), float(shorter.std(ddof=1) / np.sqrt(len(groups)))


def count_intervals(
    name: str, radiance: float, time_s: np.ndarray, pixel: np.ndarray, on: np.ndarray, seen_s: float
) -> MeasuredIntervals:
    """Count the intervals of events in order of time: (n,) times in s, pixels and polarities; seen_s: whole time."""
    order = np.argsort(pixel, kind="stable")
    t, own, off = time_s[order], pixel[order], 1 - on[order].astype(np.int64)
    follows = own[1:] == own[:-1]
    bins = np.clip(np.searchsorted(EDGES_S, np.diff(t)[follows], side="right") - 1, 0, len(CENTRES_S) - 1)
    groups = 8  # of pixels, that tell how much shares differ by chance
    group = own[1:][follows] % groups
    place = ((group * 2 + off[:-1][follows]) * 2 + off[1:][follows]) * len(CENTRES_S) + bins
    counts = np.bincount(place, minlength=groups * 4 * len(CENTRES_S)).reshape(groups, 2, 2, -1)
    return MeasuredIntervals(name, radiance, counts, seen_s)


def intervals_in_words(entry: dict[str, Any], unit: str, least: float) -> str:
    """A sentence where the distance is beyond `least` and chance; empty else."""
    far, error, median = entry["distance"], entry["distance_error"], entry["median_s"]
    sure = 3.0  # standard errors from which a difference is more than chance
    if far is None or error is None or far < max(least, sure * error):
        return ""
    return (
        f"{entry['file']} at {entry['radiance']:.3g} {unit}: intervals between events are not those predicted: shares "
        f"of shorter ones differ by up to {far:.2f}, half are below {median['measured']:.3g} s, predicted "
        f"{median['predicted']:.3g} s"
    )


def _shares(counts: np.ndarray) -> np.ndarray:
    return counts / max(float(counts.sum()), 1e-300)


def _histogram(found: np.ndarray, expected: np.ndarray | None) -> dict[str, Any]:
    """Shares of intervals of all polarities in coarser bins, where there are any."""
    coarse = [None if one is None else one.sum((0, 1)).reshape(-1, COARSE).sum(1) for one in (found, expected)]
    filled = np.flatnonzero(sum(one for one in coarse if one is not None) > LEAST_SHARE)
    if not len(filled):
        return {"edges_s": [], "measured": [], "predicted": None}
    part = slice(int(filled[0]), int(filled[-1]) + 1)
    measured, predicted = (None if one is None else one[part].tolist() for one in coarse)
    edges = EDGES_S[::COARSE][part.start : part.stop + 1]
    return {"edges_s": edges.tolist(), "measured": measured, "predicted": predicted}


def _median(shares: np.ndarray) -> float | None:
    """Of all polarities, s; None where there is no interval."""
    shorter = np.cumsum(shares.sum((0, 1)))
    if not shorter[-1] > 0:
        return None
    return float(np.exp(np.interp(0.5 * shorter[-1], np.append(0.0, shorter), np.log(EDGES_S))))
