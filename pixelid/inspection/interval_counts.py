"""Histograms of each pixel's intervals in a still scene: the published files, and the same of events.

A file holds, per pixel, how many intervals x between its successive events of one polarity had 1/x below the upper
edge of each bin, edges at 1, 2, …, 9 per decade from 1 mHz to 90 kHz.  (There are 72 edges, 71 bins; the 72nd number is
0 and means nothing.  That column j counts up to edge j + 1, not up to edge j, shows where decades meet: read the other
way the density would jump tenfold there and only there.)  Times, order and the length of the recording are not in it.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pixelid.arrays import load_arrays
from pixelid.errors import InputError
from pixelid.recordings.events import Events

EDGES_HZ = np.outer(10.0 ** np.arange(-3, 5), np.arange(1, 10)).ravel()
EDGES_S = 1.0 / EDGES_HZ[::-1]  # of intervals, rising
MOST_INTERVALS = 1 << 40  # of a pixel: a month of events at the fastest bin
NAME = re.compile(r"(?P<polarity>pos|neg)_(?P<light>[0-9.]+)(?P<kilo>k?)lux$")


@dataclass(frozen=True)
class IntervalCounts:
    """counts: (pixels, bins) intervals per bin of `EDGES_S` (rising), nominal lux, polarity "ON" | "OFF"."""

    name: str
    polarity: str
    lux: float
    counts: np.ndarray


def is_interval_counts(path: Path) -> bool:
    """Whether a file's name says that it holds such histograms, as `…_pos_161lux.npy`; others hold events."""
    return path.suffix == ".npy" and NAME.search(path.stem) is not None


def read_interval_counts(path: Path) -> IntervalCounts:
    """One file `…_pos_161lux.npy`; InputError for anything else."""
    match = NAME.search(path.stem)
    if match is None:
        raise InputError(f"{path}: expected a name ending in pos_ or neg_ and the light, as pos_161lux.npy")
    try:
        lux = float(match["light"]) * (1000.0 if match["kilo"] else 1.0)
    except ValueError:
        raise InputError(f"{path}: expected a number before lux in its name, found {match['light']!r}") from None
    if not path.exists():
        raise InputError(f"{path}: no such file")
    raw = load_arrays(path).get("", np.empty(0))
    if raw.ndim < 2 or raw.shape[-1] != len(EDGES_HZ) or not raw.size:
        raise InputError(f"{path}: expected an array of shape (…, {len(EDGES_HZ)}), found {np.shape(raw)}")
    if raw.dtype.kind not in "iuf" or not np.isfinite(raw).all() or raw.max() > MOST_INTERVALS:
        raise InputError(f"{path}: expected finite counts of at most {MOST_INTERVALS}, found others ({raw.dtype})")
    below = raw.reshape(-1, len(EDGES_HZ))[:, :-1].astype(np.float64)  # whole numbers up to 2^53; unsigned ones wrap
    counts = np.diff(below, axis=1, prepend=0)
    if (counts < 0).any() or (raw[..., -1] != 0).any() or (counts != np.rint(counts)).any():
        raise InputError(f"{path}: expected whole numbers that rise along the last axis, its last entry 0")
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
