"""Pooled counts as the search for the gap sees them: stretches of time, cells after jumps of the light, maps, distance.

Stretches take the place of pixels as exchangeable units: five of twelve fit, a quarter select, a third confirm.  Counts
scatter more than Poisson's law allows, so log-likelihoods are divided by the dispersion (quasi-likelihood; McCullagh &
Nelder 1989, section 9.2), and maps are judged by flipping the signs of whole stretches.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pixelid.errors import InputError
from pixelid.fit import newton
from pixelid.fit.coordinates import Coordinates
from pixelid.fit.pooled_rate import PooledRateObjective, simulated
from pixelid.gap.confirm.free_run import RESAMPLES, FreeRun
from pixelid.gap.criteria import Criteria
from pixelid.gap.detect.covariates import POLARITY
from pixelid.gap.detect.maps import flip_signs
from pixelid.likelihood.pooled_rate import PooledRate, delay_name
from pixelid.model.model import Model
from pixelid.parameters.parameter import Parameter
from pixelid.stimuli.stimulus import Stimulus

STRETCHES = 60  # per recording: enough to flip signs of, each long beside the pixels' memory
ROLES = (25, 15, 20)  # of them: to fit, to select, to confirm
SINCE_S = (0.0, 1e-4, 2e-4, 3.5e-4, 6e-4, 1e-3, 2e-3, 5e-3, np.inf)  # slices of the time since the light jumped
MIN_JUMP = 0.05  # change of ln L from one sample to the next that counts as a jump: a quarter of a usual threshold
TIMES = 8  # slices of a recording
POOLS = 16  # simulated: chance to a fifth
FINER = 4  # parts of a stretch, of which each is a unit for slices of a recording: these have few stretches each
LEVELS = 4  # of ln L, as many bins in each
STILL = 0.02  # of the 95 % quantile of |d ln L/dt|: slopes below count as none
PRIOR_COUNTS = 10.0  # of a cell's factor, in units of the dispersion: a gamma prior about 1 with a spread of a third


@dataclass(frozen=True)
class Fitted:
    """A model fitted to pooled counts: at which vector of which coordinates, expected counts (bins,), quasi nats."""

    model: Model
    coordinates: Coordinates
    x: np.ndarray
    expected: np.ndarray
    value: float

    @property
    def nuisances(self) -> dict[str, float]:
        """What the recordings' own parameters are there."""
        return self.coordinates.nuisances_at(self.x)


@dataclass(frozen=True)
class PooledDiagnostics:
    """What is left: cells by |score| as JSON, p of the largest, the largest in words."""

    cells: list[dict]
    p: float
    words: str


@dataclass(frozen=True)
class Cells:
    """cell: (bins,) cell of each bin under one way of sorting;  labels: in words;  name: what sorts;
    places: the same as values, for those who draw;  unit: (bins,) exchangeable units, where they are not stretches."""

    name: str
    cell: np.ndarray
    labels: tuple[str, ...]
    places: tuple[dict, ...] = ()
    unit: np.ndarray | None = None


