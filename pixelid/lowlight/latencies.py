"""What a table of latencies says of the photoreceptor in low light: the entry "latency" of lowlight.json."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from pixelid.errors import InputError
from pixelid.lowlight import poles, radii
from pixelid.lowlight.latency_break import Break, breaks
from pixelid.lowlight.latency_poles import Poles, measured_poles, threshold_sd
from pixelid.lowlight.latency_source import LatencySource
from pixelid.model.model import Model
from pixelid.parameters.parameter import OPEN_SD
from pixelid.stages.circuit import Circuit
from pixelid.statistics import Z95
from pixelid.status import Status
from pixelid.tables.fit import MOST_SUSPECT, SUSPECT_SCALES
from pixelid.tables.latency.camera import Camera, camera_for
from pixelid.tables.latency.cells import gather
from pixelid.tables.latency.levels import Level
from pixelid.tables.latency.limits import limit_sentences
from pixelid.tables.latency.model import GAMMA_OVER_CORNER, default_setting
from pixelid.tables.latency.result import predicted_result


def latency_analysis(
    source: LatencySource, camera: Camera, drawn: Sequence[Model] = (), seed: int = 0
) -> dict[str, Any]:
    """Measured poles and the model's, the law of one over the light, and which stage limits where.

    Args:
        source: rows of one camera.
        camera: the model's, in W/m²; its thresholds are the gauge.
        drawn: its circuit as uncertain as its fit left it, for the model's intervals.
        seed: of the draws behind the limits of the measured poles.

    Raises:
        InputError: another unit of radiance, a setting without a threshold, too few cells.
    """
    lenses = list(dict.fromkeys(source.table.lens.tolist()))
    camera = camera_for((camera,), source.name, lenses)
    said = predicted_result(source.table, (camera,))
    errors = next(iter(said["errors"].values()))
    if "median" not in errors:
        raise InputError(f"camera {source.name}: no latency has a median above 0: there is nothing to compare")
    cells = gather(source.table)
    misses = errors["median"]["rms_without_spoiled"]
    status, advice = said["status"], said["advice"]
    off = [abs(row["standardised"]) > SUSPECT_SCALES for row in said["rows"] if row["standardised"] is not None]
    if status == Status.converged and np.mean(off) > MOST_SUSPECT:
        status, advice = Status.misfit, f"the model lies far off {np.mean(off):.0%} of the rows: fit it to this table"
    found = measured_poles(source.name, cells, camera, seed, describes=status == Status.converged)
    if status == Status.converged:
        status, advice = found.free_fit.judge()
    entry = {
        "camera": source.name,
        "status": status,
        "advice": advice,
        "rows": len(source.table),
        "model_misses_medians_by": misses,
        "levels": [_level(found, k, camera, drawn) for k in range(len(found.levels))],
        "exponents": {edge: _exponent(found.exponent(on)) for edge, on in (("on", True), ("off", False))},
        "nats_worse_with_one_law": found.gain,
        "one_pole_errs_10_percent_from": _one_pole(found, camera),
        "breaks": [_break(one, found) for one in breaks(found.law_fit.model, found.law_fit.regression, found.light)],
        "limits": said["limits"],
    }
    return entry | {"sentences": _sentences(entry, camera)}


def _of_level(level: Level, camera: Camera) -> float:
    """Light after the step without dark current."""
    return level.irradiance * camera.lens.get(level.lens, 1.0) * (1.0 if level.on else camera.led_off_fraction)


def _level(found: Poles, k: int, camera: Camera, drawn: Sequence[Model]) -> dict[str, Any]:
    level = found.levels[k]
    light = _of_level(level, camera)
    circuit = camera.model.circuit()
    of_draws = [float(poles.dominant(model.circuit(), light)) for model in drawn]
    return {
        "edge": "on" if level.on else "off",
        "lens": level.lens,
        "irradiance_W_m2": level.irradiance,
        "light_W_m2": light + circuit.dark,
        "pole_rad_s": float(found.value[k]),
        "interval_95": [float(found.low[k]), _or_none(found.high[k])],
        "identified": bool(found.identified[k]),
        "model": {
            "pole_rad_s": float(poles.dominant(circuit, light)),
            "interval_95": np.percentile(of_draws, [2.5, 97.5]).tolist() if of_draws else None,
        },
        "one_law": {
            "pole_rad_s": float(found.law[k]),
            "interval_95": [float(found.law_low[k]), _or_none(found.law_high[k])],
        },
    }


def _exponent(found: tuple[float, float] | None) -> dict[str, Any] | None:
    if found is None:
        return None
    value, sd = found
    return {"value": value, "interval_95": [value - Z95 * sd, value + Z95 * sd]}


def _one_pole(found: Poles, camera: Camera) -> dict[str, Any]:
    """Irradiance from which (α/β)E misses the slowest pole by 10 %; β counts as its time constant, as in the draws."""
    speed, beta, sd = found.second_pole()
    slope = math.exp(speed)
    circuit = Circuit(alpha=slope * math.exp(beta), beta=math.exp(beta), gamma=GAMMA_OVER_CORNER * slope)
    natural = radii.natural_radiance(circuit)
    error = radii.error_function(circuit, "one_pole", "dominant_pole", "photoreceptor")
    first = radii.crossings(error, natural * 1e-4, natural, radii.GRID["dominant_pole"])["levels"]["10%"]["first"]
    value = first - camera.model.circuit().dark
    open_above = Z95 * sd >= 1.0
    return {"value": value, "interval_95": [first / (1 + Z95 * sd), None if open_above else first / (1 - Z95 * sd)]}


def _break(one: Break, found: Poles) -> dict[str, Any]:
    """Irradiance of the lit LED, behind the first lens, where a latency stops going as one over the light."""
    camera = found.law_fit.camera
    dark, lit = camera.model.circuit().dark, 1.0 if one.on else camera.led_off_fraction
    entry: dict[str, Any] = {"edge": "on" if one.on else "off", "setting": one.setting, "floor_s": one.floor_s}
    for name, light in (("one_over_light_to", one.holds), ("half_is_floor_at", one.half)):
        if light is None:
            entry[name] = None
            continue
        value, low, high = (max((each - dark) / lit, 0.0) for each in light)
        measured = [level.irradiance for level in found.levels if level.on == one.on]
        inside = min(measured) <= value <= max(measured)
        entry[name] = {"irradiance_W_m2": value, "interval_95": [low, high], "within_table": inside}
    return entry


def _or_none(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _sentences(entry: dict[str, Any], camera: Camera) -> list[str]:
    """What the table says, and what it cannot."""
    said = []
    name, misses = entry["camera"], entry["model_misses_medians_by"]
    if misses is not None:
        said.append(
            f"{name}: {camera.model.name} meets the medians of {entry['rows']} rows within {100 * misses:.1f} %"
        )
    known = [one for one in entry["levels"] if one["identified"]]
    if known:
        first, last = (f(known, key=lambda one: one["light_W_m2"]) for f in (min, max))
        said.append(
            f"the dominant pole is measured in {len(known)} of {len(entry['levels'])} lights, from {_pole(first)} to "
            f"{_pole(last)}"
        )
    sd = max(threshold_sd(camera, edge) for edge in ("on", "off"))
    why = "later stages hide it" if sd < OPEN_SD else "later stages, or thresholds that are open, hide it"
    for one in entry["levels"]:
        if not one["identified"]:
            low, high = one["interval_95"]
            limit = f"above {low:.3g} rad/s" + (f" and below {high:.3g}" if high is not None else "")
            said.append(f"{_place(one)}: {why}; the photoreceptor's pole lies {limit}")
    for edge, found in entry["exponents"].items():
        if found is not None:
            low, high = found["interval_95"]
            holds = "as one over the light" if low <= 1.0 <= high else "not as one over the light"
            said.append(
                f"light {edge}: the photoreceptor's delay goes as E^−{found['value']:.2f} ({low:.2f} to {high:.2f}), "
                f"{holds}"
            )
    gain = entry["nats_worse_with_one_law"]
    said.append(
        f"one circuit for all lights is {gain:.1f} nats less likely than a speed for each, of {len(entry['levels'])} "
        "parameters more"
    )
    first = entry["one_pole_errs_10_percent_from"]
    low, high = first["interval_95"]
    said.append(
        f"(α/β) E misses the slowest pole by 10 % from {first['value']:.3g} W/m² ({low:.3g} to {high:.3g})"
        if high is not None
        else f"the second pole is too fast to see: (α/β) E is within 10 % of the slowest pole below {low:.3g} W/m²"
    )  # fmt: skip
    said += _break_sentences(entry["breaks"], camera)
    said += limit_sentences(entry["limits"])
    known_to = f"known within {100 * sd:.0f} %" if sd < OPEN_SD else f"known to a factor of {math.exp(Z95 * sd):.2g}"
    said.append(
        f"delays became poles by {camera.model.name}'s thresholds, {known_to} (in the intervals), and its swing of the "
        "light: a table of latencies fixes only their product"
    )
    return said


def _break_sentences(found: Sequence[dict[str, Any]], camera: Camera) -> list[str]:
    names = dict.fromkeys(one["setting"] for one in found)
    wanted = camera.settings[default_setting(camera.settings)].name if camera.settings else None
    shown = wanted if wanted in names else next(iter(names), None)
    words = {
        "one_over_light_to": "the latency goes as one over the light (exponent above 0.9) up to",
        "half_is_floor_at": "half of it is the floor of later stages from",
    }
    said = []
    for one in found:
        if one["setting"] == shown:
            parts = [f"{text} {_irradiance(one[name])}" for name, text in words.items() if one[name] is not None]
            parts.append(f"the floor is {1e6 * one['floor_s']:.3g} µs")
            said.append(f"light {one['edge']}, setting {shown}: {'; '.join(parts)}")
    return said


def _irradiance(one: dict[str, Any]) -> str:
    low, high = one["interval_95"]
    beyond = "" if one["within_table"] else ", beyond the table's lights"
    return f"{one['irradiance_W_m2']:.3g} W/m² ({low:.3g} to {high:.3g}{beyond})"


def _place(one: dict[str, Any]) -> str:
    return f"light {one['edge']}, {one['irradiance_W_m2']:g} W/m², {one['lens']}"


def _pole(one: dict[str, Any]) -> str:
    low, high = one["interval_95"]
    return f"{one['pole_rad_s']:.3g} rad/s ({low:.3g} to {high:.3g}; {_place(one)})"
