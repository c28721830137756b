"""`pixelid flicker`: what mains flicker alone says about the pixels."""

from __future__ import annotations

from pathlib import Path

import click

EXAMPLE = """
\b
Example:
    pixelid flicker lamp.npz --frequency 120 --out flicker
"""


@click.command("flicker", epilog=EXAMPLE)
@click.argument("recording", type=click.Path(path_type=Path))
@click.option("--out", required=True, type=click.Path(path_type=Path), help="Folder for the result.")
@click.option("--frequency", type=float, default=120.0, show_default=True, help="Of the light, within 2 %.")
@click.option("--groups", default="8x6", show_default=True, help="Groups of pixels across x down.")
@click.option("--model", default="dvs128", show_default=True, help="Nominal circuit for what one frequency can fix.")
@click.option("--overwrite", is_flag=True, help="Replace --out when it exists.")
@click.option("--seed", type=int, default=0, hidden=True)
@click.option("--quiet", is_flag=True, help="Print nothing.")
def command(recording, out, frequency, groups, model, overwrite, seed, quiet):
    """Fit amplitude, phase and noise of groups of pixels under a flickering lamp, from the events' phases.

    Writes flicker.json (with what one frequency fixes and what it does not), phases.svg, maps.svg and report.html.
    """
    from pixelid.cli.progress import bar
    from pixelid.errors import InputError
    from pixelid.model.shipped import find_model
    from pixelid.outputs import refuse_existing, whole_folder
    from pixelid.recordings import open_recording
    from pixelid.report.html import write_report
    from pixelid.tables.flicker import fit_flicker
    from pixelid.tables.flicker.result import save_flicker

    across, _, down = groups.partition("x")
    if not (across.isdigit() and down.isdigit()):
        raise InputError(f"--groups: expected two whole numbers as in 8x6, found {groups!r}")
    refuse_existing(out, overwrite)
    with bar(quiet) as report:
        fit = fit_flicker(
            open_recording(recording),
            find_model(model),
            near_hz=frequency,
            grid=(int(across), int(down)),
            progress=report,
        )
    with whole_folder(out, overwrite) as folder:
        found = save_flicker(fit, folder)
        write_report(folder)
    if not quiet:
        click.echo(f"{fit.frequency_hz:.4f} ± {fit.frequency_sd:.2g} Hz, {len(fit.groups)} groups, {fit.seconds:.1f} s")
        for title in ("identified", "unidentified", "disagreements"):
            click.echo(f"{title}:")
            for sentence in found[title]:
                click.echo(f"- {sentence}")
    return 0 if found["status"] == "converged" else 1
