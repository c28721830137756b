"""`pixelid design`: which stimulus to record next, and why."""

from __future__ import annotations

from pathlib import Path

import click

EXAMPLE = """
\b
Example:
    pixelid design dvs128 --out design
    pixelid simulate dvs128 --stimulus chirp --out chirp.h5 --pixels 9
    pixelid design dvs128 --recorded chirp.h5 --criterion gamma --out design-gamma
"""

SPREAD = 0.2


@click.command("design", epilog=EXAMPLE)
@click.argument("model")
@click.option("--out", required=True, type=click.Path(path_type=Path), help="Folder for the result.")
@click.option("--criterion", default="D", show_default=True, metavar="D|A|PARAMETER", help="What is to shrink.")
@click.option("--recorded", multiple=True, metavar="REC", type=click.Path(path_type=Path),
              help="A recording (or folder) there is already; repeatable.")  # fmt: skip
@click.option("--menu", type=click.Path(path_type=Path), metavar="FILE", help="TOML of [[stimulus]] tables.")
@click.option("--pixels", type=click.IntRange(1), help="Pixels that would record [those recorded or fitted, else 25].")
@click.option("--draws", type=click.IntRange(1), default=4, show_default=True, help="Parameter values averaged over.")
@click.option("--spread", type=click.FloatRange(0), help=f"Their standard deviation in ln, without a fit [{SPREAD}].")
@click.option("--per-second", is_flag=True, help="Rank by score per second of light.")
@click.option("--overwrite", is_flag=True, help="Replace --out when it exists.")
@click.option("--seed", type=int, default=0, show_default=True, help="Of the draws and simulations.")
@click.option("--quiet", is_flag=True, help="No progress, no table.")
def command(model, out, criterion, recorded, menu, pixels, draws, spread, per_second, overwrite, seed, quiet):
    """Say which stimulus to record next to learn most about MODEL (shipped, .toml or fit folder).

    Writes design.json, next.toml (the recommended stimulus), figures and report.html.
    """
    import numpy as np
    import tomli_w

    from pixelid.cli.progress import bar
    from pixelid.errors import InputError
    from pixelid.fit.coordinates import Coordinates
    from pixelid.fit.draws import drawn, read_fit, uncertainty
    from pixelid.model.shipped import find_model
    from pixelid.outputs import refuse_existing, whole_folder, write_json
    from pixelid.provenance import provenance
    from pixelid.recordings import open_recordings

    refuse_existing(out, overwrite)
    circuit = find_model(model)
    fit = read_fit(Path(model))
    recordings = open_recordings(recorded)
    if pixels is not None and recordings:
        raise InputError("--pixels: the recordings say how many pixels there are")
    if spread is not None and (recordings or fit):
        raise InputError("--spread: a fit brings its own uncertainty, and recordings belong to one set of values")
    from pixelid.design import criteria, default_menu, read_menu, recommend
    from pixelid.design.design import known_from
    from pixelid.design.figures import write_figures
    from pixelid.design.table import design_tables
    from pixelid.report.html import write_report

    names = Coordinates.of(circuit).names
    criteria.check(criterion, names)
    rng = np.random.default_rng(seed)
    known, others = None, []
    if fit is not None:
        free, covariance = uncertainty(fit, circuit)
        known = known_from(free, covariance) if free else None
        others = drawn(circuit, free, covariance, draws - 1, rng)
        pixels = pixels or fit.get("pixels")
    elif not recordings:
        others = drawn(circuit, list(names), np.eye(len(names)) * (spread or SPREAD) ** 2, draws - 1, rng)
    candidates = read_menu(menu) if menu else default_menu(circuit)
    with bar(quiet) as report:
        found = recommend(circuit, candidates, criterion=criterion, recordings=recordings, known=known, draws=others,
                          pixels=pixels or 25, per_second=per_second, seed=seed, progress=report)  # fmt: skip
        sources = [Path(model), Path(model) / "fit.json", Path(model) / "model.toml", *([menu] if menu else [])]
        sources += [recording.source for recording in recordings if recording.source is not None]
        found |= {"seed": seed, **provenance(*sources)}
        best = found["recommended"]
        with whole_folder(out, overwrite) as folder:
            write_json(folder / "design.json", found)
            (folder / "next.toml").write_text(tomli_w.dumps({"stimulus": {"kind": best["kind"], **best["parameters"]}}))
            write_figures(found, folder)
            write_report(folder)
    if not quiet:
        from rich.console import Console

        console = Console(highlight=False, markup=False)
        for table in design_tables(found):
            console.print(table)
        console.print(f"next: {best['name']}. {found['why']}")
        if found["advice"]:
            console.print(f"- {found['advice']}")
        console.print(f"{found['status']} in {found['seconds']:.1f} s; {out / 'report.html'}")
