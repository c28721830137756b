"""The free-run gap: the model simulated under the same light, against what was measured.

Each measured pixel gets twins: simulated pixels with its thresholds as the model reads them from its events, let go
where its first event let it go, and free from then on.  What differs beyond the noise of their thresholds is the
model's fault.  (Pixels that share a readout get a whole sensor of twins.  Under shot noise, where thresholds cannot be
read off single events, sensors of other pixels stand in for the twins, and differences between pixels count as chance.)

Cells are the counts of a pixel per recording and polarity: in the whole recording, its halves, quarters and eighths,
and by the wait since the event before.  With n_b the count of all P measured pixels in cell b, μ_b and v_b mean and
variance of their twins',

    G = mean_b (n_b − μ_b)² / v_b

first over the cells of one size, then over sizes, polarities and recordings: the squared disagreement in units of
chance, about 1 when model and measurement are the same thing.  The yardstick v is that of the grown model for before,
after and floor; the floor is the same G of a set of twins of the grown model, once more simulated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pixelid.gap.side_by_side import side_by_side
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.model import Model
from pixelid.recordings.recording import Recording
from pixelid.recordings.selection import only
from pixelid.simulate import Twins, simulate

METRIC = "mean squared difference of event counts, in units of chance (about 1: none)"
PARTS, WAITS = (1, 2, 4, 8), 6
COPIES = 24  # twins of each pixel, or sensors
GROUPS = 8  # of twins behind the floor
RESAMPLES = 400
CLOSES, MUCH = 0.1, 0.75  # of the gap: next to nothing; less is not closed
VISIBLE = 2.0  # standard deviations of chance by which a gap must exceed its floor, to speak of closing it
LEAST_VARIANCE = 0.02  # of a pixel's count: cells that hardly vary


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


def closes_nothing(run: FreeRun, remainder: bool) -> bool:
    """Whether the effects behind a free run have to be withdrawn.

    They surely close next to nothing of the gap, or seem to beside something significant that is left.
    """
    if run.closed is None or run.interval is None:
        return False
    return run.interval[1] < CLOSES or (remainder and run.closed < CLOSES)


def leaves_much(run: FreeRun) -> bool:
    """Whether much of a visible gap surely stays open, whatever the maps say."""
    return run.closed is not None and run.interval is not None and run.interval[1] < MUCH


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
    seed: int,
    hot: np.ndarray | None = None,
) -> FreeRun:
    """The gap of two models on the events of `pixels` (P,).

    recordings: with their stimuli as the fit reads them;  timely: the same with what the readout did undone
    everyone: the active pixels of the sensor, which share one readout;  fitted: how many are behind the models' values
    hot: (P,) which of the pixels are hot: their twins fire the extra events of the model's hot_pixels
    """
    edges = [_wait_edges(r) for r in recordings]
    alike = not after.has("shot_noise")
    measured = counted(recordings, pixels, edges, after_first=alike)
    expected = {}
    for name, model, salt in (("before", before, 1), ("after", after, 2)):
        tables = (
            _twins(recordings, timely, pixels, everyone, model, edges, seed + 1000 * salt, hot)
            if alike
            else _sensors(recordings, len(pixels), len(everyone), model, edges, seed + 1000 * salt)
        )
        expected[name] = _expected(tables, 0.0 if alike else len(pixels) / fitted)
    variance = np.maximum(expected["after"].variance, LEAST_VARIANCE)
    totals = sum(part.mean.sum(axis=0) for part in expected.values())
    weights = _weights(measured, (measured.table.sum(axis=0) + totals) > 0)

    def gap(rows, observed, name):
        """Squares (cells,) of the difference of `observed` (P, cells) from a model, over the pixels `rows`."""
        off = observed[rows].sum(axis=0) - expected[name].mean[rows].sum(axis=0)
        return off**2 / variance[rows].sum(axis=0)

    def gaps(rows):
        floors = [gap(rows, one, "after") for one in expected["after"].sets]
        return gap(rows, measured.table, "before"), gap(rows, measured.table, "after"), np.mean(floors, axis=0)

    P = len(pixels)
    found = gaps(np.arange(P))
    G = [float(weights @ part) for part in found]
    rng = np.random.default_rng(seed)
    draws = [
        _closed(*(float(weights @ part) for part in gaps(rng.integers(P, size=P))))
        for _ in range(RESAMPLES if P > 1 else 0)
    ]
    chance = np.std([float(weights @ gap(np.arange(P), one, "after")) for one in expected["after"].sets], ddof=1)
    closed = _closed(*G) if G[0] > G[2] + VISIBLE * chance else None
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


def _twins(
    recordings, timely, pixels: np.ndarray, everyone: np.ndarray, model: Model, edges, seed: int, hot=None
) -> np.ndarray:
    """(copies, P, cells) counts of twins of the measured pixels."""
    queue = model.has("readout_latency")
    crowd = np.union1d(everyone, pixels) if queue else pixels
    named = {r.name: r for r in timely}
    mine = only([named.get(r.name, r) for r in recordings], crowd)  # true times are lost in some
    on, off = _thresholds(only(timely, crowd), crowd, model)
    copies = COPIES + GROUPS
    exact = model.without_effect("threshold_mismatch").without_effect("hot_pixels")
    extra_hz = model.circuit().hot_hz if hot is not None else 0.0
    dead = float(np.real(model.circuit().refractory))
    sensors, each = (copies, 1) if queue else (1, copies)  # sensors of twins, twins of each pixel in a sensor
    place = np.searchsorted(crowd, pixels)
    watched = (np.arange(each)[:, None] * len(crowd) + place).ravel()
    burning = watched[np.tile(hot, each)] if hot is not None and extra_hz > 0 else np.empty(0, np.int64)
    runs: list[list[Recording]] = [[] for _ in range(sensors)]
    for i, (recording, own) in enumerate(zip(recordings, mine, strict=True)):
        released = np.full(len(crowd), np.inf)
        first = np.unique(own.events.pixel, return_index=True)
        released[np.searchsorted(crowd, first[0])] = own.events.t[first[1]] * 1e-9 + dead
        twins = Twins(np.tile(on, each), np.tile(off, each), np.tile(released, each))
        for k, done in enumerate(runs):
            own_seed = seed + i + 101 * k
            run = simulate(exact, recording.stimulus, width=len(twins.on), height=1, seed=own_seed, twins=twins)
            done.append(_burning(run, burning, extra_hz, own_seed) if len(burning) else run)
    table = np.stack([counted(done, watched, edges).table for done in runs])
    return table.reshape(copies, len(pixels), -1)


def _burning(recording: Recording, pixels: np.ndarray, rate_hz: float, seed: int) -> Recording:
    """The recording with ON events of a Poisson process in some pixels."""
    assert recording.stimulus is not None
    rng, events = np.random.default_rng(seed), recording.events
    start, span = float(recording.stimulus.t[0]), recording.stimulus.duration_s
    x = np.repeat(pixels, rng.poisson(rate_hz * span, len(pixels)))
    t = np.concatenate([events.t, ((start + span * rng.random(len(x))) * 1e9).astype(np.int64)])
    order = np.argsort(t, kind="stable")
    x = np.concatenate([events.x, x.astype(np.uint16)])[order]
    p = np.concatenate([events.p, np.ones(len(t) - len(events), np.uint8)])[order]
    return replace(recording, events=replace(events, t=t[order], x=x, y=np.zeros(len(t), np.uint16), p=p))


def _thresholds(recordings, pixels: np.ndarray, model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Each pixel's ON and OFF thresholds (P,) as the model reads them from its events."""
    circuit = model.circuit()
    on = np.full(len(pixels), float(np.real(circuit.on_threshold)))
    off = np.full(len(pixels), float(np.real(circuit.off_threshold)))
    likelihood = EventTimes(recordings)
    means = likelihood.terms(circuit).group_mean.reshape(-1, 2)
    seen = np.isin(likelihood.pixel_keys, pixels)
    where = np.searchsorted(pixels, likelihood.pixel_keys[seen])
    off[where], on[where] = np.real(means[seen, 0]), np.real(means[seen, 1])
    return on, off


