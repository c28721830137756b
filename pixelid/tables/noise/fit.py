"""Fit noise rates: the shared regression of tables on ever new linearisations of ln rate.

A prediction costs tens of milliseconds per light (a second where pixels differ), and ln rate is nearly linear in the
fit's logarithmic coordinates.  So slopes are differences once, `fit_table` finds the optimum of the linear table within
`TRUST`, and the table itself says whether it is then better described, as the linear one promised.  Slopes follow each
step by the secant (Broyden 1965, Math. Comp. 19, 577); where they promise too much they are differences again, and
where those do the step is halved.  Rest is judged by differences.  What is reported is the best place visited, with
errors of its own linearisation.

Three searches by `ROUGH` rates of pixels that do not differ come near; the best goes on with what the model has of
mismatch.  `WHOLE` rates, ten times dearer, are taken where that came to rest: what they differ by is added to the rough
ones, and the search goes on until it stays where it is (Alexandrov & Lewis 2001, Optim. Eng. 2, 413).  Where no
pixel's thresholds are alike, rough rates are those of typical pixels, and pixels that differ are in what is added
only.  Priors lie around the model's values, wherever a search begins.  Errors of recordings follow profiles.
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pixelid.errors import InputError
from pixelid.model.model import Model
from pixelid.parameters.parameter import Parameter, log_prior
from pixelid.tables.fit import FREEDOM, MAX_SCATTER, TableFit, fit_at, fit_table
from pixelid.tables.model import Rows
from pixelid.tables.noise.model import BESIDE, FITTED, FLOOR, LEAST_HZ, OFF_BACKGROUND, NoiseModel, in_unit
from pixelid.tables.noise.quadrature import ROUGH, WHOLE, Resolution
from pixelid.tables.noise.reading import NoiseTable
from pixelid.tables.profile import Fallen, follow_profile

STEP = 0.02  # of a coordinate, for central differences
TRUST = 0.7  # of a coordinate per round: a factor of 2
STEPS = 60  # tried, taken or not
# nats that a step of `TRUST` promises, below which a fit has come to rest: 0.45 standard errors.  Valleys that rates
# hardly fix are curved, and steps in them gain a few hundredths for long.
REST = 0.1
NEAR = 1.0  # the same for searches that others go on from
NEARLY = 0.3  # … and for those along a profile, whose end moves by a twelfth
# Of what recordings fix along curved valleys: the thresholds, which go together, and a dead time, below which noise has
# nothing to tell
PROFILED = ("on_threshold", "refractory_s")
# Rates err by a per cent or two, in 26 rows that scatter by 7 % up to a nat: so much may be promised by a step of which
# none of any length wins its share.  Up to that it counts as an error of what is fitted.
LOST = 1.0
ROUNDS = 6  # of whole rates: where the last still moves, the search is not at rest
LEAST_GAINED, GOOD = 0.1, 0.7  # of what a step promised: taken from, and longer steps tried from
# Scatter of a table up to which slopes must be of `WHOLE`: those of `ROUGH` err by less than other tables scatter
FINE_SCATTER = 0.03
# Where a fit looks first: factors on both thresholds (over the noise), on the light's photocurrent and the follower's
# cutoff; the latter two where the light's unit leaves the photocurrent open
THRESHOLD_STARTS = np.geomspace(0.35, 1.6, 8)
LIGHT_STARTS = np.geomspace(0.03, 300.0, 9)
FOLLOWER_STARTS = (0.1, 0.4, 1.0)
# … and then on the dead time, which models of other sensors may have wrong by far
DEAD_STARTS = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0)
NEAR_STARTS = (0.8, 0.9, 1.0, 1.1)  # factors on thresholds beside those
# Between ln of the thresholds: a search that begins at equal ones, where rates may have a narrow maximum, stays there.
# The second, of rates at their maximum, also lets it begin far from that.
LEAST_RATIO, MOST_RATIO, MOST_RATIO_AT_MAXIMUM = 0.03, 0.1, 1.0
OF_QUIET = 0.9  # of the fewest OFF events in a table, to begin with whatever the light
MOST_STARTS = 3  # that searches begin from
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
    def beside(self) -> dict[str, float]:
        """Fitted values of `BESIDE`."""
        x = {p.name: math.exp(v) for p, v in zip(self.regression.parameters, self.regression.x, strict=True)}
        return dict(self.model.beside) | {name: value for name, value in x.items() if name in BESIDE}

    @property
    def fitted(self) -> NoiseModel:
        """The observation model at the fitted values."""
        return NoiseModel(self.model.table, self.circuit, self.beside)


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

    def moved(self, x: np.ndarray, level: np.ndarray) -> Linearised:
        """The same around x, where ln rates are `level`; the least change of slopes that explains the step there."""
        step = x - self.x0
        slopes = self.slopes + np.outer(level - self.level - self.slopes @ step, step) / (step @ step)
        return replace(self, x0=x, level=level, slopes=slopes)


def fit_noise(table: NoiseTable, model: Model, progress: Callable[[str, float], None] | None = None) -> NoiseFit:
    """Fit noise rates of a table or of recordings.

    Args:
        table: rates against light.
        model: start, priors, and what is not fitted; the density of its shot noise is held (thresholds and the root of
            the density go together in noise).
        progress: called with what is done and the fraction done.

    Raises:
        InputError: without a single rate above 0.
    """
    if not (table.rate_hz > 0).any():
        where = ", ".join(map(str, table.sources)) or "noise"
        raise InputError(f"{where}: expected a rate above 0 in some row, found none: without events nothing is fitted")
    begun = time.perf_counter()
    report = progress or (lambda what, fraction: None)
    starts = started(starting_model(table, model), report)

    def after(done: float, share: float) -> Callable[[float], None]:
        return lambda part: report("fitting", done + share * part)

    ends = [
        (_settled(start.of_equal_pixels, after(0.1 + 0.1 * k, 0.1), near=NEAR), start) for k, start in enumerate(starts)
    ]
    best, noise = min(ends, key=lambda pair: (not pair[0].scale < MAX_SCATTER, pair[0].misfit))
    end = _settled(noise, after(0.4, 0.2), best, near=NEAR) if noise.nearly_alike(best.x) else best
    for k in range(ROUNDS):
        rough = noise if noise.nearly_alike(end.x) else noise.of_typical_pixels(end.x)
        shift = _level(noise, end.x, WHOLE) - _level(rough, end.x, ROUGH)
        before, end = end, _settled(rough, after(0.6 + 0.4 * k / ROUNDS, 0.4 / ROUNDS), end, shift)
        if np.array_equal(end.x, before.x):
            break
    else:
        end = replace(end, at_rest=False)
    final = fit_at(end.line, end.x, end.scale, end.at_rest)
    # pixels are a sample: their mean threshold is off the sensor's by the mismatch over the root of their number
    spread = noise.circuit.values.get("threshold_mismatch.sigma", 0.0) / math.sqrt(max(table.pixels, 1))
    names = [p.name for p in noise.parameters]
    own = np.array([spread if table.pixels and name.endswith("_threshold") else 0.0 for name in names])
    sd = np.sqrt(final.sd**2 + own**2 + end.left**2)
    regression = replace(final, sd=sd, wider=end.left[None])
    if table.pixels and end.at_rest:
        fallen = _fallen(rough, end, shift)
        for name in PROFILED:
            regression = follow_profile(regression, name, fallen) if name in names else regression
    return NoiseFit(replace(regression, model=noise), noise, time.perf_counter() - begun)


def _fallen(rough: NoiseModel, end: _End, shift: np.ndarray | float) -> Fallen:
    """Of a finished search by rough rates times e^`shift`."""
    s = np.sqrt(end.scale**2 + rough.rows.turned_variance)
    top, names = _misfit(rough, end.line.level, end.x, s), [p.name for p in rough.parameters]

    def fallen(k: int, wanted: float, start: np.ndarray) -> float:
        line = end.line.moved(start, _level(rough, start, ROUGH) + shift)
        model = replace(rough, held={names[k]: math.exp(wanted)})
        begun = replace(end, of=None, x=start, line=line)
        held = _settled(model, lambda done: None, begun, shift, near=NEARLY, scatter=end.scale)
        return _misfit(rough, held.line.level, held.x, s) - top

    return fallen


@dataclass(frozen=True)
class _End:
    """Where a search came to rest, or gave up: coordinates, the linear table there, scatter, and minus log
    posterior;  of: whose slopes these are, None where they are of secants;  left: a step promised and not won."""

    of: tuple[Model, Resolution] | None
    x: np.ndarray
    line: Linearised
    at_rest: bool
    scale: float
    misfit: float
    left: np.ndarray


def _settled(
    noise: NoiseModel, report: Callable[[float], None], begun: _End | None = None, shift: np.ndarray | float = 0.0,
    *, near: float = 0.0, scatter: float | None = None,
) -> _End:  # fmt: skip
    """The end of one search by rough rates times e^`shift`, from where the model has it begin or from another's end.

    Slopes of `ROUGH` rates lead near an optimum.  Along directions that the rates hardly fix they are not good enough
    for the rest of the way, and to detect rest, where a table scatters by 1 %.

    near: nats; end where slopes, of differences or not, promise no more, for other searches to go on from
    scatter: of the table where it is known; fitted where None
    """
    limits = np.array([p.coordinate_bounds() for p in noise.parameters])
    slopes = WHOLE if begun and begun.scale < FINE_SCATTER else ROUGH
    x = begun.x if begun else _start(noise)
    level = _level(noise, x, ROUGH) + shift
    scale = begun.scale if begun else MAX_SCATTER
    line = replace(begun.line, level=level) if begun else None
    exact = line if begun and begun.of == (noise.circuit, slopes) else None
    trust, at_rest, left = TRUST, False, np.zeros(len(x))
    least_trust = 0.02  # where not even steps of this length win their share, a search ends
    for step in range(STEPS):
        report(step / STEPS)
        line = line or (exact := _linearise(noise, x, level, slopes))
        fit, here, promised, s = _promise(line, noise, limits, TRUST, scatter)
        if promised < (near or REST):
            if near or line is exact:
                scale, at_rest = fit.scale, True
                break
            line = None
            continue
        whole, most = fit, promised
        if trust < TRUST:
            fit, here, promised, s = _promise(line, noise, limits, trust, scatter)
        trial = _level(noise, fit.x, ROUGH) + shift
        gained = here - _misfit(noise, trial, fit.x, s)
        if gained > LEAST_GAINED * promised:
            line = line.moved(fit.x, trial)
            x, level, scale = fit.x, trial, fit.scale
            trust = min(2.0 * trust, TRUST) if gained > GOOD * promised else trust
        elif line is not exact:
            line = None
        elif trust > least_trust:
            trust *= 0.5
        else:
            if most < LOST:
                scale, at_rest, left = whole.scale, True, whole.x - x
            break
    s = np.sqrt(scale**2 + noise.rows.turned_variance)
    misfit = _misfit(noise, level, x, s) + float(np.log(s).sum())
    line = line or (exact := _linearise(noise, x, level, slopes))
    return _End((noise.circuit, slopes) if line is exact else None, x, line, at_rest, scale, misfit, left)


def _level(noise: NoiseModel, x: np.ndarray, resolution: Resolution) -> np.ndarray:
    """(rows,) ln rates."""
    return np.log(noise.predict_many([x], resolution)[0])


def _start(noise: NoiseModel) -> np.ndarray:
    """(parameters,) coordinates where a search begins."""
    return np.array([p.to_coordinate(p.value) for p in noise.parameters])


def _promise(
    line: Linearised, noise: NoiseModel, limits: np.ndarray, trust: float, scatter: float | None
) -> tuple[TableFit, float, float, np.ndarray]:
    """The linear table's optimum within a trusted step, minus log posterior here, what it promises, and the scales."""
    fit = fit_table(_within(line, limits, trust), np.exp(line.x0).tolist(), scatter=scatter)
    s = np.sqrt(fit.scale**2 + noise.rows.turned_variance)
    here = _misfit(noise, line.level, line.x0, s)
    return fit, here, here - _misfit(noise, np.log(line.predict(fit.x)), fit.x, s), s


