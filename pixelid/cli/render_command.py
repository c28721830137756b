"""`pixelid render`: views, videos, depth, meshes and splats of a reconstruction."""

from __future__ import annotations

import click

from pixelid.cli import options

EXAMPLE = """
\b
Example:
    pixelid render sharp --out orbit --path orbit --video
    pixelid render sharp --out novel --views scene/views/transforms_test.json --depth
    pixelid render sharp --out solid --mesh --splats
"""
POSITIVE = options.Number(0.0, open_low=True)


@click.command("render", epilog=EXAMPLE)
@click.argument("reconstruction", metavar="DIR", type=options.PATH)
@options.out()
@click.option("--views", type=options.PATH, metavar="FILE",
              help="Where from: transforms_*.json, a dataset folder, or camera_poses.npz.")  # fmt: skip
@click.option("--path", "way", type=click.Choice(["orbit", "spiral"]), default=None,
              help="Around the scene.  [default: orbit]")  # fmt: skip
@click.option("--frames", type=click.IntRange(1, 10_000), default=60, show_default=True, help="On the path; at most so "
              "many of --views.")  # fmt: skip
@click.option("--size", type=(click.IntRange(1, 8192), click.IntRange(1, 8192)), metavar="W H",
              help="Pixels.  [default: 400 400, or those of --views]")  # fmt: skip
@click.option("--fov", type=options.Number(1.0, 170.0), default=39.6, show_default=True,
              help="Horizontal, degrees, where --views states no camera.")  # fmt: skip
@click.option("--up", nargs=3, type=options.Number(), default=(0.0, 0.0, 1.0), show_default=True, metavar="X Y Z",
              help="What is up in the scene, for --path.")  # fmt: skip
@click.option("--distance", type=POSITIVE, help="Of the camera from the middle, for --path; by default the box fills "
              "the view.")  # fmt: skip
@click.option("--supersample", type=click.IntRange(1, 8), default=1, show_default=True, help="Rays per pixel and side.")
@click.option("--video", is_flag=True, help="An mp4 of the frames (with pixelid[video]).")
@click.option("--fps", type=click.IntRange(1, 240), default=30, show_default=True, help="Of the video.")
@click.option("--depth", is_flag=True, help="Distances too, as arrays and pictures.")
@click.option("--mesh", is_flag=True, help="The surface as mesh.ply.")
@click.option("--splats", is_flag=True, help="Gaussian splats as splats.ply.")
@options.overwrite
@options.no_seed
@options.quiet
def command(
    reconstruction, out, views, way, frames, size, fov, up, distance, supersample, video, fps, depth, mesh, splats,
    overwrite, seed, quiet,
):  # fmt: skip
    """Render the scene of DIR, the folder of a reconstruction.

    Writes frames/ (PNG in the unit of the test views), errors/ where --views has pictures of its poses, what the flags
    ask for, render.json and report.html.
    """
    from pixelid.cli.progress import bar
    from pixelid.cli.terminal import say_result
    from pixelid.errors import InputError
    from pixelid.outputs import claimed

    for name in ("up", "distance"):
        if views is not None and options.is_given(click.get_current_context(), name):
            raise InputError(f"--{name}: is for --path; --views says already where from")
    with claimed(out, overwrite, [reconstruction, *([views] if views else [])]):
        from pixelid.api_scenes import render

        with bar(quiet, compiles=True) as report:
            result = render(
                reconstruction, out, views=views, path=way, frames=frames, size=size,
                fov=fov if options.is_given(click.get_current_context(), "fov") else None, up=up, distance=distance,
                supersample=supersample, video=video, fps=fps, depth=depth, mesh=mesh, splats=splats,
                overwrite=overwrite, progress=report,
            )  # fmt: skip
    if not quiet:
        say_result(result, out)
    return result.status.exit_code
