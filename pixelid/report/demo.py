"""The page of the demo: that of a calibration, with what was hidden on top."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from pixelid.documents import read_json
from pixelid.report import bench
from pixelid.report.page import Result, Summary, command_line
from pixelid.report.quantities import quantity

CALIBRATION = "calibration.json"  # lies in the same folder


def summarise(result: Result, folder: Path) -> Summary:
    """The calibration's card under the answer: how much of what was hidden was found."""
    calibration = read_json(folder / CALIBRATION)
    own = bench.summarise(calibration, folder)
    sentence = f"{own.title} {own.sentence}".strip()
    command = command_line("demo", calibration, out=folder, inputs=False)
    return replace(own, kind="demo", title=result["sentence"], sentence=sentence, command=command)


def prepare(result: Result, folder: Path) -> dict[str, Any]:
    """The calibration as the page shows it, and the hidden values as rows."""
    calibration = read_json(folder / CALIBRATION)
    return {"result": calibration, "hidden": [_row(v) for v in result["hidden_and_found"]]} | bench.prepare(
        calibration, folder
    )


def _row(entry: dict[str, Any]) -> list[Any]:
    """Parameter, truth, estimate, interval, unit, and whether the interval holds the truth."""
    q = quantity(entry["name"], entry | {"value": entry["found"]})
    truth = quantity(entry["name"], entry | {"value": entry["hidden"]})
    inside = "not estimated" if entry["inside"] is None else entry["inside"]
    return [q.markup, truth.value, q.value, q.interval, q.unit, inside]
