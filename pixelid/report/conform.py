"""The page of a conformance table."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pixelid.conform.row import strengths_in_words
from pixelid.report.format import counted, number, seconds
from pixelid.report.page import Number, Result, Summary, command_line


def summarise(result: Result, folder: Path) -> Summary:
    """How many effects of the signal path are there, are missing, cannot be decided."""
    counts = result["counts"]
    return Summary(
        "conform",
        f"The signal path of {result['sensor'] or 'these recordings'}",
        result["verdict"],
        result["sentence"],
        (
            Number("has", counted(counts["present"], "effect")),
            Number("lacks", counted(counts["absent"], "effect")),
            Number("not decidable", counted(counts["not_decidable"], "effect")),
            Number("not tested", counted(counts["not_tested"], "effect")),
            Number("time taken", seconds(result.get("seconds"))),
        ),
        command_line("conform", result, "--model", str(result["base"]), out=folder),
    )


def prepare(result: Result, folder: Path) -> dict[str, Any]:
    """The table, and the cells of the maps before and after."""
    rows = [
        [
            row["stage"].replace("_", " "),
            row["effect"],
            row["verdict"].replace("_", " "),
            strengths_in_words(row),
            number(row["evidence"]["p_value"], 2),
            number(row["evidence"]["heldout_gain_nats"], 3),
            row["evidence"]["why"],
        ]
        for row in result["rows"]
    ]
    cells = [[c["response"], c["where"], number(c["score"], 3), str(c["events"])] for c in result["departs"]]
    left = [[c["response"], c["where"], number(c["score"], 3), str(c["events"])] for c in result["left"]]
    return {"rows": rows, "departs": cells, "left": left}
