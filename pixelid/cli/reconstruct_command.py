"""`pixelid reconstruct`: a scene from motion-blurred events, through the identified pixel."""

from __future__ import annotations

from pathlib import Path

import click

EXAMPLE = """
\b
Example:
    python -m pixelid.nerf.synthetic hard scene
    pixelid reconstruct scene --out sharp
    pixelid reconstruct scene --out blurred --bandwidth off
    torchrun --nproc-per-node 2 -m pixelid reconstruct scene --out sharp
"""


@click.command("reconstruct", epilog=EXAMPLE)
@click.argument("dataset", type=click.Path(path_type=Path))
@click.option("--out", required=True, type=click.Path(path_type=Path), help="Folder for the result.")
@click.option("--fit", type=click.Path(path_type=Path), help="Folder of a fit; its pixel replaces the dataset's.")
@click.option("--bandwidth", type=click.Choice(["on", "off", "joint"]), default="on", show_default=True,
              help="The pixel's filter: known, ignored, or trained with the scene.")  # fmt: skip
@click.option("--samples", type=click.IntRange(1, 1000), default=30, show_default=True, help="S, of the pixel's past.")
@click.option("--train", "comparator", multiple=True, type=click.Choice(["threshold", "ratio", "refractory"]),
              help="Trained too, with --bandwidth joint: mean threshold, ON/OFF ratio, dead time.")  # fmt: skip
@click.option("--iterations", type=click.IntRange(1), help="Training steps.")
@click.option("--background", type=click.FloatRange(min=0, min_open=True),
              help="Radiance behind the scene; by default what the views show.")  # fmt: skip
@click.option("--scale", type=click.Choice(["auto", "level", "free"]), default="auto", show_default=True,
              help="What pins the radiance unit; auto: the views' background, else their level.")  # fmt: skip
@click.option("--box", nargs=6, type=float, metavar="X0 Y0 Z0 X1 Y1 Z1",
              help="Corners of the scene; by default a cube where the views look.")  # fmt: skip
@click.option("--radiance-scale", type=click.FloatRange(min=0, min_open=True),
              help="The fit's radiance units per unit of the views; by default from q_in.")  # fmt: skip
@click.option("--checkpoint", type=click.Path(path_type=Path), help="Continue from this file, and keep it up to date.")
@click.option("--device", type=click.Choice(["auto", "cpu", "cuda"]), default="auto", show_default=True)
@click.option("--overwrite", is_flag=True, help="Replace --out when it exists.")
@click.option("--seed", type=int, default=0, show_default=True)
@click.option("--quiet", is_flag=True, help="No progress, no table.")
def command(
    dataset, out, fit, bandwidth, samples, comparator, iterations, background, scale, box, radiance_scale, checkpoint,
    device, overwrite, seed, quiet,
):  # fmt: skip
    """Reconstruct the scene of DATASET, a folder in the published layout of Robust e-NeRF and Deblur e-NeRF.

    Writes reconstruction.json, field.npz, figures and report.html.  Exit code 1 when the events were not explained.
    """
    from dataclasses import replace

    from pixelid.cli.progress import bar
    from pixelid.errors import InputError
    from pixelid.outputs import refuse_existing, whole_folder

    refuse_existing(out, overwrite)
    if comparator and bandwidth != "joint":
        raise InputError(f"--train {comparator[0]}: needs --bandwidth joint, found {bandwidth}")
    if checkpoint is not None and not checkpoint.parent.exists():
        raise InputError(f"{checkpoint}: the folder {checkpoint.parent} does not exist")
    if seed < 0:
        raise InputError(f"--seed: expected a number ≥ 0, found {seed}")
    from pixelid.nerf import parallel
    from pixelid.nerf.dataset import read_dataset
    from pixelid.nerf.figures import write_figures
    from pixelid.nerf.pixel import FILTER, Bandwidth
    from pixelid.nerf.reconstruct import reconstruct
    from pixelid.nerf.train import Recipe
    from pixelid.report.html import write_report
    from pixelid.status import Status

    data = read_dataset(dataset)
    recipe = replace(Recipe(), iterations=iterations) if iterations else Recipe()
    pixel = Bandwidth(bandwidth, samples, trained=(*FILTER, *comparator))
    first = parallel.rank() == 0
    with bar(quiet or not first) as report:
        result = reconstruct(
            data, fit=fit, bandwidth=pixel, recipe=recipe, background=background, scale=scale, box=box or None,
            radiance_scale=radiance_scale, resume=checkpoint, device=device, seed=seed, progress=report,
        )  # fmt: skip
        if first:
            with whole_folder(out, overwrite) as folder:
                result.save(folder)
                write_figures(result, folder)
                write_report(folder)
    parallel.leave()
    if first and not quiet:
        scores = result.scores
        click.echo(
            f"{result.status}: {scores.psnr.mean():.2f} dB, SSIM {scores.ssim.mean():.3f} over {len(scores.psnr)} test "
            f"views, {result.held_out:.2f} of held-out changes unexplained, {result.seconds:.0f} s; "
            f"{out / 'report.html'}"
        )
        if result.advice:
            click.echo(f"- {result.advice}")
    return 0 if result.status is Status.converged or not first else 1
