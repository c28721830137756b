"""What noise rates say: the numbers of noise.json, its disagreements and what stays open, in words."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from pixelid.documents import interpreting, read_json
from pixelid.errors import InputError
from pixelid.model.files import save_model
from pixelid.model.fitted import as_fitted, fit_hash, today
from pixelid.model.model import Model
from pixelid.provenance import provenance
from pixelid.statistics import SD_PER_MEDIAN
from pixelid.status import Status
from pixelid.tables.fit import MAX_SCATTER, misses
from pixelid.tables.model import predicted_rows
from pixelid.tables.noise.figures import draw_intervals, draw_noise
from pixelid.tables.noise.fit import NoiseFit
from pixelid.tables.noise.intervals import mean_intervals
from pixelid.tables.noise.measured_intervals import EDGES_S, intervals_in_words
from pixelid.tables.noise.model import BESIDE, FA_PER_UNIT, FLOOR, OFF_BACKGROUND, NoiseModel, in_unit
from pixelid.tables.noise.reading import NoiseTable
from pixelid.tables.result import TableResult, table_result

MODEL_FILE = "model.toml"
NAMED = 0.15  # relative disagreement that is said in words
SCALE = "light_scale["  # beginning of the names of scales that a fit of several tables finds
FOLDED = ("shot_noise.density", "diff_cutoff_hz", "threshold_sigma", "threshold_mismatch.sigma")


@dataclass(frozen=True, repr=False)
class NoiseResult(TableResult):
    """Noise events of still scenes against light, fitted or predicted."""

    FILE: ClassVar[str] = "noise.json"


def of_fit(fit: NoiseFit, seed: int) -> NoiseResult:
    """The result of a fit, with its model."""
    result = fitted_result(fit)
    model = _truthful(fit, result, seed)
    return NoiseResult(result | {"seed": seed}, _figures(fit.fitted, result),
                       lambda folder: save_model(model, folder / MODEL_FILE))  # fmt: skip


def _truthful(fit: NoiseFit, result: Mapping[str, Any], seed: int) -> Model:
    """The fitted circuit, with the fit and interval of every value that the table has moved."""
    entries = {name: entry for name, entry in result["parameters"].items()
               if name in fit.circuit.parameters and not entry.get("fixed")}  # fmt: skip
    day = today()
    return as_fitted(
        fit.circuit, fit=fit_hash("noise", fit.circuit, [result["inputs_sha256"], seed, day]), day=day, fitted=entries,
        limits={name: entry["interval_95"] for name, entry in entries.items()},
        unidentified=[name for name, entry in entries.items() if not entry["identified"]],
        to=f"noise rates of {', '.join(result['inputs_sha256']) or 'a table'}, {result['status']}",
    )  # fmt: skip


def fitted_result(fit: NoiseFit) -> dict[str, Any]:
    """The content of noise.json after a fit."""
    circuit, table = fit.circuit, fit.model.table
    result = table_result(fit.regression, circuit.name, "noise_rate")
    result["parameters"] |= _fixed(circuit, [n for n in FOLDED if n in circuit.parameters])
    density = circuit.parameters["shot_noise.density"]
    result["unidentified"] = [
        "the scale of thresholds: noise fixes on_threshold and off_threshold only over the root of shot_noise.density; "
        f"they are stated for {density.value:.3g} {density.unit}, and a density F times larger means thresholds √F "
        "times larger" + _about_unit(table.unit),
        *result["unidentified"],
    ]
    return result | {
        "gauge": {"fixed": {"shot_noise.density": density.value}},
        "radiance_unit": table.unit,
        **_about_rows(fit.fitted, result["rows"]),
        "seconds": fit.seconds,
        **provenance(*table.sources),
    }


def of_prediction(
    table: NoiseTable,
    model: Model,
    beside: Mapping[str, float],
    seed: int,
    inputs: Sequence[Path] = (),
    scales: Mapping[str, float] | None = None,
) -> NoiseResult:
    """The result of a model evaluated on a table.  scales: `model_scales`."""
    noise = NoiseModel(table, in_unit(model, table.unit), beside)
    result = predicted_result(noise, scales)
    result |= {"seed": seed, **provenance(*table.sources, *inputs)}
    return NoiseResult(result, _figures(noise, result))


def predicted_result(noise: NoiseModel, scales: Mapping[str, float] | None = None) -> dict[str, Any]:
    """The content of noise.json without fitting.  scales: of light, by the names of tables that were fitted."""
    table, rows = noise.table, noise.rows
    scale, unknown = _light_scales(table, scales or {})
    lit = replace(noise, table=replace(table, light=table.light * scale))
    predicted = lit.predict(np.array([p.to_coordinate(p.value) for p in lit.parameters]))
    ratio = rows.log_ratio(predicted)
    scatter = SD_PER_MEDIAN * float(np.median(np.abs(ratio)))
    repeatability = 0.05  # of a rate in a table without errors, against which --predict standardises
    standardised = ratio / np.sqrt(rows.known_variance + repeatability**2)
    how = misses(ratio, standardised) or (f"by {scatter:.0%} (typical)" if not scatter < MAX_SCATTER else "")
    written = predicted_rows(noise, predicted, standardised)
    return {
        "status": Status.misfit if how else Status.converged,
        "advice": f"The model misses the rates {how}: fit it to this table." if how else "",
        "model": noise.circuit.name,
        "observation": "noise_rate",
        "parameters": _fixed(noise.circuit, list(noise.circuit.parameters)) | _held(noise.beside, scale, table.group),
        "unidentified": unknown,
        "relative_scatter": scatter,
        "cells_fitted": 0,
        "rows": written,
        "radiance_unit": table.unit,
        **_about_rows(noise, written),
    }


def _about_rows(noise: NoiseModel, rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Disagreements of rates and, of recordings, intervals between their events against those predicted."""
    table, said = noise.table, disagreements(noise.table, rows)
    if not table.intervals:
        return {"disagreements": said}
    circuit, floor = noise.circuit.circuit(), noise.beside.get(FLOOR.name, 0.0)
    own = not noise.beside.get(OFF_BACKGROUND.name, 0.0)  # events whatever the light are not the circuit's
    seen = sorted((one.radiance, k) for k, one in enumerate(table.intervals) if one.counts.any())
    interval_lights = 6  # spread over those recorded, at which intervals are predicted: some seconds each
    spread = np.linspace(0, len(seen) - 1, interval_lights).round().astype(int) if seen and own else []
    predicted = {seen[k][1] for k in spread}
    entries = [
        one.compared(mean_intervals(circuit, one.radiance, EDGES_S, floor) if k in predicted else None)
        for k, one in enumerate(table.intervals)
    ]
    words = (intervals_in_words(entry, table.unit, NAMED) for entry in entries)
    return {"disagreements": [*said, *(one for one in words if one)], "intervals": entries}


