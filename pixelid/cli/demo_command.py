"""`pixelid demo`: calibrate the bench session that comes with the package."""

from __future__ import annotations

import shutil
from pathlib import Path

import click

from pixelid.cli import options

EXAMPLE = """
\b
Example:
    pixelid demo --out demo-out
    pixelid demo --only-bench --out bench      # the session's files, to calibrate yourself
"""


@click.command("demo", epilog=EXAMPLE)
@options.out(default=Path("demo-out"), show_default=True)
@click.option("--only-bench", is_flag=True, help="Only copy the session's files to DIR.")
@options.overwrite
@options.seed()
@options.quiet
def command(out: Path, only_bench: bool, overwrite: bool, seed: int, quiet: bool) -> int:
    """Calibrate a bench session of a hidden camera that comes with pixelid, and compare the result with the truth.

    The session is as `pixelid calibrate` takes it: raw events, a photodiode's traces, clocks apart, one missing effect.
    """
    from pixelid.cli.progress import bar
    from pixelid.cli.terminal import columns, say
    from pixelid.outputs import claimed, whole_folder
    from pixelid.results import wrapped

    with claimed(out, overwrite):
        from pixelid.demo.demo import copy_bench, run_demo

        if only_bench:
            with whole_folder(out, overwrite) as folder:
                copy_bench(folder)
            return 0
        kept = out.with_name(f".{out.name}.stages")  # interrupted and called again, finished stages are read back
        with bar(quiet, compiles=True) as report, whole_folder(out, overwrite) as folder:
            demo = run_demo(folder, seed, report, kept)
        shutil.rmtree(kept, ignore_errors=True)
    if not quiet:
        sentences = (wrapped(text, columns()) for text in (demo.result.sentence, demo.sentence))
        say(next(sentences), demo.table().text(width=columns()), next(sentences), str(out / "report.html"))
    return demo.result.status.exit_code
