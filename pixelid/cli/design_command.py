"""`pixelid design`: which stimulus to record next, and why."""

from __future__ import annotations

from pathlib import Path

import click

from pixelid.cli import options

EXAMPLE = """
\b
Example:
    pixelid design dvs128 --out design
    pixelid simulate dvs128 --stimulus chirp --out chirp.h5 --pixels 9
    pixelid design dvs128 --recorded chirp.h5 --criterion gamma --out design-gamma
"""


@click.command("design", epilog=EXAMPLE)
@click.argument("model")
@options.out()
@click.option("--criterion", default="D", show_default=True, metavar="D|A|PARAMETER", help="What is to shrink.")
@click.option("--recorded", multiple=True, metavar="REC", type=options.PATH,
              help="A recording (or folder) there is already; repeatable.")  # fmt: skip
@click.option("--menu", type=options.PATH, metavar="FILE", help="TOML of [[stimulus]] tables.")
@click.option("--pixels", type=options.PIXELS, help="Pixels that would record [those recorded or fitted, else 25].")
@click.option(
    "--draws", type=click.IntRange(1, 10_000), default=4, show_default=True, help="Parameter values averaged over."
)
@click.option("--spread", type=options.Number(0.0), help="Their standard deviation in ln, without a fit [0.2].")
@click.option("--per-second", is_flag=True, help="Rank by score per second of light.")
@options.overwrite
@options.seed("Of the draws and simulations.")
@options.quiet
def command(model, out, criterion, recorded, menu, pixels, draws, spread, per_second, overwrite, seed, quiet):
    """Say which stimulus to record next to learn most about MODEL (shipped, .toml or fit folder).

    Writes design.json, next.toml (the recommended stimulus), figures and report.html.
    """
    from pixelid.cli.progress import bar
    from pixelid.cli.terminal import say
    from pixelid.outputs import claimed, whole_folder

    with claimed(out, overwrite, [*recorded, model, *([menu] if menu else [])]):
        from pixelid.inputs import check_given

        check_given(recorded, [model])
        from pixelid.fit.draws import read_fit
        from pixelid.model.shipped import find_model, model_files
        from pixelid.recordings import open_recordings

        circuit, fitted, opened = find_model(model), read_fit(Path(model)), open_recordings(recorded)
        from pixelid.design.figures import write_figures
        from pixelid.design.result import design_report
        from pixelid.report.html import write_report

        with bar(quiet, compiles=True) as report:
            result = design_report(
                circuit, opened, fitted=fitted, sources=model_files(model), criterion=criterion, menu=menu,
                pixels=pixels, draws=draws, spread=spread, per_second=per_second, seed=seed, progress=report,
            )  # fmt: skip
            with whole_folder(out, overwrite) as folder:
                result.write(folder)
                write_figures(result.as_dict(), folder)
                write_report(folder)
    if not quiet:
        say(result.summary(), str(out / "report.html"))
    return result.status.exit_code
