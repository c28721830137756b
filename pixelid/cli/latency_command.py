"""`pixelid latency`: first-event latencies against irradiance, threshold setting and edge."""

from __future__ import annotations

import click

from pixelid.cli import options

EXAMPLE = """
\b
Example:
    pixelid latency fits/nist_latency/nist_latency_by_roi.csv --out latency
    pixelid latency other_irradiances.csv --model latency --predict --out check
    pixelid latency fits/imx636.toml --out imx636
"""


@click.command("latency", epilog=EXAMPLE)
@click.argument("tables", nargs=-1, required=True, type=options.PATH)
@options.out()
@options.model(
    False, "What --predict evaluates, or where a fit begins: a shipped model, a model file, or a fit folder."
)
@click.option("--predict", is_flag=True, help="Evaluate --model on the tables instead of fitting.")
@click.option("--camera", help="Only the rows of this camera.")
@click.option("--sample", is_flag=True, help="Sample the posterior with emcee.")
@options.overwrite
@options.seed("Of the sampling.")
@options.quiet
def command(tables, out, model, predict, camera, sample, overwrite, seed, quiet):
    """Fit TABLES (CSV: camera, lens, polarity, irradiance_W_m2, bias_config, min, median, max, stdev in µs).

    One circuit per camera, radiance in W/m²; thresholds and delays per setting. A recipe (.toml) says which cameras of
    its tables are of one kind, fits them as one, and names the model. Writes latency.json (rows with measured
    and predicted seconds, which stage limits where, what stays open), model.toml (one folder per camera where there are
    several), figures and report.html.
    """
    from pixelid.cli.progress import bar
    from pixelid.cli.terminal import say_result
    from pixelid.outputs import claimed

    with claimed(out, overwrite, [*tables, *([model] if model else [])]):
        from pixelid.api_tables import latency

        with bar(quiet) as report:
            result = latency(
                tables, model=model, predict=predict, camera=camera, sample=sample, seed=seed, progress=report
            )
        result.report(out, overwrite=overwrite)
    if not quiet:
        say_result(result, out)
    return result.status.exit_code
