"""Waveforms as files: WAV for sound cards, CSV for generators, and the light's expected trace next to either."""

from __future__ import annotations

import wave
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pixelid.errors import InputError
from pixelid.outputs import refuse_existing, whole_file
from pixelid.stimuli.stimulus import WITHOUT_SCALE

if TYPE_CHECKING:
    from pixelid.design.waveform import Waveform

SUFFIXES = (".wav", ".csv")
BITS = (16, 24)
MOST_WAV_RATE = (1 << 32) - 1  # of its header
MOST_WAV_BYTES = (1 << 32) - 100


def check_name(path: Path) -> None:
    """Raise InputError unless a waveform can have this name."""
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"{path}: expected a name that ends in .wav or .csv")


def trace_beside(path: Path) -> Path:
    """The name of the light's expected trace next to a waveform, NAME_light.csv."""
    return path.with_name(f"{path.stem}_light.csv")


def write(waveform: Waveform, path: Path, *, bits: int, overwrite: bool) -> Path:
    """Write the waveform and its light's expected trace; return the trace's path.  Raises InputError."""
    check_name(path)
    if bits not in BITS:
        raise InputError(f"bits: expected 16 or 24, found {bits!r}")
    trace = trace_beside(path)
    refuse_existing(trace, overwrite)
    with whole_file(path, overwrite) as temporary:
        if path.suffix.lower() == ".wav":
            _write_wav(waveform, temporary, bits)
        else:
            columns = (waveform.t, waveform.light, waveform.trigger)
            _write_table(temporary, ("t_s", _light_column(waveform), "trigger"), columns)
    with whole_file(trace, overwrite) as temporary:
        columns = (waveform.stimulus.t, waveform.stimulus.radiance)
        _write_table(temporary, ("t_s", _light_column(waveform)), columns)
    return trace


def full_scale(waveform: Waveform) -> float:
    """The light that a full-scale sample of a WAV stands for: the brightest."""
    return float(waveform.light.max())


def _light_column(waveform: Waveform) -> str:
    unit = waveform.stimulus.unit
    return "light" if unit in WITHOUT_SCALE else f"light_{unit}"


def _write_table(path: Path, names: Iterable[str], columns: Iterable[np.ndarray]) -> None:
    formats = {"t": "%.9f", "l": "%.9g", "trigger": "%d"}
    names = tuple(names)
    kinds = [formats.get(name) or formats[name[0]] for name in names]
    np.savetxt(path, np.column_stack(list(columns)), fmt=kinds, delimiter=",", header=",".join(names), comments="")


def _write_wav(waveform: Waveform, path: Path, bits: int) -> None:
    """PCM, two channels: light over its brightest value, and the trigger; both from 0 to full scale."""
    rate, top = round(waveform.rate_hz), (1 << (bits - 1)) - 1
    if rate > MOST_WAV_RATE or abs(rate - waveform.rate_hz) > 1e-9 * rate:
        raise InputError(f"{path.name}: a .wav has a whole number of samples per second, found {waveform.rate_hz:g}")
    light = np.rint(waveform.light / full_scale(waveform) * top)
    samples = np.column_stack([light, top * waveform.trigger.astype(float)]).astype("<i4")
    packed = np.ascontiguousarray(samples).view(np.uint8).reshape(-1, 4)[:, : bits // 8]  # the low bytes come first
    if packed.size > MOST_WAV_BYTES:
        raise InputError(f"{path.name}: a .wav holds at most 4 GiB; use a lower rate")
    with wave.open(str(path), "wb") as file:
        file.setnchannels(2)
        file.setsampwidth(bits // 8)
        file.setframerate(rate)
        file.writeframes(packed.tobytes())
