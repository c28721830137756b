"""Everything of a recording but its columns, as JSON: what npz and text files carry in addition to the events."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from pixelid.documents import is_number
from pixelid.errors import InputError, shown
from pixelid.recordings.answers import taken_apart
from pixelid.recordings.events import Events
from pixelid.recordings.recording import Recording
from pixelid.stimuli.pixel_lights import light_from_arrays

FORMAT = "pixelid-recording"
VERSION = 1
MOST_TICK_NS = 1_000_000_000  # no camera's clock ticks slower than once a second
MOST_SIZE = 1 << 31  # of a stated side; what a sensor may have is the business of `Events.from_columns`


def to_json(recording: Recording) -> str:
    """One line of JSON: sensor size, unit of time, labels, attributes, and how the stimulus is to be read."""
    header, _ = taken_apart(recording)
    kept = {
        name: header[name] for name in ("condition", "sensor", "pooled", "attributes", "stimulus") if name in header
    }
    return json.dumps({"format": FORMAT, "version": VERSION, "unit": "ns", **header["events"], **kept})


def from_json(line: str, where: str) -> dict:
    """The dictionary `to_json` wrote; raises InputError naming `where` when it is something else."""
    try:
        value = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{where}: expected JSON, found {shown(line, 40)}") from error
    if not isinstance(value, dict) or value.get("format") != FORMAT:
        raise InputError(f"{where}: expected format {FORMAT!r}, found {shown(line, 40)}")
    if value.get("version") != VERSION:
        raise InputError(f"{where}: expected version {VERSION}, found {shown(value.get('version'))}")
    missing = [key for key in ("unit", "width", "height") if key not in value]
    if missing:
        raise InputError(f"{where}: missing {', '.join(missing)}")
    for key in ("width", "height"):
        value[key] = whole(value[key], f"{where}: {key}", MOST_SIZE)
    if "tick_ns" in value:
        value["tick_ns"] = whole(value["tick_ns"], f"{where}: tick_ns", MOST_TICK_NS)
    value["pooled"] = yes_or_no(value.get("pooled", False), f"{where}: pooled")
    light = value.get("stimulus", {})
    words = {"unit": value["unit"], "condition": value.get("condition", ""), "sensor": value.get("sensor", "")}
    for key, table in (("stimulus", light), ("attributes", value.get("attributes", {}))):
        if not isinstance(table, dict):
            raise InputError(f"{where}: {key}: expected a JSON object, found {shown(table)}")
    words |= {f"stimulus.{key}": light.get(key, "") for key in ("unit", "interpolation")}
    for key, word in words.items():
        if not isinstance(word, str):
            raise InputError(f"{where}: {key}: expected text, found {shown(word)}")
    return value


def whole(value: object, where: str, most: int) -> int:
    """A whole number from 1 to `most`, whatever type a file has it in; raises InputError naming `where`."""
    number = value.item() if isinstance(value, np.ndarray | np.generic) and value.size == 1 else value
    if is_number(number) and 1 <= number <= most and number % 1 == 0:
        return int(number)
    limit = f" of at most {most}" if isinstance(number, int | float) and number > most else ""
    raise InputError(f"{where}: expected a positive integer{limit}, found {shown(number)}")


def yes_or_no(value: object, where: str) -> bool:
    """True or false, also as 1 or 0; raises InputError naming `where`."""
    if isinstance(value, int | float) and value in (0, 1):
        return bool(value)
    raise InputError(f"{where}: expected true or false, found {shown(value)}")


def assemble(
    meta: dict, events: Events, stimulus: Mapping[str, np.ndarray] | None, source: Path, where: str
) -> Recording:
    """The recording that `meta` describes, from its events and the arrays of its stimulus by name."""
    told = meta.get("stimulus", {})
    return Recording(
        events=events,
        stimulus=None
        if stimulus is None
        else light_from_arrays(
            stimulus, told.get("unit", "relative"), told.get("interpolation", "linear"), f"{where}: stimulus"
        ),
        condition=meta.get("condition", ""),
        sensor=meta.get("sensor", ""),
        pooled=bool(meta.get("pooled", False)),
        source=source,
        attributes=meta.get("attributes", {}),
    )
