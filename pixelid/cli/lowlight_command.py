"""`pixelid lowlight`: dominant-pole analysis over radiance."""

from __future__ import annotations

from pathlib import Path

import click

EXAMPLE = """
\b
Example:
    pixelid lowlight dvs128 --out lowlight
    pixelid simulate dvs128 --stimulus steps --out steps.h5
    pixelid lowlight dvs128 steps.h5 --with dark_current:radiance=4 --out lowlight-dark
"""

DRAWS = 60


@click.command("lowlight", epilog=EXAMPLE)
@click.argument("model")
@click.argument("recordings", nargs=-1, metavar="[REC]…", type=click.Path(path_type=Path))
@click.option("--out", required=True, type=click.Path(path_type=Path), help="Folder for the result.")
@click.option("--with", "with_", metavar="EFFECT[:param=value,…]", multiple=True, help="Add an effect.")
@click.option("--without", metavar="EFFECT", multiple=True, help="Remove an effect.")
@click.option("--set", "set_", metavar="name=value", multiple=True, help="Set a parameter.")
@click.option("--overwrite", is_flag=True, help="Replace --out when it exists.")
@click.option("--seed", type=int, default=0, show_default=True, help="Of the draws and simulations.")
@click.option("--quiet", is_flag=True, help="No progress, no table.")
def command(model, recordings, out, with_, without, set_, overwrite, seed, quiet):
    """Say where one pole describes the photoreceptor of MODEL (shipped, .toml or fit folder), and where it does not.

    With recordings of chirps or steps, REC…, their measured bandwidth or step time is put beside the model's.
    Writes lowlight.json, figures and report.html.
    """
    import numpy as np

    from pixelid.cli.progress import bar
    from pixelid.fit.draws import drawn, read_fit, uncertainty
    from pixelid.model.options import changed
    from pixelid.model.shipped import find_model
    from pixelid.outputs import refuse_existing, whole_folder, write_json
    from pixelid.provenance import provenance
    from pixelid.recordings import open_recordings

    refuse_existing(out, overwrite)
    circuit_model, remarks = changed(find_model(model), with_, without, set_)
    fit = read_fit(Path(model))
    opened = open_recordings(recordings)
    from pixelid.lowlight.analysis import analyse, sentences
    from pixelid.lowlight.figures import write_figures
    from pixelid.report.html import write_report

    with bar(quiet) as report:
        draws = []
        if fit is not None:
            draws = drawn(circuit_model, *uncertainty(fit, circuit_model), DRAWS, np.random.default_rng(seed))
        found = analyse(circuit_model, opened, draws=draws, seed=seed, progress=report)
        sources = [Path(model), Path(model) / "fit.json", Path(model) / "model.toml"]
        sources += [recording.source for recording in opened if recording.source is not None]
        found |= {"sentences": sentences(found), "seed": seed, **provenance(*sources)}
        with whole_folder(out, overwrite) as folder:
            write_json(folder / "lowlight.json", found)
            write_figures(found, circuit_model.circuit(), folder)
            write_report(folder)
    if not quiet:
        from rich.console import Console

        from pixelid.lowlight.table import lowlight_tables, not_measurable

        console = Console(highlight=False, markup=False)
        for sentence in (*remarks, *found["sentences"]):
            console.print(sentence)
        for table in lowlight_tables(found):
            console.print(table)
        for sentence in not_measurable(found):
            console.print(sentence)
        console.print(f"{found['status']} in {found['seconds']:.1f} s; {out / 'report.html'}")
        if found["advice"]:
            console.print(f"- {found['advice']}")
