"""Noise rates of a circuit as an observation model: which parameters are fitted, from where, and what they predict."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from pixelid.errors import InputError
from pixelid.model.model import Model
from pixelid.parallel import map_threads
from pixelid.parameters.gauge import Gauge
from pixelid.parameters.parameter import Parameter, Prior
from pixelid.parameters.units import in_light_unit
from pixelid.stages.circuit import Circuit
from pixelid.stages.described import power_of_radiance
from pixelid.tables.model import Rows
from pixelid.tables.noise.first_passage import mean_rates, typical_rates, typical_thresholds
from pixelid.tables.noise.quadrature import WHOLE, Resolution
from pixelid.tables.noise.reading import NoiseTable

FLOOR = Parameter("noise_floor.density", 1e-9, "1/Hz", 1e-14, 1e-2, "log")  # white noise whatever the light
# OFF events whatever the light: of hot pixels, or of a leak towards OFF.  ON events have the circuit's leak.
OFF_BACKGROUND = Parameter("off_background.rate_hz", 1e-2, "Hz", 1e-9, 1e3, "log")
BESIDE = {p.name: p for p in (FLOOR, OFF_BACKGROUND)}  # what a table of a sensor's means has beside a circuit
# Photocurrent per light of a pixel of 4.9 µm with 50 % of its area and photons: 0.22 A/W · 24 µm² / (683 lm/W) at
# 555 nm.  It only sets the noise density that thresholds are stated for; thresholds go with 1/√ of it.
FA_PER_LUX = 7.7
FA_PER_UNIT = {"fA": 1.0, "lux": FA_PER_LUX, "W/m2": 683.0 * FA_PER_LUX}
# Lights that are computed: all, or, where more, at least so many and so many per decade.  Between them ln rate is a
# monotone cubic in ln light (Fritsch & Carlson 1980, SIAM J. Numer. Anal. 17, 238), which makes no waves where rates
# fall off a cliff.
MOST_LIGHTS, PER_DECADE = 16, 10
FITTED = ("alpha", "beta", "gamma", "alpha_over_beta", "sf_cutoff_hz", "on_threshold", "off_threshold", "refractory_s",
          "dark_current.radiance", "leak.rate_hz", "parasitic_photocurrent.rate_hz_per_radiance")  # fmt: skip
# Standard deviations of ln: a sensor of the same kind differs by a factor of 3 from nominal values …
PRIOR_SD = 1.0
# … and by a factor of 7 where the light's unit is not the photocurrent's, or where an effect may be absent
WIDE_SD = 2.0
WIDE = ("alpha", "gamma", "alpha_over_beta", "dark_current.radiance", "leak.rate_hz",
        "parasitic_photocurrent.rate_hz_per_radiance")  # fmt: skip
# ln of ON over OFF threshold beyond which no pixel is near the maximum of equal ones: its width, some tenths of a
# standard deviation of noise at thresholds of four of these, and so many standard deviations of mismatch
LEAST_APART, MANY_SD = 0.1, 3.0
STEP = 0.02  # of a coordinate, for differences
HELD = 1e-6  # relative width of what is held
LEAST_HZ = 1e-12  # of a predicted rate: its logarithm must exist


@dataclass(frozen=True)
class NoiseModel:
    """Noise rates as a `TableModel`.

    Attributes:
        table: what was measured.
        circuit: the model in the table's unit of light: priors lie around its values, and what is not fitted stays.
        beside: values of `BESIDE`, 0 where there is none; fitted where `fit_beside`.
        fit_beside: see there.
        start: where a search begins, by name; the circuit's values where there is none.
        held: name → value of what a fit does not move.
        typical: pixels that stand for all: ascending (n,) lights, and (n, 2, 2) their `typical_thresholds`.
    """

    table: NoiseTable
    circuit: Model
    beside: Mapping[str, float] = field(default_factory=dict)
    fit_beside: bool = False
    start: Mapping[str, float] = field(default_factory=dict)
    held: Mapping[str, float] = field(default_factory=dict)
    typical: tuple[np.ndarray, np.ndarray] | None = None

    # an effect that is too weak to show
    neutral_bounds: tuple[tuple[str, str], ...] = (
        ("noise_floor", "lower"), ("off_background", "lower"), ("dark_current", "lower"), ("leak", "lower"),
        ("parasitic", "lower"),
    )  # fmt: skip

    @property
    def rows(self) -> Rows:
        """The table's rates."""
        table = self.table
        return Rows(table.rate_hz, table.last_digit, table.relative_error, table.columns, table.pairs, table.pair_error)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """What is fitted, where a search begins, with priors around the model's values."""
        found = []
        for name in FITTED:
            p = self.circuit.parameters.get(name)
            if p is None:
                continue
            wide = name in WIDE and (self.circuit.radiance_unit != "fA" or "." in name)
            prior = Prior(math.log(_inside(p, p.value)), WIDE_SD if wide else PRIOR_SD)
            found.append(replace(p, value=_inside(p, self.start.get(name, p.value)), prior=prior))
        for p in BESIDE.values() if self.fit_beside else ():
            prior = Prior(math.log(self.beside[p.name]), WIDE_SD)
            found.append(replace(p, value=self.start.get(p.name, self.beside[p.name]), prior=prior))
        for group in self._scaled:
            found.append(Parameter(f"light_scale[{group}]", 1.0, "1", 1e-2, 1e2, "log", prior=Prior(0.0, PRIOR_SD)))
        return tuple(_at(p, self.held[p.name]) if p.name in self.held else p for p in found)

    @property
    def of_equal_pixels(self) -> NoiseModel:
        """The same, some eight times faster, without threshold mismatch."""
        return replace(self, circuit=self.circuit.without_effect("threshold_mismatch"))

    @property
    def plain(self) -> NoiseModel:
        """The same without threshold noise, too."""
        equal = self.of_equal_pixels
        return replace(equal, circuit=equal.circuit.without_effect("threshold_noise"))

    def of_typical_pixels(self, x: np.ndarray) -> NoiseModel:
        """The same, several times faster, with pixels that differ replaced by those typical at coordinates x.

        Their ln rates differ from those of all by what hardly changes with the coordinates, thresholds that are nearly
        alike excepted (`quadrature.mismatch_draws`).
        """
        if self.typical is not None or not self.circuit.has("threshold_mismatch"):
            return self
        values = self._values(x)
        lights, _ = self._lights(values)
        circuit, floor = self._circuit(values), values.get(FLOOR.name, self.beside.get(FLOOR.name, 0.0))
        thresholds = map_threads(lambda light: typical_thresholds(circuit, light, floor), lights)
        return replace(self, typical=(lights, np.array(thresholds)))

    def nearly_alike(self, x: np.ndarray) -> bool:
        """Whether at coordinates x some pixels' thresholds are alike, where rates may have a narrow maximum."""
        values = self._circuit(self._values(x))
        apart = abs(math.log(values.on_threshold / values.off_threshold))
        return apart < LEAST_APART + MANY_SD * math.sqrt(2.0) * values.mismatch

    @property
    def nuisances(self) -> frozenset[str]:
        """How the light of a second table compares with that of the first."""
        return frozenset(p.name for p in self.parameters if p.name.startswith("light_scale"))

    @cached_property
    def _scaled(self) -> list[int]:
        return sorted(set(self.table.group.tolist()) - {0})

    def dependence(self) -> Sequence[np.ndarray]:
        """Every row depends on every parameter."""
        return [np.full(len(self.table.light), k) for k in range(len(self.parameters))]

    def predict(self, x: np.ndarray) -> np.ndarray:
        """(rows,) events per pixel and second."""
        return self.predict_many([x])[0]

    def predict_many(self, points: Sequence[np.ndarray], resolution: Resolution = WHOLE) -> list[np.ndarray]:
        """The same at several coordinates, on all cores."""
        values = [self._values(x) for x in points]
        asked = [self._lights(v) for v in values]
        jobs = [(v, light) for v, (lights, _) in zip(values, asked, strict=True) for light in lights]
        rates = iter(map_threads(lambda job: self.rates(*job, resolution), jobs))
        return [self._at_rows(lights, np.array([next(rates) for _ in lights]), scaled) for lights, scaled in asked]

    def rates(self, values: Mapping[str, float], light: float, resolution: Resolution = WHOLE) -> tuple[float, float]:
        """(ON, OFF) events per pixel and second under one light."""
        floor, background = (values.get(name, self.beside.get(name, 0.0)) for name in BESIDE)
        circuit = self._circuit(values)
        if self.typical is None:
            on, off = mean_rates(circuit, light, floor, resolution)
        else:
            lights, thresholds = self.typical
            flat = thresholds.reshape(len(lights), 4).T
            own = np.array([np.interp(math.log(light), np.log(lights), factor) for factor in flat]).reshape(2, 2)
            on, off = typical_rates(circuit, light, own, floor, resolution)
        return max(on, LEAST_HZ), max(off + background, LEAST_HZ)

    def slopes(self, x: np.ndarray, resolution: Resolution) -> np.ndarray:
        """(rows, parameters) derivatives of ln rate by the coordinates.

        Differences to both sides; but events whatever the light add to the rate, and a floor raises the noise's
        variance, which only thresholds are compared with: where it is a share f of the noise, its slope is −f/2 of both
        thresholds' slopes together.
        """
        names = [p.name for p in self.parameters]
        steps = {n: STEP * unit for n, unit in zip(names, np.eye(len(x)), strict=True) if n not in BESIDE}
        points = [x, *(x + side * step for step in steps.values() for side in (1.0, -1.0))]
        rate, *found = self.predict_many(points, resolution)
        above, below = np.log(found[0::2]), np.log(found[1::2])
        slope = dict(zip(steps, (above - below) / (2.0 * STEP), strict=True))
        values = self._values(x)
        if FLOOR.name in names:
            circuit, floor = self._circuit(values), values[FLOOR.name]
            light = self._lights(values)[1] + circuit.dark
            share = floor / (circuit.shot_density / light + floor)
            slope[FLOOR.name] = -0.5 * share * (slope["on_threshold"] + slope["off_threshold"])
            slope[OFF_BACKGROUND.name] = values[OFF_BACKGROUND.name] * ~self.table.on / rate
        return np.stack([slope[name] for name in names], axis=1)

    def _values(self, x: np.ndarray) -> dict[str, float]:
        return {p.name: p.from_coordinate(float(v)) for p, v in zip(self.parameters, x, strict=True)}

    def _circuit(self, values: Mapping[str, float]) -> Circuit:
        return self.circuit.circuit({name: v for name, v in values.items() if name in self.circuit.parameters})

    def _lights(self, values: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
        """(lights to compute, (rows,) light of each row after its table's scale)."""
        scale = np.ones(len(self.table.light))
        for group in self._scaled:
            scale[self.table.group == group] = values[f"light_scale[{group}]"]
        scaled = self.table.light * scale
        lights = np.unique(scaled)
        enough = max(MOST_LIGHTS, math.ceil(PER_DECADE * math.log10(lights[-1] / lights[0])) + 1)
        if len(lights) > enough:
            lights = np.geomspace(lights[0], lights[-1], enough)
        return lights, scaled

    def _at_rows(self, lights: np.ndarray, rates: np.ndarray, scaled: np.ndarray) -> np.ndarray:
        column = np.where(self.table.on, 0, 1)
        if np.isin(scaled, lights).all():
            return rates[np.searchsorted(lights, scaled), column]
        from scipy.interpolate import PchipInterpolator

        inside = np.clip(np.log(scaled), np.log(lights[0]), np.log(lights[-1]))
        smooth = PchipInterpolator(np.log(lights), np.log(rates), axis=0)(inside)
        return np.exp(smooth[np.arange(len(scaled)), column])


def _at(p: Parameter, value: float) -> Parameter:
    """Where bounds leave nothing to move."""
    return replace(p, value=value, lower=value * (1.0 - HELD), upper=value * (1.0 + HELD))


def _inside(p: Parameter, value: float) -> float:
    """The value, not on a bound."""
    return min(max(value, 1.01 * p.lower), 0.99 * p.upper)


def in_unit(model: Model, unit: str) -> Model:
    """A model with shot noise whose radiance is in the unit of a table.

    A radiance in fA becomes one in lux or W/m² at `FA_PER_LUX`: rates per radiance grow, densities shrink by it.
    The density of a model without shot noise is that of a photocurrent, which the library states in fA.

    Raises:
        InputError: no factor is known between the two units.
    """
    own, bare = model.radiance_unit, not model.has("shot_noise")
    model = model.with_effect("shot_noise")
    if bare:
        density = model.values["shot_noise.density"] / FA_PER_UNIT.get(own, 1.0)
        model = model.set({"shot_noise.density": density})
    if own == unit or unit in ("relative", "radiance") or own in ("relative", "radiance"):
        return model
    if own not in FA_PER_UNIT or unit not in FA_PER_UNIT:
        raise InputError(f"model {model.name}: radiance in {own}, but the table's light is in {unit}")
    factor = FA_PER_UNIT[unit] / FA_PER_UNIT[own]
    power = {"alpha": 1, "gamma": 1, "alpha_over_beta": 1, "shot_noise.density": -1, "dark_current.radiance": -1,
             "parasitic_photocurrent.rate_hz_per_radiance": 1, "bandwidth_floor.radiance": -1,
             "linear_log.knee": -1}  # fmt: skip
    parameters = {}
    for name, p in model.parameters.items():
        if grows := power.get(name, -power_of_radiance(name)):
            f = factor**grows
            p = replace(p, value=p.value * f, lower=min(p.lower, p.lower * f), upper=max(p.upper, p.upper * f))
        parameters[name] = replace(p, unit=in_light_unit(p.unit, own, unit))
    return replace(model, parameters=parameters, radiance_unit=unit, physical=None, physical_source="", gauge=Gauge())
