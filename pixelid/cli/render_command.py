"""`pixelid render`: views, videos, depth, meshes and splats of a reconstruction."""

from __future__ import annotations

import click

from pixelid.cli import options
from pixelid.nerf.options import RenderOptions

EXAMPLE = """
\b
Example:
    pixelid render sharp --out orbit --path orbit --video
    pixelid render sharp --out novel --views scene/views/transforms_test.json --depth
    pixelid render sharp --out solid --mesh --splats
"""


@click.command("render", epilog=EXAMPLE)
@click.argument("reconstruction", metavar="DIR", type=options.PATH)
@options.out()
@options.of(RenderOptions)
@options.overwrite
@options.no_seed
@options.quiet
def command(reconstruction, out, asked, overwrite, seed, quiet):
    """Render the scene of DIR, the folder of a reconstruction.

    Writes frames/ (PNG in the unit of the test views), errors/ where --views has pictures of its poses, what the flags
    ask for, render.json and report.html.
    """
    from pixelid.cli.progress import bar
    from pixelid.cli.terminal import say_result
    from pixelid.errors import InputError
    from pixelid.outputs import claimed

    for name in ("up", "distance"):
        if asked.views is not None and options.is_given(click.get_current_context(), name):
            raise InputError(f"--{name}: is for --path; --views says already where from")
    with claimed(out, overwrite, [reconstruction, *([asked.views] if asked.views else [])]):
        from pixelid.api_scenes import render

        with bar(quiet, compiles=True) as report:
            result = render(reconstruction, out, overwrite=overwrite, progress=report, **vars(asked))
    if not quiet:
        say_result(result, out)
    return result.status.exit_code
