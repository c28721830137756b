"""The free-run gap: the model simulated under the same light, against what was measured.

Cells are the counts of a pixel per recording and polarity: in the whole recording, its halves, quarters and eighths,
and by the wait since the event before.  With n_b the mean count of the P measured pixels in cell b, μ_b and v_b mean
and pixel-to-pixel variance of M simulated ones, and F pixels behind the fitted mean thresholds,

    G = mean_b (n_b − μ_b)² / (v_b (1/P + 1/M + 1/F))

first over the cells of one size, then over sizes, polarities and recordings: the squared disagreement in units of
chance, about 1 when model and measurement are the same thing.  The yardstick v is that of the grown model for before,
after and floor; the floor is the same G of groups of P pixels simulated by the grown model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pixelid.model.model import Model
from pixelid.recordings.recording import Recording
from pixelid.simulate import simulate

METRIC = "mean squared difference of counts per pixel, in units of chance (about 1: none)"
PARTS, WAITS = (1, 2, 4, 8), 6
SIMULATED = 96  # pixels
GROUPS = 8  # of simulated pixels behind the floor
RESAMPLES = 400
LEAST_VARIANCE = 0.05  # of a count per pixel: cells that hardly vary


@dataclass(frozen=True)
class Counts:
    """Counts of each pixel (pixels, cells);  recording, block: (cells,) where each cell belongs; the blocks of a
    recording are its cells of one size and polarity."""

    table: np.ndarray
    recording: np.ndarray
    block: np.ndarray


@dataclass(frozen=True)
class FreeRun:
    """before, after, floor: G of the base model, the grown model, and chance;  closed: closed fraction, None when
    there was nothing to close, interval: 95 %, by resampling pixels
    per_recording: name → (before, after, floor)
    """

    before: float
    after: float
    floor: float
    closed: float | None
    interval: tuple[float, float] | None
    per_recording: dict[str, tuple[float, float, float]]

    def as_dict(self) -> dict:
        """The "gap" of gap.json."""
        return {
            "metric": METRIC,
            "before": self.before,
            "after": self.after,
            "floor": self.floor,
            "closed_fraction": self.closed,
            "closed_fraction_interval": self.interval,
            "per_recording": {k: dict(zip(("before", "after", "floor"), v, strict=True))
                              for k, v in self.per_recording.items()},
        }  # fmt: skip


def free_run(
    recordings: Sequence[Recording],
    pixels: np.ndarray,
    sensor: int,
    fitted: int,
    before: Model,
    after: Model,
    seed: int,
) -> FreeRun:
    """The gap of two models on the events of `pixels`; recordings with their stimuli as the fit reads them.

    sensor: active pixels of the sensor, which share one readout;  fitted: pixels behind the models' values
    """
    edges = [_wait_edges(r) for r in recordings]
    measured = counted(recordings, pixels, edges)
    P = len(pixels)
    simulated = {}
    for name, model, width, salt in (
        ("before", before, SIMULATED, 1), ("after", after, SIMULATED, 2), ("floor", after, GROUPS * P, 3),
    ):  # fmt: skip
        simulated[name] = _simulated(recordings, model, sensor, width, edges, seed + 1000 * salt)
    typical = simulated["after"]
    scale = np.maximum(typical.var(axis=0, ddof=1), LEAST_VARIANCE) * (1 / P + 1 / SIMULATED + 1 / fitted)
    weights = _weights(measured, (measured.table.sum(0) + typical.sum(0) + simulated["before"].sum(0)) > 0)
    mean = {name: table.mean(axis=0) for name, table in simulated.items()}

    def squares(observed, model):
        return (observed - mean[model]) ** 2 / scale

    def gaps(rows, floor_rows):
        seen = measured.table[rows].mean(axis=0)
        floors = [squares(simulated["floor"][g * P + floor_rows].mean(axis=0), "after") for g in range(GROUPS)]
        return squares(seen, "before"), squares(seen, "after"), np.mean(floors, axis=0)

    found = gaps(np.arange(P), np.arange(P))
    G = [float(weights @ part) for part in found]
    rng = np.random.default_rng(seed)
    draws = [
        _closed(*(float(weights @ part) for part in gaps(rng.integers(P, size=P), rng.integers(P, size=P))))
        for _ in range(RESAMPLES if P > 1 else 0)
    ]
    closed = _closed(*G)
    interval = None
    usable = [d for d in draws if d is not None]
    if closed is not None and usable:
        interval = (float(np.quantile(usable, 0.025)), float(np.quantile(usable, 0.975)))
    per_recording = {}
    for i, r in enumerate(recordings):
        own = np.where(measured.recording == i, weights, 0.0)
        total = max(own.sum(), 1e-300)
        per_recording[r.name] = tuple(float(own @ part / total) for part in found)
    return FreeRun(*G, closed, interval, per_recording)  # type: ignore[arg-type]


def _simulated(recordings, model: Model, sensor: int, pixels: int, edges, seed: int) -> np.ndarray:
    """(pixels, cells) counts of simulated pixels, as many sensors as it takes."""
    width = sensor if model.has("readout_latency") else min(sensor, SIMULATED)
    tables = []
    for copy in range(-(-pixels // width)):
        runs = [
            simulate(model, r.stimulus, width=width, height=1, seed=seed + 101 * copy + i, sensor_seed=seed + copy)
            for i, r in enumerate(recordings)
        ]
        tables.append(counted(runs, np.arange(width), edges).table)
    return np.concatenate(tables)[:pixels]


def _weights(counts: Counts, shown: np.ndarray) -> np.ndarray:
    """(cells,) each cell's weight: equal within a block, equal blocks within a recording, equal recordings; sum 1."""
    weights = np.zeros(len(shown))
    recordings = np.unique(counts.recording[shown])
    for i in recordings:
        blocks = np.unique(counts.block[shown & (counts.recording == i)])
        for b in blocks:
            inside = shown & (counts.recording == i) & (counts.block == b)
            weights[inside] = 1.0 / (len(recordings) * len(blocks) * inside.sum())
    return weights


