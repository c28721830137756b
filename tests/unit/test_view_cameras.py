"""Cameras of posed pictures: what NeRF, nerfstudio and instant-ngp state is read, or refused by name."""

from pathlib import Path

import numpy as np
import pytest

from pixelid.errors import InputError
from pixelid.nerf.view_cameras import camera_of_document, states_camera

FILE = Path("transforms.json")
POSE = {"file_path": "a.png", "transform_matrix": np.eye(4).tolist()}
NERFSTUDIO = {"camera_model": "OPENCV", "fl_x": 40.0, "fl_y": 41.0, "cx": 44.0, "cy": 16.0, "w": 64, "h": 48,
              "k1": 0.0, "frames": [POSE]}  # fmt: skip


def test_focal_lengths_and_principal_points():
    camera = camera_of_document(FILE, NERFSTUDIO, 64, 48)
    np.testing.assert_allclose(camera.intrinsics, [[40, 0, 43.5], [0, 41, 15.5], [0, 0, 1]])
    assert not camera.distorts
    half = camera_of_document(FILE, NERFSTUDIO, 32, 24)
    np.testing.assert_allclose(half.intrinsics[0], [20, 0, 21.5])
    assert states_camera(NERFSTUDIO)
    assert not states_camera({"frames": [POSE]})


def test_cameras_of_frames_that_agree():
    own = {key: value for key, value in NERFSTUDIO.items() if key != "frames"}
    document = {"frames": [{**POSE, **own}, {**POSE, **own}]}
    assert camera_of_document(FILE, document, 64, 48).intrinsics[0, 2] == 43.5
    document["frames"][1]["fl_x"] = 50.0
    with pytest.raises(InputError, match=r"frames\[1\].fl_x: expected one camera"):
        camera_of_document(FILE, document, 64, 48)


def test_lenses():
    bent = camera_of_document(FILE, {**NERFSTUDIO, "k1": 0.05, "k2": 0.01, "p1": 0.002, "k3": 0.001}, 64, 48)
    assert (bent.model, bent.distortion.tolist()) == ("plumb_bob", [0.05, 0.01, 0.002, 0.0, 0.001])
    fish = camera_of_document(FILE, {**NERFSTUDIO, "camera_model": "OPENCV_FISHEYE", "k1": 0.05}, 64, 48)
    assert (fish.model, fish.distortion.tolist()) == ("equidistant", [0.05, 0.0, 0.0, 0.0])
    point = np.array([[0.2, -0.1]])
    np.testing.assert_allclose(bent.distorted(bent.undone(point)), point, atol=1e-9)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"k4": 0.1}, "k4: not read"),
        ({"camera_model": "EQUIRECTANGULAR"}, "camera_model: expected one of"),
        ({"camera_angle_x": 0.3}, "disagree"),
        ({"w": 64, "h": 64}, "w, h: expected pictures of the shape"),
        ({"fl_x": -1.0}, "fl_x: expected a number above 0"),
    ],
)
def test_what_is_not_read_is_refused_by_name(changes, says):
    with pytest.raises(InputError, match=says):
        camera_of_document(FILE, {**NERFSTUDIO, **changes}, 64, 48)


def test_a_lens_without_a_focal_length():
    with pytest.raises(InputError, match="k1: is read with fl_x only"):
        camera_of_document(FILE, {"camera_angle_x": 0.7, "k1": 0.1, "frames": [POSE]}, 64, 48)
