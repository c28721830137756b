"""A recording with its light: opened, cut, the light put on its clock; what `pixelid convert` writes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from pixelid.errors import InputError
from pixelid.recordings.crop import Crop
from pixelid.recordings.parts import LongRecording, as_long
from pixelid.recordings.reading import open_cropped, open_recording
from pixelid.recordings.recording import Recording
from pixelid.stimuli.pixel_lights import Light

if TYPE_CHECKING:
    from pixelid.recordings.alignment import Alignment

SENSOR, FRAMES = "sensor", "frames"  # the light as the sensor itself measured it


def converted(
    source: Path, stimulus: str | Path | Light | None, align: str | None, crop: Crop, seed: int
) -> tuple[Recording | LongRecording, str]:
    """The recording of a file with its light, and what to say of either.

    Args:
        source: the file.
        stimulus: the light, its file or name; "sensor" or "frames[:DARK]" for what the sensor measured; None: what
            the file holds.
        align: as of `find_alignment`; None: light and events have one clock.
        crop: what is wanted of the events.
        seed: chooses the pixels of `crop`.

    Raises:
        InputError: as `open_cropped`, `load_stimulus` and `find_alignment`; light that does not cover the events.
    """
    if align is not None and stimulus is None:
        raise InputError("--align: needs --stimulus, the light to align")
    own, dark = own_light(stimulus)
    if align is not None and own:
        raise InputError(f"--align: --stimulus {own} is on the camera's clock already")
    if own == SENSOR:  # cut afterwards: what a pixel measured counts whole
        from pixelid.recordings.sensor_light import with_measured_light

        recording = crop.applied(with_measured_light(open_recording(source)), seed)
        return recording, str(recording.attributes.get("polarity", ""))
    if own == FRAMES:
        from pixelid.recordings.frames import with_frames

        return crop.applied(with_frames(open_recording(source), dark), seed), ""
    if stimulus is None:
        return open_cropped(source, crop, seed), ""
    from pixelid.stimuli.files import load_stimulus

    light = load_stimulus(stimulus, (SENSOR, FRAMES)) if isinstance(stimulus, str | Path) else stimulus
    if align is None:  # light ends where the cut does
        recording = crop.applied(open_cropped(source, Crop()).with_stimulus(light), seed)
        recording.check_stimulus_covers_events()
        return recording, ""
    from pixelid.recordings.alignment import aligned, find_alignment, sample_to_align

    part = open_cropped(source, crop, seed)
    alignment = find_alignment(sample_to_align(part, seed) if isinstance(part, LongRecording) else part, light, align)
    light = _until(light, alignment, crop, source)
    together = aligned(part, light, alignment)
    together.check_stimulus_covers_events()
    return together, alignment.sentence()


def own_light(stimulus: str | Path | Light | None) -> tuple[str, float]:
    """(sensor, frames, or "" for other light; the grey level of no light)."""
    name, _, dark = (stimulus if isinstance(stimulus, str) else "").partition(":")
    if name == SENSOR and not dark:
        return SENSOR, 0.0
    if name != FRAMES:
        return "", 0.0
    try:
        level = float(dark or 0.0)
    except ValueError:
        level = -1.0
    if not 0.0 <= level < 65535.0:
        raise InputError(f"--stimulus frames:DARK: expected a grey level of no light, found {dark!r}")
    return FRAMES, level


def _until(light: Light, alignment: Alignment, crop: Crop, source: Path) -> Light:
    """The light up to the end of the cut, which is on the camera's clock: after it, pixels are unseen, not silent."""
    if crop.time_s is None:
        return light
    end_s = crop.time_s[1]
    if crop.from_first:
        parts = as_long(open_cropped(source, Crop())).read()
        end_s += next((int(part.events.t[0]) for part in parts if len(part.events)), 0) * 1e-9
    return light.until((end_s - alignment.offset_s) / (1.0 + alignment.rate_error))
