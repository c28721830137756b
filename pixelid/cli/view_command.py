"""`pixelid view`: a pixel to play with, or a scene to fly through, in the browser."""

from __future__ import annotations

from pathlib import Path

import click

from pixelid.cli import options

EXAMPLE = """
\b
Example:
    pixelid view dvs128 --out pixel.html
    pixelid view imx636 --with leak:rate_hz=3 --out leaking.html
    pixelid view sharp --out scene.html --open
"""


@click.command("view", epilog=EXAMPLE)
@click.argument("model")
@options.out("The page to write.")
@click.option("--open", "open_", is_flag=True, help="Show it in the browser.")
@options.with_effect
@options.without
@options.set_value
@options.overwrite
@options.no_seed
@options.quiet
def command(model: str, out: Path, open_: bool, with_, without, set_, overwrite: bool, seed: int, quiet: bool) -> None:
    """Write a page on which light, thresholds and bandwidth of the pixel of MODEL can be dragged while events move.

    MODEL is a shipped name, a .toml file or a fit folder; the page has the shipped models as well.  The folder of a
    reconstruction becomes a scene to fly through, with depth and events next to it.  Pages need no server.
    """
    from pixelid.cli.terminal import say
    from pixelid.errors import InputError
    from pixelid.model.options import changed
    from pixelid.model.shipped import find_model
    from pixelid.outputs import claimed
    from pixelid.report.pixel_view import is_scene, write_view

    with claimed(out, overwrite, [model]):
        if is_scene(model):
            from pixelid.report.scene_view import write_scene

            if with_ or without or set_:
                raise InputError(f"{model}: holds a scene; --with, --without and --set change a pixel")
            remarks = []
            write_scene(Path(model), out, overwrite=overwrite)
        else:
            shown, remarks = changed(find_model(model), with_, without, set_)
            write_view(shown, out, overwrite=overwrite)
    if open_:
        click.launch(str(out.resolve()))
    if not quiet:
        say(*remarks, str(out))
