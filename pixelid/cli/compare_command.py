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
    from pixelid.outputs import claimed, whole_folder

    with claimed(out, overwrite, [*recordings, *models]):
        from pixelid.inputs import check_given
        from pixelid.model.shipped import find_model
        from pixelid.recordings import open_recordings

        check_given(recordings)
        circuits, opened = [find_model(name) for name in models], open_recordings(recordings)
        from pixelid.compare import compare
        from pixelid.compare.figures import draw_held_out
        from pixelid.figures.style import save_figure
        from pixelid.report.html import write_report

        with bar(quiet, compiles=True) as report:
            outcome = compare(opened, circuits, folds=folds, seed=seed, posteriors=sample, progress=report)
        with whole_folder(out, overwrite) as folder:
            outcome.write(folder)
            save_figure(draw_held_out(outcome.as_dict()), folder / "held_out.svg")
            write_report(folder)
    if not quiet:
        say_result(outcome, out)
    return outcome.status.exit_code
