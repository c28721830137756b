"""Fit noise rates: the shared regression of tables on ever new linearisations of ln rate.

A prediction costs tens of milliseconds per light, and ln rate is nearly linear in the fit's logarithmic coordinates.
So each round differentiates once, lets `fit_table` find the optimum of the linearised table within `TRUST`, and looks
whether the table itself is then better described, as the linear one promised; if not, the step is halved.  What is
reported is the best place visited, with errors of its own linearisation.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pixelid.model.model import Model
from pixelid.parameters.parameter import Parameter
from pixelid.tables.fit import FREEDOM, MAX_SCATTER, TableFit, fit_at, fit_table
from pixelid.tables.model import Rows
from pixelid.tables.noise.model import FLOOR, NoiseModel, in_unit
from pixelid.tables.noise.quadrature import ROUGH, WHOLE, Resolution
from pixelid.tables.noise.reading import NoiseTable

STEP = 0.02  # of a coordinate, for central differences
TRUST = 0.7  # of a coordinate per round: a factor of 2
LEAST_TRUST = 0.02  # where the rates are not linear even so near, the search has failed
FREE_TRUST = 0.2  # a step that short promises little wherever it begins: rest is judged by longer ones
ROUNDS = 20
REST = 0.02  # nats that a step promises, below which a fit has come to rest: 0.2 standard errors
LEAST_GAINED, GOOD = 0.1, 0.7  # of what a step promised: taken from, and longer steps tried from
# Where a fit looks first: factors on both thresholds (over the noise), on the light's photocurrent and the follower's
# cutoff; the latter two where the light's unit leaves the photocurrent open
THRESHOLD_STARTS = np.geomspace(0.35, 1.6, 8)
LIGHT_STARTS = np.geomspace(0.03, 300.0, 9)
FOLLOWER_STARTS = (0.1, 0.4, 1.0)
MOST_STARTS = 3  # that a search begins from, one after the other, until one describes the table
DESCRIBED = 0.2  # scatter of rows about a fit at rest that looks no farther: public curves scatter by up to 15 %
DARK_LUX = 0.05  # typical of published sensors; a start, with a wide prior
LEAK_HZ = 0.01  # the same: leak events of sensors are reported from 0.001 to 0.3 Hz


@dataclass(frozen=True)
class NoiseFit:
    """A finished fit: the regression, its observation model, and seconds taken."""

    regression: TableFit
    model: NoiseModel
    seconds: float

    @property
    def circuit(self) -> Model:
        """The model at the fitted values."""
        own = self.model.circuit.parameters
        x = zip(self.regression.parameters, self.regression.x, strict=True)
        values = {p.name: math.exp(v) for p, v in x if p.name in own}
        return self.model.circuit.set({n: own[n].within(v) for n, v in values.items()})

    @property
    def floor(self) -> float:
        """Fitted white noise whatever the light, 1/Hz."""
        x = {p.name: math.exp(v) for p, v in zip(self.regression.parameters, self.regression.x, strict=True)}
        return x.get(FLOOR.name, self.model.floor)


@dataclass(frozen=True)
class Linearised:
    """ln rate as a linear function of the coordinates around x0, as a `TableModel`."""

    rows: Rows
    parameters: tuple[Parameter, ...]
    nuisances: frozenset[str]
    neutral_bounds: tuple[tuple[str, str], ...]
    x0: np.ndarray
    level: np.ndarray
    slopes: np.ndarray

    def predict(self, x: np.ndarray) -> np.ndarray:
        """(rows,) events per pixel and second."""
        return np.exp(np.clip(self.level + self.slopes @ (x - self.x0), -60.0, 30.0))

    def dependence(self) -> Sequence[np.ndarray]:
        """Every row depends on every parameter."""
        return [np.full(len(self.level), k) for k in range(len(self.x0))]


def fit_noise(table: NoiseTable, model: Model, progress: Callable[[str, float], None] | None = None) -> NoiseFit:
    """Fit noise rates of a table or of recordings.

    Args:
        table: rates against light.
        model: start, priors, and what is not fitted; the density of its shot noise is held (thresholds and the root of
            the density go together in noise).
        progress: called with what is done and the fraction done.
    """
    begun = time.perf_counter()
    report = progress or (lambda what, fraction: None)
    ends: list[_End] = []
    for k, noise in enumerate(started(starting_model(table, model), report)):
        ends.append(_settled(noise, lambda share, k=k: report("fitting", 0.1 + 0.9 * (k + share) / MOST_STARTS)))
        if ends[-1].converged and ends[-1].scale < DESCRIBED:
            break
    end = min(ends, key=lambda end: (not end.scale < MAX_SCATTER, end.misfit))
    noise = end.model
    final = fit_at(_linearise(noise, end.x, end.level), end.x, end.scale, end.converged)
    # pixels are a sample: their mean threshold is off the sensor's by the mismatch over the root of their number
    spread = noise.circuit.values.get("threshold_mismatch.sigma", 0.0) / math.sqrt(max(table.pixels, 1))
    names = [p.name for p in noise.parameters]
    own = np.array([spread if table.pixels and name.endswith("_threshold") else 0.0 for name in names])
    regression = replace(final, model=noise, sd=np.hypot(final.sd, own))
    return NoiseFit(regression, noise, time.perf_counter() - begun)


@dataclass(frozen=True)
class _End:
    """Where a search came to rest, or gave up: coordinates, ln rates there, scatter, and minus log posterior."""

    model: NoiseModel
    x: np.ndarray
    level: np.ndarray
    scale: float
    misfit: float
    converged: bool


def _settled(noise: NoiseModel, report: Callable[[float], None]) -> _End:
    """The end of one search, from the model's values."""
    limits = np.array([p.coordinate_bounds() for p in noise.parameters])
    x = np.array([p.to_coordinate(p.value) for p in noise.parameters])
    level = np.log(noise.predict(x))
    trust, converged, scale = TRUST, False, MAX_SCATTER
    for round_ in range(ROUNDS):
        report(round_ / ROUNDS)
        line = _linearise(noise, x, level)
        while True:
            fit = fit_table(_within(line, limits, trust), np.exp(x).tolist())
            s = np.sqrt(fit.scale**2 + _known(noise))
            here = _misfit(noise, level, x, s)
            promised = here - _misfit(noise, np.log(line.predict(fit.x)), fit.x, s)
            trial = np.log(noise.predict(fit.x))
            gained = here - _misfit(noise, trial, fit.x, s)
            if promised < REST or gained > LEAST_GAINED * promised or trust < LEAST_TRUST:
                break
            trust *= 0.5
        if gained > 0.0:
            x, level, scale = fit.x, trial, fit.scale
        if trust < LEAST_TRUST or (promised < REST and trust >= FREE_TRUST):
            converged = promised < REST and trust >= FREE_TRUST
            break
        trust = min(2.0 * trust, TRUST) if promised < REST or gained > GOOD * promised else trust
    s = np.sqrt(scale**2 + _known(noise))
    return _End(noise, x, level, scale, _misfit(noise, level, x, s) + float(np.log(s).sum()), converged)