def _figures(noise: NoiseModel, result: dict[str, Any]) -> dict[str, Callable[[], Any]]:
    """By name, functions that draw."""
    figures: dict[str, Callable[[], Any]] = {"noise": partial(draw_noise, noise, result["rows"])}
    if "intervals" in result:
        figures["noise_intervals"] = partial(draw_intervals, result["intervals"], noise.table.unit)
    return figures


def disagreements(table: NoiseTable, rows: Sequence[dict[str, Any]]) -> list[str]:
    """Rows off by more than `NAMED`, and where the rates peak, in words."""
    sentences = []
    ratios = [row["measured"] / row["predicted"] for row in rows]
    measured = [(abs(math.log(r)), k) for k, r in enumerate(ratios) if r > 0 and abs(r - 1.0) > NAMED]
    most_named = 12
    for _, k in sorted(measured, reverse=True)[:most_named]:
        sentences.append(
            f"{rows[k].get('file', '')} {'ON' if table.on[k] else 'OFF'} at {table.light[k]:.3g} {table.unit}: "
            f"measured {rows[k]['measured']:.3g} events/s, predicted {rows[k]['predicted']:.3g} events/s "
            f"({ratios[k]:.2f} times)"
        )
    if len(measured) > most_named:
        sentences.append(f"and {len(measured) - most_named} more rows off by more than {NAMED:.0%}")
    for group in sorted(set(table.group.tolist())):
        for on in (True, False):
            here = np.flatnonzero((table.group == group) & (table.on == on))
            if len(here) < 4:
                continue
            peaks = [
                table.light[here[np.argmax([rows[int(k)][key] for k in here])]] for key in ("measured", "predicted")
            ]
            if peaks[0] != peaks[1]:
                sentences.append(
                    f"{rows[int(here[0])].get('file', '')} {'ON' if on else 'OFF'}: the rate is largest at "
                    f"{peaks[0]:.3g} {table.unit}, predicted at {peaks[1]:.3g} {table.unit}"
                )
    return sentences


