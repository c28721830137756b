"""How fast the image moves at a pixel and a time, against the equations of motion; bursts by it."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pixelid.nerf.data.camera import pinhole
from pixelid.nerf.data.scenes import FIELD_OF_VIEW, spiral
from pixelid.nerf.data.trajectory import Trajectory
from pixelid.nerf.events.image_speed import CLOSEST, crossing_times
from pixelid.nerf.events.intervals import intervals
from pixelid.nerf.events.stretches import stretches

CAMERA = pinhole(33, 33, FIELD_OF_VIEW)
FOCAL, MIDDLE = float(CAMERA.intrinsics[0, 0]), 16 * 33 + 16
LOW, HIGH = np.array([-1.0, -1.0, 3.0]), np.array([1.0, 1.0, 5.0])
NEVER = 1e9


def still(t) -> np.ndarray:
    return np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1))


def test_a_turning_camera_sees_all_depths_move_alike():
    """u' = −ω (1 + u²), v' = −ω u v in focal lengths, ω about the camera's y axis, whose rate changes in the middle."""
    t = np.linspace(0.0, 1.0, 101)
    rate = np.where(t < 0.5, 0.2, 1.4)  # rad/s
    angle = np.concatenate([[0.0], np.cumsum(rate[:-1] * np.diff(t))])
    turning = Trajectory(t, np.zeros((101, 3)), Rotation.from_rotvec(angle[:, None] * [0.0, 1.0, 0.0]).as_quat())
    pixel = np.array([MIDDLE, 4 * 33 + 30, MIDDLE])
    x, y = (np.array([16, 30, 16]) - 16) / FOCAL, (np.array([16, 4, 16]) - 16) / FOCAL
    omega = np.array([0.2, 0.2, 1.4])
    speed = FOCAL * omega * np.hypot(1 + x**2, x * y)
    found = crossing_times(turning, CAMERA, LOW, HIGH, np.array([0.2, 0.3, 0.8]), pixel, within=1e-3, most=NEVER)
    np.testing.assert_allclose(found, 1 / speed, rtol=1e-4)


@pytest.mark.parametrize("cell", [0.0, 0.3])
def test_a_camera_that_shifts_passes_a_cell_in_the_same_time_at_any_depth(cell):
    """Along the axis f v/z pixels per second at 3⅓, 4, 4⅔; with cells of so many pixels, f h/z, only h/v is left."""
    t, v = np.linspace(0.0, 1.0, 11), 0.1
    moving = Trajectory(t, np.column_stack([v * (t - 0.5), 0 * t, 0 * t]), still(t))
    found = crossing_times(
        moving, CAMERA, LOW, HIGH, np.array([0.5]), np.array([MIDDLE]), cell=cell, within=1e-3, most=NEVER
    )
    depth = np.array([10 / 3, 4.0, 14 / 3])
    assert FOCAL * 0.3 / depth.max() > 1  # cells are larger than pixels
    assert found[0] == pytest.approx(cell / v if cell else 1 / np.sqrt(((FOCAL * v / depth) ** 2).mean()), rel=1e-4)


def test_rays_beside_the_box_see_what_is_nearest_to_it_and_nothing_is_at_the_camera():
    t = np.linspace(0.0, 1.0, 11)
    moving = Trajectory(t, np.column_stack([0.1 * (t - 0.5), 0 * t, 0 * t]), still(t))
    shift = np.array([50.0, 0.0, 0.0])
    beside = LOW + shift, HIGH + shift
    one = np.array([0.5]), np.array([MIDDLE])
    (found,) = crossing_times(moving, CAMERA, *beside, *one, within=1e-3, most=NEVER)
    assert found == pytest.approx(4.0 / (FOCAL * 0.1), rel=1e-4)
    (around,) = crossing_times(moving, CAMERA, -HIGH, HIGH, *one, within=1e-3, most=NEVER)
    (closest,) = crossing_times(moving, CAMERA, [-9, -9, -9], [-1, -1, -1], *one, within=1e-3, most=NEVER)
    assert closest == pytest.approx(CLOSEST * 4.0 / (FOCAL * 0.1), rel=1e-4)
    assert np.isfinite(around)


def test_a_camera_that_rests_is_given_the_most():
    t = np.linspace(0.0, 1.0, 11)
    x = np.maximum(t - 0.5, 0.0)
    resting = Trajectory(t, np.column_stack([x, 0 * t, 0 * t]), still(t))
    times = np.array([0.2, 0.9])
    found = crossing_times(resting, CAMERA, LOW, HIGH, times, np.full(2, MIDDLE), within=1e-3, most=0.5)
    assert found[0] == 0.5
    assert found[1] < 0.1
    never = Trajectory(t, np.zeros((11, 3)), still(t))
    assert (crossing_times(never, CAMERA, LOW, HIGH, times, np.full(2, MIDDLE), within=0.0, most=0.0) == 0.0).all()


def test_along_a_spiral_close_sides_pass_faster():
    """The camera is 4 from the middle, its image moves by what is on its own side faster than by what is behind."""
    flight, half = spiral(0.5, 1.0, low=0.0, high=0.0), np.full(3, 0.2)
    towards = flight.position[0] / 4.0
    one = np.array([flight.t[0] + 0.01]), np.array([MIDDLE])
    near, far = (
        crossing_times(flight, CAMERA, c - half, c + half, *one, within=1e-4, most=NEVER)[0]
        for c in (towards, -towards)
    )
    assert near < 0.8 * far


def test_bursts_are_as_long_as_the_image_is_slow():
    """Events 1 ms apart; where they may be 2 ms apart they are one burst, and where 0.5 ms they stand alone."""
    t = 1e-3 * np.arange(40.0)
    on, pixel = np.ones(40, bool), np.zeros(40, int)
    shortest = np.where(t < 20e-3, 2e-3, 0.5e-3)
    found = stretches(t, pixel, on, 0.0, 0.0, shortest)
    assert found.burst.sum() == 1
    (burst,) = np.flatnonzero(found.burst)
    assert found.begin[burst] == 0.0
    assert found.end[burst] == pytest.approx(19e-3 + 0.25e-3)  # half of the quiet interval that follows
    assert found.rise.sum() == pytest.approx(39.0)
    alike, one = (stretches(t, pixel, on, 0.0, 0.0, s) for s in (np.full(40, 1.5e-3), 1.5e-3))
    for a, b in zip(alike, one, strict=True):
        np.testing.assert_array_equal(a, b)


def test_bursts_of_pixels_are_their_own():
    """Events of two pixels in turn, with another length each, in the order of time."""
    t, x = 1e-3 * np.arange(40.0), np.arange(40) % 2
    shortest = np.where(x == 0, 5e-3, 1e-3)
    cut = intervals(t, x, np.zeros(40, int), np.ones(40, bool), 2, shortest=shortest).stretches
    assert cut.burst[cut.pixel == 0].all()
    assert not cut.burst[cut.pixel == 1].any()
