"""`pixelid demo`: the whole story on embedded data."""

from __future__ import annotations

from pathlib import Path

import click

EXAMPLE = """
\b
Example:
    pixelid demo --out demo-out
"""


@click.command("demo", epilog=EXAMPLE)
@click.option("--out", type=click.Path(path_type=Path), default=Path("demo-out"), show_default=True)
@click.option("--overwrite", is_flag=True, help="Replace --out when it exists.")
@click.option("--seed", type=int, default=1, show_default=True, help="Of the hidden camera and its session.")
@click.option("--quiet", is_flag=True, help="No progress, no table.")
def command(out: Path, overwrite: bool, seed: int, quiet: bool) -> int:
    """Simulate a calibration session of a hidden camera, fit it, and compare with the truth."""
    from pixelid.cli.progress import bar
    from pixelid.outputs import refuse_existing, whole_folder

    refuse_existing(out, overwrite)
    with bar(quiet) as report:
        from pixelid.demo.demo import run_demo

        with whole_folder(out, overwrite) as folder:
            demo = run_demo(folder, seed, report)
    if not quiet:
        from rich.console import Console

        from pixelid.fit.table import fit_table

        console = Console()
        console.print(fit_table(demo.result, demo.truth.values))
        console.print(
            f"{demo.result.status} in {demo.result.seconds:.1f} s; open {out / 'report.html'}", highlight=False
        )
    return 0 if demo.result.status == "converged" else 1
