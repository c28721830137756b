"""The free-run gap: the model simulated under the same light, against what was measured.

Each measured pixel gets twins (`simulated.py`); what differs beyond the noise of their thresholds is the model's
fault.  (Under shot noise sensors of other pixels stand in for them, and differences between pixels count as chance.)
With n_b the count of all P measured pixels in cell b (`counts.py`), μ_b and v_b mean and variance of their twins',

    G = mean_b (n_b − μ_b)² / v_b

first over the cells of one size, then over sizes, polarities and recordings: the squared disagreement in units of
chance, about 1 when model and measurement are the same thing.  The variance v is that of the grown model for before,
after and floor; the floor is the same G of a set of twins of the grown model, once more simulated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pixelid.cluster import Work
from pixelid.gap.confirm.counts import cell_weights, count_events, wait_edges
from pixelid.gap.confirm.simulated import count_sensors, count_twins
from pixelid.gap.criteria import Criteria
from pixelid.model.model import Model
from pixelid.recordings.recording import Recording

METRIC = "mean squared difference of event counts, in units of chance (about 1: none)"
COPIES = 24  # twins of each pixel, or sensors, behind mean and variance: the latter to 30 % per cell
GROUPS = 8  # more of them behind the floor
RESAMPLES = 400  # of pixels, behind the interval: its ends to a tenth of its width


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


def closes_nothing(run: FreeRun, remainder: bool, criteria: Criteria) -> bool:
    """Whether the effects behind a free run have to be withdrawn.

    They surely close next to nothing of the gap, or seem to beside something significant that is left.
    """
    if run.closed is None or run.interval is None:
        return False
    least = criteria.min_closed_fraction
    return run.interval[1] < least or (remainder and run.closed < least)


def leaves_much(run: FreeRun, criteria: Criteria) -> bool:
    """Whether much of a visible gap surely stays open, whatever the maps say."""
    if run.closed is None or run.interval is None:
        return False
    return run.interval[1] < criteria.complete_closed_fraction


@dataclass(frozen=True)
class Expected:
    """What a model expects of each pixel: mean, variance (P, cells), and whole sets of twins (sets, P, cells)."""

    mean: np.ndarray
    variance: np.ndarray
    sets: np.ndarray


def free_run(
    recordings: Sequence[Recording],
    timely: Sequence[Recording],
    pixels: np.ndarray,
    everyone: np.ndarray,
    fitted: int,
    before: Model,
    after: Model,
    criteria: Criteria,
    seed: int,
    hot: np.ndarray | None = None,
    work: Work | None = None,
) -> FreeRun:
    """The gap of two models on the events of `pixels` (P,).

    recordings: with their stimuli as the fit reads them;  timely: the same with what the readout did undone
    everyone: the active pixels of the sensor, which share one readout;  fitted: how many are behind the models' values
    hot: (P,) which of the pixels are hot: their twins fire the extra events of the model's hot_pixels
    work: who simulates
    """
    edges = [wait_edges(r) for r in recordings]
    copies = COPIES + GROUPS
    alike = not after.has("shot_noise")
    measured = count_events(recordings, pixels, edges, after_first=alike)
    counts = _Counts(tuple(recordings), tuple(timely) if alike else None, pixels, everyone, edges, copies, hot)
    simulated = (work or Work()).map(counts, ((before, seed + 1000), (after, seed + 2000)))
    shared = 0.0 if alike else len(pixels) / fitted
    expected = {name: _expected(table, shared) for name, table in zip(("before", "after"), simulated, strict=True)}
    min_variance = 0.02  # of a pixel's count: cells that hardly vary must not divide by nothing
    variance = np.maximum(expected["after"].variance, min_variance)
    totals = sum(part.mean.sum(axis=0) for part in expected.values())
    weights = cell_weights(measured, (measured.table.sum(axis=0) + totals) > 0)

    def gap(rows, observed, name):
        """Squares (cells,) of the difference of `observed` (P, cells) from a model, over the pixels `rows`."""
        off = observed[rows].sum(axis=0) - expected[name].mean[rows].sum(axis=0)
        return off**2 / variance[rows].sum(axis=0)

    def gaps(rows):
        floors = [gap(rows, one, "after") for one in expected["after"].sets]
        return gap(rows, measured.table, "before"), gap(rows, measured.table, "after"), np.mean(floors, axis=0)

    P = len(pixels)
    parts = gaps(np.arange(P))
    G = [float(weights @ part) for part in parts]
    rng = np.random.default_rng(seed)
    draws = [
        _closed(*(float(weights @ part) for part in gaps(rng.integers(P, size=P))))
        for _ in range(RESAMPLES if P > 1 else 0)
    ]
    chance = np.std([float(weights @ gap(np.arange(P), one, "after")) for one in expected["after"].sets], ddof=1)
    closed = _closed(*G) if G[0] > G[2] + criteria.min_visible_gap_sd * chance else None
    interval = None
    usable = [d for d in draws if d is not None]
    if closed is not None and usable:
        interval = (float(np.quantile(usable, 0.025)), float(np.quantile(usable, 0.975)))
    per_recording = {}
    for i, r in enumerate(recordings):
        own = np.where(measured.recording == i, weights, 0.0)
        total = max(own.sum(), 1e-300)
        per_recording[r.name] = tuple(float(own @ part / total) for part in parts)
    return FreeRun(*G, closed, interval, per_recording)  # type: ignore[arg-type]


@dataclass(frozen=True)
class _Counts:
    """Counts (copies, P, cells) of the pixels' twins, or of other sensors, under a model and from a seed.

    timely: as of `free_run`, None for other sensors
    """

    recordings: tuple[Recording, ...]
    timely: tuple[Recording, ...] | None
    pixels: np.ndarray
    everyone: np.ndarray
    edges: list[np.ndarray]
    copies: int
    hot: np.ndarray | None

    def __call__(self, job: tuple[Model, int]) -> np.ndarray:
        model, seed = job
        seen = self.pixels, self.everyone, model, self.edges, self.copies, seed
        if self.timely is None:
            return count_sensors(self.recordings, *seen)
        return count_twins(self.recordings, self.timely, *seen, self.hot)


def _expected(tables: np.ndarray, shared: float) -> Expected:
    """From sets of twins (copies, P, cells): the last `GROUPS` stand aside as sets to compare with.

    shared: what fitted pixels add to the variance of a sum over P pixels, in units of it
    """
    behind, sets = tables[:-GROUPS], tables[-GROUPS:]
    spread = behind.var(axis=0, ddof=1)
    if shared:  # pixels stand for each other: their own differences are part of chance
        spread = np.broadcast_to(behind.reshape(-1, behind.shape[2]).var(axis=0, ddof=1), spread.shape)
        mean = np.broadcast_to(behind.mean(axis=(0, 1)), spread.shape)
        return Expected(mean, spread * (1.0 + 1.0 / len(behind) + shared), sets)
    return Expected(behind.mean(axis=0), spread * (1.0 + 1.0 / len(behind)), sets)


def _closed(before, after, floor) -> float | None:
    return float(1.0 - (after - floor) / (before - floor)) if before > floor else None
