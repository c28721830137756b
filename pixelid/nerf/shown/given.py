"""What a reconstruction starts from, at a glance: events as the camera sends them, and where it went."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from pixelid.figures.style import INK, MUTED, OFF, ON, PAPER, legend_above, new_axes, styled
from pixelid.nerf.data.dataset import Dataset
from pixelid.nerf.data.views import Views

EVENTS_PER_PIXEL = 0.3  # of the picture: edges show, and hardly a pixel hides an event behind another


@dataclass(frozen=True)
class Given:
    """Events of a short time, and the camera's path.

    Attributes:
        last: (H, W) 1, −1 or 0: of each pixel's last event in that time ON, OFF, or none.
        begin_s, length_s: That time, in the middle of the recording.
        path: (n, 3) positions of the camera.
        views: (m, 3) positions of the test views.
        low, high: (3,) corners of the box that holds the scene.
    """

    last: np.ndarray
    begin_s: float
    length_s: float
    path: np.ndarray
    views: np.ndarray
    low: np.ndarray
    high: np.ndarray

    @classmethod
    def of(cls, dataset: Dataset, test: Views, low: np.ndarray, high: np.ndarray) -> Given:
        """What is seen of a dataset whose scene lies between two corners."""
        camera = dataset.calibration.camera
        last = np.zeros((camera.height, camera.width), np.int8)
        count = min(len(dataset.t), max(round(EVENTS_PER_PIXEL * last.size), 1))
        some = slice((len(dataset.t) - count) // 2, (len(dataset.t) + count) // 2)
        last[dataset.y[some], dataset.x[some]] = np.where(dataset.on[some], 1, -1)
        begin, end = (float(dataset.t[some][k]) for k in (0, -1))
        return cls(last, begin, end - begin, dataset.trajectory.position, test.position, low, high)


@styled
def draw_given(given: Given, axes: Any = None) -> Any:
    """Events of a short time, and the camera's path from the side that shows most of it; returns the two axes."""
    from matplotlib.colors import ListedColormap

    if axes is None:
        axes = new_axes(1, 2, 4.0, 3.2)
    picture, plan = np.ravel(axes)
    picture.imshow(given.last, cmap=ListedColormap([OFF, PAPER, ON]), vmin=-1, vmax=1)
    picture.set(xticks=[], yticks=[], title=f"last events of {1e3 * given.length_s:.3g} ms, ON orange, OFF blue")
    picture.grid(False)
    middle = 0.5 * (given.low + given.high)
    across = np.linalg.svd(given.path - given.path.mean(axis=0), full_matrices=False)[2][:2]
    seen = [(points - middle) @ across.T for points in (given.path, given.views)]
    plan.plot(*seen[0].T, color=INK, label="camera while it records")
    plan.plot(*seen[1].T, "o", color=MUTED, label="test views")
    plan.plot(0.0, 0.0, "x", color=INK, label="middle of the scene")
    plan.set(aspect="equal", xlabel="unit of the poses", ylabel="unit of the poses")
    legend_above(plan)
    return axes
