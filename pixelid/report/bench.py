"""The page of a calibration."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pixelid.report.format import count, counted, seconds
from pixelid.report.page import Number, Result, Summary, command_line, identified


def summarise(result: Result, folder: Path) -> Summary:
    """The answer, and the five numbers that it rests on."""
    used = sum(bool(row["used"]) for row in result["recordings"])
    return Summary(
        "calibrate",
        result["sentence"],
        result["status"],
        result.get("advice", ""),
        (
            identified(result),
            Number("missing effects", counted(len(result["effects"]), "effect")),
            Number("statements contradicted", str(len(result["bench"]))),
            Number("events", count(result["events"]), f"of {result['pixels']} pixels in {counted(used, 'recording')}"),
            Number("time taken", seconds(result.get("seconds"))),
        ),
        command_line("calibrate", result, out=folder),
    )


def prepare(result: Result, folder: Path) -> dict[str, Any]:
    """The recordings and the statements as rows."""
    return {
        "recordings": [
            [r["name"], count(r["events"]), "yes" if r["used"] else "no", r["why"]] for r in result["recordings"]
        ],
        "statements": [s["sentence"] for s in result["bench"]],
    }
