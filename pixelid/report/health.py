"""The pages of recordings looked at alone: their health, and the noise of still scenes."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from pixelid.report.format import count, counted, interval, number, percent, seconds, sentence
from pixelid.report.page import Number, Result, Summary, command_line, inputs_of
from pixelid.report.scripts import script


def summarise_inspect(result: Result, folder: Path) -> Summary:
    from pixelid.inspection.table import in_events

    dead, rate, lines = result["dead_time_s"], result["rate_hz"], result["lines"]
    if dead.get("kind") == "upper_bound":
        dead_time = Number("dead time", f"≤ {seconds(dead['interval_95'][1])}", "shortest interval")
    elif dead["value"] is not None:
        dead_time = Number("dead time", seconds(dead["value"]))
    else:
        dead_time = Number("dead time", "not visible")
    worries = _worries(result)
    file = inputs_of(result, folder) or "RECORDING"
    stem = shlex.quote(Path(result["name"]).name or "recording")
    return Summary(
        "inspect",
        _answer(result["name"] or "Recording", worries),
        "",
        "What the events of the recording show by themselves, without knowing the light.",
        (
            Number("events", count(result["events"]), f"in {seconds(result['duration_s'])}"),
            Number("mean rate", *("–" if rate["mean"] is None else in_events(rate["mean"])).split()),
            dead_time,
            Number("strongest line", number(lines[0]["frequency_hz"]) if lines else "none", "Hz" if lines else ""),
            Number("hot pixels", str(result["hot_pixel_count"])),
        ),
        command_line("inspect", result, out=folder, seed=False),
        "Ready to be fitted" if not worries else "Look at this first",
        healthy=not worries,
        next=(
            (
                "Attach the light, found among the events",
                f"pixelid convert {file} {stem}_lit.h5 --stimulus light.csv --align auto",
            ),
            ("Then fit the circuit", f"pixelid fit {stem}_lit.h5 --model dvs128 --out fit"),
        ),
    )


def _answer(name: str, worries: list[str]) -> str:
    return f"No problems found in {name}" if not worries else f"{name}: {', '.join(worries)}"


def prepare_inspect(result: Result, folder: Path) -> dict[str, Any]:
    from pixelid.inspection.table import rows_of_result

    preview = _preview(result, folder)
    return {
        "preview": preview,
        "scripts": [script("page"), script("figures"), *([script("events")] if preview else [])],
        "findings": [list(row) for row in rows_of_result(result)],
        "hot": [[f"{p['x']}, {p['y']}", number(p["rate_hz"], 3), str(p["events"])] for p in result["hot_pixels"]],
        "lines": [
            [f"{x['frequency_hz']:.3f}", number(x["uncertainty_hz"], 2), number(x["modulation"], 2),
             str(len(x["harmonics_hz"])), number(x["p_value"], 2)]
            for x in result["lines"]
        ],
    }  # fmt: skip


def _preview(result: Result, folder: Path) -> dict[str, Any] | None:
    """What `templates/events.js` draws, times in thousandths of the span; None where no events are kept."""
    from pixelid.arrays import load_arrays
    from pixelid.inspection.figures import PREVIEW

    if not (folder / PREVIEW).is_file() or (folder / PREVIEW).is_symlink():
        return None
    kept = load_arrays(folder / PREVIEW)
    columns = {name: np.ravel(kept[name]).astype(np.int64) for name in "txyp"}
    n = min(len(column) for column in columns.values())
    if n < 2 or not (span_ns := int(columns["t"][n - 1])):
        return None
    columns["t"] = columns["t"] * 1000 // span_ns
    content = {name: column[:n].tolist() for name, column in columns.items()}
    content |= {"width": int(result["width"]), "height": int(result["height"]), "span": seconds(1e-9 * span_ns)}
    return {"count": n, "span": content["span"], "json": Markup(json.dumps(content).replace("<", "\\u003c"))}


def summarise_static_noise(result: Result, folder: Path) -> Summary:
    conditions, leak = result["conditions"], result["by_light"]
    return Summary(
        "inspect",
        _leak_or_noise(conditions),
        "",
        result["findings"][-1] if result["findings"] else "",
        (
            Number("conditions", str(len(conditions))),
            Number("pixels", str(conditions[0]["pixels"])),
            Number("intervals", count(sum(c["intervals"] for c in conditions))),
            Number("leak, median pixel", number(leak["leak_hz"], 2) if leak else "–", "Hz" if leak else ""),
            Number("by light", number(leak["parasitic_hz_per_lux"], 2) if leak else "–", "Hz/lux" if leak else ""),
        ),
        command_line("inspect", result, out=folder),
        "Noise of a still scene",
    )


def _leak_or_noise(conditions: list[Result]) -> str:
    """What kind of firing was seen, in one line."""
    lights = {
        kind: sorted({c["lux"] for c in conditions if c["kind"] == kind and c["rate_hz"]})
        for kind in ("regular", "irregular")
    }
    said = [
        f"{what} at {', '.join(f'{lux:g}' for lux in lights[kind])} lux"
        for kind, what in (("regular", "a leak"), ("irregular", "noise")) if lights[kind]
    ]  # fmt: skip
    return sentence(" and ".join(said)).rstrip(".") if said else "Too few events to separate leak from noise"


def _worries(result: Result) -> list[str]:
    """What in a recording would disturb a fit of it."""
    said = []
    if result["lines"]:
        said.append(f"the light or the readout repeats at {number(result['lines'][0]['frequency_hz'])} Hz")
    if result["hot_pixel_count"]:
        said.append(f"{counted(result['hot_pixel_count'], 'hot pixel')}")
    if (result["ceiling"] or {}).get("saturated"):
        said.append("the readout is saturated at times")
    if result["duplicates"]:
        said.append(f"{counted(result['duplicates'], 'event')} twice in the file")
    return said


def prepare_static_noise(result: Result, folder: Path) -> dict[str, Any]:
    def triple(v: list | None) -> str:
        return "–" if v is None else f"{number(v[0], 3)} ({interval(v[1:])})"

    return {
        "conditions": [
            [f"{c['lux']:g} lux, {c['polarity']}", str(c["intervals"]), percent(c["without_intervals"]),
             triple(c["rate_hz"]), triple(c["cv"]), c["kind"]]
            for c in result["conditions"]
        ]
    }  # fmt: skip
