"""`pixelid demo`: the whole story on embedded data."""

from __future__ import annotations

from pathlib import Path

import click

from pixelid.cli import options

EXAMPLE = """
\b
Example:
    pixelid demo --out demo-out
"""


@click.command("demo", epilog=EXAMPLE)
@options.out(default=Path("demo-out"), show_default=True)
@options.overwrite
@options.seed("Of the hidden camera and its session.", default=1)
@options.quiet
def command(out: Path, overwrite: bool, seed: int, quiet: bool) -> int:
    """Simulate a calibration session of a hidden camera, fit it, and compare with the truth."""
    from pixelid.cli.progress import bar
    from pixelid.cli.terminal import say
    from pixelid.outputs import claimed, whole_folder

    with claimed(out, overwrite), bar(quiet) as report:
        from pixelid.demo.demo import run_demo

        with whole_folder(out, overwrite) as folder:
            demo = run_demo(folder, seed, report)
    if not quiet:
        from pixelid.results import Table, number

        rows = tuple(
            (name, number(demo.truth.values.get(name)), number(e.value)) for name, e in demo.result.estimates.items()
        )
        truth = Table("the hidden camera", ("parameter", "truth", "fit"), rows, frozenset({"parameter"}))
        say(demo.result.summary(), truth.text(), f"open {out / 'report.html'}")
    return demo.result.status.exit_code
