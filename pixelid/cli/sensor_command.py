"""`pixelid sensor`: maps of thresholds and bandwidth over a whole sensor."""

from __future__ import annotations

import click

from pixelid.cli import options

EXAMPLE = """
\b
Example:
    pixelid simulate dvs128 --stimulus chirp --out chirp.h5 --pixels 400
    pixelid sensor chirp.h5 --model dvs128 --out maps --workers 2
    pixelid sensor chirp.h5 --model fit --out maps --cluster tcp://10.0.0.1:8786
"""


@click.command("sensor", epilog=EXAMPLE)
@options.recordings
@options.model(help="The population's values: a fit folder, a model file or a shipped model.")
@options.out()
@click.option(
    "--bandwidth",
    default="sf_cutoff_hz",
    show_default=True,
    help='Parameter to map; "none": thresholds alone, as for a model without it.',
)
@click.option(
    "--block", type=options.SIDE, default=1, show_default=True, help="Side of pixel groups with one bandwidth."
)
@click.option("--tile", type=options.SIDE, default=32, show_default=True, help="Side of the units of work.")
@click.option(
    "--bootstrap", type=click.IntRange(0, 1_000_000), default=200, show_default=True, help="Replicates over pixels."
)
@options.where
@options.crop
@options.reading
@options.overwrite
@options.seed()
@options.quiet
@click.pass_context
def command(
    context, recordings, model, out, bandwidth, block, tile, bootstrap, where, crop, overwrite, seed, quiet,
):  # fmt: skip
    """Map thresholds and a bandwidth over the sensor of RECORDINGS (files or folders, full-field light).

    Every pixel is estimated, the population fitted, and each pixel shrunk towards it by what its own events say.
    Writes sensor.json, maps.npz, a figure per map and report.html.  Finished tiles stay in OUT.tiles until the end,
    so an interrupted run continues when started again.
    """
    import shutil

    from pixelid.cli.progress import bar
    from pixelid.cli.terminal import say_result
    from pixelid.interruption import keeping
    from pixelid.outputs import claimed

    keep = out.with_name(out.name + ".tiles")
    with claimed(out, overwrite, [*recordings, model]):
        from pixelid.inputs import check_given
        from pixelid.model.shipped import find_model
        from pixelid.recordings import open_recordings

        circuit = find_model(model)
        if bandwidth not in circuit.parameters and not options.is_given(context, "bandwidth"):
            bandwidth = "none"
        check_given(recordings)  # before anything slow is imported
        opened = open_recordings(recordings, crop, seed)
        from pixelid.sensors import fit_sensor

        with keeping(keep, "tiles"), bar(quiet, compiles=True) as report:
            fit = fit_sensor(
                opened,
                circuit,
                bandwidth="" if bandwidth == "none" else bandwidth,
                block=block,
                tile=tile,
                replicates=bootstrap,
                where=where,
                keep=keep,
                seed=seed,
                progress=report,
            )
        fit.report(out, overwrite=overwrite)
        shutil.rmtree(keep, ignore_errors=True)
    if not quiet:
        say_result(fit, out)
    return fit.status.exit_code
