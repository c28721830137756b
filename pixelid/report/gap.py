"""The page of a gap search."""

from __future__ import annotations

import math
import shlex
from pathlib import Path
from typing import Any

from pixelid.errors import InputError
from pixelid.figures import words
from pixelid.model.files import load_model
from pixelid.report.circuit import circuit_parts, next_recording, shipped_values, uses_of
from pixelid.report.fits import levels_of
from pixelid.report.format import chance, number, percent, seconds
from pixelid.report.methods import methods_of_search
from pixelid.report.page import VERDICTS, Number, Result, Summary, command_line, folder_name, inputs_of
from pixelid.report.quantities import quantity
from pixelid.stages import effect
from pixelid.stages.described_words import words_of_entry

HEADLINES = {
    "named": "With it, {} describes pixels that no fit has seen better",
    "none": "What {} leaves looks like noise",
    "ambiguous": "These recordings cannot separate what {} may lack",
    "unknown": "No effect of the library explains what {} leaves",
}


def summarise(result: Result, folder: Path) -> Summary:
    """The verdict, how sure it is, and how much of the gap is closed."""
    details, base, own = result.get("details", {}), _base_name(folder), shlex.quote(folder_name(folder))
    tried = _names_tried(result)
    refit = f"pixelid fit {inputs_of(result, folder)} --model {own} --out {own}_fit"
    found = bool(result["effects"] or result.get("described"))
    return Summary(
        "gap",
        _answer(result, folder),
        result["verdict"],
        result["sentence"],
        (
            Number("effects named", str(len(result["effects"])), f"of {len(tried)} tried" if tried else ""),
            Number("p-value (nothing missing)", chance(result["global_p"]), f"limit {result['alpha']:g}"),
            _strongest(result, details),
            _closed(result, details),
            Number("time taken", seconds(result.get("seconds"))),
        ),
        command_line("gap", result, "--model", base, out=folder),
        HEADLINES.get(result["verdict"], "").format(base),
        next=(*([("Estimate circuit and effect together, with intervals", refit)] if found else []), *uses_of(own)),
    )


def _answer(result: Result, folder: Path) -> str:
    """What is missing, in one line."""
    strengths = _strengths_named(result, grown_parameters(result, folder))
    if strengths:
        return f"Missing effect{'s' if len(result['effects']) > 1 else ''}: {'; '.join(strengths)}"
    if result.get("described"):
        return f"Missing, described by an equation: {'; '.join(words_of_entry(e) for e in result['described'])}"
    return VERDICTS.get(str(result["verdict"]), str(result["sentence"]))


def _strengths_named(result: Result, parameters: dict[str, Any]) -> list[str]:
    """Every effect named, with its first parameter and interval."""
    texts = []
    for e in result["effects"]:
        name, entry = next(iter(e["parameters"].items()), ("", None))
        q = quantity(name, {"unit": parameters.get(name, {}).get("unit", ""), **entry}) if entry else None
        known = f" ({q.interval.replace(' … ', ' to ')})" if q and q.interval != "–" else ""
        texts.append(e["name"].replace("_", " ") + (f", {q.value} {q.unit}".rstrip() + known if q else ""))
    return texts


def grown_parameters(result: Result, folder: Path) -> dict[str, Any]:
    """The grown model's parameters as fits have them, with the intervals of what was added; empty without a model."""
    try:
        model = load_model(folder / "model.toml")
    except InputError:
        return {}
    ends = {name: v.get("interval_95") for e in result.get("effects", ()) for name, v in e["parameters"].items()}
    return {
        name: {
            "value": model.values[name], "unit": p.unit, "interval_95": ends.get(name), "identified": True,
            "fixed": not p.free,
        }
        for name, p in model.parameters.items()
    }  # fmt: skip


def _strongest(result: Result, details: dict[str, Any]) -> Number:
    gains = [e["heldout_gain_nats"] for e in result["effects"] if e["heldout_gain_nats"] is not None]
    if gains:
        return Number("largest gain on data held out", number(max(gains), 3), "nats")
    scores = [abs(cell["score"]) for cell in details.get("seen_before", ())]
    return Number("largest disagreement", number(max(scores), 2) if scores else "–", "standard deviations")


def _closed(result: Result, details: dict[str, Any]) -> Number:
    gap = result.get("gap") or {}
    closed = gap.get("closed_fraction")
    if closed is not None:
        ends = gap.get("closed_fraction_interval")
        return Number("gap closed", percent(closed, 3), f"{percent(ends[0])} … {percent(ends[1])}" if ends else "")
    if "dispersion" in details:
        return Number("counts scatter about the model", number(details["dispersion"], 3), "times Poisson's")
    return Number("pixels", str(sum(details.get("pixels", {}).values())))


