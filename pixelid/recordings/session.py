"""Recordings of one session agree on what their files do not state: the sensor's size, the unit of time, the polarity.

Where no file states the size, it is the largest address of any recording: a pixel is the same one in all of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from pixelid.errors import InputError
from pixelid.recordings.recording import Recording
from pixelid.recordings.source import ATTRIBUTE, EMPTY, LARGEST, OPTION, Source

OF_SESSION = f"{LARGEST} of the session"


def agreed(recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings, of one size where it was inferred.

    Raises:
        InputError: sensors of different sizes, units or polarities that were inferred differently.
    """
    if len(recordings) < 2:
        return list(recordings)
    sources = [Source.from_dict(r.attributes.get(ATTRIBUTE)) for r in recordings]
    units = {r.name: s.inferred["time_unit"][0] for r, s in zip(recordings, sources, strict=True)
             if "time_unit" in s.inferred}  # fmt: skip
    _refuse_different("time_unit", "the unit of time was inferred differently", units)
    codes = {r.name: code for r, s in zip(recordings, sources, strict=True) if (code := _polarity(r, s))}
    _refuse_different("polarity", "polarities are coded differently", codes)
    return _of_one_size(recordings, sources)


def _polarity(recording: Recording, source: Source) -> str | None:
    """The code of a recording's polarity, where it was stated neither in its file nor by the user, and shows."""
    if source.stated.get("polarity"):
        return None
    if "polarity" in source.inferred:
        return "−1/1"
    return "0/1" if source.inferred and not recording.events.p.all() else None


def _refuse_different(option: str, what: str, found: dict[str, str]) -> None:
    if len(set(found.values())) > 1:
        first = {value: name for name, value in reversed(found.items())}
        shown = ", ".join(f"{value} of {name}" for value, name in first.items())
        raise InputError(f"the recordings of a session disagree: {what}: {shown}; state it: {OPTION[option]}")


def _of_one_size(recordings: Sequence[Recording], sources: Sequence[Source]) -> list[Recording]:
    sizes = [(r.events.width, r.events.height) for r in recordings]
    free = [_is_free(r, s) for r, s in zip(recordings, sources, strict=True)]
    stated = {size: r.name for r, size, f in zip(recordings, sizes, free, strict=True) if not (f or r.pooled)}
    if len(stated) > 1:
        shown = ", ".join(f"{name} {wide} × {high}" for (wide, high), name in stated.items())
        raise InputError(f"the recordings come from different sensors: {shown}; take those of one sensor at a time")
    inferred = [size for size, f in zip(sizes, free, strict=True) if f]
    if not inferred:
        return list(recordings)
    widest = max(width for width, _ in inferred), max(height for _, height in inferred)
    size, why = (next(iter(stated)), " as the session's other recordings state") if stated else (widest, OF_SESSION)
    if widest[0] > size[0] or widest[1] > size[1]:
        raise InputError(
            f"the recordings come from different sensors: {stated[size]} {size[0]} × {size[1]}, others reach "
            f"{widest[0]} × {widest[1]}; state it: {OPTION['size']}"
        )
    return [_sized(r, s, size, why) if f else r for r, s, f in zip(recordings, sources, free, strict=True)]


def _is_free(recording: Recording, source: Source) -> bool:
    """Whether a recording's size is only that of its largest address, and no light is of that size."""
    light = recording.stimulus
    inferred = source.inferred.get("size", (None, ""))[1] in (LARGEST, EMPTY, OF_SESSION)
    return inferred and not recording.pooled and (light is None or light.full_field)


def _sized(recording: Recording, source: Source, size: tuple[int, int], why: str) -> Recording:
    events = replace(recording.events, width=size[0], height=size[1])
    noted = replace(source, inferred={**source.inferred, "size": (size, why)})
    return replace(recording, events=events, attributes={**recording.attributes, ATTRIBUTE: noted.as_dict()})
