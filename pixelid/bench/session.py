"""A bench session in memory: its recordings with one size, their lights, and who is left out and why."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from pixelid.bench.files import Bench, Entry
from pixelid.errors import InputError
from pixelid.recordings.crop import Crop
from pixelid.recordings.doubts import doubts_of_events
from pixelid.recordings.reading import open_recording
from pixelid.recordings.recording import Recording
from pixelid.recordings.session import agreed
from pixelid.recordings.source import ATTRIBUTE, Source
from pixelid.stimuli.files import load_stimulus
from pixelid.stimuli.pixel_lights import Light
from pixelid.stimuli.stimulus import WITHOUT_SCALE, Stimulus

# Fits of some dozen pixels know everything but the spread of thresholds as well as the light allows; the others check.
FITTED_PIXELS = 36
LEAST_PIXELS = 4  # that see the light, fewer say little of how pixels differ
UNLIT, HOT = 0.2, 5.0  # of the median pixel's events: a mismatch of 5 % moves them by as much, dust and defects by more


@dataclass(frozen=True)
class Session:
    """What a bench's files hold.

    bench: where they lie, and what is stated;  recordings: on the camera's clock, of one size
    lights: of each, on the lights' clock, in one unit;  left_out: name → why
    notes: what was inferred about all of them
    pixels, checking: flat indices of the pixels that are fitted, and of the other good ones
    """

    bench: Bench
    recordings: tuple[Recording, ...]
    lights: tuple[Light, ...]
    left_out: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    pixels: np.ndarray = field(default_factory=lambda: np.empty(0, np.int64))
    checking: np.ndarray = field(default_factory=lambda: np.empty(0, np.int64))


def read_session(
    bench: Bench,
    roi: tuple[int, int, int, int] | None = None,
    pixels: int | None = None,
    seed: int = 0,
    progress: Callable[[str, float], None] = lambda what, fraction: None,
) -> Session:
    """Read the files of a bench.

    Args:
        bench: What there is.
        roi: (x0, y0, x1, y1) of the sensor to look at; the bench's by default.
        pixels: How many are fitted; `FITTED_PIXELS` by default.
        seed: Chooses them.
        progress: Called with the file that is read.

    Raises:
        InputError: No recording with a light, recordings of several sensors, lights in several units.
    """
    left_out = {entry.name: entry.skip for entry in bench.entries if entry.skip}
    recordings, lights = [], []
    some = [entry for entry in bench.entries if not entry.skip]
    for k, entry in enumerate(some):
        progress(f"reading {entry.name}", k / len(some))
        try:
            recording, light = _opened(entry, bench)
        except _Unusable as why:
            left_out[entry.name] = str(why)
            continue
        recordings.append(recording)
        lights.append(light)
    if not recordings:
        reasons = "; ".join(f"{name}: {why}" for name, why in left_out.items())
        raise InputError(f"{bench.folder}: no recording can be used ({reasons})")
    recordings = agreed(recordings)
    notes = _inferences(recordings)
    _check_units(recordings, lights)
    roi = roi or bench.roi
    if roi is not None:
        recordings = [Crop(roi).applied(r) if len(r.events) else r for r in recordings]
    good, bad = good_pixels(recordings)
    if len(good) < LEAST_PIXELS:
        raise InputError(f"{bench.folder}: expected events of at least {LEAST_PIXELS} pixels, found {len(good)}")
    if len(bad):
        notes.append(f"{len(bad)} pixels that fire far more or less than the others are left out")
    wanted = FITTED_PIXELS if pixels is None else pixels
    order = np.random.default_rng(seed).permutation(good)
    chosen, checking = np.sort(order[:wanted]), np.sort(order[wanted : 2 * wanted])
    if len(chosen) < len(good):
        notes.append(f"{len(chosen)} of {len(good)} pixels are fitted, {len(checking)} others check the result")
    return Session(bench, tuple(recordings), tuple(lights), left_out, tuple(notes), chosen, checking)


class _Unusable(Exception):
    """Why a recording of a session cannot be used, where the others can."""


def _opened(entry: Entry, bench: Bench) -> tuple[Recording, Light]:
    """A recording and its light, both as the bench states them."""
    if entry.events.stat().st_size == 0:
        raise _Unusable("the file is empty")
    recording = replace(open_recording(entry.events, bench.source), label=entry.name)
    if entry.light is not None:
        light = load_stimulus(entry.light)
    elif recording.stimulus is not None:
        light = recording.stimulus
    else:
        raise _Unusable("no light: neither in the file nor in its folder")
    if isinstance(light, Stimulus):
        unit = bench.unit if bench.unit is not None and light.unit in WITHOUT_SCALE else light.unit
        light = replace(light, radiance=light.radiance * entry.level, unit=unit)
    return recording, light


def _inferences(recordings: Sequence[Recording]) -> list[str]:
    """What was inferred of the files and what speaks against them, each once with the recordings that it is about."""
    lines: dict[str, list[str]] = {}
    for recording in recordings:
        line = Source.from_dict(recording.attributes.get(ATTRIBUTE)).line()
        for one in (line, *doubts_of_events(recording.events)):
            if one:
                lines.setdefault(one, []).append(recording.name)
    everyone = len(recordings)
    return [line if len(names) == everyone else f"{', '.join(names)}: {line}" for line, names in lines.items()]


def good_pixels(recordings: Sequence[Recording]) -> tuple[np.ndarray, np.ndarray]:
    """Flat indices of pixels that see the light as most do, and of those that fire far less or more."""
    size = recordings[0].events.width * recordings[0].events.height
    counts = np.sum([np.bincount(r.events.pixel, minlength=size) for r in recordings], axis=0)
    active = np.flatnonzero(counts)
    if not len(active):
        return active, active
    median = float(np.median(counts[active]))
    good = (counts[active] >= UNLIT * median) & (counts[active] <= HOT * median)
    return active[good], active[~good]


def _check_units(recordings: Sequence[Recording], lights: Sequence[Light]) -> None:
    units = {light.unit for light in lights}
    if len(units) > 1:
        names = ", ".join(f"{r.name} in {light.unit}" for r, light in zip(recordings, lights, strict=True))
        raise InputError(f"expected lights in one unit, found {', '.join(sorted(units))} ({names[:200]})")
