"""`pixelid convert`: any readable recording to .h5 with its light beside it, cut as asked, and back to text or npz."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from pixelid.cli import options

if TYPE_CHECKING:
    from pixelid.recordings.crop import Crop

SENSOR = "sensor"  # of --stimulus: the light as the sensor itself measured it
EXAMPLE = """
\b
Example:
    pixelid convert camera.aedat4 recording.h5
    pixelid convert camera.raw recording.h5 --stimulus light.csv --align trigger
    pixelid convert recording.h5 events.csv
"""


@click.command("convert", epilog=EXAMPLE)
@click.argument("source", metavar="IN", type=options.PATH)
@click.argument("target", metavar="OUT", type=options.PATH)
@click.option("--stimulus", metavar="S",
              help="The light: a table, array, video, recording, .toml or built-in name; "
                   "or sensor: the exposure measurements of an ATIS.")  # fmt: skip
@click.option("--align", metavar="HOW",
              help="The light's time zero on the camera's clock: trigger, first-event, auto, or seconds.")  # fmt: skip
@options.crop
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
    from pixelid.errors import InputError
    from pixelid.outputs import claimed
    from pixelid.recordings.writing import check_writable

    check_writable(target)
    if align is not None and stimulus is None:
        raise InputError("--align: expected --stimulus beside it, the light to align")
    if align is not None and stimulus == SENSOR:
        raise InputError("--align: --stimulus sensor is on the camera's clock already")
    said = ""
    with claimed(target, overwrite, [source, *([stimulus] if stimulus and stimulus != SENSOR else [])]):
        from pixelid.cli.progress import bar
        from pixelid.recordings import write_recording
        from pixelid.recordings.parts import LongRecording, Totals
        from pixelid.recordings.reading import check_readable, open_cropped, open_recording

        check_readable([source])

        if stimulus == SENSOR:  # cut afterwards: what a pixel measured counts whole
            from pixelid.recordings.sensor_light import with_measured_light

            recording = crop.applied(with_measured_light(open_recording(source)), seed)
            said = f"; {recording.attributes['polarity']}" if "polarity" in recording.attributes else ""
        else:
            recording = open_cropped(source, crop, seed)
        if stimulus is not None and stimulus != SENSOR:
            from pixelid.stimuli.files import load_stimulus

            light = load_stimulus(stimulus)
            if align is None:
                recording = recording.with_stimulus(light)
                _refuse_other_clock(recording)
            elif isinstance(recording, LongRecording):
                from pixelid.recordings.alignment import aligned_parts, find_alignment, sample_to_align

                alignment = find_alignment(sample_to_align(recording, seed), light, align)
                recording, said = aligned_parts(recording, light, alignment), f"; {alignment.sentence()}"
            else:
                from pixelid.recordings.alignment import aligned, find_alignment

                alignment = find_alignment(recording, light, align)
                recording, said = aligned(recording, light, alignment), f"; {alignment.sentence()}"
            recording.check_stimulus_covers_events()
        totals = Totals()
        with bar(quiet) as report:
            if isinstance(recording, LongRecording):
                recording = recording.watched(lambda part: report(f"{totals.add(part) / 1e6:.0f} M events", 0.0))
            else:
                totals.add(recording)
            write_recording(recording, target, overwrite=overwrite)
    if not quiet:
        beside = "with its stimulus" if recording.stimulus is not None else "without stimulus"
        click.echo(f"{target}: {totals.events} events, {totals.duration_s:g} s, {beside}{said}")


def _refuse_other_clock(recording) -> None:
    """Raise InputError that names --align, where events and light do not overlap at all or only in part."""
    from pixelid.errors import InputError

    try:
        recording.check_stimulus_covers_events()
    except InputError as error:
        raise InputError(
            f"{error}; if the light has its own clock, say where it starts: --align trigger|first-event|auto|SECONDS"
        ) from None
