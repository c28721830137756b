"""Everything the search works on: recordings as the fit reads them, cut into pools of pixels, and the base model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import poisson

from pixelid.errors import InputError
from pixelid.fit.coordinates import Coordinates
from pixelid.fit.starts import feasible, random_starts
from pixelid.gap.attribute import Pools
from pixelid.gap.climb import Climbed, climbed, settled
from pixelid.gap.covariates import Factor, factors
from pixelid.gap.maps import Maps, maps
from pixelid.gap.residuals import Residuals, residuals, tangents
from pixelid.gap.split import Split
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.model import Model
from pixelid.recordings.recording import Recording
from pixelid.recordings.selection import few, only
from pixelid.stimuli.resample import resampled

BETWEEN = ("smooth", "linear")
SCOUT_EVENTS = 6_000  # events of the pixels that a first search looks at
STRAYS_EXPECTED = 1e-4  # fraction of events that a true model may leave without a cause
STRAYS_SIGNIFICANT = 1e-9  # chance of so many strays
ELSEWHERE, BETTER = 3, 5.0  # random starts, and nats by which one must be better, where there are


@dataclass(frozen=True)
class Workbench:
    """recordings: with stimuli resampled as `between` says;  pools: for screening, fitting, judging;
    train: the pixels of all three;  nominal: the base model at its shipped values, feasible for these events"""

    recordings: tuple[Recording, ...]
    between: str
    split: Split
    pools: Pools
    train: EventTimes
    nominal: Model
    seed: int


@dataclass(frozen=True)
class Look:
    """What the training events look like under a fitted model.  p: of the whole, maps and strays."""

    residual: Residuals
    factors: tuple[Factor, ...]
    maps: Maps
    p: float

    @property
    def stray_fraction(self) -> float:
        """Events without a cause."""
        return float(self.residual.stray.mean())


def workbench(recordings: Sequence[Recording], split: Split, model: Model, between: str, seed: int) -> Workbench:
    """The workbench of recordings whose stimuli run `between` their samples as said ("smooth", "linear")."""
    fine = tuple(finer(r, between) for r in recordings)
    fitted = only(fine, split.fit)
    scout = few(fitted, SCOUT_EVENTS, np.random.default_rng(seed))
    pools = Pools(EventTimes(scout), EventTimes(fitted), EventTimes(only(fine, split.select)))
    return Workbench(
        fine, between, split, pools, EventTimes(only(fine, split.train)), feasible(model, pools.scout), seed
    )


def based(recordings: Sequence[Recording], split: Split, model: Model, seed: int) -> tuple[Workbench, Climbed]:
    """The workbench on which the base model fits best, and the base fitted to its training pixels."""
    best: tuple[Workbench, Climbed] | None = None
    start = None
    for between in BETWEEN:
        bench = workbench(recordings, split, model, between, seed)
        if start is None:
            start = settled(bench.pools.scout, bench.nominal, bench.nominal, tolerance=0.1, max_steps=40).model
        end = settled(bench.train, start, bench.nominal, tolerance=0.05, max_steps=25)
        if best is None or end.value > best[1].value:
            best = bench, end
    assert best is not None
    return _looked_elsewhere(*best, seed)


def _looked_elsewhere(bench: Workbench, end: Climbed, seed: int) -> tuple[Workbench, Climbed]:
    """The base fit, searched for from random starts, too, where it leaves more events without a cause than it should.

    Either something is missing, or the climb lost its way: a few pixels tell, and all are asked where that was so.
    """
    if poisson.sf(end.strays - 1, STRAYS_EXPECTED * bench.train.events) > STRAYS_SIGNIFICANT:
        return bench, end
    scout = bench.pools.scout
    here = climbed(scout, end.model, tolerance=0.1, max_steps=25)
    coordinates = Coordinates.of(bench.nominal)
    points = random_starts(coordinates.start, ELSEWHERE, np.random.default_rng(seed))
    for start in (bench.nominal, *(feasible(coordinates.model_at(point), scout) for point in points)):
        other = settled(scout, start, bench.nominal, tolerance=0.1, max_steps=40)
        if other.value > here.value + BETTER:
            there = settled(bench.train, other.model, bench.nominal, tolerance=0.05, max_steps=25)
            here, end = other, there if there.value > end.value else end
    return bench, end


def reconsidered(
    bench: Workbench, recordings: Sequence[Recording], model: Model, current: Climbed
) -> tuple[Workbench, Climbed]:
    """The workbench with the other reading of the stimuli, where the grown model fits better there."""
    other = workbench(recordings, bench.split, model, BETWEEN[1 - BETWEEN.index(bench.between)], bench.seed)
    end = climbed(other.train, current.model, tolerance=0.05, max_steps=8)
    if end.value <= current.value:
        return bench, current
    return other, climbed(other.train, end.model, tolerance=0.01, max_steps=40)


def look(
    bench: Workbench,
    current: Climbed,
    strays_expected: float | None = STRAYS_EXPECTED,
    like: Sequence[Factor] = (),
) -> Look:
    """The residuals and maps of the training events under a fitted model.

    strays_expected: fraction of events that a true model may leave without a cause; None: they do not speak against it
    like: of another look, whose cells the maps shall have
    """
    here = residuals(bench.train, current.model.circuit())
    tangent = tangents(bench.train, current.coordinates, current.x, here)
    sorted_by = tuple(factors(bench.train, current.model.circuit(), here, like=like))
    found = maps(bench.train, here, tangent, sorted_by, bench.seed)
    many = 1.0
    if found.strays and strays_expected is not None:
        many = float(poisson.sf(found.strays - 1, strays_expected * len(here.e)))
    return Look(here, sorted_by, found, min(found.p, many) if many < STRAYS_SIGNIFICANT else found.p)


def finer(recording: Recording, between: str) -> Recording:
    """The recording as a fit reads it, its stimulus run `between` samples as said.  Raises InputError without one."""
    if recording.stimulus is None:
        raise InputError(f"{recording.name}: no stimulus; the gap is between a model's events and the measured ones")
    return recording.with_stimulus(resampled(recording.stimulus, between))


def relative_noise(model: Model) -> float:
    """The relative threshold noise of a model, the unit of residuals."""
    return float(np.real(model.circuit().noise))
