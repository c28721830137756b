"""`pixelid rates`: fit tables of event rate against the frequency of a blinking light."""

from __future__ import annotations

import click

from pixelid.cli import options

EXAMPLE = """
\b
Example:
    pixelid rates rate_vs_frequency.csv --unit mev/s --out rates
    pixelid rates rate_vs_bias.csv --bias-law --out rates
    pixelid rates fits/led_rate_vs_frequency_evk4.toml --data recordings --out evk4
"""


@click.command("rates", epilog=EXAMPLE)
@click.argument("source", type=options.PATH)
@options.out()
@click.option("--unit", type=click.Choice(["hz", "kev/s", "mev/s"]),
              help="Of the rates in a CSV; default: what its header says, hz where it says nothing.")  # fmt: skip
@click.option(
    "--bias-law", is_flag=True, help="Columns end in a bias in mV (fo1477): one law for their cutoffs, and κ."
)
@click.option("--data", type=options.PATH, help="Where a recipe's files are; default: the recipe's folder.")
@options.overwrite
@options.no_seed
@options.quiet
def command(source, out, unit, bias_law, data, overwrite, seed, quiet):
    """Fit SOURCE: a CSV (freq_hz, one column per setting; one pixel) or a recipe .toml (a light's whole image).

    A CSV gives bandwidth, dead time and noise per column; a recipe gives how the image's pixels spread in bandwidth.
    Writes rates.json (with the cells that disagree, in words), rates.svg and report.html.
    """
    from pixelid.cli.terminal import say_result
    from pixelid.outputs import claimed

    with claimed(out, overwrite, [source]):
        from pixelid.api_tables import rates

        result = rates(source, unit=unit, bias_law=bias_law, data=data)
        result.report(out, overwrite=overwrite)
    if not quiet:
        say_result(result, out)
    return result.status.exit_code
