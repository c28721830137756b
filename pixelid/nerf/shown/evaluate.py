"""Views rendered from the field, corrected on validation views, compared with test views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import torch

from pixelid.nerf.data.camera import sub_pixel_directions
from pixelid.nerf.data.views import Views
from pixelid.nerf.field.radiance import Field
from pixelid.nerf.field.render import Rays
from pixelid.nerf.shown.correction import Correction, fit_correction, fit_shared_correction


@dataclass(frozen=True)
class Scores:
    """Per test view, and their means.

    psnr, ssim: (n,);  lpips: (n,) or None where its weights are not installed;  images: (n, H, W, C) corrected views
    """

    psnr: np.ndarray
    ssim: np.ndarray
    lpips: np.ndarray | None
    images: np.ndarray
    correction: Correction

    def as_dict(self, views: Views) -> dict:
        """The entry "views" of reconstruction.json."""
        per_view = [
            {
                "name": views.names[k],
                "psnr": float(self.psnr[k]),
                "ssim": float(self.ssim[k]),
                "lpips": None if self.lpips is None else float(self.lpips[k]),
            }
            for k in range(len(views))
        ]
        return {**self.means(), "per_view": per_view}

    def means(self) -> dict[str, float | None]:
        """Over the test views."""
        return {
            "psnr": _mean(self.psnr),
            "ssim": _mean(self.ssim),
            "lpips": None if self.lpips is None else _mean(self.lpips),
        }


def psnr_of(squared_error: np.ndarray, span: float) -> np.ndarray:
    """dB of mean squared errors, for pictures whose values can be `span` apart; 120 dB and more for what is equal."""
    return 10 * np.log10(span**2 / np.maximum(squared_error, 1e-12))


def _mean(values: np.ndarray) -> float:
    """NaN of nothing."""
    return float(values.mean()) if len(values) else float("nan")


def render_views(field: Field, views: Views, dark, *, supersample: int = 1) -> np.ndarray:
    """Predicted radiance of views.

    Args:
        field: the scene.
        views: where from; their images are not looked at.
        dark: (C,) black level that the field does not hold.
        supersample: rays per pixel and side.

    Returns:
        (n, H, W, C) radiance, the black level included.
    """
    camera = views.camera
    inside = sub_pixel_directions(camera, supersample).reshape(-1, supersample**2, 3).swapaxes(0, 1)
    channels = len(np.atleast_1d(dark))
    out = np.zeros((len(views), camera.height, camera.width, channels))
    with torch.no_grad():
        for k in range(len(views)):
            for directions in inside:
                world = (directions @ views.rotation[k].T).astype(np.float32)
                origins = np.repeat(views.position[k : k + 1].astype(np.float32), len(world), axis=0)
                half = np.full(len(world), 0.5, np.float32)
                for c in range(channels):
                    rays = Rays(origins, world, np.full(len(world), c), half)
                    out[k, :, :, c] += _in_parts(field, rays).reshape(camera.height, camera.width)
    return out / len(inside) + np.asarray(dark)


def _in_parts(field: Field, rays: Rays) -> np.ndarray:
    """(n,) radiance of rays, so many at a time that their samples find room on a device."""
    shown = []
    rays_at_once = 1 << 16
    for first in range(0, len(rays.origins), rays_at_once):
        part = slice(first, first + rays_at_once)
        some = Rays(rays.origins[part], rays.directions[part], rays.channels[part], rays.offsets[part])
        shown.append(field(some)[0].cpu().numpy())
    return np.concatenate(shown)


def score(predicted: np.ndarray, views: Views, correction: Correction) -> Scores:
    """Predictions (n, H, W, C) against test views, after correction, both clipped to [0, peak]."""
    images = np.clip(correction(predicted, views.exposure), 0.0, views.peak)
    return _scores(images, np.clip(views.images, 0.0, views.peak), views.peak, views.peak, correction)


def _scores(images: np.ndarray, truth: np.ndarray, peak: float, span: float, correction: Correction) -> Scores:
    """Of corrected views (n, H, W, C) against true ones; span: of the values, for PSNR."""
    psnr = psnr_of(((images - truth) ** 2).mean(axis=(1, 2, 3)), span)
    return Scores(psnr, ssim(images, truth, peak), lpips(images / peak, truth / peak), images, correction)


def evaluate(field: Field, validation: Views, test: Views, dark) -> Scores:
    """Correct on the validation views, score on the test views.

    Args:
        field: the scene.
        validation: views that fix the correction a·Lᵇ − c.
        test: views that are scored.
        dark: (C,) black level that the field does not hold.

    Returns:
        Scores of every test view, of which there may be none.
    """
    if len(test) == 0:
        return no_scores(test)
    correction = fit_correction(render_views(field, validation, dark), validation.images, validation.exposure)
    return score(render_views(field, test, dark), test, correction)


def evaluate_as_published(field: Field, test: Views, dark) -> Scores:
    """Scores by the protocol of the reference implementation of Deblur e-NeRF.

    The correction is fitted to the very views that are scored, which is kinder than `evaluate`, with one exponent for
    all colours; nothing is clipped, which is harder; PSNR is relative to the span of values that a picture can hold.
    """
    if len(test) == 0:
        return no_scores(test)
    predicted = render_views(field, test, dark)
    correction = fit_shared_correction(predicted, test.images, test.exposure)
    return _scores(correction(predicted, test.exposure), test.images, test.peak, test.span, correction)


def no_scores(test: Views) -> Scores:
    """NaN for every test view and black images: of a field that cannot be shown."""
    nothing = np.full(len(test), np.nan)
    one = np.ones(test.images.shape[-1])
    return Scores(nothing, nothing, None, np.zeros_like(test.images), Correction(one, one, 0 * one))


def ssim(images, truth, peak: float) -> np.ndarray:
    """(n,) structural similarity as its authors compute it: Gaussian window, σ = 1.5 (scikit-image)."""
    from skimage.metrics import structural_similarity

    short = min(images.shape[1:3])
    asked: dict[str, Any] = {
        "data_range": peak, "channel_axis": -1, "gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False,
        "win_size": 11 if short >= 11 else (short - 1) | 1,
    }  # fmt: skip
    return np.array([structural_similarity(a, b, **asked) for a, b in zip(images, truth, strict=True)])


@lru_cache(maxsize=1)
def _lpips_network():
    """The AlexNet metric, or None where the package or its weights are not on this computer (nothing is fetched)."""
    try:
        import lpips as package  # type: ignore[import-not-found]
    except ImportError:
        return None
    from pathlib import Path

    cached = Path(torch.hub.get_dir()) / "checkpoints"
    if not any(cached.glob("alexnet-*.pth")):
        return None
    return package.LPIPS(net="alex", verbose=False)


def lpips(images: Sequence[np.ndarray] | np.ndarray, truth) -> np.ndarray | None:
    """(n,) LPIPS of images in [0, 1], or None (see `_lpips_network`)."""
    network = _lpips_network()
    if network is None:
        return None
    a, b = (torch.as_tensor(np.moveaxis(np.asarray(x), -1, 1) * 2 - 1, dtype=torch.float32) for x in (images, truth))
    a, b = (x.expand(-1, 3, -1, -1) if x.shape[1] == 1 else x for x in (a, b))
    with torch.no_grad():
        return network(a, b).reshape(-1).numpy()
