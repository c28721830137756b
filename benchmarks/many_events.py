"""A data set as long as published ones: the same scene filmed again and again."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np

from pixelid.nerf.data import calibration
from pixelid.nerf.data.dataset import EVENTS, Dataset, write_poses
from pixelid.nerf.data.views import FOLDER, RENDERER


def filmed_again(data: Dataset, events: int, path: Path) -> int:
    """Write the data set as a folder with at least so many events; how many there are."""
    times = -(-events // len(data.t))
    right = data.trajectory
    period = right.t[-1] + right.t[1] - right.t[0]
    again = replace(
        right, t=np.concatenate([right.t + k * period for k in range(times)]),
        position=np.tile(right.position, (times, 1)), orientation=np.tile(right.orientation, (times, 1)),
    )  # fmt: skip
    path.mkdir()
    for name in (calibration.FILE, RENDERER):
        shutil.copy(data.path / name, path)
    shutil.copytree(data.path / FOLDER, path / FOLDER)
    write_poses(path, again)
    once = np.rint(data.t * 1e9).astype(np.int64) + right.zero_ns
    np.savez(
        path / EVENTS, position=np.tile(np.column_stack([data.x, data.y]).astype(np.int16), (times, 1)),
        timestamp=np.concatenate([once + round(k * period * 1e9) for k in range(times)]),
        polarity=np.tile(data.on, times),
    )  # fmt: skip
    return times * len(data.t)
