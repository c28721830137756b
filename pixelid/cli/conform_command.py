"""`pixelid conform`: what of the signal path a simulator or a camera has."""

from __future__ import annotations

import click

from pixelid.cli import options

EXAMPLE = """
\b
Example:
    mkdir session
    pixelid simulate dvs128 --stimulus chirp --out session/chirp.h5 --pixels 25 --with leak:rate_hz=1
    pixelid simulate dvs128 --stimulus steps --out session/steps.h5 --pixels 25 --with leak:rate_hz=1
    pixelid conform session/ --model dvs128 --out conform
"""


@click.command("conform", epilog=EXAMPLE)
@options.search
def command(recordings, model, out, with_, without, alpha, crop, where, overwrite, seed, quiet):
    """Say of every effect of the signal path whether RECORDINGS (files or folders) have it, for their makers.

    The search is that of `pixelid gap`; what the model has from the beginning is then tested by taking it out.  Writes
    conform.json, gap.json, model.toml, figures and report.html.
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
        from pixelid.conform.conform import conform

        kept = out.with_name(f".{out.name}.fits")  # interrupted and called again, the search reads back its fits
        with keeping(kept, "fits"), bar(quiet, compiles=True) as report:
            result = conform(opened, base, alpha=alpha, seed=seed, progress=report, resume=kept, where=where)
        result.report(out, opened, overwrite=overwrite)
    if not quiet:
        say_result(result, out, remarks)
    return result.status.exit_code
