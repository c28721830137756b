"""`pixelid biases`: a quantity of the pixel against the codes of one bias or two."""

from __future__ import annotations

import click

from pixelid.cli import options

EXAMPLE = """
\b
Example:
    pixelid biases dead_time_vs_refr.csv --at bias_refr=10 --out biases
    pixelid biases other_codes.csv --model biases --predict --out check
    pixelid fit session --model imx636 --bias-laws biases --out fit
"""


@click.command("biases", epilog=EXAMPLE)
@click.argument("tables", nargs=-1, required=True, type=options.PATH)
@options.out()
@options.model(False, "What --predict evaluates: a folder of laws, or a shipped circuit.", type=options.PATH)
@click.option("--predict", is_flag=True, help="Evaluate --model on the tables instead of fitting.")
@click.option("--at", multiple=True, metavar="BIAS=CODE,…", help="Predict a setting; may be repeated.")
@click.option("--quantity", multiple=True, metavar="COLUMN", help="What was measured [the column named as one].")
@click.option("--bias", multiple=True, metavar="COLUMN", help="Codes [columns named bias_…].")
@click.option("--unit", type=click.Choice(["s", "ms", "us", "ns", "hz", "khz", "mhz", "log"]),
              help="Of the quantity [what its column's name ends in].")  # fmt: skip
@options.overwrite
@options.seed("Of the draws behind intervals.")
@options.quiet
def command(tables, out, model, predict, at, quantity, bias, unit, overwrite, seed, quiet):
    """Fit laws of bias codes to TABLES (CSV: columns bias_…, and dead_time_us, threshold, cutoff_hz or latency_us).

    Forms that follow from what a bias does are compared; predictions have intervals, also at codes that were not
    measured. A column `polarity` parts ON and OFF; maps of thresholds (.npz: on_SETTING, off_SETTING) give the kind of
    mismatch; folders of `pixelid rates` are tables of cutoffs. Writes biases.json, a figure per quantity, report.html.
    """
    from pixelid.cli.progress import bar
    from pixelid.cli.terminal import say_result
    from pixelid.errors import InputError
    from pixelid.outputs import claimed

    if predict != (model is not None):
        raise InputError("--predict: expected --model with it" if predict else "--model: expected --predict with it")
    with claimed(out, overwrite, [*tables, *([model] if model else [])]):
        from pixelid.tables.biases.reading import Stated
        from pixelid.tables.biases.result import bias_laws

        with bar(quiet) as report:
            result = bias_laws(tables, laws=model, at=at, stated=Stated(quantity, bias, unit), seed=seed,
                               progress=report)  # fmt: skip
        result.report(out, overwrite=overwrite)
    if not quiet:
        say_result(result, out)
    return result.status.exit_code
