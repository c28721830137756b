"""`pixelid inspect`: health of a recording, no stimulus needed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click

from pixelid.cli import options
from pixelid.errors import InputError

EXAMPLE = """
\b
Example:
    pixelid inspect recording.h5 --out health
    pixelid inspect recording.aedat4 --json
    pixelid inspect static_noise_pos_161lux.npy static_noise_neg_161lux.npy static_noise_pos_3klux.npy
"""


@click.command("inspect", epilog=EXAMPLE)
@click.argument("files", metavar="FILE...", nargs=-1, required=True, type=options.PATH)
@options.as_json
@options.out("Folder for inspect.json, figures and report.html.", required=False)
@options.crop
@options.reading
@options.overwrite
@options.seed("Of the resampling of .npy histograms; else noted.")
@options.quiet
def command(files: tuple[Path, ...], as_json: bool, out: Path | None, crop, overwrite: bool, seed: int, quiet: bool):
    """Show events, rates, ON/OFF balance, dead time, timestamp tick, periodic lines, hot pixels and readout ceiling.

    FILE is any readable recording: .h5, .hdf5, .npz, .npy, .aedat4, .aedat, .raw, .dat, .es, .bag, .db3, .mcap, .mat,
    .csv, .txt.  Names ending in pos_161lux.npy, neg_3klux.npy, … are histograms of intervals of a still scene,
    inspected together, for leak, parasitic photocurrent and noise.
    """
    import json

    from pixelid.inspection.interval_counts import is_interval_counts

    if any(map(is_interval_counts, files)):
        _still_scene(files, as_json, out, overwrite, seed, quiet)
        return
    file, *more = files
    if more:
        raise InputError(f"{more[0]}: one recording at a time, or histograms of intervals (…_pos_161lux.npy)")
    from contextlib import nullcontext

    from pixelid.outputs import claimed, plain

    with nullcontext() if out is None else claimed(out, overwrite, files):
        from pixelid.cli.progress import bar
        from pixelid.recordings.reading import check_readable, open_cropped

        check_readable([file])
        with bar(quiet) as report:
            report("reading", 0.0)
            recording = open_cropped(file, crop, seed)
            from pixelid.inspection.health import inspect

            health = replace(inspect(recording, report), file=file)
        if out is not None:
            health.report(out, overwrite=overwrite, seed=seed)
    if as_json:
        click.echo(json.dumps(plain(health.content(seed)), indent=2))
    elif not quiet:
        from rich.console import Console

        from pixelid.cli.terminal import say
        from pixelid.inspection.table import health_table

        Console(markup=False).print(health_table(health))
        say(*([str(out / "report.html")] if out else []))


def _still_scene(
    files: tuple[Path, ...], as_json: bool, out: Path | None, overwrite: bool, seed: int, quiet: bool
) -> None:
    """Histograms of intervals of a still scene: table, static_noise.json."""
    import json
    from contextlib import nullcontext
    from dataclasses import asdict

    from pixelid.cli.progress import bar
    from pixelid.inspection.interval_counts import read_interval_counts
    from pixelid.inspection.static_noise import static_noise
    from pixelid.outputs import claimed, plain, whole_folder, write_json
    from pixelid.provenance import input_hashes, versions
    from pixelid.report.html import write_report

    with nullcontext() if out is None else claimed(out, overwrite, files):
        with bar(quiet) as report:
            noise = static_noise([read_interval_counts(file) for file in files], seed, progress=report)
        hashes = input_hashes(files)
        result = plain({**asdict(noise), "seed": seed, "versions": versions(), "inputs_sha256": hashes})
        if out is not None:
            from pixelid.figures.style import save_figure
            from pixelid.inspection.figures import draw_static_noise

            with whole_folder(out, overwrite) as folder:
                write_json(folder / "static_noise.json", result)
                save_figure(draw_static_noise(noise), folder / "conditions.svg")
                write_report(folder)
    if as_json:
        click.echo(json.dumps(result, indent=2))
    elif not quiet:
        from rich.console import Console

        from pixelid.cli.terminal import say
        from pixelid.inspection.static_noise_words import static_noise_table

        Console(markup=False).print(static_noise_table(noise))
        say(*([str(out / "report.html")] if out else []))
