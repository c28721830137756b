"""The pages of fits, model comparisons and sensor maps."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pixelid.documents import read_json
from pixelid.fit.bias_priors import prior_table
from pixelid.parameters.invariants import PHYSICAL_UNITS
from pixelid.report.format import count, counted, in_its_unit, number, percent, seconds, value
from pixelid.report.page import Number, Result, Summary, command_line, identified

PHYSICAL_WORDS = {
    "A_amp": "amplifier gain", "A_loop": "total loop gain", "tau_out": "output time constant",
    "q_in": "input time constant × radiance", "q_mil": "Miller time constant × radiance",
    "radiance_scale": "photocurrent per recorded unit",
}  # fmt: skip


def summarise_fit(result: Result, folder: Path) -> Summary:
    return Summary(
        "fit",
        f"{result['model']}, fitted",
        result["status"],
        result.get("advice", ""),
        (
            Number("events", count(result["events"])),
            Number("pixels", str(result["pixels"]), f"in {counted(len(result['recordings']), 'recording')}"),
            identified(result),
            Number("log-likelihood", number(result["log_likelihood"], 6), "nats"),
            Number("time taken", seconds(result["seconds"])),
        ),
        command_line("fit", result, "--model", str(result["model"]), out=folder),
    )


def prepare_fit(result: Result, folder: Path) -> dict[str, Any]:
    truth = folder / "truth.json"
    return {
        "truth": read_json(truth) if truth.is_file() else None,
        "physical": _physical(result),
        "levels": levels_of(result),
        "biases": [list(row) for row in prior_table(result["bias_priors"]).rows] if "bias_priors" in result else None,
    }


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


def _physical(result: Result) -> list[list[str]]:
    """Circuit values with intervals and units; which of them the gauge states."""
    stated, ends = result["gauge"]["fixed"], result.get("physical_intervals_95") or {}
    rows = []
    for name, v in (result.get("physical") or {}).items():
        shown = in_its_unit({"value": v, "interval_95": ends.get(name), "unit": PHYSICAL_UNITS.get(name, "")})
        said = f"assumed: {stated[name]}" if isinstance(stated.get(name), float | int) else shown.interval
        rows.append([name, PHYSICAL_WORDS.get(name, ""), shown.value, said, shown.unit])
    return rows


def summarise_compare(result: Result, folder: Path) -> Summary:
    models = result["models"]
    order = sorted(models, key=lambda name: -models[name]["behind_best_nats"])
    second = models[order[1]]
    return Summary(
        "compare",
        " or ".join(models) + "?",
        result["status"],
        result["sentence"][:1].upper() + result["sentence"][1:] + ".",
        (
            Number("most likely on held-out pixels", result["best"]),
            Number("ahead of the next by", number(-second["behind_best_nats"], 3), "nats"),
            Number("± standard error", number(second["behind_best_se"], 2), "nats"),
            Number("smallest BIC", min(models, key=lambda name: models[name]["bic"])),
            Number("models", str(len(models))),
        ),
        command_line("compare", result, *(w for name in models for w in ("--model", name)), out=folder),
    )


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
    first = next(iter(maps.values()))
    return Summary(
        "sensor",
        f"Maps of {result['width']} × {result['height']} pixels",
        result["status"],
        result.get("advice", ""),
        (
            Number("pixels with events", count(result["pixels_with_events"])),
            Number("events", count(result["events"])),
            Number("parameters mapped", str(len(maps))),
            Number(f"spread of {next(iter(maps))}", percent(first["relative_spread"])),
            Number("time taken", seconds(result["seconds"])),
        ),
        command_line("sensor", result, "--model", str(result["model"]), out=folder),
    )


def prepare_sensor(result: Result, folder: Path) -> dict[str, Any]:
    return {
        "maps": [
            [name, value(m["mean"], m["mean_interval_95"]), m["unit"], percent(m["relative_spread"]),
             percent(m["typical_error_before"]), percent(m["typical_error_after"]), str(m["without_estimate"])]
            for name, m in result["maps"].items()
        ]
    }  # fmt: skip