def starting_model(table: NoiseTable, model: Model) -> NoiseModel:
    """What is fitted: the model, with the effects that noise tables show in addition to it."""
    circuit = in_unit(model, table.unit)
    if table.pixels:  # recordings: what else there is, the model says
        return NoiseModel(table, circuit)
    if not circuit.has("leak"):
        circuit = circuit.with_effect("leak", {"rate_hz": LEAK_HZ})
    if not circuit.has("dark_current"):
        dark = DARK_LUX if table.unit == "lux" else 0.05 * float(np.exp(np.mean(np.log(table.light))))
        circuit = circuit.with_effect("dark_current", {"radiance": max(dark, 2e-6)})
    density = circuit.values["shot_noise.density"]
    floor = 0.1 * density / float(table.light.max())
    return NoiseModel(table, circuit, {FLOOR.name: floor, OFF_BACKGROUND.name: LEAK_HZ}, fit_beside=True)


def started(noise: NoiseModel, report: Callable[[str, float], None]) -> list[NoiseModel]:
    """The same from the best of a grid of thresholds, of followers, and of photocurrents where the light does not say:
    the best for each photocurrent, or for each follower, best first.

    Grid points are judged without mismatch and threshold noise, on five lights: they need be right to a factor of 2.
    """
    table, plain = noise.table, noise.plain.circuit
    lights = np.unique(table.light)
    few = lights[np.unique(np.linspace(0, len(lights) - 1, 5).round().astype(int))]
    chosen = np.isin(table.light, few) & (table.rate_hz > table.last_digit)
    if not chosen.any():
        return [noise]
    part = NoiseTable(table.light[chosen], table.on[chosen], table.rate_hz[chosen], table.relative_error[chosen],
                      table.last_digit[chosen], np.zeros(int(chosen.sum()), int), {}, table.unit)  # fmt: skip
    known_light = table.unit == "fA" or bool(table.pixels)
    beside = dict(noise.beside)
    if noise.fit_beside and (~table.on).any():
        fewest = OF_QUIET * float(table.rate_hz[~table.on].min())
        beside[OFF_BACKGROUND.name] = max(fewest, beside[OFF_BACKGROUND.name])
    leans = {0.5 * _threshold_ratio(part), 0.5 * _threshold_ratio_at_maximum(table)}

    def tried(start: Model, factors: dict[str, float]) -> tuple[float, Model]:
        """How far ln rates are off on average where parameters are so many times a start's, and the model there."""
        scaled = {n: (p, p.value * factors[n]) for n, p in start.parameters.items() if n in factors}
        trial = start.set({n: p.within(v) for n, (p, v) in scaled.items()})
        at = NoiseModel(part, trial, beside)
        (rates,) = at.predict_many([_start(at)], ROUGH)
        return float(np.abs(np.log(part.rate_hz) - np.log(rates)).mean()), trial

    best: dict[float, tuple[float, Model]] = {}  # photocurrent, or where that is known follower → (cost, model)
    grid = [(lit, slow) for lit in ((1.0,) if known_light else LIGHT_STARTS) for slow in FOLLOWER_STARTS]
    for lit, slow in grid:
        # behind a photoreceptor of bandwidth ∝ light σ² ∝ D α
        for f, lean in itertools.product(THRESHOLD_STARTS * math.sqrt(lit), sorted(leans)):
            factors = {"on_threshold": f * math.exp(lean), "off_threshold": f * math.exp(-lean), "alpha": lit,
                       "gamma": lit, "alpha_over_beta": lit, "sf_cutoff_hz": slow}  # fmt: skip
            one = tried(plain, factors)
            of = slow if known_light else lit
            best[of] = min(best.get(of, one), one, key=lambda start: start[0])
    report("fitting", 0.05)
    ranked = sorted(best.values(), key=lambda start: start[0])[:MOST_STARTS]
    if "refractory_s" in plain.parameters:
        ranked = [
            min((tried(start, {"refractory_s": dead, "on_threshold": f, "off_threshold": f})
                 for dead in DEAD_STARTS for f in NEAR_STARTS), key=lambda one: one[0])
            for _, start in ranked
        ]  # fmt: skip
        ranked.sort(key=lambda start: start[0])
    report("fitting", 0.1)
    own = [n for n in plain.parameters if n in FITTED]
    return [replace(noise, start={n: start.values[n] for n in own} | beside) for _, start in ranked]


