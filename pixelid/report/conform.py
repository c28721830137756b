"""The page of a conformance table."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

from pixelid.figures.words import in_words
from pixelid.report.format import chance, counted, number, seconds
from pixelid.report.gap import grown_parameters, strengths
from pixelid.report.page import Number, Result, Summary, command_line, folder_name, inputs_of


def summarise(result: Result, folder: Path) -> Summary:
    """How many effects of the signal path are there, are missing, cannot be decided."""
    counts, own = result["counts"], shlex.quote(folder_name(folder))
    return Summary(
        "conform",
        f"{counts['present']} effects present, {counts['absent']} absent, {counts['not_decidable']} not decidable",
        result["verdict"],
        result["sentence"],
        (
            Number("present", counted(counts["present"], "effect")),
            Number("absent", counted(counts["absent"], "effect")),
            Number("not decidable", counted(counts["not_decidable"], "effect")),
            Number("not tested", counted(counts["not_tested"], "effect")),
            Number("time taken", seconds(result.get("seconds"))),
        ),
        command_line("conform", result, "--model", str(result["base"]), out=folder),
        f"The signal path of {result['sensor'] or 'these recordings'}",
        next=(
            (
                "Estimate everything found, with intervals",
                f"pixelid fit {inputs_of(result, folder)} --model {own} --out {own}_fit",
            ),
        ),
    )


def prepare(result: Result, folder: Path) -> dict[str, Any]:
    """The table, and the cells of the maps before and after."""
    parameters = grown_parameters(result, folder)
    rows = [
        [
            in_words(row["effect"]),
            row["verdict"].replace("_", " "),
            strengths(row, parameters) if row["verdict"] == "present" else row["evidence"]["why"],
            chance(row["evidence"]["p_value"]),
            number(row["evidence"]["heldout_gain_nats"], 3),
            row["stage"].replace("_", " "),
        ]
        for row in result["rows"]
    ]
    cells = [[c["response"], c["where"], number(c["score"], 3), str(c["events"])] for c in result["departs"]]
    left = [[c["response"], c["where"], number(c["score"], 3), str(c["events"])] for c in result["left"]]
    return {"rows": rows, "departs": cells, "left": left}
