"""`pixelid lowlight`: dominant-pole analysis over radiance."""

from __future__ import annotations

from pathlib import Path

import click

from pixelid.cli import options

EXAMPLE = """
\b
Example:
    pixelid lowlight dvs128 --out lowlight
    pixelid simulate dvs128 --stimulus steps --out steps.h5
    pixelid lowlight dvs128 steps.h5 --with dark_current:radiance=4 --out lowlight-dark
    pixelid lowlight gen31 --latency fits/gen31.toml --out lowlight-gen31
"""


@click.command("lowlight", epilog=EXAMPLE)
@click.argument("model")
@click.argument("recordings", nargs=-1, metavar="[REC]…", type=options.PATH)
@options.out()
@click.option("--latency", multiple=True, type=options.PATH, metavar="TABLE",
              help="Latencies of the sensor: CSV tables (repeatable), a recipe, or the folder of a fit.")  # fmt: skip
@click.option("--camera", help="Which camera of the --latency tables the model is.")
@options.with_effect
@options.without
@options.set_value
@options.reading
@options.overwrite
@options.seed("Of the draws and simulations.")
@options.quiet
def command(model, recordings, out, latency, camera, with_, without, set_, overwrite, seed, quiet):
    """Say where one pole describes the photoreceptor of MODEL (shipped, .toml or fit folder), and where it does not.

    With recordings of chirps or steps, REC…, their measured bandwidth or step time is put next to the model's; with
    --latency, the dominant pole in each light of the table, where its delay goes as one over the light, and which stage
    limits where. A folder of `pixelid latency` brings its own table. Writes lowlight.json, figures and report.html.
    """
    from pixelid.cli.progress import bar
    from pixelid.cli.terminal import say_result
    from pixelid.outputs import claimed

    with claimed(out, overwrite, [*recordings, model, *latency]):
        from pixelid.inputs import check_given

        check_given(recordings, [model], with_=with_, without=without, set_=set_)
        from pixelid.fit.draws import read_fit
        from pixelid.model.options import changed
        from pixelid.model.shipped import find_model, model_files
        from pixelid.recordings import open_recordings

        circuit_model, remarks = changed(find_model(model), with_, without, set_)
        opened = open_recordings(recordings)
        from pixelid.lowlight.result import lowlight_report

        with bar(quiet, compiles=True) as report:
            result = lowlight_report(
                circuit_model, opened, fitted=read_fit(Path(model)), sources=model_files(model), latency=latency,
                camera=camera, seed=seed, progress=report,
            )  # fmt: skip
            result.report(out, overwrite=overwrite)
    if not quiet:
        say_result(result, out, remarks)
    return result.status.exit_code