def _threshold_ratio(table: NoiseTable) -> float:
    """ln of ON over OFF threshold where a search begins: behind a short dead time N_on C_on = N_off C_off."""
    on, off = _paired_rates(table)
    return _apart(float(np.median(np.log(off / on))) if len(on) else 0.0, MOST_RATIO)


def _threshold_ratio_at_maximum(table: NoiseTable) -> float:
    """The same of the light that makes most events, without those that come whatever the light."""
    on, off = _paired_rates(table)
    if not len(on):
        return _apart(0.0, MOST_RATIO)
    most = int(np.argmax(on + off))
    of_on, of_off = (max(float(r[most] - r.min()), 1e-3 * float(r[most]), LEAST_HZ) for r in (on, off))
    return _apart(math.log(of_off / of_on), MOST_RATIO_AT_MAXIMUM)


def _paired_rates(table: NoiseTable) -> tuple[np.ndarray, np.ndarray]:
    """(lights,) mean ON and OFF rates at the lights that have both."""
    lights = sorted(set(table.light[table.on].tolist()) & set(table.light[~table.on].tolist()))
    on, off = ([table.rate_hz[(table.light == x) & (table.on == p)].mean() for x in lights] for p in (True, False))
    return np.array(on), np.array(off)


def _apart(ratio: float, most: float) -> float:
    """A ratio of thresholds no nearer to 0 than `LEAST_RATIO`, and no farther than `most`."""
    return math.copysign(min(max(abs(ratio), LEAST_RATIO), most), ratio)


