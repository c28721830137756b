"""`pixelid calibrate`: from a bench to a checked model, in one command."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import click

from pixelid.cli import options

EXAMPLE = """
\b
Example:
    pixelid check bench/
    pixelid calibrate bench/ --out camera
"""


@click.command("calibrate", epilog=EXAMPLE)
@click.argument("bench", metavar="BENCH", type=options.PATH)
@options.out()
@options.model(required=False)
@options.stated
@options.bench
@click.option("--sample", is_flag=True, help="Also draw from the posterior of the final fit: posterior.nc and plots.")
@options.overwrite
@options.seed()
@options.quiet
def command(
    bench: Path,
    stated,
    out: Path,
    model: Path | None,
    roi,
    pixels,
    sample: bool,
    overwrite: bool,
    seed: int,
    quiet: bool,
) -> int:
    """Calibrate the pixel from BENCH: a folder of recordings and light traces, or a bench.toml.

    Reads and aligns, fits, finds what is missing, fits circuit and bench together again, and says what to record next.
    Writes calibration.json, model.toml, figures and report.html.  Interrupted, it goes on with the stage it was in.
    """
    from pixelid.bench.files import find_bench
    from pixelid.cli.progress import bar
    from pixelid.cli.terminal import say_result
    from pixelid.model.shipped import find_model
    from pixelid.outputs import claimed, whole_folder

    found = find_bench(bench)
    found = replace(found, source=stated.over(found.source))
    start = None if model is None else find_model(model)
    with claimed(out, overwrite, [*found.paths, *([model] if model else [])]):
        from pixelid.bench.calibrate import calibrate
        from pixelid.report.html import write_report

        kept = out.with_name(f".{out.name}.stages")  # interrupted and called again, finished stages are read back
        with bar(quiet, compiles=True) as report, _without_leftovers(kept):
            result = calibrate(found, model=start, roi=roi, pixels=pixels, seed=seed, resume=kept, progress=report)
            if sample:
                from pixelid.sample.sample import sample as draw

                posterior = draw(result.fit, result.recordings, seed=seed, progress=report)
        with whole_folder(out, overwrite) as folder:
            result.write(folder)
            if sample:
                posterior.write(folder)
            result.write_figures(folder)
            write_report(folder)
        shutil.rmtree(kept, ignore_errors=True)
    if not quiet:
        say_result(result, out)
    return result.status.exit_code


@contextmanager
def _without_leftovers(kept: Path) -> Iterator[None]:
    """Remove the stages that are kept where a run fails: only an interrupted one is continued."""
    try:
        yield
    except Exception:
        shutil.rmtree(kept, ignore_errors=True)
        raise
