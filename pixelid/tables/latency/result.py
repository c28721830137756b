"""What latencies say: latency.json, the model files, and where table and model disagree, in words."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from pixelid.arrays import save_arrays
from pixelid.model.fitted import fit_hash, fitted_source, implied_physical, today
from pixelid.outputs import file_name
from pixelid.parameters.parameter import Parameter, Prior
from pixelid.provenance import provenance
from pixelid.results import Table
from pixelid.status import Status
from pixelid.tables.fit import MAX_SCATTER, SUSPECT_SCALES, misses
from pixelid.tables.latency.camera import Camera, camera_for, save_camera
from pixelid.tables.latency.cells import gather
from pixelid.tables.latency.figures import draw_latency, draw_limits
from pixelid.tables.latency.fit import CameraFit, LatencyFit
from pixelid.tables.latency.limits import limit_sentences, limits
from pixelid.tables.latency.model import EXTRA_ERROR, NUISANCES, SHARED
from pixelid.tables.latency.reading import STATISTICS, TIMESTAMP_S, LatencyTable
from pixelid.tables.latency.recipe import LatencyRecipe
from pixelid.tables.latency.steps import NEVER_S
from pixelid.tables.result import TableResult, open_sentences

REPEATABLE = 0.02  # regions of one condition agree no better in the public table's clean rows
UNITS = {p.name: p.unit for p in SHARED}


def fitted_result(fit: LatencyFit) -> dict[str, Any]:
    """The content of latency.json after a fit."""
    verdicts = [one.regression.judge() for one in fit.fits]
    status = Status.worst(verdict for verdict, _ in verdicts)
    advice = "; ".join(
        f"{one.name}: {text}"
        for one, (verdict, text) in zip(fit.fits, verdicts, strict=True)
        if verdict == status and text
    )
    several = len(fit.fits) > 1
    parameters: dict[str, Any] = {}
    unidentified = []
    for one in fit.fits:
        entries = one.regression.as_dict()
        parameters |= {of_camera(name, one.name, several): entry for name, entry in entries.items()}
        unidentified += [f"{one.name}: {sentence}" for sentence in _open(one, entries)]
    return {
        "status": status,
        "advice": advice,
        **_common(fit.table, _used(fit.table, fit.cameras)),
        "parameters": parameters,
        "unidentified": unidentified,
        "relative_scatter": {one.name: one.regression.scale for one in fit.fits},
        "log_likelihood": float(sum(one.regression.log_likelihood for one in fit.fits)),
        "cells_fitted": int(sum(len(one.regression.residual) for one in fit.fits)),
        "seconds": fit.seconds,
        **provenance(*fit.table.sources),
    }


def predicted_result(table: LatencyTable, cameras: Sequence[Camera], *inputs: Path) -> dict[str, Any]:
    """The content of latency.json without fitting; status says whether the model describes what was measured."""
    used = _used(table, cameras)
    common = _common(table, used)
    spread = [e["median"]["rms_without_spoiled"] for e in common["errors"].values() if "median" in e]
    wrong = [f"by {100 * value:.0f} %" for value in spread if value is not None and value > MAX_SCATTER]
    wrong += _missed(common["rows"])
    several = len(used) > 1
    parameters = {
        of_camera(name, camera.name, several): {
            "value": value, "unit": unit, "std": None, "interval_95": None, "identified": True, "fixed": True
        }
        for camera in {id(camera): camera for camera in used.values()}.values()
        for name, value, unit in _values(camera)
    }  # fmt: skip
    return {
        "status": Status.misfit if wrong else Status.converged,
        "advice": f"the model misses what was measured {wrong[-1]}: fit it to this table" if wrong else "",
        **common,
        "parameters": parameters,
        "unidentified": _stand_ins(table, cameras, used, common["rows"]),
        **provenance(*table.sources, *inputs),
    }


def _missed(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """How what was measured of cameras is missed, in a few words each; spoiled cells and all.

    A row is judged by its median, where it has none by its extremes.
    """
    said = []
    for camera in dict.fromkeys(row.get("camera", "-") for row in rows):
        pairs = []
        for row in rows:
            if row.get("camera", "-") != camera:
                continue
            asked = ("median",) if row["measured"] is not None else ("min", "max")
            known = (row["statistics"][name] for name in asked if name in row["statistics"])
            pairs += [
                (math.log((one["predicted"] + TIMESTAMP_S) / (one["measured"] + TIMESTAMP_S)), one["standardised"])
                for one in known
            ]
        if pairs and (how := misses(*np.array(pairs).T)):
            said.append(how)
    return said


def _stand_ins(
    table: LatencyTable, cameras: Sequence[Camera], used: Mapping[str, Camera], rows: Sequence[Mapping[str, Any]]
) -> list[str]:
    """What a prediction rests on that was not measured, one sentence each."""
    said = []
    known = {lens for each in cameras for lens in each.lens}
    for label, camera in used.items():
        here = table.camera == label
        if camera.name != label != "-":
            said.append(f"camera {label}: predicted by the model of {camera.name}")
        said += [
            f"{label}: lens {lens!r} was not fitted: light is taken to be that without its factor"
            for lens in dict.fromkeys(table.lens[here].tolist())
            if known and lens not in known and lens != "-"
        ]
        for on in (True, False):
            measured = [bias for each in camera.settings if math.isfinite(bias := each.bias(on))]
            asked = table.bias[here & (table.on == on)]
            asked = asked[np.isfinite(asked)]
            if measured and len(asked) and not (min(measured) <= asked.min() and asked.max() <= max(measured)):
                said.append(
                    f"{label}, {'ON' if on else 'OFF'}: settings {min(measured):g} … {max(measured):g} were measured; "
                    f"those at {asked.min():g} … {asked.max():g} are extrapolated"
                )
    silent = sum(row["predicted"] >= NEVER_S for row in rows)
    if silent:
        said.append(f"in {silent} rows no pixel is predicted to fire: {NEVER_S:g} s stands for never")
    return said


@dataclass(frozen=True, repr=False)
class LatencyResult(TableResult):
    """First-event latencies against irradiance, fitted or predicted."""

    FILE: ClassVar[str] = "latency.json"

    def tables(self) -> list[Table]:
        """Errors per camera and statistic, and the parameters."""
        rows = tuple(
            (name, statistic, str(e["rows"]), _percent(e["rms"]), _percent(e["rms_without_spoiled"]), str(e["spoiled"]))
            for name, errors in self.content["errors"].items()
            for statistic, e in errors.items()
        )
        headings = ("camera", "latency", "rows", "rms error", "rms without outliers", "outliers")
        return [Table("", headings, rows, frozenset({"camera", "latency"})), *super().tables()]

    def sentences(self) -> list[str]:
        """Advice, and which stage limits where."""
        return [self.content["advice"], *self.content["limiting_stages"]]


def _percent(value: float | None) -> str:
    return "–" if value is None else f"{100 * value:.1f} %"


def of_fit(
    fit: LatencyFit,
    *,
    seed: int = 0,
    recipe: LatencyRecipe | None = None,
    posterior: tuple[dict[str, Any], dict[str, np.ndarray]] | None = None,
) -> LatencyResult:
    """The result of a fit, with its models, one folder per camera where there are several.

    posterior: of `posterior.sample_fit`: what it says, and the chains
    """
    cameras = [(one.name, described(one, fit.table)) for one in fit.fits]
    chains = posterior[1] if posterior else {}

    def companions(folder: Path) -> None:
        for name, camera in cameras:
            place = folder if len(cameras) == 1 else _own_folder(folder, name)
            place.mkdir(exist_ok=True)
            save_camera(recipe.finished(camera) if recipe else camera, place / "model.toml")
        if chains:
            save_arrays(folder / "posterior.npz", chains)

    result = {**fitted_result(fit), "seed": seed, **({"posterior": posterior[0]} if posterior else {})}
    if recipe:
        result |= provenance(*fit.table.sources, recipe.path)
    unconverged = [name for name, said in result.get("posterior", {}).items() if said["status"] == Status.not_converged]
    if unconverged:
        result["status"] = Status.worst([result["status"], Status.not_converged])
        said = f"{', '.join(unconverged)}: the posterior's chains have not converged"
        result["advice"] = f"{result['advice']} {said}".strip()
    return LatencyResult(result, _figures(result), companions)


def of_prediction(table: LatencyTable, cameras: Sequence[Camera], *inputs: Path, seed: int = 0) -> LatencyResult:
    """The result of cameras evaluated on a table."""
    result = {**predicted_result(table, cameras, *inputs), "seed": seed}
    return LatencyResult(result, _figures(result))


def _figures(result: Mapping[str, Any]) -> dict[str, Callable[[], Any]]:
    """By name, functions that draw."""
    return {"latency": partial(draw_latency, result["rows"]), "limits": partial(draw_limits, result["limits"])}


def described(one: CameraFit, table: LatencyTable) -> Camera:
    """The camera with where each number comes from, and its interval as a prior for later fits."""
    camera, entries = one.camera, one.regression.as_dict()
    sd = dict(zip(entries, one.regression.sd.tolist(), strict=True))
    x = dict(zip(entries, one.regression.x.tolist(), strict=True))
    setting = camera.settings[[s.on_threshold for s in camera.settings].index(camera.model.values["on_threshold"])].name
    same = {"on_threshold": f"on_threshold[{setting}]", "off_threshold": f"off_threshold[{setting}]"}
    origin = f"first-event latencies, {', '.join(path.name for path in table.sources)}"
    day = today()
    fit = fit_hash("latency", camera.model, [[path.name for path in table.sources], day])
    parameters: dict[str, Parameter] = {}
    for name, parameter in camera.model.parameters.items():
        key = same.get(name, name)
        text, prior = f"{origin}: not seen", None
        if key in entries:
            low, high = entries[key]["interval_95"]
            known = entries[key]["identified"]
            text = f"{fitted_source(fit, day, (low, high), known)}; {origin}"
            prior = Prior(x[key], sd[key]) if known else None
            if key in same.values():
                text += f"; setting {setting}, in units of the light's unknown contrast"
        elif name == "alpha":
            corner, damping = _interval(entries["alpha_over_beta"]), _interval(entries["beta"])
            text = f"{fitted_source(fit, day, None)}, alpha_over_beta {corner} times beta {damping}; {origin}"
            both = ("alpha_over_beta", "beta")
            if one.regression.converged and all(np.isfinite(sd[key]) for key in both):
                prior = Prior(sum(x[key] for key in both), float(np.hypot(*(sd[key] for key in both))))
        elif name == "gamma":
            text = "not seen by latencies: 0.034 α/β, the ratio of the DVS128"
        elif name == "delay_s":
            text = f"{origin}: mean of ON and OFF delays of setting {setting}; per setting and edge in [latency]"
        parameters[name] = replace(parameter, source=text, prior=prior)
    summary = (
        f"{camera.name}, fitted to {one.model.cells.table.camera.size} cells of first-event latencies; "
        f"scatter {100 * one.regression.scale:.1f} %. Radiance is irradiance in the light's plane, W/m²."
    )
    circuit, why = implied_physical(camera.model)
    source = f"fitted: {origin}, as the fitted values imply under the gauge" if circuit else ""
    if camera.model.physical is not None and circuit is None:
        summary += f" No [physical] values: {why}."
    model = replace(camera.model, parameters=parameters, summary=summary, physical=circuit, physical_source=source)
    return replace(camera, model=model)


def _interval(entry: Mapping[str, Any]) -> str:
    low, high = entry["interval_95"]
    return f"{entry['value']:.4g} ({low:.4g} to {high:.4g})"


def _common(table: LatencyTable, used: Mapping[str, Camera]) -> dict[str, Any]:
    rows = _rows(table, used)
    lights = {name: np.unique(table.irradiance[table.camera == name]) for name in dict.fromkeys(table.camera.tolist())}
    found = [entry | {"camera": name} for name, light in lights.items() for entry in limits(used[name], light)]
    return {
        "model": "latency",
        "observation": "first_event",
        "cameras": list(used),
        "errors": _errors(rows),
        "limits": found,
        "limiting_stages": limit_sentences(found),
        "disagreements": _disagreements(rows) + _delay_sentences(tuple(used.values())),
        "rows": rows,
    }


def _used(table: LatencyTable, cameras: Sequence[Camera]) -> dict[str, Camera]:
    """Label of the table → camera that predicts it."""
    names = dict.fromkeys(table.camera.tolist())
    return {
        name: camera_for(cameras, name, list(dict.fromkeys(table.lens[table.camera == name].tolist())))
        for name in names
    }


def _rows(table: LatencyTable, used: Mapping[str, Camera]) -> list[dict[str, Any]]:
    """The table's rows with measured, predicted [s] and standardised residual: of the median, and of each statistic."""
    cells = gather(table)
    predicted = {name: np.empty(len(table)) for name in STATISTICS}
    scatter = np.empty(len(table))
    for name, camera in used.items():
        here = np.flatnonzero(table.camera == name)
        found = camera.predict(table.select(table.camera == name))
        scatter[here] = camera.relative_scatter
        for statistic in STATISTICS:
            share = 1.0 - cells.lost[here] if statistic in ("median", "min", "max") else 1.0
            predicted[statistic][here] = found[statistic] * share
    rows = []
    for k in range(len(table)):
        each = {}
        for name in STATISTICS:
            measured, said = float(table.latency_s[name][k]), float(predicted[name][k])
            if name != "median" and not math.isfinite(measured):
                continue
            size = math.sqrt(
                max(scatter[k], REPEATABLE) ** 2
                + EXTRA_ERROR[name] ** 2
                + float(cells.error[name][cells.cell[k]]) ** 2
                + (TIMESTAMP_S / math.sqrt(12.0) / (said + TIMESTAMP_S)) ** 2
            )
            known = math.isfinite(measured)
            residual = math.log((measured + TIMESTAMP_S) / (said + TIMESTAMP_S)) / size if known else None
            each[name] = {"measured": measured if known else None, "predicted": said, "standardised": residual}
        rows.append({
            **{name: cells_[k] for name, cells_ in table.columns.items()},
            **each["median"],
            "statistics": each,
            "lost_edges": float(cells.lost[k]),
            "spoiled": bool(cells.spoiled[k]) or abs(each["median"]["standardised"] or 0.0) > SUSPECT_SCALES,
        })  # fmt: skip
    return rows


