"""The pages of recordings looked at alone: their health, and the noise of still scenes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pixelid.report.format import count, interval, number, percent, seconds
from pixelid.report.page import Number, Result, Summary, command_line


def summarise_inspect(result: Result, folder: Path) -> Summary:
    dead, rate, lines = result["dead_time_s"], result["rate_hz"], result["lines"]
    if dead.get("kind") == "upper_bound":
        dead_time = Number("dead time", f"≤ {seconds(dead['interval_95'][1])}", "shortest interval")
    elif dead["value"] is not None:
        dead_time = Number("dead time", seconds(dead["value"]))
    else:
        dead_time = Number("dead time", "not visible")
    return Summary(
        "inspect",
        result["name"] or "Recording",
        "",
        "What the events of the recording show by themselves, without knowing the light.",
        (
            Number("events", count(result["events"]), f"in {seconds(result['duration_s'])}"),
            Number("mean rate", number(rate["mean"], 3), "Hz"),
            dead_time,
            Number("strongest line", number(lines[0]["frequency_hz"]) if lines else "none", "Hz" if lines else ""),
            Number("hot pixels", str(result["hot_pixel_count"])),
        ),
        command_line("inspect", result, out=folder, seed=False),
        "Health of the recording",
    )


def prepare_inspect(result: Result, folder: Path) -> dict[str, Any]:
    from pixelid.inspection.table import rows_of_result

    return {
        "findings": [list(row) for row in rows_of_result(result)],
        "hot": [[f"{p['x']}, {p['y']}", number(p["rate_hz"], 3), str(p["events"])] for p in result["hot_pixels"]],
        "lines": [
            [f"{x['frequency_hz']:.3f}", number(x["uncertainty_hz"], 2), number(x["modulation"], 2),
             str(len(x["harmonics_hz"])), number(x["p_value"], 2)]
            for x in result["lines"]
        ],
    }  # fmt: skip


def summarise_static_noise(result: Result, folder: Path) -> Summary:
    conditions, leak = result["conditions"], result["by_light"]
    return Summary(
        "inspect",
        "Noise of a still scene",
        "",
        result["findings"][0] if result["findings"] else "",
        (
            Number("conditions", str(len(conditions))),
            Number("pixels", str(conditions[0]["pixels"])),
            Number("intervals", count(sum(c["intervals"] for c in conditions))),
            Number("leak, median pixel", number(leak["leak_hz"], 2) if leak else "–", "Hz" if leak else ""),
            Number("by light", number(leak["parasitic_hz_per_lux"], 2) if leak else "–", "Hz/lux" if leak else ""),
        ),
        command_line("inspect", result, out=folder),
        "What the intervals show",
    )


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
