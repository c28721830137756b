"""`pixelid convert`: any readable recording to .h5 with its light beside it, cut as asked, and back to text or npz."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from pixelid.cli import options

if TYPE_CHECKING:
    from pixelid.recordings.alignment import Alignment
    from pixelid.recordings.crop import Crop
    from pixelid.stimuli.pixel_lights import Light

SENSOR, FRAMES = "sensor", "frames"  # of --stimulus: the light as the sensor itself measured it
EXAMPLE = """
\b
Example:
    pixelid convert camera.aedat4 recording.h5
    pixelid convert camera.raw recording.h5 --stimulus light.csv --align trigger
    pixelid convert recording.h5 events.csv
"""


@click.command("convert", epilog=EXAMPLE)
@click.argument("source", metavar="IN", type=options.PATH)
@click.argument("target", metavar="OUT", type=options.NEW)
@click.option("--stimulus", metavar="S",
              help="The light: a table, array, video, recording, .toml or built-in name; "
                   "or sensor: the exposure measurements of an ATIS; frames[:DARK]: a DAVIS' frames, DARK the grey "
                   "level of no light.")  # fmt: skip
@click.option("--align", metavar="HOW",
              help="The light's time zero on the camera's clock: trigger or trigger:INPUT, first-event, auto, "
                   "or seconds.")  # fmt: skip
@options.crop
@options.reading
@click.option("--overwrite", is_flag=True, help="Replace the file OUT.")
@options.seed("Of the pixels chosen by --pixels.")
@options.quiet
def command(
    source: Path, target: Path, stimulus: str | None, align: str | None, crop: Crop, overwrite: bool, seed: int,
    quiet: bool,
) -> None:  # fmt: skip
    """Convert the recording IN to OUT; the extension of OUT (.h5, .npz, .csv, .txt) chooses the format.

    Nothing is lost on the way: times, addresses, polarities, stimulus, labels and biases come back as they were
    (triggers and exposure measurements in .h5).  With --align, time zero becomes the light's first sample.
    """
    from pixelid.cli.terminal import say
    from pixelid.errors import InputError
    from pixelid.outputs import claimed
    from pixelid.recordings.writing import check_writable

    check_writable(target)
    if align is not None and stimulus is None:
        raise InputError("--align: expected --stimulus beside it, the light to align")
    own, dark = _own_light(stimulus)
    if align is not None and own:
        raise InputError(f"--align: --stimulus {own} is on the camera's clock already")
    said = ""
    with claimed(target, overwrite, [source, *([stimulus] if stimulus and not own else [])]):
        from pixelid.cli.progress import bar
        from pixelid.recordings import write_recording
        from pixelid.recordings.crop import Crop
        from pixelid.recordings.parts import LongRecording, Totals
        from pixelid.recordings.reading import check_readable, open_cropped, open_recording
        from pixelid.stimuli.files import load_stimulus

        check_readable([source])

        if own == SENSOR:  # cut afterwards: what a pixel measured counts whole
            from pixelid.recordings.sensor_light import with_measured_light

            recording = crop.applied(with_measured_light(open_recording(source)), seed)
            said = f"; {recording.attributes['polarity']}" if "polarity" in recording.attributes else ""
        elif own == FRAMES:
            from pixelid.recordings.frames import with_frames

            recording = crop.applied(with_frames(open_recording(source), dark), seed)
        elif stimulus is not None and align is None:  # light ends where the cut does
            recording = open_cropped(source, Crop()).with_stimulus(load_stimulus(stimulus, (SENSOR, FRAMES)))
            if isinstance(recording, LongRecording):
                recording = crop.applied_to_parts(recording, seed)
            else:
                recording = crop.applied(recording, seed)
            _refuse_other_clock(recording)
        else:
            recording = open_cropped(source, crop, seed)
        if stimulus is not None and not own and align is not None:
            light = load_stimulus(stimulus, (SENSOR, FRAMES))
            if isinstance(recording, LongRecording):
                from pixelid.recordings.alignment import aligned_parts, find_alignment, sample_to_align

                alignment = find_alignment(sample_to_align(recording, seed), light, align)
                light = _until(light, alignment, crop, source)
                recording, said = aligned_parts(recording, light, alignment), f"; {alignment.sentence()}"
            else:
                from pixelid.recordings.alignment import aligned, find_alignment

                alignment = find_alignment(recording, light, align)
                light = _until(light, alignment, crop, source)
                recording, said = aligned(recording, light, alignment), f"; {alignment.sentence()}"
        if stimulus is not None and not own:
            recording.check_stimulus_covers_events()
        totals = Totals()
        with bar(quiet) as report:
            if isinstance(recording, LongRecording):
                recording = recording.watched(lambda part: report(f"{totals.add(part) / 1e6:.0f} M events", 0.0))
            else:
                totals.add(recording)
            write_recording(recording, target, overwrite=overwrite, progress=report)
    if not quiet:
        beside = "with its stimulus" if recording.stimulus is not None else "without stimulus"
        say(f"{target}: {totals.events} events, {totals.duration_s:g} s, {beside}{said}")


def _own_light(stimulus: str | None) -> tuple[str, float]:
    """(sensor, frames, or "" for other light; the grey level of no light)."""
    from pixelid.errors import InputError

    name, _, dark = (stimulus or "").partition(":")
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
        from pixelid.recordings.crop import Crop
        from pixelid.recordings.parts import LongRecording
        from pixelid.recordings.reading import open_cropped

        whole = open_cropped(source, Crop())
        parts = whole.read() if isinstance(whole, LongRecording) else [whole]
        end_s += next((int(part.events.t[0]) for part in parts if len(part.events)), 0) * 1e-9
    return light.until((end_s - alignment.offset_s) / (1.0 + alignment.rate_error))


def _refuse_other_clock(recording) -> None:
    """Raise InputError that names --align, where events and light do not overlap at all or only in part."""
    from pixelid.errors import InputError

    try:
        recording.check_stimulus_covers_events()
    except InputError as error:
        raise InputError(
            f"{error}; if the light has its own clock, say where it starts: --align trigger|first-event|auto|SECONDS"
        ) from None
