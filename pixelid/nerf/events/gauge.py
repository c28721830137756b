"""What events alone leave open, and what pins it: the box the scene is in, and the radiance unit.

Without a bandwidth limit a common factor on all radiance changes no event.  With one it does, but weakly, and a scale
that is free drifts: a brighter scene is a faster pixel, so that a blurred scene can explain the events.  It is pinned

    "background"   by the radiance behind the scene, where the views show one value along their borders (white behind
                   transparent ones);
    "level"        otherwise by the mean log radiance over the views that correct the scored ones, per colour;
    "free"         by nothing, on request, to see what happens, and for data without views.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pixelid.errors import InputError
from pixelid.nerf.data.camera import Camera
from pixelid.nerf.data.dataset import Dataset, evaluation_views
from pixelid.nerf.data.trajectory import Trajectory
from pixelid.nerf.data.views import FOLDER, Views

# Optical axes that point this nearly one way have no point in common: mean squared sine of their angles, 0.6° rms.
PARALLEL = 1e-4
SEEING = 0.9  # share of the poses that have the middle of the box ahead of them
CLOSEST = 0.01  # of the way that the camera goes: closer is not ahead
CLOSE_PIXELS = 0.5  # pixels: about half the width of the field's edges, and what a scene resolves
POINTS = 2000  # over the box and the trajectory, that tell how fast the image moves
UNIFORM = 0.03  # standard deviation of ln L along the borders, below which they show a background
BORDER = 0.5  # share of border pixels that must agree
# ln L by which a scene begins apart from its background at least: haze of its colour would be invisible, and no event
# could tell where it thickens.  A table before white, begun at half the background: 18.6
# instead of 15.2 dB after 300 steps.
APART = math.log(2.0)
UNKNOWN = 1.0  # radiance behind a scene of which there are no views, to begin with: their unit's white


@dataclass(frozen=True)
class Gauge:
    """kind: "background", "level" or "free";  background: (C,) radiance behind the box;  level: (C,) mean log radiance
    over the views `reference` (None: there are none), whose rays pin it"""

    kind: str
    background: np.ndarray
    level: np.ndarray
    reference: Views | None

    @property
    def free_background(self) -> bool:
        """Whether the background is trained."""
        return self.kind != "background"

    @property
    def start(self) -> float:
        """The radiance that a scene begins with: its mean level, `APART` from the background where that is held."""
        level, behind = float(self.level.mean()), float(np.log(self.background).mean())
        if self.free_background or abs(level - behind) >= APART:
            return math.exp(level)
        return math.exp(behind + APART if level > behind else behind - APART)


def gauge_of(dataset: Dataset, background: float | None = None, scale: str = "auto") -> Gauge:
    """The gauge of a dataset.

    background: overrides what its views show; where another scale is asked for, what training begins with;  scale:
    "auto" (the background where there is one), "level" or "free"

    Raises:
        InputError: the scale is to come from views, and the dataset has none.
    """
    channels = dataset.calibration.channels
    reference, _ = evaluation_views(dataset)
    if len(reference) == 0:
        if scale == "level":
            raise InputError(f"{dataset.path / FOLDER}: no such folder; --scale level needs views")
        kind = "background" if background is not None and scale == "auto" else "free"
        shown = np.full(channels, UNKNOWN if background is None else background)
        return Gauge(kind, shown, np.log(shown), None)
    level = np.log(np.maximum(reference.radiance, 1e-3)).mean(axis=(0, 1, 2))
    if scale != "auto":
        return Gauge(scale, np.exp(level) if background is None else np.full(channels, background), level, reference)
    if background is not None:
        return Gauge("background", np.full(channels, background), level, reference)
    shown = np.ones(channels) if reference.transparent else _border(reference)  # white, however bright a highlight
    if shown is not None:
        return Gauge("background", shown, level, reference)
    return Gauge("level", np.exp(level), level, reference)


def _border(views: Views) -> np.ndarray | None:
    """(C,) the value that most border pixels of the views agree on, or None."""
    logs = np.log(np.maximum(views.radiance, 1e-4))
    edge = np.concatenate(
        [logs[:, 0], logs[:, -1], logs[:, :, 0], logs[:, :, -1]], axis=1
    ).reshape(-1, logs.shape[-1])  # fmt: skip
    middle = np.median(edge, axis=0)
    agree = (np.abs(edge - middle) < UNIFORM).all(axis=1)
    return np.exp(edge[agree].mean(axis=0)) if agree.mean() > BORDER else None


def scene_box(trajectory: Trajectory, half_angle: float) -> tuple[np.ndarray, np.ndarray]:
    """(low, high) of a cube about the point nearest to all optical axes, as large as the views are wide there.

    Raises InputError where the axes are parallel, and where the camera turns in place or looks outwards: they say
    nothing of how far the scene is.
    """
    some = np.linspace(trajectory.t[0], trajectory.t[-1], 256)
    position, rotation = trajectory.at(some)
    axis = rotation[:, :, 2]
    across = np.eye(3) - axis[:, :, None] * axis[:, None, :]
    if np.linalg.eigvalsh(across.mean(axis=0))[0] < PARALLEL:
        raise InputError("--box: missing; the camera looks one way all the time, which does not say where the scene is")
    centre = np.linalg.solve(across.sum(axis=0), (across @ position[:, :, None]).sum(axis=0)[:, 0])
    ahead = ((centre - position) * axis).sum(axis=1)
    if (ahead <= CLOSEST * np.ptp(position, axis=0).max()).mean() > 1.0 - SEEING:
        raise InputError("--box: missing; no point lies ahead of all poses; the camera turns in place, or looks out")
    half = np.median(np.linalg.norm(position - centre, axis=1)) * np.tan(half_angle)
    return centre - half, centre + half


def crossing_time(trajectory: Trajectory, camera: Camera, low, high) -> float:
    """Seconds in which the image of the box moves by one pixel; 0 for a camera that stands still.

    A pixel over the root mean square speed of points spread over the ball inside the box and over the trajectory.
    low, high: (3,)
    """
    t, points = _seen_points(trajectory, low, high)
    step = 1e-5 * (trajectory.t[-1] - trajectory.t[0])
    (before, _), (after, ahead) = (_image(trajectory, camera, time, points) for time in (t, t + step))
    moved = np.linalg.norm(after - before, axis=1)[ahead]
    speed = np.sqrt((moved**2).mean()) / step if len(moved) else 0.0
    return float(1.0 / speed) if speed > 0 else 0.0


def time_resolution(trajectory: Trajectory, camera: Camera, low, high) -> float:
    """Seconds that an offset between the clocks of poses and events must have to show; inf where none does.

    A pose that is late is to first order a pose that is moved, and what moves cameras at time t is a field of
    velocities v(t) + ω(t) × x in the axes of the world.  Where that is the same at all times, the scene may as well
    stand elsewhere: cameras and scene moved, turned and scaled together make the same events.  So an offset shows by
    the image's speed beyond the best v + ω × x + σ x (least squares, over points and times as in `crossing_time`), once
    that has moved the image by `CLOSE_PIXELS`, which is what a scene resolves.

    low, high: (3,)
    """
    t, points = _seen_points(trajectory, low, high)
    share, size = 1e-7, float((high - low).max())
    later = t + share * (trajectory.t[-1] - trajectory.t[0])
    arms = (points - 0.5 * (low + high)) / size
    turns = [np.cross(axis, arms) for axis in np.eye(3)]
    moved = [points + share * size * way for way in (*np.eye(3), *turns, arms)]
    at, ahead = _image(trajectory, camera, t, points)
    seen = [_image(trajectory, camera, later, points), *(_image(trajectory, camera, t, there) for there in moved)]
    ahead = np.all([ahead, *(before for _, before in seen)], axis=0)
    along, *ways = ((place - at)[ahead].ravel() / share for place, _ in seen)  # over the flight, over the box
    columns = np.column_stack(ways)
    beyond = float(np.linalg.norm(along - columns @ np.linalg.lstsq(columns, along, rcond=None)[0]))
    flight_s = float(trajectory.t[-1] - trajectory.t[0])
    return CLOSE_PIXELS * flight_s * math.sqrt(ahead.sum()) / beyond if beyond > 0 else math.inf


def _seen_points(trajectory: Trajectory, low, high) -> tuple[np.ndarray, np.ndarray]:
    """(times (n,), points (n, 3)) spread over the trajectory and over the ball inside the box."""
    rng = np.random.default_rng(0)
    t = rng.uniform(trajectory.t[0], trajectory.t[-1], POINTS)
    ball = rng.normal(size=(POINTS, 3))
    ball *= (rng.random(POINTS) ** (1 / 3) / np.linalg.norm(ball, axis=1))[:, None]
    return t, 0.5 * (low + high) + 0.5 * ball * (high - low)


def _image(trajectory: Trajectory, camera: Camera, times, points) -> tuple[np.ndarray, np.ndarray]:
    """(places (n, 2) in pixels of points (n, 3) at times (n,), which of them are ahead of the camera)."""
    position, rotation = trajectory.at(times)
    inside = np.einsum("nij,ni->nj", rotation, points - position)
    return inside[:, :2] / np.maximum(inside[:, 2:], 1e-9) * camera.intrinsics[0, 0], inside[:, 2] > 0
