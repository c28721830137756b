"""Everything of a recording but its columns, as JSON: what npz and text files carry beside the events."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from pixelid.errors import InputError
from pixelid.outputs import plain
from pixelid.recordings.events import Events
from pixelid.recordings.recording import Recording
from pixelid.stimuli.pixel_lights import light_from_arrays

FORMAT = "pixelid-recording"
VERSION = 1


def to_json(recording: Recording) -> str:
    """One line of JSON: sensor size, unit of time, labels, attributes, and how the stimulus is to be read."""
    events, stimulus = recording.events, recording.stimulus
    value = {
        "format": FORMAT,
        "version": VERSION,
        "unit": "ns",
        "tick_ns": events.tick_ns,
        "width": events.width,
        "height": events.height,
        "condition": recording.condition,
        "sensor": recording.sensor,
        "pooled": recording.pooled,
        "attributes": recording.attributes,
    }
    if stimulus is not None:
        value["stimulus"] = {"unit": stimulus.unit, "interpolation": stimulus.interpolation}
    return json.dumps(plain(value))


def from_json(line: str, where: str) -> dict:
    """The dictionary `to_json` wrote; raises InputError naming `where` when it is something else."""
    try:
        value = json.loads(line)
    except json.JSONDecodeError as error:
        raise InputError(f"{where}: expected JSON, found {line[:40]!r}") from error
    if not isinstance(value, dict) or value.get("format") != FORMAT:
        raise InputError(f"{where}: expected format {FORMAT!r}, found {line[:40]!r}")
    if value.get("version") != VERSION:
        raise InputError(f"{where}: expected version {VERSION}, found {value.get('version')!r}")
    missing = [key for key in ("unit", "width", "height") if key not in value]
    if missing:
        raise InputError(f"{where}: missing {', '.join(missing)}")
    return value


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
