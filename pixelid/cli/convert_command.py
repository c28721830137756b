"""`pixelid convert`: any readable recording to .h5 with its light with it, cut as asked, and back to text or npz."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from pixelid.cli import options
from pixelid.errors import InputError

if TYPE_CHECKING:
    from pixelid.recordings.crop import Crop
    from pixelid.recordings.recording import Recording

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
                   "or seconds with their standard deviation, 12.345±0.001 (default 1 ms).")  # fmt: skip
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
    from pixelid.outputs import claimed
    from pixelid.recordings.writing import check_writable

    check_writable(target)
    if align is not None and stimulus is None:
        raise InputError("--align: needs --stimulus, the light to align")
    light_files = [stimulus] if stimulus and Path(stimulus).exists() else []
    with claimed(target, overwrite, [source, *light_files]):
        from pixelid.recordings.reading import check_readable

        check_readable([source])
        from pixelid.cli.progress import bar
        from pixelid.recordings.conversion import converted
        from pixelid.recordings.parts import LongRecording, Totals
        from pixelid.recordings.writing import write_recording

        recording, said = converted(source, stimulus, align, crop, seed)
        totals = Totals()
        with bar(quiet) as report:

            def counted(part: Recording) -> Recording:
                report(f"{totals.add(part) / 1e6:.0f} M events", 0.0)
                return part

            if isinstance(recording, LongRecording):
                recording = recording.map(counted)
            else:
                totals.add(recording)
            write_recording(recording, target, overwrite=overwrite, progress=report)
    if not quiet:
        beside = "with its stimulus" if recording.stimulus is not None else "without stimulus"
        said = f"; {said}" if said else ""
        say(f"{target}: {totals.events} events, {totals.duration_s:g} s, {beside}{said}")
