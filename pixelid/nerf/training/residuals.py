"""What a scene seen through a pixel leaves unexplained of held-out events, row by row, and how two pixels compare.

A row is a stretch between events of a pixel that training has not seen.  Two pixels are compared by Huber's loss of the
same rows; pixels of the sensor are the independent units, since a chain's rows share what the scene gets wrong there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from pixelid.nerf.events.intervals import CHAIN, Intervals
from pixelid.nerf.training.held_out import Gain, paired
from pixelid.nerf.training.losses import Weights, huber
from pixelid.nerf.training.predict import chains_at, predict
from pixelid.nerf.training.state import Problem, State

BLOCK = 256  # chains rendered at a time
MOST_CHAINS = 8192  # that judge a pixel, some 1e5 rows: the cost of a search does not grow with the sensor
BINS = 8  # of a residual map
RUN = 8  # rows whose rests are summed up


@dataclass(frozen=True)
class Rows:
    """(n,) each, by pixel and time.

    pixel: row-major index;  begin, end: s;  rest: what events say beyond the predicted change, in `unit`, positive
    where the scene explains too little of an ON event or too much of an OFF event;  variance: of the events' own part
    in thresholds²;  rise: whether it ends in ON events more than OFF;  burst: several events at once;  radiance: at its
    end;  unit: ln L
    """

    pixel: np.ndarray
    begin: np.ndarray
    end: np.ndarray
    rest: np.ndarray
    variance: np.ndarray
    rise: np.ndarray
    burst: np.ndarray
    radiance: np.ndarray
    unit: float

    @property
    def beyond(self) -> np.ndarray:
        """(n,) by how many thresholds events say more than the scene, of either polarity."""
        return self.rest * np.where(self.rise, 1.0, -1.0)

    @property
    def told(self) -> bool:
        """Whether there are any, and all are numbers."""
        return bool(len(self.rest) and np.isfinite(self.rest).all() and np.isfinite(self.radiance).all())


def apart(of: Intervals) -> np.ndarray:
    """Indices into `of.starts` at which chains begin that share no stretch and leave none of these pixels out."""
    pixel = of.stretches.pixel
    first = np.flatnonzero(np.concatenate([[True], pixel[1:] != pixel[:-1]]))
    since = of.starts - first[np.searchsorted(first, of.starts, side="right") - 1]
    return np.flatnonzero(since % CHAIN == 0)


def of_some_pixels(of: Intervals, starts: np.ndarray, most: int) -> np.ndarray:
    """Places in `starts` (k,), indices into `of.starts`, of as many whole pixels as have some `most` of them.

    The pixels are drawn, the same ones every time, also when their events are cut differently.
    """
    pixel = of.stretches.pixel[of.starts[starts]].astype(np.int64)
    order = np.argsort(np.random.default_rng(5).random(int(pixel.max()) + 1)[pixel], kind="stable")
    last = pixel[order[most - 1]]
    return np.sort(order[: int(np.flatnonzero(pixel[order] == last)[-1]) + 1])


def of_every_pixel(of: Intervals, starts: np.ndarray, most: int) -> np.ndarray:
    """Places in `starts` (k,), indices into `of.starts`, drawn as evenly over pixels as makes some `most`."""
    pixel = of.stretches.pixel[of.starts[starts]]
    drawn = np.random.default_rng(6).permutation(len(starts))
    order = drawn[np.argsort(pixel[drawn], kind="stable")]
    first = np.flatnonzero(np.concatenate([[True], np.diff(pixel[order]) != 0]))
    place = np.arange(len(order)) - np.repeat(first, np.diff(np.append(first, len(order))))
    return np.sort(order[place < max(most // len(first), 1)])


def rows_of(problem: Problem, state: State, of: Intervals, unit: float, most: int = MOST_CHAINS) -> Rows:
    """The rows of the pixels of `of`, of as many as have some `most` chains, with the same random numbers every time.

    unit: thresholds that rests are counted in, ln L
    """
    starts = apart(of)
    starts = starts[of_some_pixels(of, starts, most)] if len(starts) > most else starts
    return _rows_at(problem, state, of, starts, unit)


def _rows_at(problem: Problem, state: State, of: Intervals, starts: np.ndarray, unit: float) -> Rows:
    """The rows of the chains that begin at `starts`, indices into `of.starts`."""
    parts = []
    for k in range(0, len(starts), BLOCK):
        rng = np.random.default_rng([1, k])
        with torch.no_grad():
            batch = chains_at(problem, state, of, starts[k : k + BLOCK], rng)
            change, _, u = predict(problem, state, batch, rng)
            on, off = (x.cpu().numpy() for x in state.pixel.thresholds_at(batch.pixel))
        told = batch.weight > 0
        said = batch.rise * on - batch.fall * off
        rest = (said - change.cpu().numpy()) / unit
        columns = (
            np.broadcast_to(batch.pixel[:, None], told.shape), batch.t[batch.begin], batch.t[batch.end], rest,
            batch.variance, batch.rise > batch.fall, batch.burst, np.exp(u.cpu().numpy())[batch.end],
        )  # fmt: skip
        parts.append([column[told] for column in columns])
    return Rows(*(np.concatenate(part) for part in zip(*parts, strict=True)), unit=unit)


def residual_map(**of: Rows) -> dict[str, dict[str, list]]:
    """Mean rests over what may move them, in bins of equally many rows of the first.

    Args:
        of: rows by the name of what they were left by: `before=…, after=…`.

    Returns:
        Per covariate ("interval_s", "time_s", "radiance"): "edges" of the bins, and per polarity and name
        ("on_before", …) by how many thresholds events say more than the scene.
    """
    found, first = {}, next(iter(of.values()))
    for name in ("interval_s", "time_s", "radiance"):
        edges = np.unique(np.quantile(_covariate(first, name), np.linspace(0, 1, BINS + 1)))
        edges = edges if len(edges) > 1 else np.repeat(edges, 2)  # one value everywhere
        columns: dict[str, list] = {"edges": edges.tolist()}
        for when, rows in of.items():
            bin_ = np.clip(np.searchsorted(edges, _covariate(rows, name), side="right") - 1, 0, len(edges) - 2)
            for polarity, some in (("on", rows.rise), ("off", ~rows.rise)):
                some, beyond = some & ~rows.burst, rows.beyond
                number = np.bincount(bin_[some], minlength=len(edges) - 1)
                total = np.bincount(bin_[some], beyond[some], minlength=len(edges) - 1)
                means = [float(t / n) if n else None for t, n in zip(total, number, strict=True)]
                columns[f"{polarity}_{when}"] = means
        found[name] = columns
    return found


@dataclass(frozen=True)
class Left:
    """What events say beyond a scene that has been trained to its end.

    maps: of `residual_map` under "final", of held-out pixels;  on, off: (height, width) mean over the rows of each
    pixel, of training ones as well, in thresholds, NaN where a pixel has none;  rms: (height, width) of both
    """

    maps: Mapping[str, Mapping[str, list]]
    on: np.ndarray
    off: np.ndarray
    rms: np.ndarray

    def as_dict(self) -> dict[str, Any]:
        """The entry "final" of "gap" in reconstruction.json."""
        return {
            "residuals": {name: dict(columns) for name, columns in self.maps.items()},
            "pixel_spread": {
                name: float(np.nanstd(values)) if np.isfinite(values).any() else None
                for name, values in (("on", self.on), ("off", self.off))
            },
        }  # fmt: skip


def left_by(problem: Problem, state: State) -> Left | None:
    """The residuals of a trained scene under its trained pixel; None where it has diverged.

    Args:
        problem: that it was trained on.
        state: of the training.

    Returns:
        Maps over covariates, of held-out pixels, and over the sensor, of some `MOST_CHAINS` chains or one a pixel.
    """
    unit = state.pixel.mean_threshold
    of_held_out = rows_of(problem, state, problem.held_out, unit) if len(problem.held_out.starts) else None
    every = Intervals(problem.training.stretches, np.arange(len(problem.training.stretches.begin), dtype=np.int32))
    starts = apart(every)
    rows = _rows_at(problem, state, every, starts[of_every_pixel(every, starts, MOST_CHAINS)], unit)
    if not rows.told:
        return None
    shape = problem.camera.height, problem.camera.width
    single = ~rows.burst
    on, off = (_mean(rows.pixel, rows.beyond, single & some, shape) for some in (rows.rise, ~rows.rise))
    maps = residual_map(final=of_held_out) if of_held_out is not None and of_held_out.told else {}
    return Left(maps, on, off, np.sqrt(_mean(rows.pixel, rows.rest**2, single, shape)))


def _mean(pixel: np.ndarray, values: np.ndarray, some: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """(height, width) of values (n,) at pixels (n,), NaN where there are none among `some`."""
    number = np.bincount(pixel[some], minlength=shape[0] * shape[1])
    total = np.bincount(pixel[some], values[some], minlength=len(number))
    return np.where(number > 0, total / np.maximum(number, 1), np.nan).reshape(shape)


def _covariate(rows: Rows, name: str) -> np.ndarray:
    return {"interval_s": rows.end - rows.begin, "time_s": rows.end, "radiance": rows.radiance}[name]


def compare(before: Rows, after: Rows) -> Gain:
    """How much better `after` explains the rows that both have.

    Pixels that differ in their dead time cut the events differently; then quiet intervals that end with the same event
    are compared, and the sums of all that lies between them: of single rows alone, a scene that has lost its contrast
    explains more.
    """
    a, b = _shared(before, after)
    if len(a) == 0:
        return Gain(0.0, 1.0, 0)
    variance = before.variance[a]
    old, new = _losses(before, a, variance), _losses(after, b, variance)
    _, unit = np.unique(before.pixel[a], return_inverse=True)
    return paired(np.bincount(unit, old), np.bincount(unit, new), len(a))


def loss_of_pixels(rows: Rows) -> np.ndarray:
    """(pixels,) what `compare` counts, of every pixel that has rows."""
    _, unit = np.unique(rows.pixel, return_inverse=True)
    return np.bincount(unit, _losses(rows, np.arange(len(rows.rest)), rows.variance))


def _losses(rows: Rows, which: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """(k,) of some rows (k,): what training minimises, of each row and of sums of rests in runs of `RUN` of them."""
    each = _huber(rows.rest[which] / np.sqrt(1.0 + variance))
    pixel, total = rows.pixel[which], np.cumsum(rows.rest)[which]
    first = np.flatnonzero(np.concatenate([[True], pixel[1:] != pixel[:-1]]))
    place = np.arange(len(which)) - np.repeat(first, np.diff(np.append(first, len(which))))
    run = np.cumsum(place % RUN == 0) - 1
    size = np.bincount(run)
    centred = total - (np.bincount(run, total) / size)[run]
    spread = np.bincount(run, variance)[run] / 6  # of a centred random walk
    return each + Weights().chain * _huber(centred / np.sqrt(1.0 + spread))


def _huber(size: np.ndarray) -> np.ndarray:
    return huber(torch.from_numpy(size)).numpy()


def _shared(before: Rows, after: Rows) -> tuple[np.ndarray, np.ndarray]:
    """Indices of the rows that both have, in order."""
    if len(before.end) == len(after.end) and np.array_equal(before.begin, after.begin):
        every = np.arange(len(before.end))
        return every, every
    quiet = [np.flatnonzero(~rows.burst) for rows in (before, after)]
    first, second = (np.rec.fromarrays([r.pixel[k], r.end[k]]) for r, k in zip((before, after), quiet, strict=True))
    _, a, b = np.intersect1d(first, second, return_indices=True)
    return quiet[0][a], quiet[1][b]
