"""`pixelid sensor`: maps of thresholds and bandwidth over a whole sensor."""

from __future__ import annotations

from pathlib import Path

import click

EXAMPLE = """
\b
Example:
    pixelid simulate dvs128 --stimulus chirp --out chirp.h5 --pixels 400
    pixelid sensor chirp.h5 --model dvs128 --out maps --workers 2
    pixelid sensor chirp.h5 --model fit --out maps --cluster tcp://10.0.0.1:8786
"""


@click.command("sensor", epilog=EXAMPLE)
@click.argument("recordings", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--model", required=True, help="The population's values: a fit folder, a model file or a shipped model.")
@click.option("--out", required=True, type=click.Path(path_type=Path), help="Folder for the result.")
@click.option(
    "--bandwidth", default="sf_cutoff_hz", show_default=True, help='Parameter to map; "none": thresholds alone.'
)
@click.option(
    "--block", type=click.IntRange(1), default=1, show_default=True, help="Side of pixel groups with one bandwidth."
)
@click.option("--tile", type=click.IntRange(1), default=32, show_default=True, help="Side of the units of work.")
@click.option("--bootstrap", type=click.IntRange(0), default=200, show_default=True, help="Replicates over pixels.")
@click.option("--workers", type=click.IntRange(0), default=0, help="Local Dask processes; 0: this process alone.")
@click.option("--cluster", default="", metavar="tcp://HOST:PORT", help="A running Dask scheduler.")
@click.option("--overwrite", is_flag=True, help="Replace --out when it exists.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True)
@click.option("--quiet", is_flag=True, help="No progress, no table.")
def command(recordings, model, out, bandwidth, block, tile, bootstrap, workers, cluster, overwrite, seed, quiet):
    """Map thresholds and a bandwidth over the sensor of RECORDINGS (files or folders, full-field light).

    Every pixel is estimated, the population fitted, and each pixel shrunk towards it by what its own events say.
    Writes sensor.json, maps.npz, a figure per map and report.html.  Finished tiles stay in OUT.tiles until the end,
    so an interrupted run continues when started again.
    """
    import shutil

    from pixelid.cli.progress import bar
    from pixelid.errors import InputError
    from pixelid.model.shipped import find_model
    from pixelid.outputs import refuse_existing, whole_folder
    from pixelid.recordings import open_recordings
    from pixelid.report.html import write_report
    from pixelid.sensors import fit_sensor
    from pixelid.sensors.saving import save
    from pixelid.sensors.work import Where

    if cluster and workers:
        raise InputError("--cluster and --workers exclude each other")
    refuse_existing(out, overwrite)
    keep = out.with_name(out.name + ".tiles")
    with bar(quiet) as report:
        fit = fit_sensor(
            open_recordings(recordings),
            find_model(model),
            bandwidth="" if bandwidth == "none" else bandwidth,
            block=block,
            tile=tile,
            replicates=bootstrap,
            where=Where(cluster, workers),
            keep=keep,
            seed=seed,
            progress=report,
        )
    with whole_folder(out, overwrite) as folder:
        save(fit, folder)
        write_report(folder)
    shutil.rmtree(keep, ignore_errors=True)
    found = fit.as_dict()
    if not quiet:
        from rich.console import Console
        from rich.table import Table

        table = Table(title=f"{found['pixels_with_events']} pixels, {found['events']} events, {found['seconds']:.1f} s")
        for heading in ("parameter", "mean", "spread", "error alone", "error shrunk", "pixels without"):
            table.add_column(
                heading, justify="left" if heading == "parameter" else "right", no_wrap=heading == "parameter"
            )
        for name, entry in found["maps"].items():
            percent = [entry["relative_spread"], entry["typical_error_before"], entry["typical_error_after"]]
            cells = ["–" if v is None else f"{100 * v:.2g} %" for v in percent]
            table.add_row(name, f"{entry['mean']:.4g} {entry['unit']}", *cells, str(entry["without_estimate"]))
        Console().print(table)
        if found["advice"]:
            click.echo(found["advice"])
    return 0 if found["status"] == "converged" else 1
