"""The pages of tables: event rates, latencies, noise events, and phases under mains light."""

from __future__ import annotations

import math
import re
import shlex
import statistics
from pathlib import Path
from typing import Any

from pixelid.report.circuit import interval_parts, uses_of
from pixelid.report.format import counted, in_its_unit, number, percent, seconds
from pixelid.report.page import Number, Result, Summary, command_line, folder_name, identified
from pixelid.report.quantities import name_of
from pixelid.statistics import Z95

REST = (("A light that fixes the rest, for a sound card", "pixelid stimulus chirp --for dvs128 --out chirp.wav"),)


def _healthy(result: Result) -> bool | None:
    """Not, where a fit ended well and leaves parameters open."""
    opened = any(not p["identified"] and not p.get("fixed") for p in result["parameters"].values())
    return False if result["status"] == "converged" and opened else None


def summarise_rates(result: Result, folder: Path) -> Summary:
    suspects = sum(abs(row["standardised"]) > 4 for row in result.get("rows", ()))
    return Summary(
        "rates",
        f"Event rates: {identified(result).value} parameters identified, {counted(suspects, 'outlier')}",
        result["status"],
        result.get("advice", ""),
        (
            Number("cells", str(result["cells_fitted"])),
            Number("relative scatter", percent(result["relative_scatter"])),
            Number("outliers", str(suspects)),
            identified(result),
            Number("log-likelihood", number(result["log_likelihood"]), "nats"),
        ),
        command_line("rates", result, out=folder),
        {"pixel": "Event rates of one pixel", "pool": "Event rates of a light's image"}[result["model"]],
        healthy=_healthy(result),
        next=REST,
    )


def summarise_latency(result: Result, folder: Path) -> Summary:
    medians = {name: errors["median"] for name, errors in result["errors"].items() if "median" in errors}
    own, models = shlex.quote(folder_name(folder)), sorted(folder.glob("*/model.toml"))
    model = (
        own if (folder / "model.toml").is_file() else f"{own}/{shlex.quote(models[0].parent.name)}" if models else ""
    )
    missed = [error["rms_without_spoiled"] for error in medians.values() if error["rms_without_spoiled"] is not None]
    return Summary(
        "latency",
        f"Median latency predicted within {percent(max(missed))} (rms)"
        if missed
        else "No median latency to compare with",
        result["status"],
        result.get("advice", ""),
        (
            Number("rows", str(len(result["rows"]))),
            Number("medians missed by", percent(max(missed)) if missed else "–", "rms, worst camera"),
            Number("rows excluded", str(sum(row["spoiled"] for row in result["rows"]))),
            identified(result),
            Number("time taken", seconds(result.get("seconds"))),
        ),
        command_line("latency", result, out=folder),
        f"First-event latency of {', '.join(result['cameras'])}",
        healthy=_healthy(result),
        next=(("How slow it is in low light", f"pixelid lowlight {model} --out {own}_lowlight"),) if model else (),
    )


def summarise_noise(result: Result, folder: Path) -> Summary:
    worst = max(
        (abs(row["measured"] / row["predicted"] - 1.0) for row in result["rows"] if row["measured"]), default=0.0
    )
    return Summary(
        "noise",
        f"Noise rates described within {percent(worst)}" if result["rows"] else "No noise rates",
        result["status"],
        result.get("advice", ""),
        (
            Number("rows", str(len(result["rows"]))),
            Number("relative scatter", percent(result["relative_scatter"])),
            Number("largest disagreement", percent(worst)),
            identified(result),
            Number("unit of light", result["radiance_unit"]),
        ),
        command_line("noise", result, out=folder),
        "Noise events of still scenes",
        healthy=_healthy(result),
        next=uses_of(shlex.quote(folder_name(folder)))[:2] if (folder / "model.toml").is_file() else REST,
    )


def summarise_biases(result: Result, folder: Path) -> Summary:
    laws, own = result["quantities"], shlex.quote(folder_name(folder))
    fitted = {name: law for name, law in laws.items() if "rivals" in law}
    rows = [row for law in laws.values() for row in law["rows"] if row["measured"] is not None]
    held = [
        law["rivals"][0]["heldout_median"] for law in fitted.values() if law["rivals"][0]["heldout_rms"] is not None
    ]
    return Summary(
        "biases",
        _answer_biases(laws),
        result["status"],
        result["advice"],
        (
            Number("laws", str(len(laws)), "" if fitted else "evaluated"),
            Number("rows", str(len(rows))),
            Number("outliers", str(sum(abs(row["standardised"] or 0.0) > 4 for row in rows))),
            Number("settings left out missed by", percent(max(held)) if held else "–", "median, worst quantity"),
            Number("time taken", seconds(result["seconds"])),
        ),
        command_line("biases", result, out=folder),
        next=(
            (
                "As priors of a fit, at the codes of its .bias files",
                f"pixelid fit session/ --model dvs128 --bias-laws {own} --out fit",
            ),
        )
        if fitted
        else (),
    )