def starting_model(table: NoiseTable, model: Model) -> NoiseModel:
    """What is fitted: the model, with the effects that noise tables show beside it."""
    circuit = in_unit(model, table.unit)
    if table.pixels:  # recordings: what else there is, the model says
        return NoiseModel(table, circuit)
    if not circuit.has("leak"):
        circuit = circuit.with_effect("leak", {"rate_hz": LEAK_HZ})
    if not circuit.has("dark_current"):
        dark = DARK_LUX if table.unit == "lux" else 0.05 * float(np.exp(np.mean(np.log(table.light))))
        circuit = circuit.with_effect("dark_current", {"radiance": max(dark, 2e-6)})
    density = circuit.values["shot_noise.density"]
    return NoiseModel(table, circuit, 0.1 * density / float(table.light.max()), fit_floor=True)


def started(noise: NoiseModel, report: Callable[[str, float], None]) -> list[NoiseModel]:
    """The same from the best of a grid of thresholds, of followers, and of photocurrents where the light does not say:
    the best for each photocurrent, or for each follower, best first.

    Grid points are judged without mismatch and threshold noise, on five lights: they need be right to a factor of 2.
    """
    table, circuit = noise.table, noise.circuit
    plain = circuit.without_effect("threshold_mismatch").without_effect("threshold_noise")
    lights = np.unique(table.light)
    few = lights[np.unique(np.linspace(0, len(lights) - 1, 5).round().astype(int))]
    chosen = np.isin(table.light, few) & (table.rate_hz > table.last_digit)
    if not chosen.any():
        return [noise]
    part = NoiseTable(table.light[chosen], table.on[chosen], table.rate_hz[chosen], table.relative_error[chosen],
                      table.last_digit[chosen], np.zeros(int(chosen.sum()), int), {}, table.unit)  # fmt: skip
    target = np.log(part.rate_hz)
    known_light = table.unit == "fA" or bool(table.pixels)
    best: dict[float, tuple[float, dict[str, float]]] = {}  # photocurrent, or where that is known follower → (cost, …)
    grid = [(lit, slow) for lit in ((1.0,) if known_light else LIGHT_STARTS) for slow in FOLLOWER_STARTS]
    for lit, slow in grid:
        for f in THRESHOLD_STARTS * math.sqrt(lit):  # behind a photoreceptor of bandwidth ∝ light σ² ∝ D α
            factors = {"on_threshold": f, "off_threshold": f, "alpha": lit, "gamma": lit, "alpha_over_beta": lit,
                       "sf_cutoff_hz": slow}  # fmt: skip
            scaled = {n: (p, p.value * factors[n]) for n, p in plain.parameters.items() if n in factors}
            values = {n: p.within(v) for n, (p, v) in scaled.items()}
            trial = NoiseModel(part, plain.set(values), noise.floor)
            rates = rates_by_light(trial, np.unique(part.light), ROUGH)
            found = np.log([rates[light][0 if on else 1] for light, on in zip(part.light, part.on, strict=True)])
            cost = float(np.abs(target - found).mean())
            of = slow if known_light else lit
            if of not in best or cost < best[of][0]:
                best[of] = cost, values
    report("fitting", 0.1)
    ranked = sorted(best.values(), key=lambda start: start[0])
    return [replace(noise, circuit=circuit.set(values)) for _, values in ranked[:MOST_STARTS]]


