"""`pixelid reconstruct`: a scene from motion-blurred events, through the identified pixel."""

from __future__ import annotations

import click

from pixelid.cli import options

AUTO, PREVIEW = "auto", "preview.png"
TRAINABLE = (  # `pixel.TRAINABLE`, here without what it takes to import it
    "threshold", "ratio", "refractory", "leak", "parasitic_photocurrent", "threshold_drift", "polarity_memory",
)  # fmt: skip
EXAMPLE = """
\b
Example:
    python -m pixelid.nerf.synthetic hard scene
    pixelid reconstruct scene --out blurred --bandwidth off
    pixelid reconstruct scene --out sharp --beside blurred
    torchrun --nproc-per-node 2 -m pixelid reconstruct scene --out sharp
"""


class StepsOrAuto(click.IntRange):
    """A number of steps, or `AUTO`."""

    name = "integer|auto"

    def __init__(self) -> None:
        super().__init__(1, 1_000_000_000)

    def convert(self, value, param, ctx):
        """The number, or the word."""
        return value if value == AUTO else super().convert(value, param, ctx)


@click.command("reconstruct", epilog=EXAMPLE)
@click.argument("dataset", type=options.PATH)
@options.out()
@click.option("--fit", type=options.PATH,
              help="Folder of a fit or of gap, or a model file; its pixel replaces the dataset's.")  # fmt: skip
@click.option("--sensor", type=options.PATH, help="Folder of `pixelid sensor`: thresholds and bandwidth of each pixel.")
@click.option("--bandwidth", type=click.Choice(["on", "off", "joint"]), default="on", show_default=True,
              help="The pixel's filter: known, ignored, or trained with the scene.")  # fmt: skip
@click.option("--samples", type=click.IntRange(1, 1000), default=30, show_default=True, help="Past samples per event.")
@click.option("--train", "trained", multiple=True, type=click.Choice(TRAINABLE),
              help="Of the pixel, trained with the scene: mean threshold, ON/OFF ratio, dead time (refractory), or an "
                   "effect.")  # fmt: skip
@click.option("--between-poses", type=click.Choice(["linear", "cubic"]), default="linear", show_default=True,
              help="The camera's way from pose to pose: at constant rates, or along cubic splines.")  # fmt: skip
@click.option("--refine-time", type=options.Number(0.0, open_low=True), metavar="SD",
              help="Train an offset between the clocks of poses and events, known to SD seconds.")  # fmt: skip
@click.option("--refine-poses", nargs=2, type=options.Number(0.0), metavar="SD DEGREES",
              help="Train smooth corrections of the poses, known to SD in the scene's unit and DEGREES.")  # fmt: skip
@click.option("--gap", is_flag=True,
              help="Look in the events for effects that the pixel lacks, and train with those found.")  # fmt: skip
@click.option("--beside", type=options.PATH, help="Folder of another reconstruction of DATASET, to compare with.")
@click.option("--cells", type=click.IntRange(8, 512),
              help="Cells of the field per side; by default one per pixel, 32 to 512.")  # fmt: skip
@click.option("--harmonics", type=click.IntRange(0, 2), default=1, show_default=True,
              help="Degree of the harmonics by which colours depend on the direction; 0: they do not.")  # fmt: skip
@click.option("--steps", "--iterations", type=StepsOrAuto(), default=1200, show_default=True,
              help="Training steps; auto: steps and batch by the number of events.")  # fmt: skip
@click.option(
    "--batch", type=click.IntRange(1, 10_000_000), help="Chains of events per step; 320, or what --steps auto chooses."
)
@click.option("--regularisation", type=click.Choice(["usual", "auto"]), default="usual", show_default=True,
              help="Smoothing; auto: ⅓, 1 or 3 × usual, chosen on held-out events.")  # fmt: skip
@click.option("--background", type=options.Number(0.0, open_low=True),
              help="Radiance behind the scene; by default what the views show.")  # fmt: skip
@click.option("--scale", type=click.Choice(["auto", "level", "free"]), default="auto", show_default=True,
              help="What pins the radiance unit; auto: the views' background, else their level.")  # fmt: skip