@dataclass(frozen=True)
class Stretches:
    """Pooled counts cut into stretches of time.

    whole: the likelihood of all bins;  stretch, role: (bins,) where each belongs, roles 0 fit, 1 select, 2 confirm
    dispersion: variance of counts over that of the model's pool;  nuisances: of the recordings, free and held
    """

    whole: PooledRate
    stretch: np.ndarray
    role: np.ndarray
    dispersion: float
    nuisances: tuple[Parameter, ...]

    def part(self, *roles: int) -> PooledRate:
        """The likelihood of the stretches of some roles."""
        return self.whole.of_bins(np.isin(self.role, roles))

    def fit(self, model: Model, nuisances: Mapping[str, float], likelihood: PooledRate, steps: int) -> Fitted:
        """The model fitted to a part of the stretches."""
        coordinates = Coordinates.of(model, tuple(p.at(p.within(nuisances[p.name])) for p in self.nuisances))
        objective = PooledRateObjective(likelihood, coordinates)
        end = newton.maximise(objective, coordinates.start, tolerance=0.1 * self.dispersion, max_steps=steps)
        expected = objective.expected(end.x)
        value = likelihood.log_likelihood(expected) / self.dispersion
        return Fitted(coordinates.model_at(end.x), coordinates, end.x, expected, value)

    def near(self, model: Fitted) -> Stretches:
        """The same with the variances of counts of another model, and what counts scatter about it."""
        whole = self.whole.near(model.model.circuit(), model.coordinates.values(model.x))
        return replace(self, whole=whole, dispersion=max(whole.dispersion(model.expected), 1.0))

    def free_run(self, model: Fitted, pools: int, seed: int) -> np.ndarray | None:
        """(pools, bins) counts of pools simulated from a model; None where it cannot be simulated."""
        values, whole = model.coordinates.values(model.x), self.whole
        pixels = max(round(values["pooled.pixels"]), 1)
        rng, rows = np.random.default_rng(seed), []
        for pool in range(pools):
            parts = []
            for i, counts in enumerate(whole.counts):
                try:
                    bins, _ = simulated(whole, i, model.model, values, pixels, seed * pools + pool)
                except InputError:
                    return None
                noise = rng.poisson(whole.background(i, values))
                parts.append(np.bincount(bins, minlength=2 * len(counts.on)) + noise)
            rows.append(np.concatenate(parts))
        return np.array(rows, float)

    def by_stretch(self, role: int, better: Fitted, worse: Fitted) -> np.ndarray:
        """(stretches of a role,) quasi nats that one model gains on another."""
        gain = (self.whole.per_bin(better.expected) - self.whole.per_bin(worse.expected)) / self.dispersion
        inside = self.role == role
        return np.bincount(np.unique(self.stretch[inside], return_inverse=True)[1], gain[inside])


