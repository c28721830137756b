"""One test view as its reference, this reconstruction and another one show it: pictures for the slider of the page."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pixelid.documents import interpreting
from pixelid.errors import InputError
from pixelid.nerf.data.views import Views
from pixelid.nerf.shown.correction import Correction
from pixelid.nerf.shown.evaluate import Scores, render_views
from pixelid.nerf.shown.saved import SavedReconstruction
from pixelid.provenance import input_hashes

REFERENCE, THIS, OTHER = "slider_reference", "slider_reconstruction", "slider_beside"  # names of the pictures


@dataclass(frozen=True)
class Beside:
    """Another reconstruction of the same data, to be shown next to one.

    Attributes:
        scene: The other.
        correction: That its scores were made with.
        dark: (C,) black level that its field does not hold.
    """

    scene: SavedReconstruction
    correction: Correction
    dark: np.ndarray

    @classmethod
    def read(cls, folder: Path, files: Iterable[Path]) -> Beside:
        """The reconstruction of a folder.

        Args:
            folder: that `pixelid reconstruct` wrote.
            files: of the data set that both have to be of.

        Raises:
            InputError: no reconstruction there, a damaged one, or one of other data.
        """
        scene = SavedReconstruction.load(folder)
        file = folder / SavedReconstruction.FILE
        with interpreting(file, "a reconstruction"):
            hashes = dict(scene.content["inputs_sha256"])
        for name, own in input_hashes(list(files)).items():
            if hashes.get(name) != own:
                raise InputError(f"{folder}: expected a reconstruction of the same data, found one with another {name}")
        if scene.correction is None:
            raise InputError(f"{file}: correction: missing; nothing was scored")
        return cls(scene, scene.correction, scene.dark)

    def image(self, view: Views) -> np.ndarray:
        """(H, W, C) what it shows of a single view, clipped to what a picture holds."""
        seen = self.correction(render_views(self.scene.field, view, self.dark), view.exposure)
        return np.clip(seen, 0.0, view.peak)[0]

    def as_dict(self) -> dict[str, Any]:
        """The entry "beside" of reconstruction.json."""
        content: Mapping[str, Any] = self.scene.content
        return {"status": content["status"], "bandwidth": content["bandwidth"], "psnr": content["views"]["psnr"]}


def write_slider(truth: Views, scores: Scores, beside: Beside | None, folder: Path) -> None:
    """Write the pictures of the middle one of the test views.

    Args:
        truth: Test views, at least one.
        scores: Of them.
        beside: Another reconstruction, or None.
        folder: Where slider_reference.png, slider_reconstruction.png and (with `beside`) slider_beside.png go.
    """
    k = len(truth) // 2
    view = truth.some([k])
    _save(folder / f"{REFERENCE}.png", np.clip(truth.images[k], 0.0, truth.peak), truth.peak)
    _save(folder / f"{THIS}.png", scores.images[k], truth.peak)
    if beside is not None:
        _save(folder / f"{OTHER}.png", beside.image(view), truth.peak)


def _save(path: Path, image: np.ndarray, peak: float) -> None:
    """An image (H, W, C) as a picture of 8 bits."""
    from skimage.io import imsave

    least_side = 384  # screen pixels of a picture's longer side; smaller views are enlarged by whole factors
    factor = max(-(-least_side // max(image.shape[:2])), 1)
    levels = np.round(255.0 * np.nan_to_num(np.clip(image / peak, 0.0, 1.0))).astype(np.uint8)
    levels = levels.repeat(factor, axis=0).repeat(factor, axis=1)
    imsave(path, levels if levels.shape[-1] == 3 else levels[..., 0], check_contrast=False)
