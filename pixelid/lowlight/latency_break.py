"""Up to which light a latency goes as one over it, and from which on later stages take half of it.

Of the circuit fitted to a table, per setting and edge: the light at which −d ln t / d ln E falls to 0.9, and that at
which the latency is twice what it is in boundless light (the floor of later stages, comparator and readout).
Intervals by the delta method from the fit's covariance, in the logarithm of the light.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pixelid.statistics import Z95
from pixelid.tables.fit import TableFit, covariance_at
from pixelid.tables.latency.camera import predict
from pixelid.tables.latency.model import LatencyModel
from pixelid.tables.latency.spread import Spread

SLOPE = 0.9
_STEP = 0.02  # of fitting coordinates: larger than what interpolation between the times of a response errs by
_MOVES = ("alpha_over_beta", "beta", "sf_cutoff_hz", "diff_cutoff_hz", "led_off_fraction")


@dataclass(frozen=True)
class Break:
    """One setting and edge.

    Attributes:
        setting, on: which.
        holds: (value, low, high) of the light after the step [W/m²] up to which −d ln t / d ln E is above 0.9.
        half: the same where half of the latency is the floor.
        floor_s: latency in boundless light.
    """

    setting: str
    on: bool
    holds: tuple[float, float, float] | None
    half: tuple[float, float, float] | None
    floor_s: float


def breaks(model: LatencyModel, fit: TableFit, light: np.ndarray) -> list[Break]:
    """One per setting and edge of a fitted table; None where a light is not within reach.

    Args:
        model: with one law for all lights.
        fit: of it.
        light: (…) W/m² after steps of the table.
    """
    points = 61
    reach = 30.0  # times beyond the table's lights, in either direction, that a break is looked for
    grid = np.geomspace(light.min() / reach, light.max() * reach, points)
    on_, names = np.array([True, False]), model.settings
    settings = [(name, bool(on)) for on in on_ for name in names]
    place = {p.name: k for k, p in enumerate(model.parameters)}
    shared = [[place[name]] * len(settings) for name in _MOVES]
    own = [
        [place[f"{'on' if on else 'off'}_{kind}[{name}]"] for name, on in settings] for kind in ("threshold", "delay_s")
    ]
    slots = np.array([*shared, *own])  # (kinds, settings): coordinates that are moved at once
    at, floor = _lights(model, fit.x, settings, grid)
    covariance = covariance_at(fit)
    slopes = np.zeros((2, len(settings), len(fit.x)))
    for kind in slots:
        ends = []
        for side in (1.0, -1.0):
            x = fit.x.copy()
            x[np.unique(kind)] += side * _STEP
            ends.append(_lights(model, x, settings, grid)[0])
        slopes[:, np.arange(len(settings)), kind] += (ends[0] - ends[1]) / (2.0 * _STEP)
    error = np.sqrt(np.einsum("qsn,nm,qsm->qs", np.nan_to_num(slopes), covariance, np.nan_to_num(slopes)))
    found = []
    for k, (name, on) in enumerate(settings):
        limits = []
        for value, sd, moved in zip(at[:, k], error[:, k], slopes[:, k], strict=True):
            known = np.isfinite(value) and np.isfinite(moved).all()
            limits.append(tuple(np.exp(value + side * Z95 * sd) for side in (0.0, -1.0, 1.0)) if known else None)
        found.append(Break(name, on, limits[0], limits[1], float(floor[k])))
    return found


def _lights(
    model: LatencyModel, x: np.ndarray, settings: list[tuple[str, bool]], grid: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """((2, settings) ln of the lights where the slope is 0.9 and half is floor, NaN out of reach, and floors)."""
    v = {p.name: float(np.exp(x[k])) for k, p in enumerate(model.parameters)}
    off = v["led_off_fraction"]
    values = model.circuit_values(x)
    circuit = model.template.circuit(values).with_(dark=0.0, shot_density=0.0)
    row = np.repeat(np.arange(len(settings)), len(grid))
    on = np.array([edge for _, edge in settings])[row]
    lit = np.tile(grid, len(settings)) / np.where(on, 1.0, off)

    def own(kind: str) -> np.ndarray:
        return np.array([v[f"{'on' if edge else 'off'}_{kind}[{name}]"] for name, edge in settings])[row]

    def medians(circuit) -> np.ndarray:
        ones = np.ones(len(row))
        quiet = Spread(0.0, 0.0, 0.0, 0.0)
        found = predict(circuit, off, quiet, lit, on, own("threshold"), own("delay_s"), ones)["median"]
        return found.reshape(len(settings), len(grid))

    t = medians(circuit)
    floor = medians(circuit.with_(photoreceptor="unlimited"))[:, -1]
    ln_light = np.log(grid)
    slope = -np.gradient(np.log(t), ln_light, axis=1)
    return np.array([
        [_falls_to(SLOPE, one, ln_light) for one in slope],
        [_falls_to(np.log(2.0 * f), np.log(one), ln_light) for f, one in zip(floor, t, strict=True)],
    ]), floor  # fmt: skip


def _falls_to(level: float, values: np.ndarray, at: np.ndarray) -> float:
    """Where values (n,) at (n,) first fall through a level; NaN where they do not."""
    below = np.flatnonzero((values[1:] < level) & (values[:-1] >= level))
    if not len(below):
        return float("nan")
    k = below[-1]
    share = (values[k] - level) / (values[k] - values[k + 1])
    return float(at[k] + share * (at[k + 1] - at[k]))
