"""The pages of analyses that a model alone decides: low light, and what to record next."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

from pixelid.figures import words
from pixelid.report.circuit import uses_of
from pixelid.report.format import interval, number, seconds, sentence
from pixelid.report.page import Number, Result, Summary, command_line, folder_name, inputs_of
from pixelid.report.quantities import quantity


def summarise_lowlight(result: Result, folder: Path) -> Summary:
    regimes = result["regimes"]
    critical = regimes["critical"]
    unit = result["radiance_unit"]
    return Summary(
        "lowlight",
        _answer_lowlight(result),
        result["status"],
        result.get("advice", ""),
        (
            Number("radiance where αL = β²", number(regimes["epsilon_one"], 3), unit),
            Number("radiance where γL = β", number(regimes["gamma_one"], 3), unit),
            Number("poles are complex", interval(critical) if critical else "nowhere", unit if critical else ""),
            Number("lowest damping", number(regimes["lowest_damping"], 2)),
            Number("recordings compared", str(len(result["measured"]))),
        ),
        command_line("lowlight", result, str(result["model"]), out=folder, inputs=False),
        f"{result['model']} in low light",
        next=uses_of(shlex.quote(folder_name(folder)))[:2],
    )


def _answer_lowlight(result: Result) -> str:
    """Below which light one pole is right within 10 %, in everything that it is compared in."""
    scopes = [entry for by_scope in result["errors"]["one_pole"].values() for entry in by_scope.values()]
    firsts = [first for entry in scopes if (first := entry["levels"]["10%"]["first"]) is not None]
    if not firsts:
        return "One pole is accurate to 10 % at every level of light"
    if not min(firsts):
        return "One pole is off by 10 % even in the dark"
    return f"One pole is accurate to 10 % below {number(min(firsts), 3)} {result['radiance_unit']}"


def prepare_lowlight(result: Result, folder: Path) -> dict[str, Any]:
    from pixelid.lowlight.table import (
        LATENCY_HEADINGS,
        MEASURED_HEADINGS,
        RADII_HEADINGS,
        latency_rows,
        measured_rows,
        not_measurable,
        radii_rows,
    )
    from pixelid.tables.noise.model import FA_PER_LUX

    levels = [
        [number(x["radiance"], 3)]
        + (
            [number(x["epsilon"], 3), number(x["gamma_ratio"], 3), number(x["damping"], 3),
             "complex" if x["complex"] else "real"]
            if "damping" in x else ["–"] * 4
        )
        for x in result["regimes"]["levels"]
    ]  # fmt: skip
    drawn = [
        "Exact and approximate poles, −3 dB frequency and step time over radiance.",
        "Grey: 95 % band of the fit." if result.get("bands") else "",
        "Green: measured, with 95 % bars; ×: the model's own events under the same light."
        if result["measured"]
        else "",
        "Shaded: the pair of poles is complex." if result["regimes"]["critical"] else "",
    ]
    return {
        "fa_per_lux": FA_PER_LUX if result["radiance_unit"] == "fA" else None,
        "poles_caption": " ".join(filter(None, drawn)),
        "radii_headings": RADII_HEADINGS,
        "radii": radii_rows(result),
        "measured_headings": MEASURED_HEADINGS,
        "measured": measured_rows(result),
        "not_measurable": not_measurable(result),
        "levels": levels,
        "latency_headings": LATENCY_HEADINGS,
        "latency": latency_rows(result["latency"]) if result.get("latency") else [],
    }


def summarise_design(result: Result, folder: Path) -> Summary:
    if "wishes" in result:
        return _summarise_biases(result, folder)
    best, light = result["recommended"], words.light_unit(result["widths_before"])
    return Summary(
        "design",
        f"Record next: {words.stimulus(best['name'], best['parameters'], light)}, {seconds(best['duration_s'])}",
        result["status"],
        " ".join(sentence(x) for x in (result["why"], result.get("advice", "")) if x),
        (
            Number("stimulus", best["kind"]),
            Number("light", seconds(best["duration_s"])),
            Number(f"expected information ({result['criterion']})", number(best["score"], 3), "nats"),
            Number("events expected", number(best["events"], 2)),
            Number("stimuli compared", str(len(result["ranking"]))),
        ),
        command_line("design", result, str(result["model"]), "--criterion", result["criterion"], out=folder,
                     inputs=False),
        f"For {result['model']}",
        next=_play(result, folder),
    )  # fmt: skip


def _play(result: Result, folder: Path) -> tuple[tuple[str, str], ...]:
    """Commands that write and try the recommended light."""
    own, model = shlex.quote(folder_name(folder)), inputs_of(result, folder) or shlex.quote(str(result["model"]))
    return (
        ("Its waveform, for a generator or a sound card", f"pixelid stimulus {own} --out {own}.wav"),
        ("What the model does with it", f"pixelid simulate {model} --stimulus {own}/next.toml --out {own}.h5"),
    )


def _summarise_biases(result: Result, folder: Path) -> Summary:
    best, numbers = result["recommended"], []
    for name, said in best["predicted"].items():
        numbers.append(Number(f"{name}, 95 % {interval(said['interval_95'])}", number(said["value"], 3)))
    wanted = [f"--{name} {one['wanted']:g}" for name, one in result["wishes"].items()]
    low, high = result["fitted_range_mv"]
    return Summary(
        "design",
        f"Set {result['bias'] or 'the bias'} to {best['bias_mv']:.0f} mV",
        result["status"],
        " ".join(sentence(x) for x in (result["why"], result.get("advice", "")) if x),
        (
            Number("recommended", f"{best['bias_mv']:.0f}", "mV"),
            Number("fitted settings", f"{low:g} to {high:g}", "mV"),
            Number("the wish that binds", result["binding"]),
            *numbers,
        ),
        command_line("design", result, str(result["model"]), "--biases", *" ".join(wanted).split(), out=folder,
                     inputs=False),
    )  # fmt: skip


def prepare_design(result: Result, folder: Path) -> dict[str, Any]:
    if "wishes" in result:
        from pixelid.design import bias_result

        return {
            "wish_headings": bias_result.WISH_HEADINGS,
            "wishes": bias_result.wish_rows(result),
            "measured_headings": bias_result.MEASURED_HEADINGS,
            "measured": bias_result.measured_rows(result),
        }
    from pixelid.design.table import RANKING_HEADINGS, WIDTHS_HEADINGS, ranking_rows

    light = words.light_unit(result["widths_before"])

    return {
        "ranking_headings": RANKING_HEADINGS,
        "ranking": [
            [words.stimulus(entry["name"], entry["parameters"], light), *row[1:]]
            for entry, row in zip(result["ranking"], ranking_rows(result), strict=True)
        ],
        "widths_headings": WIDTHS_HEADINGS,
        "widths": [_width(name, one, result["widths_after"][name]) for name, one in result["widths_before"].items()],
    }


def _width(name: str, before: dict[str, Any], after: dict[str, Any]) -> list[Any]:
    """A parameter, its value, its intervals before and after, how much narrower, and its unit."""
    first, last = quantity(name, before), quantity(name, {**after, "value": before["value"], "unit": before["unit"]})
    ratio = f"{before['std_coordinate'] / after['std_coordinate']:.3g} ×"
    return [first.markup, first.value, first.interval, last.interval, ratio, first.unit]
