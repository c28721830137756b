"""A scene from posed images: a field fitted to them, which then stands for the truth and is rendered like any scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from pixelid.errors import InputError
from pixelid.nerf.data.camera import Camera, pinhole_of_focal
from pixelid.nerf.data.views import LUMA, OPENGL, Views
from pixelid.nerf.field.radiance import Field
from pixelid.nerf.field.render import Rays
from pixelid.nerf.field.smoothness import mean_log_density, mean_square, variation
from pixelid.nerf.shown.evaluate import render_views
from pixelid.nerf.training.state import HARMONICS_RATE

VERTICES = (33, 65, 97)
BATCH, ITERATIONS = 8192, 2000
# Chosen on the Lego pictures of NeRF at 100 × 100 pixels, one in ten of them held out (docs/results/reconstruction.md).
DEGREE, STIFFNESS, ROUGHNESS, EMPTINESS = 1, 1e-2, 5e-4, 1e-4
DARKEST = 5e-3
HALF = 1.5  # of the side of the box about the origin
RATE = 0.1


@dataclass(frozen=True)
class PosedScene:
    """A fitted field before a uniform background; renders as `scenes.Scene` does."""

    field: Field
    background: float

    def render(self, camera: Camera, position, rotation, supersample: int = 1) -> np.ndarray:
        """Images (n, height, width) of cameras at position (n, 3), rotation (n, 3, 3) to world."""
        position, rotation = np.atleast_2d(position), np.asarray(rotation).reshape(-1, 3, 3)
        n = len(position)
        blank = np.empty((n, camera.height, camera.width, 1))
        views = Views(blank, position, rotation, camera, ("",) * n, np.ones(n), False, 1.0)
        images = render_views(self.field, views, np.zeros(1), supersample=supersample)[..., 0]
        return np.maximum(images, DARKEST)


def scene_of_images(images: np.ndarray, poses: np.ndarray, focal: float, *, seed: int = 0) -> PosedScene:
    """Fit a grey scene to images, over white where they are transparent.

    Args:
        images: (n, H, W, 3 or 4) of 8 bits.
        poses: (n, 4, 4) camera to world, as OpenGL has them.
        focal: length in pixels.
        seed: of the rays drawn.

    Returns:
        The scene, which renders from anywhere.

    Raises:
        InputError: shapes that do not match.
    """
    if images.ndim != 4 or images.shape[3] not in (3, 4) or poses.shape != (len(images), 4, 4):
        raise InputError(f"posed images: expected (n, H, W, 3 or 4) and (n, 4, 4), found {images.shape}, {poses.shape}")
    grey = np.maximum(grey_over_white(images), DARKEST)
    height, width = grey.shape[1:]
    camera = pinhole_of_focal(width, height, focal)
    box = np.full(3, -HALF), np.full(3, HALF)
    position, rotation = poses[:, :3, 3], poses[:, :3, :3] @ OPENGL
    return PosedScene(fit_field(grey, position, rotation, camera, *box, seed=seed), 1.0)


def grey_over_white(images: np.ndarray) -> np.ndarray:
    """(n, H, W) grey of images (n, H, W, 3 or 4) of 8 bits, 0 to 1, over white where they are transparent."""
    values = images[..., :3] / 255.0
    if images.shape[3] == 4:
        alpha = images[..., 3:] / 255.0
        values = alpha * values + 1.0 - alpha
    return values @ LUMA


def fit_field(
    images: np.ndarray, position: np.ndarray, rotation: np.ndarray, camera: Camera, low: np.ndarray, high: np.ndarray,
    *, background: float = 1.0, iterations: int = ITERATIONS, seed: int = 0,
) -> Field:  # fmt: skip
    """Fit a grey field to images, by squared differences.

    Args:
        images: (n, H, W) radiance, not below 0.
        position, rotation: (n, 3), (n, 3, 3) of the cameras, to world.
        camera: that took them.
        low, high: (3,) corners of the box.
        background: radiance behind it.
        iterations: of the fit.
        seed: of the rays drawn.

    Returns:
        The field.
    """
    inside, pixels = camera.all_directions(), images.reshape(len(images), -1)
    rng = np.random.default_rng(seed)
    field = Field(low, high, VERTICES[0], 1, [background], level=0.5 * background, degree=DEGREE)
    optimiser = _optimiser(field)
    for k in range(iterations):
        vertices = VERTICES[k * len(VERTICES) // iterations]
        if vertices != field.vertices:
            field.refine(vertices)
            optimiser = _optimiser(field)
        for group in optimiser.param_groups:
            group["lr"] = group["share"] * RATE * 0.1 ** (k / iterations)
        which, pixel = rng.integers(0, len(images), BATCH), rng.integers(0, pixels.shape[1], BATCH)
        directions = np.einsum("nij,nj->ni", rotation[which], inside[pixel]).astype(np.float32)
        offsets = rng.random(BATCH, dtype=np.float32)
        rays = Rays(position[which].astype(np.float32), directions, np.zeros(BATCH, np.int64), offsets)
        predicted, _ = field(rays)
        truth = torch.from_numpy(pixels[which, pixel].astype(np.float32))
        loss = ((predicted - truth) ** 2).mean() + EMPTINESS * mean_log_density(field.grid, field.bricks)
        loss = loss + ROUGHNESS * variation(field.grid, field.bricks)
        loss = loss + STIFFNESS * mean_square(field.coefficients, field.bricks)
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        optimiser.step()
        if k >= 64 and k % 16 == 0:
            field.look_for_empty_blocks()
    return field


def _optimiser(field: Field) -> torch.optim.Optimizer:
    groups = [{"params": [field.grid], "share": 1.0}, {"params": [field.coefficients], "share": HARMONICS_RATE}]
    return torch.optim.Adam(groups, lr=RATE, eps=1e-15, fused=True)
