"""What `import pixelid` shows of scenes: data to reconstruct from, reconstructions, views, and pages to play with."""
# pyright: reportUnnecessaryIsInstance=false
# what users give is checked, whatever the annotations promise

from __future__ import annotations

import tempfile
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pixelid.errors import InputError
from pixelid.nerf.options import DatasetOptions, RenderOptions
from pixelid.nerf.options import Options as Reconstructing
from pixelid.options import takes
from pixelid.public import public

if TYPE_CHECKING:
    from pixelid.api import Progress
    from pixelid.fit.result import FitResult
    from pixelid.gap.result import GapReport
    from pixelid.inputs import ModelLike
    from pixelid.nerf.data.published.convert import Conversion
    from pixelid.nerf.field.radiance import Field
    from pixelid.nerf.reconstruct import Reconstruction
    from pixelid.nerf.shown.render import Rendered


@public
@takes(DatasetOptions)
def dataset(
    layout: str,
    source: str | Path,
    out: str | Path,
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
    **options: Any,
) -> Conversion:
    """Write a dataset that `reconstruct` reads from published raw data.

    Args:
        layout: "esim", a bag of rpg_esim or a folder with one; "eds" or "tumvie", a sequence of these data sets.
        source: the bag or folder.
        out: the dataset's folder, with a figure and a page next to the data.
        **options
        overwrite: replace the dataset that is there.
        progress: called with what is done and the fraction.

    Returns:
        What was kept.

    Raises:
        InputError: naming file and field that are missing or wrong.

    Example:
        >>> import pixelid as px
        >>> px.dataset("eds", "08_peanuts_running/", "scene", start=2.0, end=6.0)  # doctest: +SKIP
    """
    from pixelid.nerf.data.published.convert import LAYOUTS, convert
    from pixelid.options import one_of
    from pixelid.outputs import whole_folder
    from pixelid.report.html import write_report

    asked = DatasetOptions(**options)
    if not Path(source).exists():
        raise InputError(f"{source}: no such file or folder")
    if asked.end is not None and asked.end <= (asked.start or 0.0):
        raise InputError(f"--end: expected a time after --start, found {asked.end:g} s")
    kind = one_of("layout", layout, tuple(LAYOUTS))
    with whole_folder(Path(out), overwrite) as folder:
        result = convert(Path(source), kind, folder, asked, progress or (lambda what, share: None))
        result.write(folder)
        write_report(folder)
    return result


@public
@takes(Reconstructing)
def reconstruct(
    dataset: str | Path,
    *,
    resume: str | Path | None = None,
    preview: str | Path | None = None,
    progress: Progress | None = None,
    **options: Any,
) -> Reconstruction:
    """Reconstruct a scene from motion-blurred events, through the identified pixel.

    Args:
        dataset: a folder in the published layout of Robust e-NeRF and Deblur e-NeRF.
        **options
        resume: a checkpoint, continued when it exists and written as training goes on.
        preview: a PNG of the scene, replaced as training goes on; another picture of that name is refused.
        progress: called with what is done and the fraction.

    Returns:
        The scene, with the scores of its test views.

    Raises:
        InputError: a dataset or options that cannot be used.

    Example:
        >>> import pixelid as px
        >>> px.reconstruct("scene/", fit="fit/")  # doctest: +SKIP
    """
    from pixelid.nerf.data.dataset import read_dataset
    from pixelid.nerf.reconstruct import reconstruct as run

    with _as_file(options.pop("fit", None)) as file:
        asked = Reconstructing(fit=file, **options)
        return run(
            read_dataset(Path(dataset)), asked, resume=None if resume is None else Path(resume),
            preview=None if preview is None else Path(preview), progress=progress or (lambda what, share: None),
        )  # fmt: skip


