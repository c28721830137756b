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
    from pixelid.cli.terminal import say, say_page, say_sentences
    from pixelid.errors import InputError
    from pixelid.outputs import claimed, whole_folder

    if not source.exists():
        raise InputError(f"{source}: no such file")
    with claimed(out, overwrite, [source]):
        from pixelid.report.html import write_report
        from pixelid.tables.rates.bias_law import biases_of
        from pixelid.tables.rates.pixel import fit_pixel
        from pixelid.tables.rates.pool import fit_pool
        from pixelid.tables.rates.reading import read_table
        from pixelid.tables.rates.recipe import read_pool_recipe
        from pixelid.tables.rates.result import save_pixel, save_pool

        if source.suffix == ".toml":
            if bias_law:
                raise InputError("--bias-law: for a CSV of one pixel, not for a recipe")
            table, file = read_pool_recipe(source, data)
            fit = fit_pool(table)
            with whole_folder(out, overwrite) as folder:
                written = save_pool(fit, folder, file)
                write_report(folder)
        else:
            table = read_table(source, unit)
            if bias_law:
                biases_of(table.columns)
            pixel = fit_pixel(table)
            with whole_folder(out, overwrite) as folder:
                written = save_pixel(pixel, folder, bias_law)
                write_report(folder)
    if not quiet:
        for name, v in written["parameters"].items():
            say(f"{name:32s} {v['value']:10.4g} {v['unit']:12s} {written['precision'][name]}")
        say(f"relative scatter {100 * written['relative_scatter']:.1f} %")
        say_sentences(written.get("bias_law", {}).get("sentences", []))
        say_sentences(written["disagreements"])
        say_page(out)
    return written["status"].exit_code
