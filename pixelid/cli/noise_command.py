"""`pixelid noise`: noise events of still scenes against light."""

from __future__ import annotations

import click

from pixelid.cli import options

EXAMPLE = """
\b
Example:
    pixelid noise noise_vs_lux.csv --out noise
    pixelid noise other_lights.csv --model noise --predict --out check
    pixelid noise dark.h5 dim.h5 bright.h5 --model dvs128 --out noise
"""


@click.command("noise", epilog=EXAMPLE)
@click.argument("sources", nargs=-1, required=True, type=options.PATH)
@options.out()
@options.model(False, "Where a fit starts, and what --predict evaluates; default: dvs128.")
@click.option("--predict", is_flag=True, help="Evaluate --model on the rates instead of fitting.")
@options.reading
@options.overwrite
@options.seed("No effect on this command.")
@options.quiet
def command(sources, out, model, predict, overwrite, seed, quiet):
    """Fit noise rates of SOURCES: tables (CSV: light, ON and OFF events per pixel and second) or still recordings.

    The circuit's own noise, through all its stages and resets, gives rates against light: thresholds over noise,
    bandwidth, dark current, leak. Writes noise.json (rows with measured and predicted events/s), model.toml, noise.svg
    and report.html.
    """
    from pixelid.cli.progress import bar
    from pixelid.cli.terminal import say_result
    from pixelid.outputs import claimed

    with claimed(out, overwrite, [*sources, *([model] if model else [])]):
        from pixelid.api_tables import noise

        with bar(quiet) as report:
            result = noise(sources, model=model, predict=predict, seed=seed, progress=report)
        result.report(out, overwrite=overwrite)
    if not quiet:
        say_result(result, out)
    return result.status.exit_code
