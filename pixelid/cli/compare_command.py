"""`pixelid compare`: which of several models the recordings support."""

from __future__ import annotations

import click

from pixelid.cli import options

EXAMPLE = """
\b
Example:
    pixelid compare session/ --model dvs128 --model photoreceptor --model dvs128_low_light --out compare
"""


@click.command("compare", epilog=EXAMPLE)
@options.recordings
@click.option(
    "--model", "models", multiple=True, required=True, help="A shipped model, a file or a fit folder; repeat."
)
@options.out("Folder for compare.json and report.html.")
@click.option(
    "--folds", type=click.IntRange(2, 1000), default=2, show_default=True, help="Parts the pixels are dealt into."
)
@click.option("--sample", is_flag=True, help="Also PSIS-LOO over pixels, from posteriors.")
@options.reading
@options.overwrite
@options.seed()
@options.quiet
def command(recordings, models, out, folds, sample, overwrite, seed, quiet):
    """Fit every MODEL to RECORDINGS and judge it on pixels that its fit has not seen."""
    from pixelid.cli.progress import bar
    from pixelid.cli.terminal import say_result
    from pixelid.inputs import check_given
    from pixelid.outputs import claimed

    with claimed(out, overwrite, [*recordings, *models]):
        check_given(recordings, models)
        from pixelid.api_analyses import compare

        with bar(quiet, compiles=True) as report:
            result = compare(recordings, models, folds=folds, sample=sample, seed=seed, progress=report)
        result.report(out, overwrite=overwrite)
    if not quiet:
        say_result(result, out)
    return result.status.exit_code