def rates_by_light(
    noise: NoiseModel, lights: np.ndarray, resolution: Resolution = WHOLE
) -> dict[float, tuple[float, float]]:
    """Rates at each light, at the model's own values."""
    from pixelid.parallel import map_threads

    found = map_threads(lambda light: noise.rates({}, float(light), resolution), lights)
    return dict(zip(lights.tolist(), found, strict=True))


def _linearise(noise: NoiseModel, x: np.ndarray, level: np.ndarray) -> Linearised:
    points = [x + side * STEP * unit for unit in np.eye(len(x)) for side in (1.0, -1.0)]
    logs = np.log(noise.predict_many(points, ROUGH))
    slopes = ((logs[0::2] - logs[1::2]) / (2.0 * STEP)).T
    return Linearised(noise.rows, noise.parameters, noise.nuisances, noise.neutral_bounds, x, level, slopes)


def _within(line: Linearised, limits: np.ndarray, trust: float) -> Linearised:
    """The same with bounds a trusted step around x0."""
    parameters = []
    for p, x, (low, high) in zip(line.parameters, line.x0, limits, strict=True):
        below, above = math.exp(max(low, x - trust)), math.exp(min(high, x + trust))
        parameters.append(replace(p, value=float(np.clip(math.exp(x), below, above)), lower=below, upper=above))
    return replace(line, parameters=tuple(parameters))


def _known(noise: NoiseModel) -> np.ndarray:
    rows = noise.rows
    digit = rows.last_digit / math.sqrt(12.0) / (rows.measured + rows.last_digit)
    return digit**2 + np.asarray(rows.relative_error) ** 2


def _misfit(noise: NoiseModel, level: np.ndarray, x: np.ndarray, s: np.ndarray) -> float:
    """Minus log posterior for given scales, without constants."""
    rows = noise.rows
    r = (np.log(rows.measured + rows.last_digit) - np.log(np.exp(level) + rows.last_digit)) / s
    prior = sum(((v - p.prior.mean) / p.prior.sd) ** 2 for v, p in zip(x, noise.parameters, strict=True) if p.prior)
    return float(0.5 * (FREEDOM + 1.0) * np.log1p(r**2 / FREEDOM).sum() + 0.5 * prior)
