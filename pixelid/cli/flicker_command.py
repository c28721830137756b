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
    from pixelid.cli.terminal import say_result
    from pixelid.errors import InputError
    from pixelid.outputs import claimed

    across, _, down = groups.partition("x")
    if not all(part.isascii() and part.isdigit() and len(part) < 5 and int(part) > 0 for part in (across, down)):
        raise InputError(f"--groups: expected two whole numbers as in 8x6, found {groups[:60]!r}")
    with claimed(out, overwrite, [recording, model]):
        from pixelid.inputs import check_given

        check_given([recording], [model])
        from pixelid.api_tables import flicker

        with bar(quiet, compiles=True) as report:
            result = flicker(
                recording, frequency=frequency, groups=(int(across), int(down)), model=model, progress=report
            )
        result.report(out, overwrite=overwrite)
    if not quiet:
        say_result(result, out)
    return result.status.exit_code
