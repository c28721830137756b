"""`pixelid render`: frames along a way, with depth, as video, and the scene as a mesh or as splats."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from pixelid.nerf.options import RenderOptions
from pixelid.nerf.shown import ply, video
from pixelid.nerf.shown.correction import Correction
from pixelid.nerf.shown.errors import FULL_SCALE, pictures_of
from pixelid.nerf.shown.evaluate import render_views
from pixelid.nerf.shown.frames import DEPTH, ERRORS, FRAMES, eight_bits, make_frames, read_back, view_of
from pixelid.nerf.shown.saved import FIELD, SavedReconstruction
from pixelid.nerf.shown.solid import mesh_of
from pixelid.nerf.shown.splats import splats_of
from pixelid.nerf.shown.ways import Way
from pixelid.provenance import provenance
from pixelid.results import Table, WrittenResult
from pixelid.status import Status

VIDEO, DEPTH_VIDEO = "video.mp4", "depth.mp4"
MESH, SPLATS = "mesh.ply", "splats.ply"
BRIGHTEST = 0.995  # quantile of the first frames that becomes white where no views say what white is


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

    def write_companions(self, folder: Path) -> None:
        """Draw a few of the frames; the others are there."""
        from pixelid.nerf.shown.figures import write_figures

        write_figures(self, folder)


def render(
    path: Path,
    saved: SavedReconstruction,
    way: Way,
    folder: Path,
    asked: RenderOptions,
    *,
    seed: int = 0,
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> Rendered:
    """Render a reconstruction into a folder.

    Args:
        path: of the reconstruction's folder.
        saved: the reconstruction.
        way: the cameras.
        folder: an existing one, which is filled.
        asked: what is made of it, and how finely; `way` has where from.
        seed: recorded; nothing here is random.
        progress: called with what is done and the fraction.

    Returns:
        What was made.

    Raises:
        InputError: a scene without surface is to become a mesh, or one without density splats.
    """
    watch = time.perf_counter()
    dark, correction = saved.dark, _correction(saved)
    tone, notes = tone_of(saved, way, dark)
    pictures, lacking = pictures_of(way, correction, len(dark), saved.log_eps)
    notes += lacking
    if saved.status is not Status.converged:
        notes.append(f"the reconstruction ended as {saved.status}: {saved.advice or saved.status.advice}")
    if way.left_out:
        notes.append(f"{way.left_out} of {len(way) + way.left_out} poses are left out, evenly; --frames takes more")
    mesh = mesh_of(saved.field) if asked.mesh else None  # before the frames: scenes without are refused at once
    splats = splats_of(saved.field) if asked.splats else None
    made = make_frames(
        saved.field, way, folder, tone, dark, depth=asked.depth, pictures=pictures, supersample=asked.supersample,
        progress=lambda share: progress("frames", 0.8 * share),
    )  # fmt: skip
    files = {f"{FRAMES}/": f"{made.frames} PNG pictures"}
    much_white = 0.01  # share of the pixels beyond white from which on it is said
    if (white := made.white / made.frames) > much_white:
        notes.append(f"{white:.1%} of the pixels are brighter than white of the views, and shown as white")
    if asked.depth:
        files[f"{DEPTH}/"] = f"{made.frames} arrays of distances (NaN: nothing there), and pictures of them"
    if pictures is not None:
        scale = f"black for none, brightest from {pictures.full_scale:.3g} of the views' unit on, {FULL_SCALE} of white"
        files[f"{ERRORS}/"] = f"{len(made.rows)} arrays, frame less picture, and pictures of their size: {scale}"
    if made.unread:
        notes.append(f"{len(made.unread)} of {made.frames} frames have no error map; the first: {made.unread[0]}")
    if asked.video:
        files |= _write_videos(folder, way, asked, notes)
    if mesh is not None:
        ply.write_mesh(folder / MESH, mesh, eight_bits(tone(mesh.radiance[None] + dark))[0])
        files[MESH] = f"{len(mesh.faces)} triangles, coloured"
    if splats is not None:
        ply.write_splats(
            folder / SPLATS, splats, splats.colours(lambda radiance: eight_bits(tone(radiance[None] + dark))[0] / 255)
        )
        files[SPLATS] = f"{len(splats.centre)} Gaussian splats"
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
        "depth_range": made.depth_range,
        "errors": None if pictures is None else {"full_scale": pictures.full_scale, "frames": made.rows},
        "notes": notes,
        "seconds": time.perf_counter() - watch,
        "seed": seed,
        **provenance(path / FIELD, path / SavedReconstruction.FILE),
    }
    return Rendered(
        content, np.array(made.shown), np.array(made.depths) if made.depths else None,
        np.array(made.errors) if made.errors else None,
    )  # fmt: skip


def _correction(saved: SavedReconstruction) -> Correction | None:
    """Of the scores, None where nothing was scored."""
    return saved.correction if saved.content["views"]["per_view"] else None


def tone_of(
    saved: SavedReconstruction, way: Way, dark: np.ndarray
) -> tuple[Callable[[np.ndarray], np.ndarray], list[str]]:
    """Radiance (H, W, C) → what a picture shows of it, white at 1, and what has to be stated about it.

    With test views, their unit: the correction a·L^b − c of the scores, white at 1.  Without, nobody knows the
    exponent: radiance is scaled to the brightest of the first frame and coded by sRGB's 1/2.2.
    """
    if (correction := _correction(saved)) is not None:
        one = np.ones(1)
        return lambda radiance: correction(radiance[None], one)[0], []
    first = render_views(saved.field, view_of(way, 0, len(dark)), dark)[0]
    white = max(float(np.quantile(first, BRIGHTEST)), 1e-6)
    note = "no views say how bright the scene is: white is the brightest of the first frame, colours are coded by 1/2.2"
    return lambda radiance: (np.maximum(radiance, 0) / white) ** (1 / 2.2), [note]


def _write_videos(folder: Path, way: Way, asked: RenderOptions, notes: list[str]) -> dict[str, str]:
    """Of the pictures that are in the folder."""
    if not video.can_write():
        notes.append('no video: pip install "pixelid[video]" brings PyAV; the frames are there as PNG')
        return {}
    rate = asked.fps
    video.write_video(folder / VIDEO, read_back(folder / FRAMES, way.names), rate)
    files = {VIDEO: f"{len(way) / rate:.1f} s at {rate} frames a second"}
    if asked.depth:
        video.write_video(folder / DEPTH_VIDEO, read_back(folder / DEPTH, way.names), rate)
        files[DEPTH_VIDEO] = "the same of the depths"
    return files
