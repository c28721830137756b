"""`pixelid flicker`: what mains flicker alone says about the pixels."""

from __future__ import annotations

import click

from pixelid.cli import options

EXAMPLE = """
\b
Example:
    pixelid flicker lamp.npz --frequency 120 --out flicker
"""


@click.command("flicker", epilog=EXAMPLE)
@click.argument("recording", type=options.PATH)
@options.out()
@click.option(
    "--frequency",
    type=options.Number(0.0, 1e5, open_low=True),
    default=120.0,
    show_default=True,
    help="Of the light, within 2 %.",
)
@click.option("--groups", default="8x6", show_default=True, help="Groups of pixels across x down.")
@options.model(False, "Nominal circuit for what one frequency can fix.", default="dvs128", show_default=True)
@options.reading
@options.overwrite
@options.no_seed
@options.quiet
def command(recording, out, frequency, groups, model, overwrite, seed, quiet):
    """Fit amplitude, phase and noise of groups of pixels under a flickering lamp, from the events' phases.

    Writes flicker.json (with what one frequency fixes and what it does not), phases.svg, maps.svg and report.html.
    """
    from pixelid.cli.progress import bar
    from pixelid.cli.terminal import say, say_page, say_sentences
    from pixelid.errors import InputError
    from pixelid.outputs import claimed, whole_folder

    across, _, down = groups.partition("x")
    if not all(part.isascii() and part.isdigit() and len(part) < 5 and int(part) > 0 for part in (across, down)):
        raise InputError(f"--groups: expected two whole numbers as in 8x6, found {groups[:60]!r}")
    with claimed(out, overwrite, [recording, model]):
        from pixelid.model.shipped import find_model
        from pixelid.recordings import open_recording

        circuit, opened = find_model(model), open_recording(recording)
        from pixelid.report.html import write_report
        from pixelid.tables.flicker import fit_flicker
        from pixelid.tables.flicker.result import save_flicker

        grid = (int(across), int(down))
        with bar(quiet, compiles=True) as report:
            fit = fit_flicker(opened, circuit, near_hz=frequency, grid=grid, progress=report)
        with whole_folder(out, overwrite) as folder:
            written = save_flicker(fit, folder)
            write_report(folder)
    if not quiet:
        say(f"{fit.frequency_hz:.4f} ± {fit.lock.error_hz:.2g} Hz, {len(fit.groups)} groups, {fit.seconds:.1f} s")
        for title in ("identified", "unidentified", "disagreements"):
            say(f"{title}:")
            say_sentences(written[title])
        say_page(out)
    return written["status"].exit_code