@public
@takes(RenderOptions)
def render(
    reconstruction: str | Path,
    out: str | Path,
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
    **options: Any,
) -> Rendered:
    """Render views, videos, depth, meshes and splats of a reconstruction.

    Args:
        reconstruction: its folder.
        out: folder for frames/ and what is asked for, with a page.
        **options
        overwrite: replace the result that is there.
        progress: called with what is done and the fraction.

    Returns:
        What was rendered.

    Raises:
        InputError: no reconstruction, cameras that cannot be read, a scene without what is asked for.

    Example:
        >>> import pixelid as px
        >>> px.render("sharp/", "orbit", depth=True)  # doctest: +SKIP
    """
    import math

    from pixelid.nerf.shown.render import render as run
    from pixelid.nerf.shown.saved import SavedReconstruction
    from pixelid.nerf.shown.ways import around, way_of_file
    from pixelid.outputs import whole_folder
    from pixelid.report.html import write_report

    asked = RenderOptions(**options)
    if not Path(reconstruction).is_dir():
        found = "a file" if Path(reconstruction).exists() else "nothing of that name"
        raise InputError(f"{reconstruction}: expected the folder of a reconstruction, found {found}")
    if asked.views is not None and asked.path is not None:
        raise InputError(f"--path {asked.path}: --views says already where from; give one of them")
    saved = SavedReconstruction.load(reconstruction)
    size = None if asked.size is None else (asked.size[0], asked.size[1])
    angle = None if asked.fov is None else math.radians(asked.fov)
    if asked.views is not None:
        cameras = way_of_file(asked.views, size, angle, asked.frames)
    else:
        cameras = around(
            saved.field.low, saved.field.high, asked.path or "orbit", asked.frames, size or (400, 400),
            fov=math.radians(39.6) if angle is None else angle, up=asked.up, distance=asked.distance,
        )  # fmt: skip
    with whole_folder(Path(out), overwrite) as folder:
        result = run(
            Path(reconstruction), saved, cameras, folder, asked, progress=progress or (lambda what, share: None)
        )
        result.write(folder)
        write_report(folder)
    return result


@public
def view(model: ModelLike, out: str | Path, *, open: bool = False, overwrite: bool = False) -> Path:
    """Write a page with a pixel to play with, or with a reconstructed scene to fly through.

    Args:
        model: the circuit that the page begins with, with the shipped ones; or the folder of a reconstruction.
        out: the page to write; it needs no server.
        open: show it in the browser.
        overwrite: replace a page that is there.

    Returns:
        The path of the page.

    Raises:
        InputError: an unknown model, a damaged scene, a page that is there already.

    Example:
        >>> import pixelid as px
        >>> px.view("dvs128", "pixel.html", open=True)  # doctest: +SKIP
    """
    from pixelid.inputs import as_model
    from pixelid.report.pixel_view import is_scene, write_view
    from pixelid.report.scene_view import write_scene

    if isinstance(model, str | Path) and is_scene(model):
        write_scene(Path(model), Path(out), overwrite=overwrite)
    else:
        write_view(as_model(model), Path(out), overwrite=overwrite)
    if open:
        import webbrowser

        webbrowser.open(Path(out).resolve().as_uri())
    return Path(out)


def load_field(folder: str | Path) -> Field:
    """The scene of a reconstruction's folder, to render or to look at.

    Args:
        folder: that `pixelid reconstruct` or `.save` wrote.

    Returns:
        The field: `field(rays)` gives radiance and opacity, `field.dense()` log density and log radiances at the
        vertices, and the harmonics.

    Raises:
        InputError: no scene there, or a damaged one.

    Example:
        >>> import pixelid as px
        >>> px.load_field("sharp/").vertices  # doctest: +SKIP
    """
    from pixelid.nerf.shown.saved import read_field

    return read_field(Path(folder))


@contextmanager
def _as_file(fit: ModelLike | FitResult | GapReport | None) -> Generator[Path | None]:
    """The folder or file of a fit or a model; one in memory goes to a temporary folder, for as long as the block."""
    from pixelid.inputs import as_model
    from pixelid.model.files import save_model
    from pixelid.model.shipped import shipped_models
    from pixelid.results import Result

    if fit is None or (isinstance(fit, str | Path) and str(fit) not in shipped_models()):
        yield None if fit is None else Path(fit)
        return
    with tempfile.TemporaryDirectory() as name:
        if isinstance(fit, Result):
            fit.write(name)
        else:
            save_model(as_model(fit), Path(name) / "model.toml")
        yield Path(name)