def _linearise(noise: NoiseModel, x: np.ndarray, level: np.ndarray, resolution: Resolution) -> Linearised:
    """The table at x by differences.

    Slopes are of typical pixels: of equal ones they would be some per cent too steep, not by the same share for all
    parameters, and would promise gains along valleys in which they cancel.  Those along thresholds that are nearly
    alike change by tenths with how pixels differ, for which `ROUGH` will do.
    """
    typical = noise.of_typical_pixels(x)
    slopes = np.empty((len(level), len(x)))
    thresholds = np.array([p.name.endswith("_threshold") for p in noise.parameters]) & noise.nearly_alike(x)
    for model, some in ((noise, thresholds), (typical, ~thresholds)):
        if not some.any():
            continue
        points = [x + side * STEP * unit for unit in np.eye(len(x))[some] for side in (1.0, -1.0)]
        logs = np.log(model.predict_many(points, resolution if model is typical else ROUGH))
        slopes[:, some] = ((logs[0::2] - logs[1::2]) / (2.0 * STEP)).T
    return Linearised(noise.rows, noise.parameters, noise.nuisances, noise.neutral_bounds, x, level, slopes)


def _within(line: Linearised, limits: np.ndarray, trust: float) -> Linearised:
    """The same with bounds a trusted step around x0."""
    parameters = []
    for p, x, (low, high) in zip(line.parameters, line.x0, limits, strict=True):
        below, above = math.exp(max(low, x - trust)), math.exp(min(high, x + trust))
        parameters.append(replace(p, value=float(np.clip(math.exp(x), below, above)), lower=below, upper=above))
    return replace(line, parameters=tuple(parameters))


def _misfit(noise: NoiseModel, level: np.ndarray, x: np.ndarray, s: np.ndarray) -> float:
    """Minus log posterior for given scales, without constants."""
    r = noise.rows.turned(noise.rows.log_ratio(np.exp(level))) / s
    prior = log_prior(noise.parameters, x)
    return float(0.5 * (FREEDOM + 1.0) * np.log1p(r**2 / FREEDOM).sum() - prior)
