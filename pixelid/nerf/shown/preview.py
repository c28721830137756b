"""What a scene looks like while it is trained: one small picture, renewed at every look."""

from __future__ import annotations

import os
import struct
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np

from pixelid.errors import InputError
from pixelid.nerf.data.views import Views, no_views
from pixelid.nerf.shown.evaluate import Scores, render_views
from pixelid.nerf.training.state import Problem, State
from pixelid.outputs import refuse_existing, whole_file

MOST_SIDE = 400  # pixels of a preview's longer side
# Of a scene without views, which is rendered for the preview alone: a hundred thousand rays over a run, forwards only,
# of some 1e7 that the default recipe sends.
UNSEEN_SIDE = 96
WHITE = 0.995  # quantile of such a picture that becomes white, coded by 1/2.2


# A text chunk (PNG specification, 5.3 and 11.3.3.2) behind the header: a preview that an interrupted run has left is
# replaced without asking, as its checkpoint is, and another file of that name is not.
HEADER_BYTES = 33
MARK = b"tEXtSoftware\0pixelid reconstruct, preview"


def refuse_preview(path: Path, overwrite: bool = False) -> None:
    """Check, before any training, that a preview can be written.

    Args:
        path: of the preview.
        overwrite: whether it may replace another file.

    Raises:
        InputError: it cannot be written, or would replace a file that is no preview.
    """
    if path.suffix.lower() != ".png" or path.is_dir():
        raise InputError(f"{path}: expected the name of a PNG for the preview")
    refuse_existing(path, overwrite=True)
    if os.path.lexists(path) and not overwrite and not _is_preview(path):
        raise InputError(f"{path}: is not a preview and would be replaced by one; rename it or pass --overwrite")


def _is_preview(path: Path) -> bool:
    """Whether a file is a preview that `write_preview` has written."""
    if not path.is_file():
        return False
    try:
        with path.open("rb") as file:
            return MARK in file.read(HEADER_BYTES + 4 + len(MARK))
    except OSError:
        return False


def write_preview(path: Path, problem: Problem, state: State, scores: Scores | None, validation: Views) -> None:
    """Replace the preview by what the scene shows now; nothing where it holds other than numbers.

    Args:
        path: of a PNG.
        problem: that is trained on.
        state: of the training, which stays as it is; nothing random is drawn.
        scores: of a validation view, already rendered; None where there are no views, and the first pose is shown.
        validation: the views, which say what white is.
    """
    if not state.finite:
        return
    image = _first_pose(problem, state) if scores is None else scores.images[-1] / validation.peak
    _save(path, image)


def _first_pose(problem: Problem, state: State) -> np.ndarray:
    """(h, w, C) of the scene as the first pose sees it, white at 1."""
    camera = problem.camera
    share = min(UNSEEN_SIDE / max(camera.width, camera.height), 1.0)
    small = camera.resized(max(round(share * camera.width), 1), max(round(share * camera.height), 1))
    position, rotation = problem.trajectory.at(problem.trajectory.t[:1])
    blank = np.empty((1, small.height, small.width, len(problem.dark)), np.float32)
    view = replace(no_views(small, len(problem.dark)), images=blank, position=position, rotation=rotation, names=("",))
    radiance = render_views(state.field, view, problem.dark)[0]
    return (radiance / max(float(np.quantile(radiance, WHITE)), 1e-6)).clip(min=0.0) ** (1 / 2.2)


def _save(path: Path, image: np.ndarray) -> None:
    """An image (H, W, C), white at 1, as a PNG of at most `MOST_SIDE`, whole or not at all."""
    from skimage.io import imsave

    every = -(-max(image.shape[:2]) // MOST_SIDE)
    levels = np.round(255.0 * np.nan_to_num(np.clip(image[::every, ::every], 0.0, 1.0))).astype(np.uint8)
    with whole_file(path, overwrite=True) as temporary:
        imsave(temporary, levels if levels.shape[-1] == 3 else levels[..., 0], check_contrast=False)
        plain = temporary.read_bytes()
        chunk = struct.pack(">I", len(MARK) - 4) + MARK + struct.pack(">I", zlib.crc32(MARK))
        temporary.write_bytes(plain[:HEADER_BYTES] + chunk + plain[HEADER_BYTES:])
