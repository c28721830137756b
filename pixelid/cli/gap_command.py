"""`pixelid gap`: which effect a model lacks."""

from __future__ import annotations

import click

from pixelid.cli import options

EXAMPLE = """
\b
Example:
    mkdir session
    pixelid simulate dvs128 --stimulus chirp --out session/chirp.h5 --pixels 25 --with leak:rate_hz=1
    pixelid simulate dvs128 --stimulus steps --out session/steps.h5 --pixels 25 --with leak:rate_hz=1
    pixelid gap session/ --model dvs128 --out gap
"""


@click.command("gap", epilog=EXAMPLE)
@options.search
@options.pixel_levels
def command(
    recordings, model, out, with_, without, alpha, crop, where, overwrite, seed, quiet, pixel_levels,
):  # fmt: skip
    """Find where a model and RECORDINGS (files or folders) disagree, and which effect is missing.

    The verdict is none, named, ambiguous or unknown.  Writes gap.json, model.toml (the grown model), figures and
    report.html.  Interrupted, it keeps the fits it has made, and goes on there when called again.
    """
    from pixelid.cli.progress import bar
    from pixelid.cli.terminal import say_result
    from pixelid.interruption import keeping
    from pixelid.outputs import claimed

    with claimed(out, overwrite, [*recordings, model]):
        from pixelid.inputs import check_given
        from pixelid.model.options import changed
        from pixelid.model.shipped import find_model
        from pixelid.recordings import open_recordings

        base, remarks = changed(find_model(model), with_, without, ())
        check_given(recordings)
        opened = open_recordings(recordings, crop, seed)
        from pixelid.gap.gap import gap

        kept = out.with_name(f".{out.name}.fits")  # interrupted and called again, the search reads back its fits
        with keeping(kept, "fits"), bar(quiet, compiles=True) as report:
            result = gap(
                opened, base, alpha=alpha, seed=seed, pixel_levels=pixel_levels or None, progress=report, resume=kept,
                where=where,
            )  # fmt: skip
        result.report(out, opened, overwrite=overwrite)
    if not quiet:
        say_result(result, out, remarks)
    return result.status.exit_code
