"""`pixelid compare`: which of several models the recordings support."""

from __future__ import annotations

from pathlib import Path

import click

EXAMPLE = """
\b
Example:
    pixelid compare session/ --model dvs128 --model photoreceptor --model dvs128_low_light --out compare
"""


@click.command("compare", epilog=EXAMPLE)
@click.argument("recordings", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--model", "models", multiple=True, required=True, help="A shipped model, a file or a fit folder; repeat."
)
@click.option("--out", required=True, type=click.Path(path_type=Path), help="Folder for compare.json and report.html.")
@click.option(
    "--folds", type=click.IntRange(min=2), default=2, show_default=True, help="Parts the pixels are dealt into."
)
@click.option("--sample", is_flag=True, help="Also PSIS-LOO over pixels, from posteriors.")
@click.option("--overwrite", is_flag=True, help="Replace --out when it exists.")
@click.option("--seed", type=int, default=0, show_default=True)
@click.option("--quiet", is_flag=True, help="No progress, no table.")
def command(recordings, models, out, folds, sample, overwrite, seed, quiet):
    """Fit every MODEL to RECORDINGS and judge it on pixels that its fit has not seen."""
    from pixelid.cli.progress import bar
    from pixelid.compare import compare
    from pixelid.compare.figures import draw_held_out
    from pixelid.figures.style import save_figure
    from pixelid.model.shipped import find_model
    from pixelid.outputs import refuse_existing, whole_folder, write_json
    from pixelid.provenance import provenance
    from pixelid.recordings import open_recordings
    from pixelid.report.html import write_report

    refuse_existing(out, overwrite)
    found = [find_model(name) for name in models]
    with bar(quiet) as report:
        opened = open_recordings(recordings)
        sources = [recording.source for recording in opened if recording.source is not None]
        outcome = compare(opened, found, folds=folds, seed=seed, posteriors=sample, progress=report)
    with whole_folder(out, overwrite) as folder:
        result = {**outcome.as_dict(), "seed": seed, **provenance(*sources)}
        write_json(folder / "compare.json", result)
        save_figure(draw_held_out(result), folder / "held_out.svg")
        write_report(folder)
    if not quiet:
        from rich.console import Console
        from rich.table import Table

        table = Table(title="held-out pixels, nats")
        for heading in ("model", "free", "held-out", "behind the best", "BIC"):
            table.add_column(heading, justify="left" if heading == "model" else "right")
        for name, row in outcome.as_dict()["models"].items():
            behind = f"{row['behind_best_nats']:.4g} ± {row['behind_best_se']:.2g}"
            table.add_row(
                name, str(row["free_parameters"]), f"{row['held_out_log_likelihood']:.1f}", behind, f"{row['bic']:.1f}"
            )
        console = Console()
        console.print(table)
        console.print(outcome.sentence, highlight=False)
    return 0