@click.option("--box", nargs=6, type=options.Number(), metavar="X0 Y0 Z0 X1 Y1 Z1",
              help="Corners of the scene; by default a cube where the views look.")  # fmt: skip
@click.option("--near", type=options.Number(0.0), default=0.0, show_default=True,
              help="Distance from the camera before which nothing is, in the unit of the poses.")  # fmt: skip
@click.option("--unbounded", is_flag=True,
              help="The scene goes on beyond the box: space is held to the horizon, ever coarser.")  # fmt: skip
@click.option("--radiance-scale", type=options.Number(0.0, open_low=True),
              help="The fit's radiance units per unit of the views; by default from q_in.")  # fmt: skip
@click.option("--protocol", type=click.Choice(["strict", "paper"]), default="strict", show_default=True,
              help="paper: also the reference implementation's scores, corrected on the scored views.")  # fmt: skip
@click.option("--checkpoint", type=options.NEW, help="Keep the training in this file, and continue from it.")
@click.option("--device", type=click.Choice(["auto", "cpu", "cuda"]), default="auto", show_default=True)
@options.overwrite
@options.seed()
@options.quiet
def command(
    dataset, out, fit, sensor, bandwidth, samples, trained, between_poses, refine_time, refine_poses, gap, beside,
    cells, harmonics, steps, batch, regularisation, background, scale, box, near, unbounded, radiance_scale, protocol,
    checkpoint, device, overwrite, seed, quiet,
):  # fmt: skip
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
    given = ((dataset, "a dataset"), (fit, "a fit"), (sensor, "a sensor's maps"), (beside, "a reconstruction"))
    for folder, what in given:
        if folder is not None and not folder.is_dir() and not (folder is fit and folder.is_file()):
            found = "a file" if folder.exists() else "nothing of that name"
            raise InputError(f"{folder}: expected the folder of {what}, found {found}")
    if checkpoint is not None and checkpoint.exists() and checkpoint.suffix != ".pt":
        for folder, _ in given:  # a checkpoint that is none would be set aside, and the input with it
            if folder is not None and folder.resolve() in (checkpoint.resolve(), *checkpoint.resolve().parents):
                raise InputError(f"{checkpoint}: --checkpoint is a file of the input {folder}; choose another name")
    refuse_existing(out, overwrite)
    preview = out.with_name(f"{out.name}.preview.png")  # beside the folder until that is there, then in it
    refuse_inputs(preview, [folder for folder, _ in given if folder is not None])
    from pixelid.nerf import parallel
    from pixelid.nerf.checkpoint import search_file
    from pixelid.nerf.dataset import read_dataset
    from pixelid.nerf.figures import write_figures
    from pixelid.nerf.pixel import Bandwidth
    from pixelid.nerf.poses import Refinement
    from pixelid.nerf.recipe import Recipe
    from pixelid.nerf.reconstruct import reconstruct
    from pixelid.report.html import write_report

    first = parallel.rank() == 0
    kept = checkpoint or out.with_name(f".{out.name}.checkpoint.pt")  # the latter until the result is there
    with (
        claimed(out, overwrite, [folder for folder in (dataset, fit, sensor, beside) if folder])
        if first
        else nullcontext()
    ):
        data = read_dataset(dataset)
        recipe = Recipe.asked(
            steps=steps, batch=batch, cells=cells, harmonics=harmonics, between_poses=between_poses,
            regularisation=regularisation, refinement=Refinement.of(refine_time, refine_poses), unbounded=unbounded,
        )  # fmt: skip
        pixel = Bandwidth(bandwidth, samples, trained=trained)
        with keeping(kept, "the training"), bar(quiet or not first, compiles=True) as report:
            result = reconstruct(
                data, fit=fit, sensor=sensor, bandwidth=pixel, recipe=recipe, background=background, scale=scale,
                box=box or None, near=near, radiance_scale=radiance_scale, protocol=protocol, gap=gap, beside=beside,
                resume=kept, preview=preview, overwrite=overwrite, device=device, seed=seed, progress=report,
            )  # fmt: skip
            if first:
                with whole_folder(out, overwrite) as folder:
                    result.write(folder)
                    write_figures(result, folder)
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
