"""The pages of fits, model comparisons and sensor maps."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

from pixelid.figures.words import in_words
from pixelid.fit.bias_priors import prior_table
from pixelid.parameters.invariants import PHYSICAL_UNITS
from pixelid.report.circuit import STATUS_LINES, circuit_alone, circuit_parts, shipped_values, uses_of
from pixelid.report.format import count, counted, in_its_unit, number, percent, seconds, value
from pixelid.report.methods import methods_of_fit
from pixelid.report.page import Number, Result, Summary, command_line, folder_name, identified, inputs_of
from pixelid.report.quantities import quantities, quantity, with_index

USABLE = {"converged": "Usable", "not_identified": "Usable in part"}
LACKING = ("converged", "misfit", "not_converged")  # after which a search for what is missing comes next
PHYSICAL_WORDS = {
    "A_amp": "amplifier gain", "A_loop": "total loop gain", "tau_out": "output time constant",
    "q_in": "input time constant × radiance", "q_mil": "Miller time constant × radiance",
    "radiance_scale": "photocurrent per recorded unit",
}  # fmt: skip


def summarise_fit(result: Result, folder: Path) -> Summary:
    own = shlex.quote(folder_name(folder))
    again = ("Find what the model lacks", f"pixelid gap {inputs_of(result, folder)} --model {own} --out {own}_gap")
    return Summary(
        "fit",
        _answer(result),
        result["status"],
        result.get("advice", ""),
        (
            identified(circuit_alone(result)),
            Number("events", count(result["events"])),
            Number("pixels", str(result["pixels"]), f"in {counted(len(result['recordings']), 'recording')}"),
            Number("log-likelihood", number(result["log_likelihood"], 6), "nats"),
            Number("time taken", seconds(result["seconds"])),
        ),
        command_line("fit", result, "--model", str(result["model"]), out=folder),
        f"{result['model']}: {STATUS_LINES.get(result['status'], '')}",
        next=(*([again] if result["status"] in LACKING else []), *uses_of(own)),
    )


def _answer(result: Result) -> str:
    """Whether the fit may be used, and how much of the circuit it identifies."""
    share = identified(circuit_alone(result)).value
    return f"{USABLE.get(result['status'], 'Not usable as it is')}: {share} parameters identified"


def prepare_fit(result: Result, folder: Path) -> dict[str, Any]:
    model, estimated = str(result["model"]), [q for q in quantities(result["parameters"]) if not q.fixed]
    start = shipped_values(model, result["parameters"])
    return circuit_parts(result["parameters"], start, folder, model) | {
        "physical": _physical(result),
        "levels": levels_of(result),
        "biases": [list(row) for row in prior_table(result["bias_priors"]).rows] if "bias_priors" in result else None,
        "posterior": _posterior(result["details"].get("posterior") or {}, result["parameters"]),
        "methods": methods_of_fit(result, estimated),
    }


def _posterior(sampled: dict[str, Any], parameters: dict[str, Any]) -> list[list[Any]]:
    """Mean, interval and convergence of every parameter that was sampled."""
    drawn = sampled.get("parameters", {})
    shown = [quantity(name, {**parameters[name], **row, "value": row["mean"]}) for name, row in drawn.items()]
    return [
        [q.markup, q.value, q.interval, q.unit, f"{row['effective_samples']:.0f}", f"{row['nested_r_hat']:.4f}"]
        for q, row in zip(shown, drawn.values(), strict=True)
    ]


def levels_of(result: Result) -> dict[str, list[list[str]]] | None:
    """How far levels of pixels spread, and what they cost the camera's parameters; None where nobody asked."""
    found = result.get("pixel_levels")
    if not found:
        return None
    words = {"gain": "ln gain (standard deviation)", "background": "background (root mean square)"}
    scales = []
    for kind, scale in found["scales"].items():
        shown = in_its_unit(scale)
        said = "given" if scale["given"] else shown.interval
        scales.append([words.get(kind, kind), shown.value, said, shown.unit])
    camera = [
        [name, *(number(sd[key], 2) for key in ("sd", "sd_if_levels_known", "growth", "sd_of_these_pixels"))]
        for name, sd in found["camera"].items()
    ]
    return {"scales": scales, "camera": camera}


