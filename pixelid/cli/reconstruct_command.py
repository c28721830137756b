"""`pixelid reconstruct`: a scene from motion-blurred events, through the identified pixel."""

from __future__ import annotations

import click

from pixelid.cli import options
from pixelid.nerf.options import Options

PREVIEW = "preview.png"
EXAMPLE = """
\b
Example:
    python -m pixelid.nerf.synthetic hard scene
    pixelid reconstruct scene --out blurred --bandwidth off
    pixelid reconstruct scene --out sharp --beside blurred
    torchrun --nproc-per-node 2 -m pixelid reconstruct scene --out sharp
"""


@click.command("reconstruct", epilog=EXAMPLE)
@click.argument("dataset", type=options.PATH)
@options.out()
@options.of(Options)
@click.option("--checkpoint", type=options.NEW, help="Keep the training in this file, and continue from it.")
@options.overwrite
@options.quiet
def command(dataset, out, asked, checkpoint, overwrite, quiet):
    """Reconstruct the scene of DATASET, a folder in the published layout of Robust e-NeRF and Deblur e-NeRF.

    Writes reconstruction.json, field.npz, figures and report.html.  Exit code 1 when the events were not explained.
    An interrupted run continues when started again.  OUT.preview.png next to OUT shows the scene as it comes; another
    file of that name is replaced with --overwrite only.
    """
    import shutil
    from contextlib import nullcontext

    from pixelid.cli.progress import bar
    from pixelid.cli.terminal import say_result
    from pixelid.errors import InputError
    from pixelid.interruption import keeping
    from pixelid.outputs import claimed, refuse_existing, refuse_inputs, whole_folder

    if checkpoint is not None and checkpoint.is_dir():
        raise InputError(f"{checkpoint}: expected a file for the training's state, found a folder")
    if checkpoint is not None and not checkpoint.parent.exists():
        raise InputError(f"{checkpoint}: the folder {checkpoint.parent} does not exist")
    given = [
        (folder, what)
        for folder, what in ((dataset, "a dataset"), (asked.fit, "a fit"), (asked.sensor, "a sensor's maps"),
                             (asked.beside, "a reconstruction"))
        if folder is not None
    ]  # fmt: skip
    for folder, what in given:
        if not folder.is_dir() and not (folder is asked.fit and folder.is_file()):
            found = "a file" if folder.exists() else "nothing of that name"
            raise InputError(f"{folder}: expected the folder of {what}, found {found}")
    if checkpoint is not None and checkpoint.exists() and checkpoint.suffix != ".pt":
        for folder, _ in given:  # a checkpoint that is none would be set aside, and the input with it
            if folder.resolve() in (checkpoint.resolve(), *checkpoint.resolve().parents):
                raise InputError(f"{checkpoint}: --checkpoint is a file of the input {folder}; choose another name")
    refuse_existing(out, overwrite)
    preview = out.with_name(f"{out.name}.preview.png")  # beside the folder until that is there, then in it
    refuse_inputs(preview, [folder for folder, _ in given])
    from pixelid.nerf.data.dataset import read_dataset
    from pixelid.nerf.reconstruct import reconstruct
    from pixelid.nerf.training import parallel
    from pixelid.nerf.training.checkpoint import search_file
    from pixelid.report.html import write_report

    first = parallel.rank() == 0
    kept = checkpoint or out.with_name(f".{out.name}.checkpoint.pt")  # the latter until the result is there
    with claimed(out, overwrite, [folder for folder, _ in given]) if first else nullcontext():
        data = read_dataset(dataset)
        with keeping(kept, "the training"), bar(quiet or not first, compiles=True) as report:
            result = reconstruct(data, asked, resume=kept, preview=preview, overwrite=overwrite, progress=report)
            if first:
                with whole_folder(out, overwrite) as folder:
                    result.write(folder)
                    result.write_figures(folder)
                    write_report(folder)
                    if result.state.finite:
                        shutil.copyfile(preview, folder / PREVIEW)
                preview.unlink(missing_ok=True)
                if checkpoint is None:
                    kept.unlink(missing_ok=True)
                    search_file(kept).unlink(missing_ok=True)
    parallel.leave()
    if first and result.ignored:
        click.echo(f"warning: the reconstruction does not model {', '.join(result.ignored)} of this pixel", err=True)
    if first and not quiet:
        say_result(result, out)
    return result.status.exit_code if first else 0
