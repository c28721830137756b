"""The page of a gap search."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pixelid.errors import InputError
from pixelid.model.files import load_model
from pixelid.report.format import interval, number, percent, seconds, value
from pixelid.report.page import Number, Result, Summary, command_line


def summarise(result: Result, folder: Path) -> Summary:
    gap = result.get("gap") or {}
    closed = gap.get("closed_fraction")
    best = max((e["heldout_gain_nats"] for e in result["effects"] if e["heldout_gain_nats"] is not None), default=None)
    return Summary(
        "gap",
        f"What {_base_name(folder)} lacks",
        result["verdict"],
        result["sentence"],
        (
            Number("effects named", str(len(result["effects"]))),
            Number("chance of the base model showing this", number(result["global_p"], 2)),
            Number("largest held-out gain", number(best, 3), "nats" if best is not None else ""),
            Number("gap closed", percent(closed, 3), interval(gap.get("closed_fraction_interval")) if closed else ""),
            Number("time taken", seconds(result.get("seconds"))),
        ),
        command_line("gap", result, "--model", _base_name(folder), out=folder),
    )


def _base_name(folder: Path) -> str:
    """The name of the model that was grown; the grown one carries it with a suffix."""
    try:
        return load_model(folder / "model.toml").name.removesuffix("_grown")
    except InputError:
        return "the model"


def prepare(result: Result, folder: Path) -> dict[str, Any]:
    details = result.get("details", {})
    effects = [
        [
            e["name"],
            "; ".join(
                f"{name} = {value(v['value'], v.get('interval_95'))}"
                + (f" ({interval(v['interval_95'])})" if v.get("interval_95") else "")
                for name, v in e["parameters"].items()
            ),
            number(e["p_value"], 2),
            number(e["heldout_gain_nats"]),
            f"{e['runner_up']}, {number(e['runner_up_gain_nats'])}" if e.get("runner_up") else "–",
            f"{e['max_cosine_with']} ({e['max_cosine']:.2f})" if e.get("max_cosine_with") else "–",
        ]
        for e in result["effects"]
    ]
    shows = details.get("shows_at_typical_strength_nats", {})
    confusion = [
        [
            name,
            number(shows.get(name)),
            f"{v['most_alike']} ({v['cosines'][v['most_alike']]:.2f})" if v["most_alike"] else "–",
            number(v["told_apart_nats"]),
        ]
        for name, v in details.get("confusion", {}).items()
    ]
    jumps = [
        [row["where"], number(row["measured"]), number(row["base"]), number(row["grown"])]
        for row in details.get("after_jumps", ())
    ]
    return {"effects": effects, "confusion": confusion, "after_jumps": jumps}
