"""The page of a gap search."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from pixelid.errors import InputError
from pixelid.model.files import load_model
from pixelid.report.fits import levels_of
from pixelid.report.format import chance, interval, number, percent, seconds, value
from pixelid.report.page import Number, Result, Summary, command_line
from pixelid.stages import effect
from pixelid.stages.described_words import words_of_entry


def summarise(result: Result, folder: Path) -> Summary:
    """The verdict, how sure it is, and how much of the gap is closed."""
    details = result.get("details", {})
    tried = _names_tried(result)
    return Summary(
        "gap",
        f"What {_base_name(folder)} lacks",
        result["verdict"],
        result["sentence"],
        (
            Number("effects named", str(len(result["effects"])), f"of {len(tried)} tried" if tried else ""),
            Number("chance of this if the model were right", chance(result["global_p"]), f"limit {result['alpha']:g}"),
            _strongest(result, details),
            _closed(result, details),
            Number("time taken", seconds(result.get("seconds"))),
        ),
        command_line("gap", result, "--model", _base_name(folder), out=folder),
    )


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
                [str(entry["round"]), name, _what_it_does(name), number(looked.get(name), 3),
                 number(c.get("gain_nats"), 3), number(c.get("heldout_gain_nats"), 3),
                 chance(c["p_value"]) if c else "–", said]
            )  # fmt: skip
    return rows


def _departure(row: Result) -> float:
    """How far a count is from what the base model expects, in units of chance."""
    return abs(row["measured"] - row["base"]) / math.sqrt(max(row["base"], 1.0))


def _strengths(entry: dict[str, Any]) -> str:
    """The parameters of an effect, with intervals where they are known."""
    return "; ".join(
        f"{name} = {value(v['value'], v.get('interval_95'))}"
        + (f" ({interval(v['interval_95'])})" if v.get("interval_95") else "")
        for name, v in entry["parameters"].items()
    )


def prepare(result: Result, folder: Path) -> dict[str, Any]:
    """The tables of the page, and which of its figures show counts."""
    details = result.get("details", {})
    effects = [
        [
            e["name"],
            _strengths(e),
            chance(e["p_value"]),
            number(e["heldout_gain_nats"], 3),
            f"{e['runner_up']}, {number(e['runner_up_gain_nats'], 3)}" if e.get("runner_up") else "–",
            f"{e['max_cosine_with']} ({e['max_cosine']:.2f})" if e.get("max_cosine_with") else "–",
        ]
        for e in result["effects"]
    ]
    shows = details.get("shows_at_typical_strength_nats", {})
    confusion = [
        [
            name,
            number(shows.get(name), 3),
            f"{v['most_alike']} ({v['cosines'][v['most_alike']]:.2f})" if v["most_alike"] else "–",
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
            _strengths(e),
            number(e["heldout_gain_nats"], 3),
        ]
        for e in result.get("described", ())
    ]
    return {
        "described": described, "levels": levels_of(result),
        "base": _base_name(folder), "effects": effects, "tried": _tried(result), "names_tried": _names_tried(result),
        "confusion": confusion, "after_jumps": jumps, "grown": grown, "pooled": "after_jumps" in details,
        "named": [(e["name"], _what_it_does(e["name"]), e["where"]) for e in result["effects"]],
    }  # fmt: skip