def _base_name(folder: Path) -> str:
    """The name of the model that was grown; the grown one carries it with a suffix."""
    try:
        return load_model(folder / "model.toml").name.removesuffix("_grown")
    except InputError:
        return "the model"


def _names_tried(result: Result) -> list[str]:
    found = [name for entry in result["rounds"] for name in entry.get("screened_nats", {})]
    found += [c["name"] for entry in result["rounds"] for c in entry["candidates"]]
    return list(dict.fromkeys(found))


def _what_it_does(name: str) -> str:
    """An effect's sentence; empty for what the library does not hold."""
    try:
        return effect(name).sentence
    except InputError:
        return ""


def _tried(result: Result) -> list[list[str]]:
    """Round by round, every effect tried, the most promising first: quick look, fit, held-out data, what was stated."""
    rows = []
    for entry in result["rounds"]:
        fitted = {c["name"]: c for c in entry["candidates"]}
        looked = {name: gain for name, gain in entry.get("screened_nats", {}).items() if gain is not None}
        best_first = {**fitted, **dict(sorted(looked.items(), key=lambda item: -item[1]))}
        for name in best_first:
            c = fitted.get(name, {})
            said = "named" if name == entry["named"] else "fitted" if c else "not\u00a0fitted"
            rows.append(
                [str(entry["round"]), name.replace("_", " "), _what_it_does(name), number(looked.get(name), 3),
                 number(c.get("gain_nats"), 3), number(c.get("heldout_gain_nats"), 3),
                 chance(c["p_value"]) if c else "–", said]
            )  # fmt: skip
    return rows


def _departure(row: Result) -> float:
    """How far a count is from what the base model expects, in units of chance."""
    return abs(row["measured"] - row["base"]) / math.sqrt(max(row["base"], 1.0))


def strengths(entry: dict[str, Any], parameters: dict[str, Any]) -> str:
    """The parameters of an effect, with intervals where they are known."""
    shown = [quantity(name, {"unit": "", **parameters.get(name, {}), **v}) for name, v in entry["parameters"].items()]
    return "; ".join(
        f"{q.name} {q.value} {q.unit}".rstrip() + (f" ({q.interval})" if q.interval != "–" else "") for q in shown
    )


def prepare(result: Result, folder: Path) -> dict[str, Any]:
    """The tables of the page, and which of its figures show counts."""
    details, base, parameters = result.get("details", {}), _base_name(folder), grown_parameters(result, folder)
    effects = [
        [
            e["name"].replace("_", " "),
            strengths(e, parameters),
            chance(e["p_value"]),
            number(e["heldout_gain_nats"], 3),
            f"{e['runner_up'].replace('_', ' ')}, {number(e['runner_up_gain_nats'], 3)}" if e.get("runner_up") else "–",
            f"{e['max_cosine_with'].replace('_', ' ')} ({e['max_cosine']:.2f})" if e.get("max_cosine_with") else "–",
        ]
        for e in result["effects"]
    ]
    shows = details.get("shows_at_typical_strength_nats", {})
    confusion = [
        [
            name.replace("_", " "),
            number(shows.get(name), 3),
            f"{v['most_alike'].replace('_', ' ')} ({v['cosines'][v['most_alike']]:.2f})" if v["most_alike"] else "–",
            number(v["told_apart_nats"], 3),
        ]
        for name, v in sorted(details.get("confusion", {}).items(), key=lambda item: shows.get(item[0]) or 0.0)
    ]
    grown = bool(result["effects"] or result.get("described"))
    columns = ("measured", "base", "grown") if grown else ("measured", "base")
    jumps = [
        [row["where"], *(number(row[key], 6) for key in columns)]
        for row in sorted(details.get("after_jumps", ()), key=_departure, reverse=True)
    ]
    described = [
        [
            words_of_entry(e),
            e["equation"],
            strengths(e, {}),
            number(e["heldout_gain_nats"], 3),
        ]
        for e in result.get("described", ())
    ]
    added = list(dict.fromkeys(e["name"] for e in result["effects"]))
    names = _strengths_named(result, parameters)
    circuit = circuit_parts(parameters, shipped_values(base, parameters), folder, base, added) if parameters else {}
    return {
        "drawings": (), "base": base, **circuit,
        "described": described, "levels": levels_of(result),
        "effects": effects, "tried": _tried(result), "names_tried": _names_tried(result),
        "confusion": confusion, "after_jumps": jumps, "grown": grown, "pooled": "after_jumps" in details,
        "named": [(e["name"].replace("_", " "), _what_it_does(e["name"]), e["where"]) for e in result["effects"]],
        "worse": [name for name, one in ((result.get("gap") or {}).get("per_recording") or {}).items()
                  if one["after"] > one["before"]],
        "next_sentence": next_recording(result["recommended_next"], words.light_unit(parameters)),
        "methods": methods_of_search(result, base, names),
    }  # fmt: skip
