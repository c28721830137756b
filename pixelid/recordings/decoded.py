"""Camera makers' files (AEDAT4, Prophesee RAW and DAT, ES), decoded by the library faery."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from pixelid.errors import InputError
from pixelid.recordings.columns import to_nanoseconds
from pixelid.recordings.events import Events
from pixelid.recordings.recording import Recording

TYPES: dict = {".aedat4": "aedat", ".raw": "evt", ".dat": "dat", ".es": "es"}
VERSIONS: dict = {"2.0": "evt2", "2.1": "evt2.1", "3.0": "evt3", "2": "evt2", "3": "evt3"}


def read(path: Path) -> Recording:
    """The first event stream of a camera maker's file; frames, IMU samples and triggers are left out.

    Raises InputError when the file cannot be decoded.
    """
    from faery.file_decoder import Decoder

    header = _header(path)
    version = VERSIONS.get(header.get("evt", ""))
    try:
        decoder = Decoder(
            path,
            dimensions_fallback=_size(header),
            version_fallback=version if path.suffix.lower() == ".raw" else None,
            file_type=TYPES.get(path.suffix.lower()),
            time_range_cache=None,
        )
        width, height = decoder.dimensions()
        packets = [
            (packet["t"].copy(), packet["x"].copy(), packet["y"].copy(), packet["on"].astype(np.uint8))
            for packet in decoder
        ]
    except (Exception, SystemError) as error:
        reason = str(error).splitlines()[0][:120] if str(error) else type(error).__name__
        raise InputError(
            f"{path}: cannot be decoded; truncated, or not the format of its extension ({reason})"
        ) from None
    if packets:
        t, x, y, p = (np.concatenate(columns) for columns in zip(*packets, strict=True))
    else:
        t, x, y, p = np.empty(0, np.int64), np.empty(0, np.uint16), np.empty(0, np.uint16), np.empty(0, np.uint8)
    del packets
    where = f"{path}: events"
    nanoseconds = to_nanoseconds(t, "us", where)
    events = Events.from_columns(nanoseconds, x, y, p, width, height, tick_ns=1000, where=where)
    sensor = header.get("plugin_name", "") or header.get("source", "")
    return Recording(events, sensor=sensor, source=path, attributes={"header": header} if header else {})


def _header(path: Path) -> dict[str, str]:
    """The `% name value` lines of a Prophesee file, or the camera's name in an AEDAT4 file."""
    with path.open("rb") as file:
        head = file.read(1 << 16)
    if head.startswith(b"#!AER-DAT4"):
        found = re.search(rb'key="source"[^>]*>([^<]+)<', head)
        return {"source": found.group(1).decode("latin1")} if found else {}
    header = {}
    for line in head.split(b"\n"):
        if not line.startswith(b"% "):
            break
        name, _, value = line[2:].decode("latin1").strip().partition(" ")
        header[name] = value
    return header


def _size(header: dict[str, str]) -> tuple[int, int]:
    """Sensor size: from the header where it says, else by the generation of the sensor."""
    text = " ".join(f"{name} {value}" for name, value in header.items())
    if found := re.search(r"geometry (\d+)x(\d+)", text):
        return int(found.group(1)), int(found.group(2))
    width, height = re.search(r"width[= ](\d+)", text, re.I), re.search(r"height[= ](\d+)", text, re.I)
    if width and height:
        return int(width.group(1)), int(height.group(1))
    return (640, 480) if re.search(r"gen3", text, re.I) else (1280, 720)