def _result_of(spec: str | Path) -> Path:
    """noise.json of the folder that a model is given by, or that its model.toml lies in."""
    path = Path(spec)
    return (path.parent if path.name == MODEL_FILE else path) / "noise.json"


def model_beside(spec: str | Path) -> dict[str, float]:
    """What a folder of `pixelid noise` (or its model.toml) found in addition to its model, by names of `BESIDE`; empty
    for any other model.

    Raises:
        InputError: a noise.json that is damaged.
    """
    path = _result_of(spec)
    if not path.is_file():
        return {}
    parameters, found = read_json(path).get("parameters", {}), {}
    for name in BESIDE:
        value = parameters.get(name, {}).get("value", 0.0)
        if not isinstance(value, int | float) or not 0 <= value < math.inf:
            raise InputError(f"{path}: {name}: expected a number of at least 0, found {value!r}")
        found[name] = float(value)
    return found


def model_scales(spec: str | Path) -> dict[str, float]:
    """Name of a table → scale of its light, as a fit of `pixelid noise` found it; empty for any other model.

    The first table's light is the unit.  Of tables that share a name nobody can know which is meant: none is known.

    Raises:
        InputError: a noise.json that is damaged.
    """
    path = _result_of(spec)
    if not path.is_file():
        return {}
    document = read_json(path)
    with interpreting(path, "rows and parameters of fitted tables"):
        if not document["cells_fitted"]:
            return {}
        names = list(dict.fromkeys(str(row["file"]) for row in document["rows"]))
        found = {n: float(v["value"]) for n, v in document["parameters"].items() if n.startswith(SCALE)}
    for name, value in found.items():
        if not 0 < value < math.inf:
            raise InputError(f"{path}: {name}: expected a number above 0, found {value!r}")
    if len(names) != len(found) + 1:
        return {}
    return {file: found.get(f"{SCALE}{k}]", 1.0) for k, file in enumerate(names)}


def _light_scales(table: NoiseTable, known: Mapping[str, float]) -> tuple[np.ndarray, list[str]]:
    """((rows,) factor on the light of each row, a sentence per table of which none is known).

    A single table with a model that was fitted to none has no light to compare with: nothing is stated of it.
    """
    scale, unknown = np.ones(len(table.light)), []
    for group in sorted(set(table.group.tolist())):
        here = table.group == group
        name = str(table.columns["file"][int(np.flatnonzero(here)[0])]) if "file" in table.columns else ""
        scale[here] = known.get(name, 1.0)
        if not table.pixels and name not in known and (known or group):
            unknown.append(
                f"the light of {name}: no fit says how its scale compares with that of the model; it is taken as stated"
            )
    return scale, unknown


def _fixed(model: Model, names: Sequence[str]) -> dict[str, Any]:
    return {
        n: {
            "value": model.values[n], "unit": model.parameters[n].unit, "std": None, "interval_95": None,
            "identified": False, "fixed": True,
        }
        for n in names
    }  # fmt: skip


def _held(beside: Mapping[str, float], scale: np.ndarray, group: np.ndarray) -> dict[str, Any]:
    """Values of `BESIDE` and scales of light (rows,) that a prediction takes from a fit, where they change anything."""
    found = {f"{SCALE}{k}]": (float(scale[group == k][0]), "1") for k in sorted(set(group[scale != 1.0].tolist()))}
    found |= {name: (value, BESIDE[name].unit) for name, value in beside.items() if value > 0}
    return {
        name: {"value": value, "unit": unit, "std": None, "interval_95": None, "identified": False, "fixed": True}
        for name, (value, unit) in found.items()
    }


def _about_unit(unit: str) -> str:
    if unit not in FA_PER_UNIT or unit == "fA":
        return ""
    return (
        f"; a photocurrent of {FA_PER_UNIT[unit]:.3g} fA per {unit} is assumed, and one F times larger means a "
        "density F times smaller"
    )
