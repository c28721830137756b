"""`pixelid check`: a bench's recordings, held against their lights in seconds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click

from pixelid.cli import options

EXAMPLE = """
\b
Example:
    pixelid check bench/
    pixelid check bench/ --init          # writes bench/bench.toml, to be corrected by hand
"""


@click.command("check", epilog=EXAMPLE)
@click.argument("bench", metavar="BENCH", type=options.PATH)
@options.stated
@options.bench
@click.option("--init", is_flag=True, help="Write BENCH/bench.toml with what the folder was taken for.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of a table.")
@options.seed("Of the pixels that are chosen.")
@options.quiet
def command(bench: Path, stated, roi, pixels, init: bool, as_json: bool, seed: int, quiet: bool) -> int:
    """Read BENCH (a folder, or a bench.toml) and bring every recording onto its light's clock.

    One line per recording: what is inferred, what is wrong.  NAME_light.csv with NAME.raw is its light.
    """
    import json

    from pixelid.bench.check import check
    from pixelid.bench.files import TOML, find_bench, write_bench
    from pixelid.cli.progress import bar
    from pixelid.cli.terminal import say, say_result
    from pixelid.errors import InputError
    from pixelid.outputs import plain

    found = find_bench(bench)
    found = replace(found, source=stated.over(found.source))
    if init:
        target = found.folder / TOML
        if target.exists():
            raise InputError(f"{target}: exists already; it is read as it is")
        write_bench(found, target)
    with bar(quiet or as_json) as report:
        result = check(found, roi=roi, pixels=pixels, seed=seed, progress=report)
    if as_json:
        click.echo(json.dumps(plain(result.as_dict()), indent=2))
    elif not quiet:
        say_result(result)
        say(*([f"{found.folder / TOML} is written"] if init else []))
    return result.status.exit_code
