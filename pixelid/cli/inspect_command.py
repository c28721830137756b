"""`pixelid inspect`: health of a recording, no stimulus needed."""

from __future__ import annotations

from pathlib import Path

import click

EXAMPLE = """
\b
Example:
    pixelid inspect recording.h5 --out health
    pixelid inspect recording.aedat4 --json
"""


@click.command("inspect", epilog=EXAMPLE)
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print JSON on stdout instead of a table.")
@click.option("--out", type=click.Path(path_type=Path), help="Folder for inspect.json and the figures.")
@click.option("--overwrite", is_flag=True, help="Replace --out when it exists.")
@click.option("--seed", type=int, default=0, show_default=True, help="Noted in the JSON; nothing here is random.")
@click.option("--quiet", is_flag=True, help="Print no table.")
def command(file: Path, as_json: bool, out: Path | None, overwrite: bool, seed: int, quiet: bool) -> None:
    """Show events, rates, ON/OFF balance, dead time, timestamp tick, periodic lines, hot pixels and readout ceiling.

    FILE is any readable recording: .h5, .npz, .aedat4, .aedat, .raw, .dat, .es, .csv, .txt.
    """
    import json

    from pixelid.inspection import inspect
    from pixelid.outputs import plain, refuse_existing, whole_folder, write_json
    from pixelid.provenance import provenance
    from pixelid.recordings import open_recording

    if out is not None:
        refuse_existing(out, overwrite)
    recording = open_recording(file)
    health = inspect(recording)
    result = plain({**health.to_dict(), "file": str(file), "seed": seed, **provenance(file)})
    if out is not None:
        from pixelid.inspection.figures import write_figures

        with whole_folder(out, overwrite) as folder:
            write_json(folder / "inspect.json", result)
            write_figures(recording, health, folder)
    if as_json:
        click.echo(json.dumps(result, indent=2))
    elif not quiet:
        from rich.console import Console

        from pixelid.inspection.table import health_table

        Console().print(health_table(health))
