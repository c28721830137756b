"""AEDAT2 of jAER's DAVIS and DVS128: text header, then big-endian pairs of 32-bit address and 32-bit microseconds.

Address of a DAVIS (inivation.github.io/inivation-docs, "AEDAT 2.0"): bit 31 set for frame and IMU samples, bits
22–30 the row, bits 12–21 the column, bit 11 the polarity (1 ON), bit 10 an external input.  Of a DVS128 (jAER's
`DVS128.Extractor`): bit 31 or 15 set for external inputs, bits 8–14 the row, bits 1–7 the column, bit 0 the polarity,
0 for ON.  The header repeats every bias of the chip, kept here in `attributes["biases"]`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from pixelid.errors import InputError, shown
from pixelid.recordings.columns import Rollovers, word_pairs
from pixelid.recordings.events import Events
from pixelid.recordings.raw import Block, RawEvents
from pixelid.recordings.recording import Recording
from pixelid.recordings.source import SENSOR_SIZES, ReadingOptions

CHIPS = ("DAVIS240", "DAVIS346", "DVS128")
ENTRY = re.compile(r'<entry key="([^"]+)" value="([^"]*)"')
BIAS = re.compile("[Bb]ias|IPot|ShiftedSource")
TEXT = re.compile(rb"#[\t\x20-\x7e\x80-\xff]*\r?\n")  # in any coding of letters; numbers hold zeros
END_OF_HEADER, LONGEST_LINE = "#End Of ASCII Header", 1 << 20


def opened(path: Path, options: ReadingOptions) -> RawEvents:
    """The events of an AEDAT2 file; frames, IMU samples and external inputs are left out.

    Raises InputError for other chips, and none.
    """
    lines, start = _header(path)
    words = next((line.split("AEChip:")[1].split() for line in lines if "AEChip:" in line), [])
    chip = options.chip or (words[0].rsplit(".", 1)[-1] if words else "")
    name = next((name for name in CHIPS if chip.upper().replace("-", "").startswith(name)), None)
    if name is None:
        raise InputError(
            f"{path}: AEChip: expected one of {', '.join(CHIPS)}, found {shown(chip) if chip else 'nothing'}; "
            "state whose addresses these are: --chip DAVIS346|DAVIS240|DVS128"
        )
    head = Recording(Events.empty(1, 1), sensor=chip, source=path, attributes={"biases": _biases(lines, chip)})
    return RawEvents(
        head, lambda: _blocks(path, start, name == "DVS128"), f"{path}: events", "us", 1000, size=SENSOR_SIZES[name],
        polarity="01",
    )  # fmt: skip


def _blocks(path: Path, start: int, dvs128: bool) -> Iterator[Block]:
    """Blocks of (t µs, x, y, p), the clock's rollovers undone."""
    columns = _of_dvs128 if dvs128 else _of_davis
    clock = Rollovers(1 << 32)
    for words in word_pairs(path, start, ">u4"):
        address = words[:, 0].astype(np.uint32)
        no_event, *xyp = columns(address)
        keep = (address >> 31 | no_event) == 0
        yield Block.of((clock.undone(words[keep, 1]), *(column[keep] for column in xyp)))


def _of_davis(address: np.ndarray) -> tuple[np.ndarray, ...]:
    """(external input, x, y, p) of addresses."""
    return address >> 10 & 1, address >> 12 & 0x3FF, address >> 22 & 0x1FF, address >> 11 & 1


def _of_dvs128(address: np.ndarray) -> tuple[np.ndarray, ...]:
    """(external input, x, y, p) of addresses."""
    return address >> 15 & 1, address >> 1 & 0x7F, address >> 8 & 0x7F, address & 1 ^ 1


def _header(path: Path) -> tuple[list[str], int]:
    """The header's lines, and the byte at which the events begin."""
    lines, start = [], 0
    with path.open("rb") as file:
        while TEXT.fullmatch(line := file.readline(LONGEST_LINE)):  # an event's address may begin with a # too
            lines.append(line.decode("latin1").rstrip())
            start += len(line)
            if lines[-1].startswith(END_OF_HEADER):
                break
    return lines, start


def _biases(lines: list[str], chip: str) -> dict[str, str]:
    """Every preference of this chip's bias generator, without the chip's name."""
    entries = (match.groups() for match in map(ENTRY.search, lines) if match)
    return {key[len(chip) + 1 :]: value for key, value in entries if key.startswith(f"{chip}.") and BIAS.search(key)}
