"""The plain way from events to a scene, in two stages: images from events, and a field fitted to the images.

Images are those of the high-pass filter of Scheerlinck, Barnes & Mahony (ACCV 2018) without frames: every event adds
its threshold to the log radiance of its pixel, which decays to the background at a cutoff,

    y ← y exp(−ω Δt),  y ← y ± C at an event,  L = L_background exp(y).

It needs no downloaded weights and knows nothing of the pixel but its thresholds.  Whoever compares with it may choose
the cutoff by the score: that favours it.
"""

from __future__ import annotations

import math

import numpy as np
from posed import fit_field

from pixelid.nerf.data.dataset import Dataset, evaluation_views
from pixelid.nerf.shown.evaluate import Scores, evaluate
from pixelid.nerf.training.problem import problem_of

IMAGES = 256
SETTLED = 0.125  # share of the recording before the first image
BRIGHTEST = 3.0  # of an image, in backgrounds


def images_of_events(data: Dataset, times: np.ndarray, cutoff: float) -> np.ndarray:
    """(n, H, W) log radiance over the background's at increasing times [s]; cutoff: ω [rad/s]."""
    calibration = data.calibration
    camera, circuit = calibration.camera, calibration.circuit
    step = np.where(data.on, circuit.on_threshold, -circuit.off_threshold)
    pixel = data.y.astype(np.int64) * camera.width + data.x
    level, images, begin, now = np.zeros(camera.height * camera.width), [], 0, float(data.t[0])
    for t in times:
        end = int(np.searchsorted(data.t, t, side="right"))
        level *= math.exp(-cutoff * (t - now))
        some = slice(begin, end)
        weight = step[some] * np.exp(-cutoff * (t - data.t[some]))
        level += np.bincount(pixel[some], weights=weight, minlength=len(level))
        images.append(level.reshape(camera.height, camera.width).copy())
        begin, now = end, float(t)
    return np.array(images)


def two_stage(data: Dataset, cutoff: float, *, seed: int = 0) -> Scores:
    """Scores of the test views of a field fitted to images of the events; cutoff: of the filter [rad/s]."""
    problem = problem_of(data, data.calibration)
    background, dark = float(problem.gauge.background[0]), float(problem.dark[0])
    first, last = data.trajectory.t[0], data.trajectory.t[-1]
    times = np.linspace(first + SETTLED * (last - first), last, IMAGES)
    contrast = np.exp(np.minimum(images_of_events(data, times, cutoff), math.log(BRIGHTEST)))
    images = np.maximum((background + dark) * contrast - dark, 0.0)
    field = fit_field(
        images, *data.trajectory.at(times), data.calibration.camera, problem.low, problem.high, background=background,
        seed=seed,
    )  # fmt: skip
    return evaluate(field, *evaluation_views(data), problem.dark)