def cut_into_stretches(whole: PooledRate, dispersion: float, nuisances: Iterable[Parameter], seed: int) -> Stretches:
    """The counts cut, roles drawn by the seed."""
    rng = np.random.default_rng(seed)
    stretch, role, first = [], [], 0
    for counts in whole.counts:
        n = len(counts.on)
        own = np.minimum(np.arange(n) * STRETCHES // n, STRETCHES - 1)
        roles = np.repeat([0, 1, 2], ROLES)[rng.permutation(STRETCHES)]
        stretch += [first + own, first + own]
        role += [roles[own], roles[own]]
        first += STRETCHES
    return Stretches(whole, np.concatenate(stretch), np.concatenate(role), max(dispersion, 1.0), tuple(nuisances))


def sort_bins(stretches: Stretches, base: Fitted) -> list[Cells]:
    """Bins sorted by the time since the light last jumped, by its level and slope, and by the time in the recording."""
    whole, known = stretches.whole, base.coordinates.values(base.x)
    since, since_labels, since_places, time, time_labels, finer = [], [], [], [], [], []
    light_cell, light_labels = [], []
    for i, (recording, counts) in enumerate(zip(whole.recordings, whole.counts, strict=True)):
        stimulus = recording.stimulus
        assert isinstance(stimulus, Stimulus)
        light = 1.0 + 2.0 * stimulus.radiance if stimulus.unit == "shape" else stimulus.radiance
        logs, delay = np.log(np.maximum(light, 1e-300)), known[delay_name(whole.recordings, i)]
        change = np.diff(logs)
        jumps = np.flatnonzero(np.abs(change) > MIN_JUMP)
        at = stimulus.t[jumps + 1] + delay
        middle = 0.5 * (counts.edges[1:] + counts.edges[:-1])
        last = np.searchsorted(at, middle, side="right") - 1
        up = change[jumps][np.maximum(last, 0)] > 0 if len(jumps) else np.zeros(len(middle), dtype=bool)
        wait = middle - at[np.maximum(last, 0)] if len(at) else np.zeros(len(middle))
        slice_ = np.clip(np.searchsorted(SINCE_S, wait, side="right") - 1, 0, len(SINCE_S) - 2)
        since_cell = np.where(last < 0, 2 * (len(SINCE_S) - 1), np.where(up, len(SINCE_S) - 1, 0) + slice_)
        of_light, of_light_labels = _by_light(np.interp(middle - delay, stimulus.t, logs))
        piece = i * STRETCHES * FINER + np.arange(len(middle)) * STRETCHES * FINER // len(middle)
        part = np.minimum(np.arange(len(middle)) * TIMES // len(middle), TIMES - 1)
        for polarity in (1, 0):
            since.append(len(since_labels) + since_cell)
            for side, (a, b) in itertools.product(("fell", "rose"), itertools.pairwise(SINCE_S)):
                bounded = np.isfinite(b)
                span = f"{1e3 * a:.3g}–{1e3 * b:.3g} ms" if bounded else f"more than {1e3 * a:.3g} ms"
                since_labels.append(f"{POLARITY[polarity]} in {recording.name}, {span} after the light {side}")
                since_places.append(
                    {"recording": recording.name, "polarity": POLARITY[polarity], "light": side, "from_s": float(a),
                     "to_s": float(b) if bounded else None}
                )  # fmt: skip
            since_labels.append(f"{POLARITY[polarity]} in {recording.name}, before any jump of the light")
            since_places.append(
                {
                    "recording": recording.name,
                    "polarity": POLARITY[polarity],
                    "light": "none",
                    "from_s": 0.0,
                    "to_s": None,
                }
            )
            light_cell.append(len(light_labels) + of_light)
            light_labels += [f"{POLARITY[polarity]} in {recording.name}, {label}" for label in of_light_labels]
            finer.append(piece)
            time.append(len(time_labels) + part)
            time_labels += [f"{POLARITY[polarity]} in {recording.name}, part {k + 1} of {TIMES}" for k in range(TIMES)]
    return [
        Cells("time since the light jumped", np.concatenate(since), tuple(since_labels), tuple(since_places)),
        Cells("level and slope of the light", np.concatenate(light_cell), tuple(light_labels)),
        Cells("time in the recording", np.concatenate(time), tuple(time_labels), unit=np.concatenate(finer)),
    ]


def _by_light(logs: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """((bins,) cell, labels) of ln L (bins,): its level, and whether it rises, falls or stands still."""
    level = np.searchsorted(np.unique(np.quantile(logs, np.arange(1, LEVELS) / LEVELS)), logs, side="left")
    slope = np.gradient(logs) if len(logs) > 1 else np.zeros(len(logs))
    moving = np.abs(slope) > STILL * np.quantile(np.abs(slope), 0.95)
    way = np.where(moving, np.where(slope > 0, 1, 2), 0)
    quarters = ("dimmest", "second", "third", "brightest")
    labels = [
        f"{quarter} quarter of the light, {how}" for how in ("steady", "rising", "falling") for quarter in quarters
    ]
    return way * LEVELS + level, labels


def diagnose_pooled(
    stretches: Stretches, cells: Sequence[Cells], model: Fitted, criteria: Criteria, seed: int
) -> PooledDiagnostics:
    """What the training stretches leave under a model."""
    train = stretches.role < 2
    observed, expected = stretches.whole.observed[train], model.expected[train]
    scatter = stretches.dispersion * stretches.whole.ratio[train] * expected
    table: list[dict] = []
    sums: dict[bool, list[np.ndarray]] = {}
    for sorted_by in cells:
        own = stretches.stretch if sorted_by.unit is None else sorted_by.unit
        units = np.unique(own[train], return_inverse=True)[1]
        k = len(sorted_by.labels)
        cell = sorted_by.cell[train]
        n, mu, variance = (np.bincount(cell, values, k) for values in (observed, expected, scatter))
        shown = np.flatnonzero(mu > criteria.min_cell_events)
        off = np.bincount(units * k + cell, observed - expected, (units.max() + 1) * k).reshape(-1, k)
        sums.setdefault(sorted_by.unit is None, []).append(off[:, shown])
        score = (n - mu) / np.sqrt(np.maximum(variance, 1e-300))
        table += [
            {"response": "count", "where": sorted_by.labels[b], "score": float(score[b]), "events": int(n[b]),
             "expected": float(mu[b]), "mean": float(n[b] / mu[b])}
            for b in shown
        ]  # fmt: skip
    table.sort(key=lambda c: -abs(c["score"]))
    if not table:
        return PooledDiagnostics([], 1.0, "nowhere in particular")
    chances = [flip_signs(np.concatenate(some, axis=1), seed) for some in sums.values()]
    told = [p for p in chances if p is not None]
    p = min(1.0, len(told) * min(told)) if told else 1.0
    top = table[0]
    return PooledDiagnostics(
        table, p, f"{top['where']}: {top['events']} events, the model expects {top['expected']:.0f}"
    )


def closed_gap(
    stretches: Stretches, cells: Cells, base: Fitted, grown: Fitted, criteria: Criteria, seed: int
) -> FreeRun:
    """The gap of the counts after jumps, on the stretches set aside, before and after.

    Where cycles of a readout are given, expected counts know what came before: both models then run freely, as
    simulated pools, and chance is what these scatter by.
    """
    confirm = stretches.role == 2
    units = np.unique(stretches.stretch[confirm], return_inverse=True)[1]
    k, cell = len(cells.labels), cells.cell[confirm]

    def table(values):
        return np.bincount(units * k + cell, values[confirm], (units.max() + 1) * k).reshape(-1, k)

    observed, before, after = table(stretches.whole.observed), table(base.expected), table(grown.expected)
    scatter, pools = table(stretches.dispersion * stretches.whole.ratio * grown.expected), None
    if any(stretches.whole.cycles):
        free_base, free_grown = (stretches.free_run(model, POOLS, seed) for model in (base, grown))
        if free_base is not None and free_grown is not None:
            before, pools = table(free_base.mean(axis=0)), np.array([table(pool) for pool in free_grown])
            after = pools.mean(axis=0)

    def gaps(rows) -> tuple[float, float]:
        mu = after[rows].sum(axis=0)
        shown = mu > criteria.min_cell_events
        chance = scatter[rows].sum(axis=0)[shown]
        if pools is not None:
            chance = (1.0 + 1.0 / POOLS) * np.maximum(pools[:, rows].sum(axis=1).var(axis=0, ddof=1)[shown], 1.0)
        return tuple(
            float(np.mean((observed[rows].sum(axis=0) - model[rows].sum(axis=0))[shown] ** 2 / chance))
            for model in (before, after)
        )  # type: ignore[return-value]

    def closed(pair):
        return 1.0 - (pair[1] - 1.0) / (pair[0] - 1.0) if pair[0] > 1.0 else None

    rows = np.arange(len(observed))
    G = gaps(rows)
    rng = np.random.default_rng(seed)
    draws = [c for c in (closed(gaps(rng.choice(rows, len(rows)))) for _ in range(RESAMPLES)) if c is not None]
    interval = (float(np.quantile(draws, 0.025)), float(np.quantile(draws, 0.975))) if draws else None
    return FreeRun(*G, 1.0, closed(G), interval, {})


def flexible_factor(stretches: Stretches, cells: Sequence[Cells], model: Fitted) -> tuple[str, float]:
    """(what sorts, quasi nats on the select stretches) of rates multiplied by a factor per cell; ("", 0) for none."""
    best = ("", 0.0)
    for sorted_by in cells:
        k = len(sorted_by.labels)
        sums = []
        for role in (0, 1):
            at = stretches.role == role
            for values in (stretches.whole.observed, model.expected):
                sums.append(np.bincount(sorted_by.cell[at], values[at], k))
        n, mu, held, held_mu = sums
        prior = stretches.dispersion * PRIOR_COUNTS
        factor = (n + prior) / (mu + prior)
        gain = float(np.sum(held * np.log(factor) - held_mu * (factor - 1.0)) / stretches.dispersion)
        best = max(best, (sorted_by.name, gain), key=lambda pair: pair[1])
    return best


def profiles_after_jumps(
    stretches: Stretches, cells: Cells, base: Fitted, grown: Fitted, min_events: int
) -> list[dict]:
    """Counts per cell of the time since the light jumped, all stretches: measured, base, grown."""
    k = len(cells.labels)
    n, mu, nu = (np.bincount(cells.cell, v, k) for v in (stretches.whole.observed, base.expected, grown.expected))
    return [
        {"where": label, **place, "measured": float(n[i]), "base": float(mu[i]), "grown": float(nu[i])}
        for i, (label, place) in enumerate(zip(cells.labels, cells.places, strict=True))
        if max(mu[i], n[i]) > min_events
    ]  # fmt: skip
