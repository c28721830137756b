"""`pixelid render`: frames along a way, with depth, as video, and the scene as a mesh or as splats."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from pixelid.errors import InputError
from pixelid.nerf.correction import Correction
from pixelid.nerf.evaluate import render_views
from pixelid.nerf.saved import FIELD, SavedReconstruction
from pixelid.nerf.shown import ply, video
from pixelid.nerf.shown.errors import error_picture, pictures_of, write_error
from pixelid.nerf.shown.solid import depth_of, mesh_of
from pixelid.nerf.shown.splats import splats_of
from pixelid.nerf.shown.ways import Way
from pixelid.nerf.views import Views
from pixelid.provenance import provenance
from pixelid.results import Table, WrittenResult
from pixelid.status import Status

FRAMES, DEPTH, ERRORS, VIDEO, DEPTH_VIDEO = "frames", "depth", "errors", "video.mp4", "depth.mp4"
MESH, SPLATS = "mesh.ply", "splats.ply"
MUCH_WHITE = 0.01  # share of the pixels beyond white from which on it is said
BRIGHTEST = 0.995  # quantile of the first frames that becomes white where no views say what white is


@dataclass(frozen=True)
class Wanted:
    """What is made beside the frames."""

    video: bool = False
    depth: bool = False
    mesh: bool = False
    splats: bool = False
    frames_per_second: int = 30


@dataclass(frozen=True, repr=False)
class Rendered(WrittenResult):
    """What was rendered.

    content: of render.json;  shown: (k, H, W, 3) 8-bit, a few of the frames;  depths: (k, H, W) their depths, or None;
    errors: (k, H, W) their mean absolute errors over the colours, or None
    """

    FILE: ClassVar[str] = "render.json"

    shown: np.ndarray
    depths: np.ndarray | None = None
    errors: np.ndarray | None = None

    @property
    def headline(self) -> str:
        """How many frames of what size."""
        c = self.content
        return f"render: {len(c['frames'])} frames of {c['width']} × {c['height']} pixels, {c['seconds']:.0f} s"

    def tables(self) -> list[Table]:
        """The files."""
        return [Table("", ("file", "what"), tuple(self.content["files"].items()), frozenset({"file", "what"}))]

    def records(self) -> list[dict[str, Any]]:
        """One row per file."""
        return [{"file": name, "what": what} for name, what in self.content["files"].items()]


def render(
    path: Path,
    saved: SavedReconstruction,
    way: Way,
    folder: Path,
    wanted: Wanted,
    *,
    supersample: int = 1,
    seed: int = 0,
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> Rendered:
    """Render a reconstruction into a folder.

    Args:
        path: of the reconstruction's folder.
        saved: the reconstruction.
        way: the cameras.
        folder: an existing one, which is filled.
        wanted: what beside the frames.
        supersample: rays per pixel and side.
        seed: recorded; nothing here is random.
        progress: called with what is done and the fraction.

    Returns:
        What was made.

    Raises:
        InputError: a scene without surface is to become a mesh, or one without density splats.
    """
    watch = time.perf_counter()
    if not saved.field.finite:
        raise InputError(f"{path / FIELD}: the field holds numbers that are not finite: the reconstruction diverged")
    colours = saved.field.grid.shape[1] - 1
    dark = np.resize(np.asarray(saved.content["pixel"].get("dark") or 0.0, dtype=float), colours)
    correction = _correction(saved)
    tone, notes = _tone(saved, correction, way, dark)
    pictures, lacking = pictures_of(way, correction, colours)
    notes += lacking
    if saved.status is not Status.converged:
        notes.append(f"the reconstruction ended as {saved.status}: {saved.advice or saved.status.advice}")
    if way.left_out:
        notes.append(f"{way.left_out} of {len(way) + way.left_out} poses are left out, evenly; --frames takes more")
    mesh = mesh_of(saved.field) if wanted.mesh else None  # before the frames: scenes without are refused at once
    splats = splats_of(saved.field) if wanted.splats else None
    files: dict[str, str] = {}
    frames, depths, errors, white = [], [], [], 0.0
    (folder / FRAMES).mkdir()
    if pictures is not None:
        (folder / ERRORS).mkdir()
    for k in range(len(way)):
        view = _views(way, k, colours)
        radiance = render_views(saved.field, view, dark, supersample=supersample)[0]
        image = tone(radiance)
        frame = _eight_bits(image)
        white += float(np.mean((image > 1.0).any(axis=-1))) / len(way)
        _save(folder / FRAMES / f"{way.names[k]}.png", frame)
        frames.append(frame)
        if wanted.depth:
            depths.append(depth_of(saved.field, view)[0].astype(np.float32))
        if pictures is not None:
            errors.append(pictures.error(radiance, k))
            write_error(folder / ERRORS, way.names[k], errors[k], error_picture(errors[k], pictures.full_scale))
        progress("frames", 0.8 * (k + 1) / len(way))
    files[f"{FRAMES}/"] = f"{len(frames)} PNG pictures"
    if white > MUCH_WHITE:
        notes.append(f"{white:.1%} of the pixels are brighter than white of the views, and shown as white")
    if depths:
        files |= _write_depths(folder, way, depths)
    if pictures is not None:
        scale = f"black for none, brightest from {pictures.full_scale:.3g} of the views' unit on"
        files[f"{ERRORS}/"] = f"{len(errors)} arrays, frame less picture, and pictures of their size: {scale}"
    if wanted.video:
        files |= _write_videos(folder, frames, depths, wanted.frames_per_second, notes)
    if mesh is not None:
        ply.write_mesh(folder / MESH, mesh, _eight_bits(tone(mesh.radiance[None] + dark))[0])
        files[MESH] = f"{len(mesh.faces)} triangles, coloured"
    if splats is not None:
        ply.write_splats(
            folder / SPLATS, splats, splats.colours(lambda radiance: _eight_bits(tone(radiance[None] + dark))[0] / 255)
        )
        files[SPLATS] = f"{len(splats.centre)} Gaussian splats"
    some = np.unique(np.linspace(0, len(frames) - 1, min(5, len(frames))).astype(int))
    content = {
        "status": Status.converged,
        "advice": "",
        "scene_status": saved.status,
        "width": way.camera.width,
        "height": way.camera.height,
        "intrinsics": way.camera.intrinsics,
        "frames": [
            {"name": way.names[k], "position": way.position[k], "rotation": way.rotation[k]} for k in range(len(way))
        ],
        "files": files,
        "depth_range": [float(np.nanmin(depths)), float(np.nanmax(depths))] if np.isfinite(depths).any() else None,
        "errors": None if pictures is None else pictures.as_dict(way.names, errors),
        "notes": notes,
        "seconds": time.perf_counter() - watch,
        "seed": seed,
        **provenance(path / FIELD, path / SavedReconstruction.FILE),
    }
    return Rendered(
        content, np.array([frames[k] for k in some]), np.array([depths[k] for k in some]) if depths else None,
        np.array([np.abs(errors[k]).mean(axis=-1) for k in some]) if errors else None,
    )  # fmt: skip


def _views(way: Way, k: int, colours: int) -> Views:
    """One camera of a way, without an image."""
    blank = np.empty((1, way.camera.height, way.camera.width, colours), np.float32)
    return Views(blank, way.position[k : k + 1], way.rotation[k : k + 1], way.camera, ("",), np.ones(1), False, 1.0)


def _correction(saved: SavedReconstruction) -> Correction | None:
    """Of the scores, None where nothing was scored."""
    if not saved.content["views"]["per_view"] or saved.content["correction"]["a"] is None:
        return None
    return Correction(*(np.atleast_1d(np.asarray(saved.content["correction"][name], float)) for name in "abc"))


def _tone(
    saved: SavedReconstruction, correction: Correction | None, way: Way, dark: np.ndarray
) -> tuple[Callable[[np.ndarray], np.ndarray], list[str]]:
    """Radiance (H, W, C) → what a picture shows of it, white at 1, and what has to be said about it.

    With test views, their unit: the correction a·L^b − c of the scores, white at 1.  Without, nobody knows the
    exponent: radiance is scaled to the brightest of the first frame and coded by sRGB's 1/2.2.
    """
    if correction is not None:
        one = np.ones(1)
        return lambda radiance: correction(radiance[None], one)[0], []
    first = render_views(saved.field, _views(way, 0, len(dark)), dark)[0]
    white = max(float(np.quantile(first, BRIGHTEST)), 1e-6)
    note = "no views say how bright the scene is: white is the brightest of the first frame, colours are coded by 1/2.2"
    return lambda radiance: (np.maximum(radiance, 0) / white) ** (1 / 2.2), [note]


def _eight_bits(image: np.ndarray) -> np.ndarray:
    shown = np.rint(255 * np.clip(np.nan_to_num(image), 0, 1)).astype(np.uint8)
    return np.repeat(shown, 3, axis=-1) if shown.shape[-1] == 1 else shown


def _write_depths(folder: Path, way: Way, depths: list[np.ndarray]) -> dict[str, str]:
    (folder / DEPTH).mkdir()
    for name, depth, picture in zip(way.names, depths, _depth_pictures(depths), strict=True):
        np.save(folder / DEPTH / f"{name}.npy", depth)
        _save(folder / DEPTH / f"{name}.png", picture)
    return {f"{DEPTH}/": f"{len(depths)} arrays of distances (NaN: nothing there), and pictures of them"}


def _depth_pictures(depths: list[np.ndarray]) -> list[np.ndarray]:
    """(H, W, 3) 8-bit each: near is bright, white is nothing."""
    import matplotlib

    colours = matplotlib.colormaps["viridis_r"]
    seen = np.concatenate([depth[np.isfinite(depth)] for depth in depths])
    low, high = (float(seen.min()), float(seen.max())) if len(seen) else (0.0, 1.0)
    pictures = []
    for depth in depths:
        share = (np.nan_to_num(depth, nan=high) - low) / max(high - low, 1e-9)
        picture = (255 * colours(share)[..., :3]).astype(np.uint8)
        picture[~np.isfinite(depth)] = 255
        pictures.append(picture)
    return pictures


def _write_videos(folder: Path, frames, depths, rate: int, notes: list[str]) -> dict[str, str]:
    if not video.can_write():
        notes.append('no video: pip install "pixelid[video]" brings PyAV; the frames are there as PNG')
        return {}
    video.write_video(folder / VIDEO, frames, rate)
    files = {VIDEO: f"{len(frames) / rate:.1f} s at {rate} frames a second"}
    if depths:
        video.write_video(folder / DEPTH_VIDEO, _depth_pictures(depths), rate)
        files[DEPTH_VIDEO] = "the same of the depths"
    return files


def _save(path: Path, image: np.ndarray) -> None:
    from skimage.io import imsave

    imsave(path, image, check_contrast=False)