def _answer_biases(laws: Result) -> str:
    """The law of each quantity, and of which codes."""
    words = [
        f"{name_of(name)}: {law['law']} in {', '.join(law['codes'])}" for name, law in laws.items() if law.get("codes")
    ]
    said = "; ".join(words) or f"{', '.join(map(name_of, laws)) or 'thresholds'} against bias codes"
    return _capital(said)


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _equation(quantity: str, law: Result) -> str:
    """A law with names in place of its parameters' keys, and the codes that it is of; empty without one."""
    if "equation" not in law:
        return ""
    said = re.sub(r"\bq\b", name_of(quantity), law["equation"])
    for key in sorted(law["parameters"], key=len, reverse=True):
        said = said.replace(key, f"({name_of(key)})")
    codes = (f"{code}, reference {of['reference']:g}" for code, of in law["codes"].items())
    return f"{said}, with {' and '.join(f'{letter}: {code}' for letter, code in zip('xd', codes, strict=False))}"


def _prediction(one: Result) -> list[str]:
    """A predicted setting as a row of the page."""
    shown = in_its_unit(one)
    codes = ", ".join(f"{code} {value:g}" for code, value in one["codes"].items())
    return [_capital(name_of(one["quantity"])), codes, shown.value, shown.interval, shown.unit, one["note"]]


def prepare_biases(result: Result, folder: Path) -> dict[str, Any]:
    from pixelid.outputs import file_name
    from pixelid.tables.biases.result import PREDICTION_HEADINGS

    def left_out(one: Result) -> list[str]:
        errors = (one["heldout_median"], one["heldout_rms"])
        return ["–" if error is None else percent(error) for error in errors]

    def rivals(law: Result) -> list[list[str]]:
        return [
            [one["law"], str(one["coordinates"]), f"{one['bic']:.1f}", percent(one["weight"]),
             percent(one["relative_scatter"]), *left_out(one)]
            for one in law.get("rivals", ())
        ]  # fmt: skip

    return {
        "laws": [
            (_capital(name_of(name)), file_name(name), law, _equation(name, law), rivals(law))
            for name, law in result["quantities"].items()
        ],
        "rival_headings": ("law", "parameters", "ΔBIC", "weight", "scatter", "settings left out, median", "rms"),
        "prediction_headings": PREDICTION_HEADINGS,
        "predictions": [_prediction(one) for one in result["predictions"]],
    }


def summarise_flicker(result: Result, folder: Path) -> Summary:
    frequency, groups = result["frequency_hz"], result["groups"]
    locked = sum(g["amplitude_over_on_threshold"]["identified"] and g["phase_cycles"]["identified"] for g in groups)
    return Summary(
        "flicker",
        f"Flicker at {frequency['value']:.2f} Hz: {locked} of {counted(len(groups), 'group')} locked",
        result["status"],
        result.get("advice", ""),
        (
            Number("frequency", f"{frequency['value']:.3f}", f"± {number(frequency['std'], 2)} Hz"),
            Number("shape of the light", result["shape"]),
            Number("groups locked", f"{locked} of {len(groups)}", f"{result['groups_left_out']} left out"),
            Number("directions fixed", str(result["fixed_directions"]), f"{result['blind_directions']} blind"),
            Number("time taken", seconds(result["seconds"])),
        ),
        command_line("flicker", result, "--frequency", f"{frequency['value']:.4g}", out=folder),
        next=REST,
    )


def prepare_flicker(result: Result, folder: Path) -> dict[str, Any]:
    def cell(entry: dict) -> str:
        return f"{entry['value']:.3g}" + (f" ± {entry['std']:.2g}" if entry["std"] is not None else " (open)")

    names = ("amplitude_over_on_threshold", "off_over_on_threshold", "phase_cycles", "noise_over_on_threshold")
    amplitudes = {f"group {g['column']}, {g['row']}": g["amplitude_over_on_threshold"] for g in result["groups"]}
    entries = {name: _with_interval(entry) for name, entry in amplitudes.items()} if len(amplitudes) > 1 else {}
    middle = statistics.median(entry["value"] for entry in amplitudes.values()) if amplitudes else 1.0
    return interval_parts(entries, dict.fromkeys(entries, middle), "the median of the groups") | {
        "groups": [
            [f"{g['column']}, {g['row']}", str(g["events"]), *(cell(g[n]) for n in names), f"{g['dispersion']:.2f}"]
            for g in sorted(result["groups"], key=lambda g: -g["events"])
        ]
    }


def _with_interval(entry: Result) -> Result:
    """A group's amplitude over the ON threshold as the parameter of a forest: its 95 % interval from its error."""
    ends = None
    if entry["std"] is not None:
        width = math.exp(Z95 * entry["std"] / entry["value"])
        ends = [entry["value"] / width, entry["value"] * width]
    return {**entry, "unit": "1", "interval_95": ends, "fixed": False}


def prepare_parameters(result: Result, folder: Path) -> dict[str, Any]:
    """The forest of a table's parameters."""
    return interval_parts(result["parameters"])
