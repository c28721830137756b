"""Latencies of one camera as a `TableModel`: one circuit, thresholds and delays per setting, what the set-up adds."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pixelid.model.model import Model, expected_parameters
from pixelid.parameters.parameter import Parameter, Prior
from pixelid.tables.latency.camera import DELAY_SIGMA, OFF_FRACTION, UNIT, Camera, Setting, predict
from pixelid.tables.latency.cells import Cells
from pixelid.tables.latency.levels import Level, levels_of
from pixelid.tables.latency.reading import LEAST_S, STATISTICS, TIMESTAMP_S
from pixelid.tables.latency.spread import Spread
from pixelid.tables.model import Rows

EFFECTS = (
    "dark_current", "shot_noise", "source_follower_pole", "differencing_pole", "threshold_mismatch", "threshold_noise"
)  # fmt: skip
# γ acts where γL nears β, which no latency shows beside the later stages: it stays at the ratio of the DVS128
GAMMA_OVER_CORNER = 0.034
# Relative errors beyond the regression's own scatter: what the order statistics miss the public table by.  A minimum
# counts an event that noise brought just after the edge, a maximum one straggler in a hundred pixels, and a deviation
# between a few edges is that of the few
EXTRA_ERROR = {"median": 0.0, "min": 0.4, "max": 0.3, "stdev": 0.5, "sd": 0.3}


def _log(name: str, value: float, unit: str, lower: float, upper: float, sd: float) -> Parameter:
    return Parameter(name, value, unit, lower, upper, "log", prior=Prior(math.log(value), sd))


# A prior of sd 3 spans a factor 400 both ways: the order of magnitude of any sensor.  Of the dark current more is
# known: pixels still answer to contrast at 0.1 lx, and the DVS128's is worth some 0.01 lx
SHARED = (
    _log("alpha_over_beta", 1e5, "rad/s/(W/m²)", 1.0, 1e8, 4.0),
    _log("beta", 1e5, "1/s", 1e2, 1e7, 2.0),
    _log("sf_cutoff_hz", 5e3, "Hz", 1.0, 1e7, 2.5),
    _log("diff_cutoff_hz", 2e4, "Hz", 10.0, 1e7, 2.0),
    _log("dark_current.radiance", 1e-4, "W/m²", 1e-6, 1.0, 1.5),  # 5e-6 to 2e-3: 2 mlx to 0.7 lx of white light
    _log("shot_noise.density", 1e-7, "W/m²/Hz", 1e-12, 1e-2, 3.0),
    _log("threshold_mismatch.sigma", 0.1, "1", 1e-3, 1.0, 1.0),
    _log("threshold_sigma", 0.1, "1", 1e-3, 1.0, 1.0),
    _log("delay_sigma", DELAY_SIGMA, "1", 1e-2, 1.0, 1.0),
    _log("led_off_fraction", OFF_FRACTION, "1", 1e-4, 0.9, 1.0),
    _log("edge_jitter_s", 1e-6, "s", 1e-9, 1e-2, 2.0),
)
NUISANCES = frozenset({"led_off_fraction", "edge_jitter_s"})
LENS = _log("lens_factor", 1.0, "1", 0.2, 5.0, 0.3)
THRESHOLD = _log("threshold", 0.3, "log radiance", 1e-3, 10.0, 1.5)
DELAY = _log("delay_s", 1e-5, "s", 1e-8, 1e-1, 2.0)
# A factor e either way: it only matters where latencies do not show the photoreceptor, and keeps their slope finite
DEPARTURE = _log("departure", 1.0, "1", 1e-3, 1e3, 1.0)
FOLLOWER_STARTS_HZ = (1e3, 3e4)  # a follower slower, or faster, than the latencies


@dataclass(frozen=True)
class LatencyModel:
    """The cells of one camera and what may explain them.

    Attributes:
        camera: its label.
        cells: what was measured.
        follower_hz: cutoff that the fit begins at.
        start: a camera to begin at instead.
        one_delay: all settings and edges share one delay, for comparison.
        departing: every light has a speed of the photoreceptor of its own (`levels.py`).
        start: name → value to begin at instead of the library's.
    """

    camera: str
    cells: Cells
    follower_hz: float = FOLLOWER_STARTS_HZ[0]
    one_delay: bool = False
    start: Camera | None = None
    departing: bool = False

    # stages too fast to see, a light or an effect too small to show
    neutral_bounds: tuple[tuple[str, str], ...] = (
        ("beta", "upper"), ("sf_cutoff_hz", "upper"), ("diff_cutoff_hz", "upper"), ("dark_current", "lower"),
        ("shot_noise", "lower"), ("threshold_mismatch", "lower"), ("threshold_sigma", "lower"),
        ("delay_sigma", "lower"), ("on_delay_s", "lower"), ("off_delay_s", "lower"), ("departure", "upper"),
    )  # fmt: skip

    @cached_property
    def lenses(self) -> tuple[str, ...]:
        """In order of appearance; the first is the reference."""
        return tuple(dict.fromkeys(str(lens) for lens in self.cells.table.lens))

    @cached_property
    def settings(self) -> tuple[str, ...]:
        """In order of their bias where all have one, else of appearance."""
        table = self.cells.table
        bias = {str(name): float(b) for name, b in zip(table.setting, table.bias, strict=True)}
        return tuple(sorted(bias, key=bias.__getitem__)) if all(map(math.isfinite, bias.values())) else tuple(bias)

    @cached_property
    def entries(self) -> tuple[np.ndarray, np.ndarray]:
        """(cell, statistic) of what was measured."""
        latency = self.cells.table.latency_s
        values = np.stack([latency[name] for name in STATISTICS], axis=1)
        cell, statistic = np.nonzero(np.isfinite(values) & (values >= LEAST_S))
        return cell, statistic

    @property
    def rows(self) -> Rows:
        """Cells × statistics, in seconds."""
        return self._rows

    @cached_property
    def _rows(self) -> Rows:
        table, (cell, statistic) = self.cells.table, self.entries
        names = [STATISTICS[k] for k in statistic]
        measured = np.array([table.latency_s[name][k] for name, k in zip(names, cell, strict=True)])
        error = np.array([self.cells.error[name][k] for name, k in zip(names, cell, strict=True)])
        extra = np.array([EXTRA_ERROR[name] for name in names])
        columns = {
            "camera": [self.camera] * len(cell),
            "lens": [str(table.lens[k]) for k in cell],
            "edge": ["on" if table.on[k] else "off" for k in cell],
            "irradiance_W_m2": [float(table.irradiance[k]) for k in cell],
            "setting": [str(table.setting[k]) for k in cell],
            "statistic": names,
        }
        return Rows(measured, TIMESTAMP_S, np.hypot(error, extra), columns)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The circuit, the set-up, then thresholds and delays of every setting."""
        return self._parameters

    @cached_property
    def _parameters(self) -> tuple[Parameter, ...]:
        shared = [p.at(self.follower_hz) if p.name == "sf_cutoff_hz" else p for p in SHARED]
        lenses = [replace(LENS, name=f"lens_factor[{name}]") for name in self.lenses[1:]]
        per_setting = [
            replace(base, name=f"{edge}_{base.name}[{name}]")
            for base in ((THRESHOLD,) if self.one_delay else (THRESHOLD, DELAY))
            for edge in ("on", "off")
            for name in self.settings
        ]
        known = _values_of(self.start) if self.start is not None else {}
        everything = shared + lenses + per_setting + ([DELAY] if self.one_delay else [])
        everything += [replace(DEPARTURE, name=level.name) for level in self.levels if self.departing]
        return tuple(p.at(p.within(known.get(p.name, p.value))) for p in everything)

    @property
    def nuisances(self) -> frozenset[str]:
        """The light, the lens, the triggers."""
        return NUISANCES | {f"lens_factor[{name}]" for name in self.lenses}

    @cached_property
    def places(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(cells,) where each cell's lens factor, threshold and delay sit in x; the reference lens at no place, −1."""
        table, first, count = self.cells.table, len(SHARED), len(self.settings)
        lens = np.array([self.lenses.index(str(name)) - 1 for name in table.lens])
        setting = np.array([self.settings.index(str(name)) for name in table.setting])
        threshold = first + len(self.lenses) - 1 + np.where(table.on, 0, count) + setting
        delay = (
            np.full(len(lens), first + len(self.lenses) - 1 + 2 * count) if self.one_delay else threshold + 2 * count
        )
        return np.where(lens >= 0, first + lens, -1), threshold, delay

    @cached_property
    def levels(self) -> tuple[Level, ...]:
        """Every light that a step of the table ends in."""
        return levels_of(self.cells.table)

    @cached_property
    def departures(self) -> np.ndarray:
        """(cells,) where each cell's departure sits in x."""
        table, first = self.cells.table, len(self.parameters) - len(self.levels)
        place = {level: first + k for k, level in enumerate(self.levels)}
        each = zip(table.on.tolist(), table.lens.tolist(), table.irradiance.tolist(), strict=True)
        return np.array([place[Level(*key)] for key in each])

    def dependence(self) -> Sequence[np.ndarray]:
        """Every cell depends on the circuit, on its lens, on its setting's threshold and delay, and on its light."""
        cell = self.entries[0]
        lens, threshold, delay = self.places
        slots = [np.full(len(cell), k) for k in range(len(SHARED))]
        if len(self.lenses) > 1:
            slots.append(np.where(lens[cell] >= 0, lens[cell], len(SHARED)))
        slots += [threshold[cell], delay[cell]]
        return [*slots, self.departures[cell]] if self.departing else slots

    @cached_property
    def template(self) -> Model:
        """The structure of the circuit, radiance in W/m²."""
        return Model(
            self.camera, "second_order", EFFECTS, expected_parameters("second_order", EFFECTS), radiance_unit=UNIT
        )

    def circuit_values(self, x: np.ndarray) -> dict[str, float]:
        """Values of the circuit's parameters that do not depend on the setting."""
        v = dict(zip((p.name for p in SHARED), np.exp(x[: len(SHARED)]).tolist(), strict=True))
        corner = v["alpha_over_beta"]
        circuit = {name: value for name, value in v.items() if name in self.template.parameters}
        return circuit | {"alpha": corner * v["beta"], "gamma": GAMMA_OVER_CORNER * corner}

    def statistics_at(self, x: np.ndarray) -> dict[str, np.ndarray]:
        """Statistic → (cells,) seconds."""
        table, (lens, threshold, delay) = self.cells.table, self.places
        v = dict(zip((p.name for p in SHARED), np.exp(x[: len(SHARED)]).tolist(), strict=True))
        circuit = self.template.circuit(self.circuit_values(x))
        spread = Spread(circuit.mismatch, circuit.noise, v["delay_sigma"], v["edge_jitter_s"])
        factor = np.where(lens >= 0, np.exp(x[lens]), 1.0)
        return predict(
            circuit, v["led_off_fraction"], spread, factor * table.irradiance, table.on, np.exp(x[threshold]),
            np.exp(x[delay]), table.pixels, np.exp(x[self.departures]) if self.departing else 1.0,
        )  # fmt: skip

    def predict(self, x: np.ndarray) -> np.ndarray:
        """(rows,) seconds."""
        cell, statistic = self.entries
        found = self.statistics_at(x)
        return np.stack([found[name] for name in STATISTICS], axis=1)[cell, statistic]

    def camera_at(self, x: np.ndarray, scatter: float) -> Camera:
        """The camera at fitting coordinates x; thresholds of its model are those of the default setting.

        scatter: relative, of the table about it
        """
        v = {p.name: float(np.exp(value)) for p, value in zip(self.parameters, x, strict=True)}
        table = self.cells.table
        settings = []
        for name in self.settings:
            on, off = (table.bias[(table.setting == name) & (table.on == edge)] for edge in (True, False))
            settings.append(
                Setting(
                    name,
                    bias_on=float(on[0]) if len(on) else math.nan,
                    bias_off=float(off[0]) if len(off) else math.nan,
                    on_threshold=v[f"on_threshold[{name}]"],
                    off_threshold=v[f"off_threshold[{name}]"],
                    on_delay_s=v.get(f"on_delay_s[{name}]", v.get("delay_s", 0.0)),
                    off_delay_s=v.get(f"off_delay_s[{name}]", v.get("delay_s", 0.0)),
                )
            )
        middle = settings[default_setting(settings)]
        values = self.circuit_values(x) | {
            "on_threshold": middle.on_threshold,
            "off_threshold": middle.off_threshold,
            "delay_s": 0.5 * (middle.on_delay_s + middle.off_delay_s),
        }
        lens = {self.lenses[0]: 1.0} | {name: v[f"lens_factor[{name}]"] for name in self.lenses[1:]}
        return Camera(
            self.camera, self.template.set(values), tuple(settings), lens, v["led_off_fraction"], v["delay_sigma"],
            v["edge_jitter_s"], scatter,
        )  # fmt: skip


def _values_of(camera: Camera) -> dict[str, float]:
    """Name → value of what a fit's parameters and a camera have in common; radiances only in W/m²."""
    model, found = camera.model, {}
    if model.radiance_unit == UNIT:
        found |= model.values
        if "beta" in found:
            found["alpha_over_beta"] = found["alpha"] / found["beta"]
    found |= {f"lens_factor[{lens}]": factor for lens, factor in camera.lens.items()}
    for s in camera.settings:
        found |= {f"on_threshold[{s.name}]": s.on_threshold, f"off_threshold[{s.name}]": s.off_threshold}
        found |= {f"on_delay_s[{s.name}]": s.on_delay_s, f"off_delay_s[{s.name}]": s.off_delay_s}
    return found


def default_setting(settings: Sequence[Setting]) -> int:
    """Which setting stands for the camera: the one of bias 0, or the middle one."""
    for k, setting in enumerate(settings):
        if setting.bias_on == 0.0:
            return k
    return len(settings) // 2
