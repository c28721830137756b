"""`pixelid gap`: which effect a model lacks."""

from __future__ import annotations

from pathlib import Path

import click

EXAMPLE = """
\b
Example:
    pixelid simulate dvs128 --stimulus chirp --out session/chirp.h5 --pixels 25 --with leak:rate_hz=1
    pixelid simulate dvs128 --stimulus steps --out session/steps.h5 --pixels 25 --with leak:rate_hz=1
    pixelid gap session/ --model dvs128 --out gap
"""


@click.command("gap", epilog=EXAMPLE)
@click.argument("recordings", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--model", required=True, help="A shipped model, a model file, or a fit folder.")
@click.option("--out", required=True, type=click.Path(path_type=Path), help="Folder for the result.")
@click.option("--with", "with_", multiple=True, metavar="EFFECT[:param=value,…]", help="Add an effect to the base.")
@click.option("--without", multiple=True, metavar="EFFECT", help="Remove an effect from the base.")
@click.option("--alpha", type=float, default=0.01, show_default=True, help="Chance of a false alarm.")
@click.option("--overwrite", is_flag=True, help="Replace --out when it exists.")
@click.option("--seed", type=int, default=0, show_default=True)
@click.option("--quiet", is_flag=True, help="No progress, no table.")
def command(recordings, model, out, with_, without, alpha, overwrite, seed, quiet):
    """Find where a model and RECORDINGS (files or folders) disagree, and which effect is missing.

    The verdict is none, named, ambiguous or unknown.  Writes gap.json, model.toml (the grown model), figures and
    report.html.  Interrupted, it keeps the fits it has made, and goes on there when called again.
    """
    from pixelid.cli.progress import bar
    from pixelid.gap.figures import write_figures
    from pixelid.gap.gap import gap
    from pixelid.model.options import changed
    from pixelid.model.shipped import find_model
    from pixelid.outputs import refuse_existing, whole_folder
    from pixelid.recordings import open_recordings
    from pixelid.report.html import write_report

    refuse_existing(out, overwrite)
    base, remarks = changed(find_model(model), with_, without, ())
    found = open_recordings(recordings)
    with bar(quiet) as report:
        # interrupted and called again, the search reads back the fits it has made
        result = gap(found, base, alpha=alpha, seed=seed, progress=report, resume=out.with_name(f".{out.name}.fits"))
    with whole_folder(out, overwrite) as folder:
        result.save(folder)
        write_figures(result, found, folder)
        write_report(folder)
    if not quiet:
        from rich.console import Console

        from pixelid.gap.table import gap_table

        console = Console()
        for remark in remarks:
            console.print(remark)
        if result.rounds and result.rounds[0]["candidates"]:
            console.print(gap_table(result))
        console.print(f"[bold]{result.verdict}[/bold]: {result.sentence}", highlight=False)
        console.print(f"{result.seconds:.1f} s; {out / 'report.html'}", highlight=False)
    return 0
