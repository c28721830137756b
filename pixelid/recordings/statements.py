"""What a file of arrays states of its sensor and its times in attributes, small arrays and scalars with the events.

Programs call these by many names: `width` and `height`, `resolution`, `sensor_size`, `geometry`; `unit`, `time_unit`,
`timestamp_units`.  Two numbers of a size come in either order; one that is wider than high is meant, if both hold all
events.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from pixelid.errors import InputError, shown
from pixelid.recordings.metadata import MOST_SIZE, whole
from pixelid.recordings.source import OPTION, size_of_chip
from pixelid.time_units import SECONDS, UNIT_OF, plain

Size = tuple[int | None, int | None]
Likely = tuple[tuple[tuple[int, int], str], ...]
SIDES = (("width", "sensor_width", "image_width", "w"), ("height", "sensor_height", "image_height", "h"))
PAIRS = ("sensor_resolution", "sensor_size", "resolution", "geometry", "image_size", "frame_size", "shape", "size",
         "calib/resolution", "deviceaddressspace")  # fmt: skip
CHIPS = ("plugin_name", "sensor_name", "sensor", "camera", "camera_name", "chip", "source", "sensor_type")
UNITS = ("unit", "units", "time_unit", "time_units", "t_unit", "t_units", "timestamp_unit", "timestamp_units",
         "timestamps_unit")  # fmt: skip
WIDTH_X_HEIGHT = re.compile(r"\s*(\d{1,5})\s*x\s*(\d{1,5})\s*", re.I | re.ASCII)


def stated_size(holders: Iterable[Mapping[str, Any]], where: str) -> tuple[Size, Likely]:
    """The size of the sensor that is stated by sides, or else the likely ones, by pairs of numbers or by its name.

    Args:
        holders: names (in any case) → values, the nearest to the events first.
        where: named in errors.

    Raises:
        InputError: a side that is no whole number of pixels.
    """
    found: list[int | None] = [None, None]
    likely: list[tuple[tuple[int, int], str]] = []
    for holder in holders:
        values = {name.lower(): value for name, value in holder.items()}
        for k, names in enumerate(SIDES):
            name = next((name for name in names if name in values and np.size(values[name]) == 1), None)
            if found[k] is None and name is not None and (name == names[0] or np.all(np.asarray(values[name]) > 0)):
                found[k] = whole(np.asarray(values[name]).item(), f"{where}: attribute {name}", MOST_SIZE)
        for name in (name for name in PAIRS if name in values):
            value = values[name]
            text = WIDTH_X_HEIGHT.fullmatch(value) if isinstance(value, str) else None
            if text and found == [None, None]:
                found = [int(text[1]), int(text[2])]
            likely += [(size, f" as {name} says") for size in _pair(value)]
        for name in (name for name in CHIPS if isinstance(values.get(name), str)):
            parts = re.split(r"[\W_]+", values[name])
            sizes = [size for part in parts if (size := size_of_chip(part)) is not None]
            likely += [(size, f" of the sensor ({shown(values[name], 40)})") for size in sizes[:1]]
    return (found[0], found[1]), tuple(likely)


def _pair(value: Any) -> list[tuple[int, int]]:
    """Sizes that a pair of numbers may mean, the likelier first."""
    sides = np.asarray(value)
    if sides.size != 2 or sides.dtype.kind not in "iuf" or not np.all((sides >= 1) & (sides < 1 << 16)):
        return []
    one, other = sorted((int(side) for side in sides.ravel()), reverse=True)
    return [(one, other), (other, one)]


def stated_unit(own: Mapping[str, Any], others: Iterable[Mapping[str, Any]], where: str) -> str | None:
    """The unit of the times that is stated, "s", "ms", "us" or "ns".

    Args:
        own: what is stated of the times themselves.
        others: what is stated of more than them, where a `unit` may be of something else.
        where: named in errors.

    Raises:
        InputError: the times have another one.
    """
    for holder in (own, *others):
        for name, value in holder.items():
            if name.lower() in UNITS and isinstance(value, str) and value:
                unit = UNIT_OF.get(plain(value)) or UNIT_OF.get(plain(value).partition(" since ")[0])
                if unit is not None and SECONDS[unit] <= 1:
                    return unit
                if holder is own or name.lower().startswith("t"):
                    raise InputError(
                        f"{where}/t: expected unit ns or us or ms or s, found {shown(value)}; {OPTION['time_unit']}"
                    )
    return None