def _sensors(recordings, P: int, sensor: int, model: Model, edges, seed: int) -> np.ndarray:
    """(copies, P, cells) counts of P pixels of each of many simulated sensors, whole where pixels share a readout."""
    width = sensor if model.has("readout_latency") else P

    def run(job: tuple[int, int]) -> Recording:
        copy, i = job
        own, light = seed + 101 * copy + i, recordings[i].stimulus
        return simulate(model, light, width=width, height=1, seed=own, sensor_seed=seed + copy)

    tables = []
    for copy in range(COPIES + GROUPS):
        runs = side_by_side(run, [(copy, i) for i in range(len(recordings))])
        tables.append(counted(runs, np.arange(width), edges).table[:P])
    return np.stack(tables)


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


def counted(
    recordings: Sequence[Recording], pixels: np.ndarray, wait_edges: Sequence[np.ndarray], after_first: bool = False
) -> Counts:
    """The counts of the given pixels in the cells of each recording; after_first: without each pixel's first event."""
    tables, home, blocks = [], [], []
    highest = max([int(pixels.max(initial=0)), *(int(r.events.pixel.max(initial=0)) for r in recordings)])
    place = np.full(highest + 1, -1)
    place[pixels] = np.arange(len(pixels))
    for k, (recording, edges) in enumerate(zip(recordings, wait_edges, strict=True)):
        events, stimulus = recording.events, recording.stimulus
        assert stimulus is not None
        row = place[events.pixel]
        mine = row >= 0
        if after_first:
            mine[np.unique(events.pixel, return_index=True)[1]] = False
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
