"""`pixelid dataset`: published raw data in the layout that `pixelid reconstruct` reads."""

from __future__ import annotations

import click

from pixelid.cli import options
from pixelid.nerf.options import DatasetOptions

LAYOUTS = ("esim", "eds", "tumvie")
EXAMPLE = """
\b
Example:
    pixelid dataset esim sequence/esim.bag scene
    pixelid dataset eds 08_peanuts_running/ scene --start 2 --end 6
    pixelid dataset tumvie mocap-desk2/ scene --camera right --every 4
    pixelid reconstruct scene --out sharp --bandwidth off
"""


@click.command("dataset", epilog=EXAMPLE)
@click.argument("layout", type=click.Choice(LAYOUTS))
@click.argument("source", metavar="IN", type=options.PATH)
@click.argument("out", type=options.NEW)
@options.of(DatasetOptions)
@options.overwrite
@options.quiet
def command(layout, source, out, asked, overwrite, quiet):
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
            result = dataset(layout, source, out, overwrite=overwrite, progress=report, **vars(asked))
    if not quiet:
        say_result(result, out)
    return result.status.exit_code
