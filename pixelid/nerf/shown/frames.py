"""Frames along a way, their depths and errors: each is on disk before the next, so that many take no more memory."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pixelid.errors import InputError
from pixelid.nerf.data.views import Views
from pixelid.nerf.field.radiance import Field
from pixelid.nerf.shown.errors import Pictures, error_picture, write_error
from pixelid.nerf.shown.evaluate import render_views
from pixelid.nerf.shown.solid import depth_of
from pixelid.nerf.shown.ways import Way

FRAMES, DEPTH, ERRORS = "frames", "depth", "errors"
FEW = 5  # of the frames, that a figure shows


@dataclass
class Made:
    """What a way has come to so far.

    frames: number;  white: sum over them of the share of pixels beyond white;  nearest, farthest: of all depths;  rows:
    of `Pictures.row`;  unread: why frames have no error map;  shown: (H, W, 3) 8-bit, a few of the frames;  depths:
    (H, W) of these;  errors: (H, W) of these, mean absolute error over the colours, NaN where there is none
    """

    frames: int = 0
    white: float = 0.0
    nearest: float = math.inf
    farthest: float = -math.inf
    rows: list[dict[str, Any]] = dataclasses.field(default_factory=list)
    unread: list[str] = dataclasses.field(default_factory=list)
    shown: list[np.ndarray] = dataclasses.field(default_factory=list)
    depths: list[np.ndarray] = dataclasses.field(default_factory=list)
    errors: list[np.ndarray] = dataclasses.field(default_factory=list)

    @property
    def depth_range(self) -> tuple[float, float] | None:
        """Of all frames, None where nothing has a depth."""
        return (self.nearest, self.farthest) if self.nearest <= self.farthest else None


def make_frames(
    field: Field, way: Way, folder: Path, tone: Callable[[np.ndarray], np.ndarray], dark: np.ndarray, *,
    depth: bool = False, pictures: Pictures | None = None, supersample: int = 1,
    progress: Callable[[float], None] = lambda share: None,
) -> Made:  # fmt: skip
    """Write frames/, and on request depth/ and errors/.

    Args:
        field: the scene.
        way: the cameras.
        folder: an existing one.
        tone: radiance (H, W, C) → what a picture shows of it, white at 1.
        dark: (C,) black level that the field does not hold.
        depth: whether distances are wanted.
        pictures: that frames are compared with.
        supersample: rays per pixel and side.
        progress: called with the share that is done.

    Returns:
        What is stated of them.
    """
    made = Made()
    some = set(np.linspace(0, len(way) - 1, min(FEW, len(way))).astype(int).tolist())
    for name, asked in ((FRAMES, True), (DEPTH, depth), (ERRORS, pictures is not None)):
        if asked:
            (folder / name).mkdir()
    for k, name in enumerate(way.names):
        view = view_of(way, k, len(dark))
        radiance = render_views(field, view, dark, supersample=supersample)[0]
        image = tone(radiance)
        frame = eight_bits(image)
        _save(folder / FRAMES / f"{name}.png", frame)
        made.frames += 1
        made.white += float(np.mean((image > 1.0).any(axis=-1)))
        if k in some:
            made.shown.append(frame)
        if depth:
            _add_depth(made, depth_of(field, view)[0].astype(np.float32), folder / DEPTH / name, k in some)
        if pictures is not None:
            _add_error(made, pictures, radiance, k, folder / ERRORS, name, k in some)
        progress((k + 1) / len(way))
    if depth:
        for name in way.names:
            _save(folder / DEPTH / f"{name}.png", _depth_picture(np.load(folder / DEPTH / f"{name}.npy"), made))
    return made


def read_back(folder: Path, names: tuple[str, ...]) -> Iterator[np.ndarray]:
    """(H, W, 3) 8-bit each: the pictures of these names in a folder that `make_frames` has filled."""
    from skimage.io import imread

    return (imread(folder / f"{name}.png") for name in names)


def view_of(way: Way, k: int, colours: int) -> Views:
    """One camera of a way, without an image."""
    blank = np.empty((1, way.camera.height, way.camera.width, colours), np.float32)
    return Views(blank, way.position[k : k + 1], way.rotation[k : k + 1], way.camera, ("",), np.ones(1), False, 1.0)


def eight_bits(image: np.ndarray) -> np.ndarray:
    """(…, 3) 8-bit of an image (…, C), white at 1."""
    shown = np.rint(255 * np.clip(np.nan_to_num(image), 0, 1)).astype(np.uint8)
    return np.repeat(shown, 3, axis=-1) if shown.shape[-1] == 1 else shown


def _add_depth(made: Made, depth: np.ndarray, path: Path, shown: bool) -> None:
    np.save(path.with_name(f"{path.name}.npy"), depth)
    seen = depth[np.isfinite(depth)]
    if seen.size:
        made.nearest, made.farthest = min(made.nearest, float(seen.min())), max(made.farthest, float(seen.max()))
    if shown:
        made.depths.append(depth)


def _add_error(made: Made, pictures: Pictures, radiance, k: int, folder: Path, name: str, shown: bool) -> None:
    try:
        error = pictures.error(radiance, k)
    except InputError as why:
        made.unread.append(f"{name}: {why}")
        error = np.full(radiance.shape, np.nan, np.float32)
    else:
        write_error(folder, name, error, error_picture(error, pictures.full_scale))
        made.rows.append(pictures.row(name, error))
    if shown:
        made.errors.append(np.abs(error).mean(axis=-1))


def _depth_picture(depth: np.ndarray, made: Made) -> np.ndarray:
    """(H, W, 3) 8-bit: near is bright, white is nothing; one scale for all frames."""
    import matplotlib

    low, high = made.depth_range or (0.0, 1.0)
    share = (np.nan_to_num(depth, nan=high) - low) / max(high - low, 1e-9)
    picture = (255 * matplotlib.colormaps["viridis_r"](share)[..., :3]).astype(np.uint8)
    picture[~np.isfinite(depth)] = 255
    return picture


def _save(path: Path, image: np.ndarray) -> None:
    from skimage.io import imsave

    imsave(path, image, check_contrast=False)
