"""`pixelid convert`: any readable recording to .h5 with its light beside it, cut as asked, and back to text or npz."""

from __future__ import annotations

from pathlib import Path

import click

EXAMPLE = """
\b
Example:
    pixelid convert camera.aedat4 recording.h5
    pixelid convert camera.raw recording.h5 --stimulus light.csv --align trigger
    pixelid convert recording.h5 events.csv
"""


def region(context, parameter, text: str | None) -> tuple[int, int, int, int] | None:
    """The four whole numbers of --roi."""
    if text is None:
        return None
    parts = text.split(",")
    if len(parts) != 4 or not all(part.strip().isdigit() for part in parts):
        raise click.BadParameter(f"expected x0,y0,x1,y1 in pixels, found {text!r}")
    x0, y0, x1, y1 = (int(part) for part in parts)
    return x0, y0, x1, y1


def span(context, parameter, text: str | None) -> tuple[float, float] | None:
    """The two times of --time; either may be left out."""
    if text is None:
        return None
    parts = text.split(":")
    try:
        begin, end = (float(part) if part.strip() else default for part, default in zip(parts, (0.0, 9e9), strict=True))
    except ValueError:
        raise click.BadParameter(f"expected from:to in seconds, found {text!r}") from None
    return begin, end


@click.command("convert", epilog=EXAMPLE)
@click.argument("source", metavar="IN", type=click.Path(path_type=Path))
@click.argument("target", metavar="OUT", type=click.Path(path_type=Path))
@click.option("--stimulus", metavar="S", help="The light: a table, array, video, recording, .toml or built-in name.")
@click.option(
    "--align",
    metavar="HOW",
    help="Where the light's time zero lies on the camera's clock: trigger, first-event, auto, or seconds.",
)
@click.option("--roi", metavar="X0,Y0,X1,Y1", callback=region, help="Only these columns and rows; X1, Y1 excluded.")
@click.option("--time", "time_s", metavar="FROM:TO", callback=span, help="Only these seconds of the camera's clock.")
@click.option("--pixels", type=click.IntRange(1), metavar="N", help="Only N pixels, chosen at random by --seed.")
@click.option("--without-hot-pixels", is_flag=True, help="Leave out pixels that fire whatever the others do.")
@click.option("--overwrite", is_flag=True, help="Replace OUT when it exists.")
@click.option("--seed", type=int, default=0, show_default=True, help="Of the pixels chosen.")
@click.option("--quiet", is_flag=True, help="Print nothing.")
def command(
    source: Path, target: Path, stimulus: str | None, align: str | None, roi, time_s, pixels: int | None,
    without_hot_pixels: bool, overwrite: bool, seed: int, quiet: bool,
) -> None:  # fmt: skip
    """Convert the recording IN to OUT; the extension of OUT (.h5, .npz, .csv, .txt) chooses the format.

    Nothing is lost on the way: times, addresses, polarities, stimulus, labels and biases come back as they were
    (triggers and exposure measurements in .h5).  With --align, time zero becomes the light's first sample.
    """
    import numpy as np

    from pixelid.errors import InputError
    from pixelid.outputs import refuse_existing
    from pixelid.recordings import open_recording, write_recording
    from pixelid.recordings.crop import crop
    from pixelid.recordings.writing import check_writable

    check_writable(target)
    refuse_existing(target, overwrite)
    if align is not None and stimulus is None:
        raise InputError("--align: expected --stimulus beside it, the light to align")
    recording = open_recording(source)
    hot = None
    if without_hot_pixels:
        from pixelid.inspection.hot_pixels import find_hot_pixels

        hot = np.array([p.y * recording.events.width + p.x for p in find_hot_pixels(recording.events)], np.int64)
    recording = crop(recording, roi=roi, time_s=time_s, pixels=pixels, without=hot, seed=seed)
    said = ""
    if stimulus is not None:
        from pixelid.stimuli.files import load_stimulus

        light = load_stimulus(stimulus)
        if align is None:
            recording = recording.with_stimulus(light)
            _refuse_other_clock(recording)
        else:
            from pixelid.recordings.alignment import aligned, find_alignment

            alignment = find_alignment(recording, light, align)
            recording, said = aligned(recording, light, alignment), f"; {alignment.sentence()}"
        recording.check_stimulus_covers_events()
    write_recording(recording, target, overwrite=overwrite)
    if not quiet:
        beside = "with its stimulus" if recording.stimulus is not None else "without stimulus"
        click.echo(f"{target}: {len(recording.events)} events, {recording.events.duration_s:g} s, {beside}{said}")


def _refuse_other_clock(recording) -> None:
    """Raise InputError that names --align, where events and light do not overlap at all or only in part."""
    from pixelid.errors import InputError

    try:
        recording.check_stimulus_covers_events()
    except InputError as error:
        raise InputError(
            f"{error}; if the light has its own clock, say where it starts: --align trigger|first-event|auto|SECONDS"
        ) from None