def _errors(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Camera → statistic → rms of ln(predicted / measured), of all rows and of those that are not spoiled."""
    errors: dict[str, Any] = {}
    for camera in dict.fromkeys(row.get("camera", "-") for row in rows):
        mine = [row for row in rows if row.get("camera", "-") == camera]
        errors[camera] = {}
        for name in STATISTICS:
            pairs = [
                (row["statistics"][name], row["spoiled"]) for row in mine
                if name in row["statistics"] and (row["statistics"][name]["measured"] or 0.0) > 0.0
            ]  # fmt: skip
            if not pairs:
                continue
            logs = np.array([math.log(max(p["predicted"], 1e-12) / p["measured"]) for p, _ in pairs])
            clean = ~np.array([spoiled for _, spoiled in pairs])
            errors[camera][name] = {
                "rows": len(logs),
                "spoiled": int((~clean).sum()),
                "rms": float(np.sqrt(np.mean(logs**2))),
                "rms_without_spoiled": float(np.sqrt(np.mean(logs[clean] ** 2))) if clean.any() else None,
            }
    return errors


def _disagreements(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """The rows that the model down-weights most, one sentence each."""
    spoiled = [row for row in rows if abs(row["standardised"] or 0.0) > SUSPECT_SCALES]
    spoiled.sort(key=lambda row: -abs(row["standardised"]))
    most_said = 20  # spoiled cells in words; all are marked in `rows`
    said = [
        f"{_place(row)}: median {1e6 * row['measured']:.4g} µs, the model says {1e6 * row['predicted']:.4g} "
        f"({row['standardised']:+.0f} scales)"
        for row in spoiled[:most_said]
    ]
    if len(spoiled) > most_said:
        said.append(f"and {len(spoiled) - most_said} more outliers, marked `spoiled`")
    lost = [row["lost_edges"] for row in rows if row["lost_edges"] > 0]
    if lost:
        said.append(
            f"{len(lost)} rows scatter between edges, or count more pixels, as if {100 * np.median(lost):.0f} % of the "
            "edges had given no latency: their means are short by that share, and are predicted so"
        )
    return said


def _place(row: Mapping[str, Any]) -> str:
    words = [str(row[key]) for key in ("camera", "lens", "bias_config") if key in row]
    edge = "on" if row["polarity"] == 1 else "off"
    return f"{', '.join(words)}, light {edge}, {row['irradiance_W_m2']:g} W/m²"


def _delay_sentences(cameras: Sequence[Camera]) -> list[str]:
    """What delays after the crossing say, where they change with the setting."""
    said = []
    for camera in cameras:
        for on in (True, False):
            delays = [(s.delay(on), s.name) for s in camera.settings]
            if len(delays) > 1 and max(delays)[0] > 3.0 * min(delays)[0] and max(delays)[0] > 1e-4:
                said.append(
                    f"{camera.name}, {'ON' if on else 'OFF'} events: the delay after the crossing grows from "
                    f"{1e6 * min(delays)[0]:.2g} µs ({min(delays)[1]}) to {1e6 * max(delays)[0]:.2g} µs "
                    f"({max(delays)[1]}), which no pole shared by all settings gives: as of a comparator whose bias "
                    "current falls as its threshold rises"
                )
    return said


def _open(one: CameraFit, entries: Mapping[str, Any]) -> list[str]:
    said = open_sentences(entries, at_rest=one.regression.converged)
    for other in one.rivals:
        poles = ("beta", "sf_cutoff_hz", "diff_cutoff_hz")
        values = {p.name: float(np.exp(x)) for p, x in zip(other.parameters, other.x, strict=True) if p.name in poles}
        said.append(
            "poles can be exchanged: the table is met as well with beta "
            f"{values['beta']:.3g} 1/s, follower {values['sf_cutoff_hz']:.3g} Hz and amplifier "
            f"{values['diff_cutoff_hz']:.3g} Hz; intervals reach both"
        )
    said.append(
        "thresholds are in units of the light's swing: threshold over contrast shows, and led_off_fraction is fixed "
        "only as far as its prior says (a factor e either way)"
    )
    said.append(
        "a threshold includes what the last event of the edge before left of a threshold in the amplifier: only their "
        "sum shows"
    )
    return said


def _values(camera: Camera) -> list[tuple[str, float, str]]:
    """(name, value, unit) of everything that predicts."""
    found = [(p.name, p.value, p.unit) for p in camera.model.parameters.values()]
    found += [(name, getattr(camera, name), UNITS[name]) for name in (*sorted(NUISANCES), "delay_sigma")]
    found += [(f"lens_factor[{lens}]", factor, "1") for lens, factor in camera.lens.items()]
    for s in camera.settings:
        found += [
            (f"on_threshold[{s.name}]", s.on_threshold, "log radiance"),
            (f"off_threshold[{s.name}]", s.off_threshold, "log radiance"),
            (f"on_delay_s[{s.name}]", s.on_delay_s, "s"),
            (f"off_delay_s[{s.name}]", s.off_delay_s, "s"),
        ]
    return found


def of_camera(name: str, camera: str, several: bool) -> str:
    """Parameter names of several cameras in one file: alpha[CAM1], on_threshold[CAM1, 0.25MAX]."""
    if not several:
        return name
    base, bracket, rest = name.partition("[")
    return f"{base}[{camera}, {rest}" if bracket else f"{base}[{camera}]"


def _own_folder(folder: Path, camera: str) -> Path:
    """A folder of the camera's own: labels that differ in characters that file systems do not take get a number."""
    name = file_name("".join(c if c.isalnum() or c in "-_." else "_" for c in camera))
    return next(p for k in itertools.count(1) if not (p := folder / (name if k == 1 else f"{name}_{k}")).exists())