def _closed(before, after, floor) -> float | None:
    return float(1.0 - (after - floor) / (before - floor)) if before > floor else None


def counted(recordings: Sequence[Recording], pixels: np.ndarray, wait_edges: Sequence[np.ndarray]) -> Counts:
    """The counts of the given pixels in the cells of each recording."""
    tables, home, blocks = [], [], []
    highest = max([int(pixels.max(initial=0)), *(int(r.events.pixel.max(initial=0)) for r in recordings)])
    place = np.full(highest + 1, -1)
    place[pixels] = np.arange(len(pixels))
    for k, (recording, edges) in enumerate(zip(recordings, wait_edges, strict=True)):
        events, stimulus = recording.events, recording.stimulus
        assert stimulus is not None
        row = place[events.pixel]
        mine = row >= 0
        row, t, p = row[mine], events.t[mine] * 1e-9, events.p[mine].astype(np.int64)
        span = stimulus.t[-1] - stimulus.t[0]
        sorted_by = []
        for parts in PARTS:
            stretch = np.clip(((t - stimulus.t[0]) / span * parts).astype(np.int64), 0, parts - 1)
            sorted_by.append((row, p, stretch, parts))
        order = np.lexsort((t, row))
        same = np.flatnonzero(row[order][1:] == row[order][:-1]) + 1
        later = order[same]
        wait = t[later] - t[order[same - 1]]
        sorted_by.append((row[later], p[later], np.searchsorted(edges, wait), WAITS))
        for b, (rows, polarity, cell, cells) in enumerate(sorted_by):
            tables.append(_table(rows, polarity * cells + cell, len(pixels), 2 * cells))
            home.append(np.full(2 * cells, k))
            blocks.append(np.repeat([2 * b, 2 * b + 1], cells))
    return Counts(np.concatenate(tables, axis=1), np.concatenate(home), np.concatenate(blocks))


def _table(row, cell, rows, cells) -> np.ndarray:
    return np.bincount(row * cells + cell, minlength=rows * cells).reshape(rows, cells).astype(float)


def _wait_edges(recording: Recording) -> np.ndarray:
    """(WAITS − 1,) edges between waits, the same for measurement and models: quantiles of what was measured."""
    events = recording.events
    order = np.lexsort((events.t, events.pixel))
    pixel, t = events.pixel[order], events.t[order] * 1e-9
    waits = np.diff(t)[pixel[1:] == pixel[:-1]]
    if len(waits) < WAITS:
        return np.linspace(0.01, 1.0, WAITS - 1)
    return np.quantile(waits, np.linspace(0, 1, WAITS + 1)[1:-1])
