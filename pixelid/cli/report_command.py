"""`pixelid report`: one page for a result folder."""

from __future__ import annotations

from pathlib import Path

import click

from pixelid.cli import options

EXAMPLE = """
\b
Example:
    pixelid report fit
"""


@click.command("report", epilog=EXAMPLE)
@click.argument("folder", type=options.PATH)
@options.no_seed
@options.quiet
def command(folder: Path, seed: int, quiet: bool) -> None:
    """Write report.html into the result FOLDER."""
    from pixelid.cli.terminal import say
    from pixelid.report.html import write_report

    path = write_report(folder, command="")
    if not quiet:
        say(str(path))
