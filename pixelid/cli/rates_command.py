"""`pixelid rates`: fit tables of event rate against the frequency of a blinking light."""

from __future__ import annotations

from pathlib import Path

import click

EXAMPLE = """
\b
Example:
    pixelid rates rate_vs_frequency.csv --unit mev/s --out rates
    pixelid rates fits/led_rate_vs_frequency_evk4.toml --data recordings --out evk4
"""


@click.command("rates", epilog=EXAMPLE)
@click.argument("source", type=click.Path(path_type=Path))
@click.option("--out", required=True, type=click.Path(path_type=Path), help="Folder for the result.")
@click.option("--unit", type=click.Choice(["hz", "kev/s", "mev/s"]), default="hz", show_default=True,
              help="Of the rates in a CSV.")  # fmt: skip
@click.option("--data", type=click.Path(path_type=Path), help="Where a recipe's files are; default: beside the recipe.")
@click.option("--overwrite", is_flag=True, help="Replace --out when it exists.")
@click.option("--seed", type=int, default=0, hidden=True)
@click.option("--quiet", is_flag=True, help="Print nothing.")
def command(source, out, unit, data, overwrite, seed, quiet):
    """Fit SOURCE: a CSV (freq_hz, one column per setting; one pixel) or a recipe .toml (a light's whole image).

    A CSV gives bandwidth, dead time and noise per column; a recipe gives how the image's pixels spread in bandwidth.
    Writes rates.json (with the cells that disagree, in words), rates.svg and report.html.
    """
    from pixelid.errors import InputError
    from pixelid.outputs import refuse_existing, whole_folder
    from pixelid.report.html import write_report
    from pixelid.tables.rates.pixel import fit_pixel
    from pixelid.tables.rates.pool import fit_pool
    from pixelid.tables.rates.reading import read_table
    from pixelid.tables.rates.recipe import read_pool_recipe
    from pixelid.tables.rates.result import save_pixel, save_pool

    refuse_existing(out, overwrite)
    if not source.is_file():
        raise InputError(f"{source}: no such file")
    if source.suffix == ".toml":
        table, file = read_pool_recipe(source, data)
        fit = fit_pool(table)
        with whole_folder(out, overwrite) as folder:
            found = save_pool(fit, folder, file)
            write_report(folder)
    else:
        pixel = fit_pixel(read_table(source, unit))
        with whole_folder(out, overwrite) as folder:
            found = save_pixel(pixel, folder)
            write_report(folder)
    if not quiet:
        for name, v in found["parameters"].items():
            known = "" if v["identified"] else "   not identified"
            click.echo(f"{name:32s} {v['value']:10.4g} {v['unit']}{known}")
        click.echo(f"relative scatter {100 * found['relative_scatter']:.1f} %")
        for sentence in found["disagreements"]:
            click.echo(f"- {sentence}")
    return 0 if found["status"] == "converged" else 1
