"""Recordings and arrays on a pipe: a header of JSON, then the columns that it names, as NumPy stores them.

Only numbers and JSON come back from a process that read a file, nothing that is executed.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from types import SimpleNamespace
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


def taken_apart(recording: Recording) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """The recording as JSON, and its columns by name."""
    light, edges = recording.stimulus, recording.triggers
    header: dict[str, Any] = {name: getattr(recording, name) for name in ("condition", "sensor", "pooled")}
    header["attributes"] = plain(recording.attributes)
    columns = {}
    for name in ("events", "exposures"):
        some = getattr(recording, name)
        if some is not None:
            header[name] = {"width": some.width, "height": some.height, "tick_ns": some.tick_ns}
            columns |= {f"{name}/{letter}": getattr(some, letter) for letter in "txyp"}
    if light is not None:
        header["stimulus"] = {"unit": light.unit, "interpolation": light.interpolation}
        columns |= {f"stimulus/{name}": array for name, array in light.arrays.items()}
    if edges is not None:
        header["triggers"] = {}
        columns |= {f"triggers/{name}": getattr(edges, name) for name in EDGE_COLUMNS}
    return header, columns


def assembled(header: dict[str, Any], columns: dict[str, np.ndarray], path: Path) -> Recording:
    """The recording of an answer."""

    def made(name: str, kind: Callable[..., Any]) -> Any:
        mine = {key.partition("/")[2]: array for key, array in columns.items() if key.startswith(f"{name}/")}
        return kind(**mine, **header[name]) if name in header else None

    return Recording(
        events=made("events", Events),
        stimulus=made("stimulus", PixelLights.from_arrays if "stimulus/of_pixel" in columns else Stimulus),
        condition=printable(header["condition"]),
        sensor=printable(header["sensor"]),
        pooled=header["pooled"],
        source=path,
        attributes=header["attributes"],
        triggers=made("triggers", Triggers),
        exposures=made("exposures", Events),
    )


def send(pipe: IO[bytes], header: dict[str, Any], columns: Mapping[str, np.ndarray]) -> None:
    """Write a header and its columns."""
    text = json.dumps([header, list(columns)]).encode()
    pipe.write(len(text).to_bytes(8, "little") + text)
    for column in columns.values():
        array = np.ascontiguousarray(column)
        np.lib.format.write_array_header_2_0(pipe, np.lib.format.header_data_from_array_1_0(array))
        pipe.write(array.reshape(-1).view(np.uint8).data)
    pipe.flush()


def receive(pipe: IO[bytes]) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """The header of an answer and its columns.  Raises ValueError where it is cut."""
    header, names = json.loads(pipe.read(int.from_bytes(pipe.read(8), "little")))
    unnamed: Any = SimpleNamespace(read=pipe.read)  # of real files NumPy asks for their place, which a pipe has not
    return header, {name: np.lib.format.read_array(unnamed, allow_pickle=False) for name in names}
