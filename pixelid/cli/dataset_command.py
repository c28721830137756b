"""`pixelid dataset`: published raw data in the layout that `pixelid reconstruct` reads."""

from __future__ import annotations

import click

from pixelid.cli import options

LAYOUTS = ("esim", "eds", "tumvie")
EXAMPLE = """
\b
Example:
    pixelid dataset esim sequence/esim.bag scene
    pixelid dataset eds 08_peanuts_running/ scene --start 2 --end 6
    pixelid dataset tumvie mocap-desk2/ scene --camera right --every 4
    pixelid reconstruct scene --out sharp --bandwidth off
"""
POSITIVE = options.Number(0.0, 1e9, open_low=True)


@click.command("dataset", epilog=EXAMPLE)
@click.argument("layout", type=click.Choice(LAYOUTS))
@click.argument("source", metavar="IN", type=options.PATH)
@click.argument("out", type=options.NEW)
@click.option("--start", type=options.Number(0.0, 1e9), metavar="S", help="Begin S seconds after the first pose.")
@click.option("--end", type=POSITIVE, metavar="S", help="End S seconds after the first pose.")
@click.option("--every", type=click.IntRange(1, 1 << 24), default=1, show_default=True, metavar="N",
              help="Keep one pixel in N, with all of its events.")  # fmt: skip
@click.option("--views", type=click.IntRange(0, 1_000_000), default=40, show_default=True, metavar="N",
              help="At most N pictures as views to compare with, but all posed views that come with a sequence; "
              "0: none.")  # fmt: skip
@click.option("--camera", default="", metavar="NAME", help="esim: first word of the topics; eds: the sensor's name in "
              "the calibration; tumvie: left or right.")  # fmt: skip
@click.option(
    "--time-offset", type=options.Number(-1e9, 1e9), default=0.0, metavar="S", help="Added to the events' times."
)
@click.option("--on-threshold", type=POSITIVE, help="In place of the one known or assumed.")
@click.option("--off-threshold", type=POSITIVE, help="In place of the one known or assumed.")
@click.option("--dead-time", type=options.Number(0.0, 1e9), metavar="S", help="In place of the one known or assumed.")
@options.overwrite
@options.seed("Of the pixels that --every keeps.")
@options.quiet
def command(
    layout, source, out, start, end, every, views, camera, time_offset, on_threshold, off_threshold, dead_time,
    overwrite, seed, quiet,
):  # fmt: skip
    """Write the dataset OUT, which `pixelid reconstruct` reads, from published raw data IN.

    \b
    esim    a bag of rpg_esim, or a folder with one (and esim.conf, views/)
    eds     a sequence of EDS: events.h5, stamped_groundtruth.txt, images/, Kalibr's calibration
    tumvie  a sequence of TUM-VIE: *events_left.h5, mocap_data.txt, two calibrations, left_images/

    Events are read piece by piece, whatever their number.  Lens distortion of the sensor goes into the dataset's
    calibration, that of pictures is undone.  Writes dataset.json, a figure and report.html next to the data.
    """
    from pixelid.cli.progress import bar
    from pixelid.cli.terminal import say_result
    from pixelid.outputs import claimed

    with claimed(out, overwrite, [source]):
        from pixelid.api_scenes import dataset

        with bar(quiet) as report:
            result = dataset(
                layout, source, out, start=start, end=end, every=every, views=views, camera=camera,
                time_offset=time_offset, on_threshold=on_threshold, off_threshold=off_threshold, dead_time=dead_time,
                overwrite=overwrite, seed=seed, progress=report,
            )  # fmt: skip
    if not quiet:
        say_result(result, out)
    return result.status.exit_code