def _physical(result: Result) -> list[list[Any]]:
    """Circuit values with intervals and units; which of them the gauge states."""
    stated, ends = result["gauge"]["fixed"], result.get("physical_intervals_95") or {}
    rows = []
    for name, v in (result.get("physical") or {}).items():
        shown = in_its_unit({"value": v, "interval_95": ends.get(name), "unit": PHYSICAL_UNITS.get(name, "")})
        said = f"assumed: {stated[name]}" if isinstance(stated.get(name), float | int) else shown.interval
        symbol = "" if name == "radiance_scale" else with_index(name)
        rows.append([symbol, PHYSICAL_WORDS.get(name, ""), shown.value, said, shown.unit])
    return rows


def summarise_compare(result: Result, folder: Path) -> Summary:
    models = result["models"]
    order = sorted(models, key=lambda name: -models[name]["behind_best_nats"])
    second, sure = models[order[1]], result["status"] == "converged"
    return Summary(
        "compare",
        f"{result['best']} describes unseen pixels best",
        result["status"],
        result["sentence"][:1].upper() + result["sentence"][1:] + "." + _caution(result),
        (
            Number("most likely on held-out pixels", result["best"]),
            Number("ahead of the next by", number(-second["behind_best_nats"], 3), "nats"),
            Number("± standard error", number(second["behind_best_se"], 2), "nats"),
            Number("smallest BIC", min(models, key=lambda name: models[name]["bic"])),
            Number("models", str(len(models))),
        ),
        command_line("compare", result, *(w for name in models for w in ("--model", name)), out=folder),
        f"{counted(len(models), 'model')} compared" + ("" if sure else "; not every fit is reliable"),
        healthy=sure,
        next=(
            (
                "Find what the best of them lacks",
                f"pixelid gap {inputs_of(result, folder)} --model {result['best']} --out gap",
            ),
        ),
    )


def _caution(result: Result) -> str:
    """Why the status is not good although a model is ahead."""
    return "" if result["status"] == "converged" else f" None of them is the whole truth: {result['advice']}"


def prepare_compare(result: Result, folder: Path) -> dict[str, Any]:
    return {
        "models": [
            [name, m["status"].replace("_", " "), str(m["free_parameters"]), f"{m['held_out_log_likelihood']:.1f}",
             f"{number(m['behind_best_nats'])} ± {number(m['behind_best_se'], 2)}", number(m["bic"], 7)]
            for name, m in sorted(result["models"].items(), key=lambda item: -item[1]["behind_best_nats"])
        ]
    }  # fmt: skip


def summarise_sensor(result: Result, folder: Path) -> Summary:
    maps = result["maps"]
    first_name, first = next(iter(maps.items()))
    return Summary(
        "sensor",
        f"{_name(first_name)} varies by {percent(first['relative_spread'])} over "
        + counted(result["pixels_with_events"], "pixel"),
        result["status"],
        result.get("advice", ""),
        (
            Number("pixels with events", count(result["pixels_with_events"])),
            Number("events", count(result["events"])),
            Number("parameters mapped", str(len(maps))),
            Number(f"spread of {_name(first_name)}", percent(first["relative_spread"])),
            Number("time taken", seconds(result["seconds"])),
        ),
        command_line("sensor", result, "--model", str(result["model"]), out=folder),
        f"Maps of {result['width']} × {result['height']} pixels",
        next=uses_of(shlex.quote(folder_name(folder))),
    )


def _name(parameter: str) -> str:
    """A parameter as a title begins with it."""
    words = in_words(parameter)
    return words[:1].upper() + words[1:]


def prepare_sensor(result: Result, folder: Path) -> dict[str, Any]:
    return {
        "maps": [
            [_name(name), value(m["mean"], m["mean_interval_95"]), m["unit"], percent(m["relative_spread"]),
             percent(m["typical_error_before"]), percent(m["typical_error_after"]), str(m["without_estimate"])]
            for name, m in result["maps"].items()
        ]
    }  # fmt: skip
