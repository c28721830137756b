"""Poses as training sees them: an offset between clocks, smooth corrections, their gradients and what they become."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from pixelid.nerf.data.dataset import _poses as read_poses
from pixelid.nerf.data.dataset import write_poses
from pixelid.nerf.data.scenes import spiral
from pixelid.nerf.data.trajectory import Trajectory
from pixelid.nerf.training.poses import Poses, Refinement

TRAJECTORY = spiral(2.0, 3)
BOTH = Refinement(5e-3, 0.05, math.radians(1.0), knots=9)


def flight(t):
    """(position (n, 3), rotations) of a camera in formulas."""
    position = np.stack([np.cos(3 * t), np.sin(2 * t), 0.3 * t**2], axis=1)
    return position, Rotation.from_euler("xyz", np.stack([0.6 * np.sin(3 * t), 0.4 * np.cos(5 * t), 2 * t], axis=1))


@pytest.mark.parametrize(("poses", "better"), [(40, 15), (80, 60)])  # fourth order beside second order
def test_splines_follow_a_camera_between_sparse_poses(poses, better):
    t, times = np.linspace(0.0, 2.0, poses), np.random.default_rng(0).uniform(0.1, 1.9, 500)
    position, rotations = flight(t)
    sparse, (place, turn) = Trajectory(t, position, rotations.as_quat()), flight(times)
    errors = {}
    for name, trajectory in (("linear", sparse), ("cubic", sparse.splined())):
        ours, rotation = trajectory.at(times)
        apart = (Rotation.from_matrix(rotation) * turn.inv()).magnitude()
        errors[name] = np.array([np.abs(ours - place).max(), apart.max()])
    step = t[1] - t[0]
    assert errors["linear"][0] == pytest.approx(9.0 * step**2 / 8, rel=0.1)  # a chord, of a second derivative of 9
    assert (errors["cubic"] < errors["linear"] / better).all()


def test_splines_go_through_the_poses():
    for poses in (2, 3, 20):
        some = replace(
            TRAJECTORY, t=TRAJECTORY.t[:poses], position=TRAJECTORY.position[:poses],
            orientation=TRAJECTORY.orientation[:poses], zero_ns=7,
        )  # fmt: skip
        splined = some.splined(4)
        assert len(splined.t) == 4 * (poses - 1) + 1
        assert splined.zero_ns == 7
        np.testing.assert_allclose(splined.t[::4], some.t, rtol=1e-15)
        np.testing.assert_allclose(splined.position[::4], some.position, atol=1e-12)
        same = Rotation.from_quat(splined.orientation[::4]) * Rotation.from_quat(some.orientation).inv()
        assert same.magnitude().max() < 1e-12


def some_rays(n=50, seed=0):
    rng = np.random.default_rng(seed)
    inside = rng.normal(size=(n, 3)) * 0.2 + [0, 0, 1]
    return rng.uniform(0.1, 1.9, n), inside / np.linalg.norm(inside, axis=1, keepdims=True)


def moved(refinement=BOTH, seed=1) -> Poses:
    poses = Poses(TRAJECTORY, refinement)
    with torch.no_grad():
        poses.offset += 0.7
        poses.moved += torch.randn(
            poses.moved.shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64
        )
    return poses


def test_nothing_trained_nothing_changed():
    times, inside = some_rays()
    poses = Poses(TRAJECTORY, Refinement())
    assert not poses.trained
    assert poses.as_dict(1.0) is None
    for ours, plain in zip(poses.rays(times, inside), TRAJECTORY.rays(times, inside), strict=True):
        np.testing.assert_array_equal(ours, plain)


def test_an_offset_reads_the_trajectory_at_another_time():
    times, inside = some_rays()
    poses = moved(Refinement(5e-3))
    assert poses.time_offset_s == pytest.approx(3.5e-3)
    for ours, there in zip(poses.rays(times, inside), TRAJECTORY.rays(times + 3.5e-3, inside), strict=True):
        np.testing.assert_allclose(ours.detach().numpy(), there, atol=1e-6)


def test_rays_are_those_of_the_refined_trajectory():
    """By another way: rotations and quaternions of SciPy."""
    poses = moved()
    refined = poses.refined()
    which = np.arange(3, len(TRAJECTORY.t) - 3, 7)
    _, inside = some_rays(len(which))
    origins, directions = poses.rays(TRAJECTORY.t[which], inside)
    np.testing.assert_allclose(origins.detach().numpy(), refined.position[which], atol=2e-6)
    turned = Rotation.from_quat(refined.orientation[which]).apply(inside)
    np.testing.assert_allclose(directions.detach().numpy(), turned, atol=2e-6)
    away = Rotation.from_quat(refined.orientation) * Rotation.from_matrix(TRAJECTORY.at(TRAJECTORY.t + 3.5e-3)[1]).inv()
    assert 0.2 < math.degrees(away.magnitude().max()) < 5.0


@pytest.mark.parametrize("name", ["offset", "moved"])
def test_gradients_are_those_of_finite_differences(name):
    times, inside = some_rays()
    weight = torch.tensor(np.random.default_rng(4).normal(size=(2, len(times), 3)))

    def value(poses):
        return sum((w * column.double()).sum() for w, column in zip(weight, poses.rays(times, inside), strict=True))

    poses = moved()
    value(poses).backward()
    slopes = getattr(poses, name).grad.ravel()
    for k in range(0, len(slopes), 11):
        ends = []
        for step in (-0.05, 0.05):
            there = moved()
            with torch.no_grad():
                getattr(there, name).ravel()[k] += step
                ends.append(float(value(there)))
        assert float(slopes[k]) == pytest.approx((ends[1] - ends[0]) / 0.1, rel=0.02, abs=2e-3)


def test_what_cameras_have_in_common_moves_nothing():
    times, inside = some_rays()
    one, other = moved(), moved()
    with torch.no_grad():
        other.moved += torch.tensor([1.0, -2.0, 0.5, 0.3, 0.1, -0.4], dtype=torch.float64)
    for a, b in zip(one.rays(times, inside), other.rays(times, inside), strict=True):
        torch.testing.assert_close(a, b)
    assert float(other.penalty().detach()) > float(one.penalty().detach())


def test_refined_poses_are_written_on_the_clock_of_the_file(tmp_path):
    write_poses(tmp_path, Poses(TRAJECTORY, BOTH).refined())
    read = read_poses(tmp_path / "camera_poses.npz")
    np.testing.assert_allclose(read.position, TRAJECTORY.position, atol=1e-9)
    assert read.zero_ns == 0
    shifted = replace(TRAJECTORY, zero_ns=1_600_000_000_123_456_789)
    write_poses(tmp_path, Poses(shifted, BOTH).refined())
    with np.load(tmp_path / "camera_poses.npz") as file:
        assert file["T_wc_timestamp"][0] == 1_600_000_000_123_456_789
