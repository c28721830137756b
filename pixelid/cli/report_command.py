"""`pixelid report`: one page for a result folder."""

from __future__ import annotations

from pathlib import Path

import click

EXAMPLE = """
\b
Example:
    pixelid report fit
"""


@click.command("report", epilog=EXAMPLE)
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--seed", type=int, default=0, hidden=True)
@click.option("--quiet", is_flag=True, help="Print nothing.")
def command(folder: Path, seed: int, quiet: bool) -> None:
    """Write report.html into the result FOLDER."""
    from pixelid.report.html import write_report

    path = write_report(folder)
    if not quiet:
        click.echo(path)
