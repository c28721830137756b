"""Where a scene departs from the pictures of its views: error maps of what is rendered, as the scores count it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pixelid.errors import InputError
from pixelid.nerf.data.views import ViewsFile
from pixelid.nerf.shown.correction import Correction
from pixelid.nerf.shown.evaluate import psnr_of
from pixelid.nerf.shown.ways import Way

FULL_SCALE = 0.3  # of the white of all pictures of a file, shown or not: the absolute error that is shown brightest


@dataclass(frozen=True)
class Pictures:
    """The pictures of a way's frames, read one at a time.

    truth: the views of their file;  which: of them are frames;  correction: that the scores were made with
    """

    truth: ViewsFile
    which: Sequence[int]
    correction: Correction

    @property
    def full_scale(self) -> float:
        """The absolute error that is shown brightest, in the unit of the views."""
        return FULL_SCALE * self.truth.peak

    def error(self, radiance: np.ndarray, k: int) -> np.ndarray:
        """(H, W, C) by how much frame k of that radiance is brighter than its picture, both clipped as for scores.

        Raises:
            InputError: its picture is missing, damaged, or unlike the others.
        """
        view = self.truth.view(self.which[k])
        seen = np.clip(self.correction(radiance[None], view.exposure), 0.0, view.peak)
        return (seen - np.clip(view.images, 0.0, view.peak))[0].astype(np.float32)

    def row(self, name: str, error: np.ndarray) -> dict[str, Any]:
        """Of one frame, in the entry "errors" of render.json."""
        psnr = psnr_of(np.array((error.astype(float) ** 2).mean()), self.truth.peak)
        of_all = {"mean": float(error.mean()), "mean_absolute": float(np.abs(error).mean())}
        return {"name": name, "psnr": float(psnr), **of_all}


def pictures_of(
    way: Way, correction: Correction | None, colours: int, log_eps: float = 0.0
) -> tuple[Pictures | None, list[str]]:  # fmt: skip
    """(the pictures of a way's frames, why there are none where the way names some).

    correction: of the scores, None where there are none: then nobody knows what the scene's unit is in the pictures';
    log_eps: of the views that were scored
    """
    if way.listed is None or correction is None:
        return None, []
    try:
        truth = ViewsFile.open(way.listed.file, colours, way.listed.dataset, log_eps=log_eps)
    except InputError as error:
        return None, [f"no error maps: {error}"]
    found, asked = truth.first.shape[1::-1], (way.camera.width, way.camera.height)
    if found != asked:
        sizes = f"pictures have {found[0]} × {found[1]} pixels, frames {asked[0]} × {asked[1]}"
        return None, [f"no error maps: {sizes}; leave --size out"]
    return Pictures(truth, way.listed.which, correction), []


def error_picture(error: np.ndarray, full_scale: float) -> np.ndarray:
    """(H, W, 3) 8-bit: the mean absolute error over the colours, black for none, brightest from `full_scale` on."""
    import matplotlib

    share = np.abs(error).mean(axis=-1) / full_scale
    return (255 * matplotlib.colormaps["magma"](np.clip(share, 0.0, 1.0))[..., :3]).astype(np.uint8)


def write_error(folder: Path, name: str, error: np.ndarray, picture: np.ndarray) -> None:
    """Write NAME.npy, the signed error (H, W, C), and NAME.png into an existing folder."""
    from skimage.io import imsave

    np.save(folder / f"{name}.npy", error)
    imsave(folder / f"{name}.png", picture, check_contrast=False)
