"""AEDAT2 of DAVIS sensors: text header, then big-endian pairs of 32-bit address and 32-bit microseconds.

Address of a DAVIS (inivation.github.io/inivation-docs, "AEDAT 2.0"): bit 31 set for frame and IMU samples, bits
22–30 the row, bits 12–21 the column, bit 11 the polarity (1 ON), bit 10 an external input.  The header repeats
every bias of the chip, kept here in `attributes["biases"]`.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from pixelid.errors import InputError
from pixelid.recordings.columns import to_nanoseconds
from pixelid.recordings.events import Events
from pixelid.recordings.recording import Recording

SIZES = {"DAVIS240": (240, 180), "DAVIS346": (346, 260)}
ENTRY = re.compile(r'<entry key="([^"]+)" value="([^"]*)"')
BIAS = re.compile("Bias|IPot|ShiftedSource")


def read(path: Path) -> Recording:
    """The events of a DAVIS AEDAT2 file; frames and IMU samples are left out.

    Raises InputError for other chips and for a file that ends within an event.
    """
    lines, start = _header(path)
    chip = next((line.split("AEChip:")[1].strip().rsplit(".", 1)[-1] for line in lines if "AEChip:" in line), "")
    size = next((size for name, size in SIZES.items() if chip.upper().startswith(name)), None)
    if size is None:
        raise InputError(f"{path}: AEChip: expected one of {', '.join(SIZES)}, found {chip or 'nothing'}")
    length = path.stat().st_size - start
    if length % 8:
        raise InputError(f"{path}: expected 8 bytes per event after the header, found {length % 8} left over")
    words = np.memmap(path, ">u4", "r", start, (length // 8, 2)) if length else np.empty((0, 2), np.uint32)
    address = words[:, 0].astype(np.uint32)
    keep = (address >> 31 == 0) & (address >> 10 & 1 == 0)
    address, stamp = address[keep], words[keep, 1].astype(np.int64)
    wraps = np.cumsum(np.diff(stamp, prepend=stamp[:1]) < -(1 << 31))
    where = f"{path}: events"
    events = Events.from_columns(
        to_nanoseconds(stamp + (wraps << 32), "us", where),
        address >> 12 & 0x3FF,
        address >> 22 & 0x1FF,
        address >> 11 & 1,
        *size,
        tick_ns=1000,
        where=where,
    )
    return Recording(events, sensor=chip, source=path, attributes={"biases": _biases(lines, chip)})


def _header(path: Path) -> tuple[list[str], int]:
    """The header's lines, and the byte at which the events begin."""
    lines, start = [], 0
    with path.open("rb") as file:
        for line in file:
            if not line.startswith(b"#"):
                break
            lines.append(line.decode("latin1").rstrip())
            start += len(line)
    return lines, start


def _biases(lines: list[str], chip: str) -> dict[str, str]:
    """Every preference of this chip's bias generator, without the chip's name."""
    entries = (match.groups() for match in map(ENTRY.search, lines) if match)
    return {key[len(chip) + 1 :]: value for key, value in entries if key.startswith(f"{chip}.") and BIAS.search(key)}
