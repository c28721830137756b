"""Recordings and arrays on a pipe: a header of JSON, then the raw columns that it describes, in its order.

Only numbers and JSON come back from a process that read a file, nothing that is executed.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import IO, Any

import numpy as np

from pixelid.errors import printable
from pixelid.outputs import plain
from pixelid.recordings.events import Events
from pixelid.recordings.recording import Recording
from pixelid.recordings.triggers import COLUMNS as EDGE_COLUMNS
from pixelid.recordings.triggers import Triggers
from pixelid.stimuli.pixel_lights import PixelLights
from pixelid.stimuli.stimulus import Stimulus


class Counted:
    """A pipe that counts what came through it."""

    def __init__(self, pipe: IO[bytes]) -> None:
        self._pipe, self.count = pipe, 0

    def read(self, count: int) -> bytes:
        data = self._pipe.read(count)
        self.count += len(data)
        return data

    def readinto(self, view: memoryview) -> int:
        count = self._pipe.readinto(view) or 0  # type: ignore[attr-defined]
        self.count += count
        return count


def taken_apart(recording: Recording, arrays: list[np.ndarray]) -> dict[str, Any]:
    """The recording as JSON, its columns appended to `arrays`."""

    def column(values: np.ndarray) -> dict:
        arrays.append(np.ascontiguousarray(values))
        return {"dtype": values.dtype.str, "shape": list(values.shape)}

    def events(some: Events | None) -> dict | None:
        if some is None:
            return None
        columns = {name: column(getattr(some, name)) for name in "txyp"}
        return {**columns, "width": some.width, "height": some.height, "tick_ns": some.tick_ns}

    light, edges = recording.stimulus, recording.triggers
    return {
        "events": events(recording.events),
        "exposures": events(recording.exposures),
        "stimulus": None
        if light is None
        else {
            **{name: column(array) for name, array in light.arrays.items()},
            "unit": light.unit,
            "interpolation": light.interpolation,
        },
        "triggers": None if edges is None else {name: column(getattr(edges, name)) for name in EDGE_COLUMNS},
        "condition": recording.condition,
        "sensor": recording.sensor,
        "pooled": recording.pooled,
        "attributes": plain(recording.attributes),
    }


def assembled(answer: dict[str, Any], path: Path) -> Recording:
    """The recording of an answer whose columns are arrays."""

    def events(some: dict | None) -> Events | None:
        return None if some is None else Events(**some)

    light, edges = answer["stimulus"], answer["triggers"]
    measured = events(answer["events"])
    assert measured is not None
    return Recording(
        events=measured,
        stimulus=None if light is None else (PixelLights.from_arrays if "of_pixel" in light else Stimulus)(**light),
        condition=printable(answer["condition"]),
        sensor=printable(answer["sensor"]),
        pooled=answer["pooled"],
        source=path,
        attributes=answer["attributes"],
        triggers=None if edges is None else Triggers(**edges),
        exposures=events(answer["exposures"]),
    )


def send(pipe: IO[bytes], header: dict, arrays: list[np.ndarray]) -> None:
    """Write a header and its columns."""
    text = json.dumps(header).encode()
    pipe.write(len(text).to_bytes(8, "little") + text)
    for array in arrays:
        pipe.write(array.reshape(-1).view(np.uint8).data)
    pipe.flush()


def receive(pipe: Counted) -> dict[str, Any]:
    """The header of an answer, each description of a column replaced by the column, in the order they were sent."""
    header = json.loads(_exactly(pipe, int.from_bytes(_exactly(pipe, 8), "little")))

    def filled(value: Any) -> Any:
        if isinstance(value, dict) and value.keys() == {"dtype", "shape"}:
            array = np.empty(value["shape"], np.dtype(value["dtype"]))
            _fill(pipe, array.reshape(-1).view(np.uint8))
            return array
        return {k: filled(v) for k, v in value.items()} if isinstance(value, dict) else value

    attributes = header.pop("attributes", {})
    return {**filled(header), "attributes": attributes}


def _exactly(pipe: Counted, count: int) -> bytes:
    data = pipe.read(count)
    if len(data) < count:
        raise EOFError
    return data


def _fill(pipe: Counted, array: np.ndarray) -> None:
    view, done = array.data, 0
    while done < len(view):
        count = pipe.readinto(view[done:])
        if not count:
            raise EOFError
        done += count
