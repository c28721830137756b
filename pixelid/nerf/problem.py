"""From a dataset to what training needs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pixelid.errors import InputError
from pixelid.nerf.calibration import Calibration
from pixelid.nerf.dataset import Dataset
from pixelid.nerf.gauge import crossing_time, gauge_of, scene_box
from pixelid.nerf.intervals import intervals, split
from pixelid.nerf.pixel_maps import PixelMaps, find_hot, maps_of_circuit
from pixelid.nerf.stretches import NOISE
from pixelid.nerf.train import Problem
from pixelid.nerf.views import Views, no_views

CLOSE_PIXELS = 0.5  # pixels: about half the width of the field's edges
HELD_OUT = 0.03  # share of pixels whose events are kept from training


def problem_of(
    dataset: Dataset,
    calibration: Calibration | None = None,
    *,
    background: float | None = None,
    scale: str = "auto",
    box: Sequence[float] | None = None,
    maps: PixelMaps | None = None,
    held_out: float = HELD_OUT,
    close: float = CLOSE_PIXELS,
    seed: int = 0,
) -> Problem:
    """The problem of a dataset under its own calibration or another one (a fit's).

    Args:
        dataset: as read.
        calibration: of the camera and its pixel; the dataset's own by default.
        background: radiance behind the scene; by default what the views show.
        scale: what pins the radiance unit: "auto", "level" or "free".
        box: corners of the scene, x0 y0 z0 x1 y1 z1; by default a cube where the camera looks.
        maps: how single pixels depart from the circuit; by default unknown to its mismatch.
        held_out: share of the pixels that training does not see.
        close: events are merged while the image moves by less than that, in pixels.
        seed: of the pixels held out.

    Returns:
        What training works on.

    Raises:
        InputError: no pixel has two events, or the box has no inside.
    """
    calibration = dataset.calibration if calibration is None else calibration
    camera = calibration.camera
    if box is None:
        low, high = scene_box(dataset.trajectory, camera.half_angle)
    else:
        low, high = np.asarray(box[:3], dtype=float), np.asarray(box[3:], dtype=float)
        if not (high > low).all():
            raise InputError(f"--box: expected low corner below high corner, found {list(box)}")
    circuit = calibration.circuit
    maps = maps_of_circuit(circuit, camera.width * camera.height) if maps is None else maps
    t, x, y, on = dataset.t, dataset.x, dataset.y, dataset.on
    hot = np.union1d(maps.hot, find_hot(x, y, on, camera, circuit, float(t[-1] - t[0])))
    if len(hot):
        is_hot = np.zeros(camera.width * camera.height, bool)
        is_hot[hot] = True
        kept = ~is_hot[y * camera.width + x]
        maps, (t, x, y, on) = replace(maps, hot=hot), (column[kept] for column in (t, x, y, on))
    every = intervals(
        t, x, y, on, camera.width, dead=circuit.refractory, lag=1 / circuit.differencing,
        shortest=close * crossing_time(dataset.trajectory, camera, low, high),
        noise=math.hypot(circuit.noise, circuit.mismatch) or NOISE, drift=circuit.threshold_drift,
        memory=circuit.polarity_memory,
    )  # fmt: skip
    if len(every.starts) == 0:
        raise InputError(f"{dataset.path}: raw_events.npz: timestamp: no pixel has two events, nothing to learn from")
    training, held = split(every, held_out, np.random.default_rng([seed, 77]))
    if len(training.starts) == 0:
        training, held = every, every.of(np.zeros(len(every.starts), bool))
    y, x = np.divmod(np.arange(camera.width * camera.height), camera.width)
    return Problem(
        training, held, dataset.trajectory, camera, calibration.channel_of(x, y), calibration.dark,
        calibration.circuit, gauge_of(dataset, background, scale), low, high, maps,
    )  # fmt: skip


def evaluation_views(dataset: Dataset) -> tuple[Views, Views]:
    """The views that fix the correction and those that are scored, apart from each other.

    Test views are scored and validation views correct them; a missing stage is stood in for by the next, a single one
    is halved; a dataset without views has none of either.

    Args:
        dataset: as read.

    Returns:
        (views that fix the correction, views that are scored).
    """
    stages = [dataset.views[stage] for stage in ("test", "val", "train") if stage in dataset.views]
    if not stages:
        nothing = no_views(dataset.calibration.camera, dataset.calibration.channels)
        return nothing, nothing
    if len(stages) == 1:
        every = np.arange(len(stages[0]))
        return (stages[0], stages[0]) if len(every) == 1 else (stages[0].some(every[1::2]), stages[0].some(every[::2]))
    return stages[1], stages[0]
