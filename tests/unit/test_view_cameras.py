"""Cameras of posed pictures: what NeRF, nerfstudio and instant-ngp state is read, or refused by name."""

import struct
from pathlib import Path

import numpy as np
import pytest

from pixelid.errors import InputError
from pixelid.nerf.data.view_cameras import camera_of_document, states_camera
from pixelid.nerf.shown.ways import way_of_file

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
        ({"distortion_params": [0.1, 0.0]}, "distortion_params.*not read"),
        ({"camera_model": "PINHOLE", "k1": 0.1}, "k1: camera_model PINHOLE has no lens"),
        ({"camera_angle_y": 0.3}, "camera_angle_y 0.3 and a focal length of 41 pixels disagree"),
    ],
)
def test_what_is_not_read_is_refused_by_name(changes, says):
    with pytest.raises(InputError, match=says):
        camera_of_document(FILE, {**NERFSTUDIO, **changes}, 64, 48)


def test_a_lens_without_a_focal_length():
    with pytest.raises(InputError, match="k1: is read with fl_x only"):
        camera_of_document(FILE, {"camera_angle_x": 0.7, "k1": 0.1, "frames": [POSE]}, 64, 48)


def _write_colmap(folder: Path, binary: bool, model: str = "OPENCV") -> None:
    """Two images of a camera 3 m before the origin, by COLMAP's description of its files."""
    folder.mkdir()
    values, turned = [40.0, 41.0, 44.0, 16.0, 0.05, 0.01, 0.002, 0.0], [np.cos(0.1), 0.0, np.sin(0.1), 0.0]
    poses = [([1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 3.0], "a.png"), (turned, [0.1, 0.2, 3.0], "b c.png")]
    if not binary:
        words = " ".join(map(str, values if model == "OPENCV" else values[:5]))
        (folder / "cameras.txt").write_text(f"# Camera list\n7 {model} 64 48 {words}\n")
        lines = [f"{k} {' '.join(map(str, [*q, *t]))} 7 {name}\n{'1.5 2.5 -1' if k else ''}\n"
                 for k, (q, t, name) in enumerate(poses)]  # fmt: skip
        (folder / "images.txt").write_text("# Image list with two lines\n" + "".join(lines))
        return
    (folder / "cameras.bin").write_bytes(struct.pack("<QiiQQ8d", 1, 7, 4, 64, 48, *values))
    images = struct.pack("<Q", 2)
    for k, (q, t, name) in enumerate(poses):
        images += struct.pack("<i7di", k, *q, *t, 7) + name.encode() + b"\0" + struct.pack("<Q", k) + bytes(24 * k)
    (folder / "images.bin").write_bytes(images)


@pytest.mark.parametrize("binary", [False, True])
def test_cameras_and_poses_of_colmap(tmp_path, binary):
    _write_colmap(tmp_path / "sparse", binary)
    way = way_of_file(tmp_path, None)
    assert [name[5:] for name in way.names] == ["a.png", "b c.png"]
    assert (way.camera.width, way.camera.height, way.camera.model) == (64, 48, "plumb_bob")
    np.testing.assert_allclose(way.camera.distortion, [0.05, 0.01, 0.002, 0.0, 0.0])
    np.testing.assert_allclose(way.camera.intrinsics[:2, 2], [43.5, 15.5])
    world = np.array([0.3, -0.2, 0.5])
    c, s = np.cos(0.2), np.sin(0.2)
    expected = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ world + [0.1, 0.2, 3.0]  # quaternion and translation
    np.testing.assert_allclose(way.rotation[1].T @ (world - way.position[1]), expected)


def test_a_lens_of_colmap_that_is_not_read_is_refused_by_name(tmp_path):
    _write_colmap(tmp_path / "sparse", False, "FOV")
    with pytest.raises(InputError, match=r"omega.*not read"):
        way_of_file(tmp_path, None)
    (tmp_path / "sparse" / "cameras.txt").write_text("7 STARRY 64 48 1 2 3\n")
    with pytest.raises(InputError, match="STARRY"):
        way_of_file(tmp_path / "sparse" / "images.txt", None)
