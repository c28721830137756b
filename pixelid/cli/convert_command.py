"""`pixelid convert`: any readable recording to .h5, and back to text or npz."""

from __future__ import annotations

from pathlib import Path

import click

from pixelid.cli import options

EXAMPLE = """
\b
Example:
    pixelid convert camera.aedat4 recording.h5
    pixelid convert recording.h5 events.csv
"""


@click.command("convert", epilog=EXAMPLE)
@click.argument("source", metavar="IN", type=options.PATH)
@click.argument("target", metavar="OUT", type=options.PATH)
@click.option("--stimulus", metavar="S", help="Recording, .toml stimulus or built-in name to put beside the events.")
@click.option("--overwrite", is_flag=True, help="Replace the file OUT.")
@options.no_seed
@options.quiet
def command(source: Path, target: Path, stimulus: str | None, overwrite: bool, seed: int, quiet: bool) -> None:
    """Convert the recording IN to OUT; the extension of OUT (.h5, .npz, .csv, .txt) chooses the format.

    Nothing is lost on the way: times, addresses, polarities, stimulus, labels and biases come back as they were.
    """
    from pixelid.outputs import claimed
    from pixelid.recordings.writing import check_writable

    check_writable(target)
    with claimed(target, overwrite, [source, *([stimulus] if stimulus else [])]):
        from pixelid.recordings import open_recording, write_recording

        recording = open_recording(source)
        if stimulus is not None:
            from pixelid.stimuli.files import load_stimulus

            recording = recording.with_stimulus(load_stimulus(stimulus))
            recording.check_stimulus_covers_events()
        write_recording(recording, target, overwrite=overwrite)
    if not quiet:
        beside = "with its stimulus" if recording.stimulus is not None else "without stimulus"
        click.echo(f"{target}: {len(recording.events)} events, {recording.events.duration_s:g} s, {beside}")
