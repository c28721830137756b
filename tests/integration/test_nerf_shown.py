"""What a reconstruction shows: a ball whose views, depth, mesh and splats are known."""

import json
import math
import shutil
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import torch
from test_schemas import check

import pixelid as px
from pixelid.cli.main import main
from pixelid.errors import InputError
from pixelid.nerf.data.camera import pinhole
from pixelid.nerf.data.dataset import write_poses
from pixelid.nerf.data.views import Views, read_views
from pixelid.nerf.field.harmonics import harmonics
from pixelid.nerf.field.radiance import Field
from pixelid.nerf.options import RenderOptions
from pixelid.nerf.shown.evaluate import render_views
from pixelid.nerf.shown.render import render
from pixelid.nerf.shown.saved import SavedReconstruction, write_field
from pixelid.nerf.shown.solid import depth_of, mesh_of
from pixelid.nerf.shown.splats import splats_of
from pixelid.nerf.shown.ways import around, way_of_file

RADIUS, CENTRE, CELLS = 0.6, np.array([0.2, -0.1, 0.0]), 32
CORRECTION = {"a": 0.8, "b": 0.9, "c": 0.01}


def ball(colours: int) -> Field:
    """Opaque inside a radius, brighter towards +x, before a background of 0.3."""
    field = Field(np.full(3, -1.0), np.full(3, 1.0), CELLS + 1, colours, [0.3] * colours)
    axis = np.linspace(-1, 1, CELLS + 1)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    r = np.sqrt((x - CENTRE[0]) ** 2 + (y - CENTRE[1]) ** 2 + (z - CENTRE[2]) ** 2)
    density = 8.0 * np.tanh((RADIUS - r) * 20) + 2.0
    colour = np.stack([np.log(0.4 + 0.3 * x + 0.05 * c) for c in range(colours)], axis=-1)
    grid = np.concatenate([density[..., None], colour], axis=-1)
    field.hold_dense(torch.from_numpy(grid.astype(np.float32)))
    return field


def content(views: bool, status: str = "converged") -> dict:
    per_view = [{"name": "r_0", "psnr": 30.0, "ssim": 0.9, "lpips": None}] if views else []
    return {
        "status": status, "advice": "", "bandwidth": "off", "ignored": [], "correction": CORRECTION,
        "views": {"psnr": 30.0, "ssim": 0.9, "lpips": None, "per_view": per_view}, "held_out_residual": 0.3,
        "seconds": 1.0, "pixel": {"dark": [0.05]}, "lpips_note": "", "iterations": 1, "device": "cpu", "samples": 1,
        "rays_per_second": 1.0, "gauge": {"kind": "free", "background": 1.0}, "history": [], "seed": 0, "versions": {},
        "box": {"low": [-1.0] * 3, "high": [1.0] * 3}, "inputs_sha256": {},
    }  # fmt: skip


@pytest.fixture
def folder(tmp_path) -> Path:
    SavedReconstruction(content(True), ball(1)).save(tmp_path / "scene")
    return tmp_path / "scene"


def read_ply(path: Path) -> dict[str, np.ndarray]:
    """The elements of a binary PLY, by the format's definition."""
    kinds = {"float": "<f4", "uchar": "u1", "int": "<i4"}
    head, body = path.read_bytes().split(b"end_header\n", 1)
    lines = head.decode().splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    elements: list[tuple[str, int, list]] = []
    for words in (line.split() for line in lines[2:]):
        if words[0] == "element":
            elements.append((words[1], int(words[2]), []))
        elif words[1] == "list":
            elements[-1][2].extend([("number", kinds[words[2]]), ("vertices", kinds[words[3]], 3)])
        else:
            elements[-1][2].append((words[2], kinds[words[1]]))
    out = {}
    for name, number, fields in elements:
        kind = np.dtype(fields)
        out[name], body = np.frombuffer(body[: number * kind.itemsize], kind), body[number * kind.itemsize :]
    assert not body
    return out


def test_frames_are_the_views_that_are_scored(folder, tmp_path):
    """The poses of a file, the dark current, and the correction: what `evaluate` compares with test views."""
    from skimage.io import imread

    way = around([-1] * 3, [1] * 3, "spiral", 5, (24, 20), fov=0.7)
    opengl = np.diag([1.0, -1.0, -1.0])
    frames = []
    for k in range(5):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = way.rotation[k] @ opengl, way.position[k]
        frames.append({"file_path": f"./test/r_{k}", "transform_matrix": pose.tolist()})
    file = tmp_path / "transforms_test.json"
    file.write_text(json.dumps({"camera_angle_x": 0.7, "frames": frames}))
    words = ["render", str(folder), "--out", str(tmp_path / "out"), "--views", str(file), "--size", "24", "20"]
    assert main([*words, "--quiet"]) == 0
    views = Views(
        np.empty((5, 20, 24, 1)), way.position, way.rotation, way.camera, ("",) * 5, np.ones(5), False, 1.0
    )  # fmt: skip
    radiance = render_views(px.load_field(folder), views, np.array([0.05]))[..., 0]
    expected = 0.8 * radiance**0.9 - 0.01
    for k in range(5):
        found = imread(tmp_path / "out" / "frames" / f"{k:04d}_r_{k}.png")
        np.testing.assert_allclose(found[..., 1] / 255, np.clip(expected[k], 0, 1), atol=0.5 / 255 + 1e-6)
    result = json.loads((tmp_path / "out" / "render.json").read_text())
    check("render", result)
    np.testing.assert_allclose(result["frames"][2]["position"], way.position[2])
    assert (tmp_path / "out" / "report.html").is_file()


def test_more_views_than_frames_are_thinned_out_evenly(folder, tmp_path):
    frames = []
    for k in range(11):
        pose = np.eye(4)
        pose[:3, 3] = k, 0.0, 0.0
        frames.append({"file_path": f"./test/r_{k}", "transform_matrix": pose.tolist()})
    (tmp_path / "transforms_test.json").write_text(json.dumps({"camera_angle_x": 0.7, "frames": frames}))
    words = ["render", str(folder), "--out", str(tmp_path / "out"), "--views", str(tmp_path / "transforms_test.json")]
    assert main([*words, "--frames", "3", "--size", "6", "5", "--quiet"]) == 0
    result = json.loads((tmp_path / "out" / "render.json").read_text())
    assert [frame["position"][0] for frame in result["frames"]] == [0.0, 5.0, 10.0]
    assert any("8 of 11 poses are left out" in note for note in result["notes"])


def test_stated_intrinsics_are_of_the_pictures_whatever_the_size(tmp_path):
    from imageio.v3 import imwrite

    matrix = [[50.0, 0.0, 31.5], [0.0, 50.0, 23.5], [0.0, 0.0, 1.0]]
    frame = {"file_path": "./test/r_0", "transform_matrix": np.eye(4).tolist()}
    file = tmp_path / "transforms_test.json"
    file.write_text(json.dumps({"intrinsics": matrix, "frames": [frame]}))
    with pytest.raises(InputError, match="intrinsics"):
        way_of_file(file, (16, 12))
    (tmp_path / "test").mkdir()
    imwrite(tmp_path / "test" / "r_0.png", np.zeros((48, 64, 3), np.uint8))
    whole, small = way_of_file(file, None).camera, way_of_file(file, (16, 12)).camera
    assert (whole.width, whole.height, small.width, small.height) == (64, 48, 16, 12)
    for camera in (whole, small):
        edge = np.array([[-0.5, -0.5], [camera.width - 0.5, camera.height - 0.5]])  # outer corners of the view
        np.testing.assert_allclose(camera.directions(edge), whole.directions([[-0.5, -0.5], [63.5, 47.5]]))


def test_poses_are_seen_by_the_camera_beside_them(folder, tmp_path, capsys):
    """A data set without pictures: its event camera, whose angle --fov does not change."""
    from pixelid.nerf.data.trajectory import Trajectory

    data, matrix = tmp_path / "data", np.array([[50.0, 0.0, 30.0], [0.0, 51.0, 20.0], [0.0, 0.0, 1.0]])
    data.mkdir()
    turned = np.tile([0.0, 0.0, 0.0, 1.0], (3, 1))
    write_poses(data, Trajectory(np.arange(3.0), np.arange(9.0).reshape(3, 3), turned))
    alone = way_of_file(data, None, 0.5)
    assert (alone.camera.width, alone.camera.height) == (400, 400)
    np.testing.assert_allclose(alone.camera.directions([[-0.5, 199.5]])[0, 0], -math.sin(0.25))
    np.savez(
        data / "camera_calibration.npz", intrinsics=matrix, distortion_params=np.array([0.1, 0.0, 0.0, 0.0]),
        distortion_model="plumb_bob", img_height=48, img_width=64, bayer_pattern="", pos_contrast_threshold=0.2,
        neg_contrast_threshold=0.2, refractory_period=0,
    )  # fmt: skip
    for path in (data, data / "camera_poses.npz"):
        camera = way_of_file(path, None).camera
        assert (camera.width, camera.height, camera.distorts) == (64, 48, True)
        np.testing.assert_array_equal(camera.intrinsics, matrix)
    assert way_of_file(data, (32, 24)).camera.intrinsics[0, 0] == 25.0
    words = ["render", str(folder), "--out", str(tmp_path / "out"), "--fov", "60", "--views"]
    (data / "transforms_test.json").write_text(json.dumps(
        {"camera_angle_x": 0.7, "frames": [{"file_path": "r_0", "transform_matrix": np.eye(4).tolist()}]}
    ))  # fmt: skip
    for path in (data, data / "transforms_test.json"):
        assert main([*words, str(path)]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert "--fov" in line


def test_normals_of_a_box_that_is_no_cube(tmp_path):
    """A ball in a box twice as high as wide: half as many cells per length there."""
    low, high, side = np.array([-1.0, -1.0, -2.0]), np.array([1.0, 1.0, 2.0]), 49
    axes = [np.linspace(a, b, side) for a, b in zip(low, high, strict=True)]
    x, y, z = np.meshgrid(*axes, indexing="ij")
    grid = np.empty((side, side, side, 2), np.float32)
    grid[..., 0] = np.clip(40 * (0.7 - np.sqrt(x**2 + y**2 + z**2)), -8, 8)
    grid[..., 1] = 0.0
    field = Field(low, high, side, 1, [1.0])
    field.hold_dense(torch.from_numpy(grid))
    mesh = mesh_of(field)
    outwards = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1, keepdims=True)
    angle = np.degrees(np.arccos(np.clip((mesh.normals * outwards).sum(axis=1), -1, 1)))
    assert np.median(angle) < 3


def test_splats_of_a_box_that_is_no_cube_are_as_opaque_as_the_cells():
    """A haze in a box twice as high as wide: layers along the three axes, what they let through averaged."""
    low, high, side, sigma = np.array([-1.0, -1.0, -2.0]), np.array([1.0, 1.0, 2.0]), 17, 0.5
    field = Field(low, high, side, 1, [1.0])
    grid = np.zeros((side, side, side, 2), np.float32)
    grid[..., 0] = np.log(sigma)
    field.hold_dense(torch.from_numpy(grid))
    splats = splats_of(field)
    covered = 2 * np.pi * splats.opacity.mean()  # of a layer across an axis, times the deviations along it
    along = []
    for axis in range(3):
        across = np.delete(splats.deviation[0], axis)
        spacing = (high - low) / (side - 1)
        share = covered * np.prod(across) / np.prod(np.delete(spacing, axis))
        along.append(-np.log1p(-share) / spacing[axis])  # optical depth per length
    assert np.exp(np.mean(np.log(along))) == pytest.approx(sigma, rel=0.02)


@pytest.mark.parametrize(("away", "radius", "coarse", "slope"), [(0.0, 0.7, 0.03, 20.0), (6.0, 2.0, 0.5, 2.0)])
def test_an_unbounded_scene_is_shown_where_it_is(away, radius, coarse, slope):
    """A ball in the inner box of [−1, 1]³, and one outside: its surface, its splats and its distance."""
    field = Field(np.full(3, -1.0), np.full(3, 1.0), 97, 1, [0.3], unbounded=True)
    centre = np.array([away, 0.2, -0.1])
    inside = radius - np.linalg.norm(field.positions() - centre, axis=1)
    surface = np.log(np.log(2) / field.step)  # half of the light passes a cell
    field.grid.data[64:, 0] = torch.as_tensor(surface + np.clip(slope * inside, -8, 8)[64:])
    field.grid.data[:, 1] = 0.0
    mesh = mesh_of(field)
    outwards = mesh.vertices - centre
    size = np.linalg.norm(outwards, axis=1)
    assert np.abs(size - radius).max() < coarse
    turned = ((mesh.normals * outwards).sum(axis=1) / size).clip(-1, 1)
    assert np.degrees(np.arccos(np.median(turned))) < 15
    splats = splats_of(field)
    apart = np.linalg.norm(splats.centre - centre, axis=1)
    cell = splats.deviation.max(axis=1) * np.sqrt(2 * np.pi)
    assert (apart < radius + 3.6 / slope + cell).all()  # 2 % of the light where the density is e^−3.6 of the surface's
    assert (apart < radius).any()
    assert splats.deviation.shape == splats.centre.shape
    inner = np.abs(splats.centre).max(axis=1) < 1
    np.testing.assert_allclose(cell[inner], 4 / 96, rtol=1e-6)
    assert (cell[~inner] > 4 / 96).all()
    turn = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # looks along x, z up
    blank = np.empty((1, 9, 9, 1), np.float32)
    view = Views(blank, np.array([[-3.0, 0.2, -0.1]]), turn[None], pinhole(9, 9, 0.02), ("",), np.ones(1), False, 1.0)
    distance = depth_of(field, view)[0]
    assert distance[4, 4] == pytest.approx(3.0 + away - radius, abs=2 * coarse)


def test_what_is_brighter_than_white_is_told(tmp_path):
    bright = ball(1)
    with torch.no_grad():
        bright.grid[:, 1:] += 2.0
    SavedReconstruction(content(True), bright).save(tmp_path / "scene")
    words = ["render", str(tmp_path / "scene"), "--out", str(tmp_path / "out"), "--frames", "1", "--size", "24", "24"]
    assert main([*words, "--quiet"]) == 0
    notes = json.loads((tmp_path / "out" / "render.json").read_text())["notes"]
    assert any("brighter than white" in note for note in notes)


def test_depth_has_the_unit_of_the_scene_whatever_that_is():
    """The ball in a unit a million times smaller: distances are that many times larger."""
    small, unit = ball(1), 1e6
    large = Field(unit * small.low, unit * small.high, CELLS + 1, 1, [0.3])
    grid = torch.as_tensor(small.dense()[0]).clone()
    grid[..., 0] -= math.log(unit)  # density is per length
    large.hold_dense(grid)
    way = around(small.low, small.high, "orbit", 1, (9, 9))
    blank = np.empty((1, 9, 9, 1))
    near, far = (
        depth_of(field, Views(blank, scale * way.position, way.rotation, way.camera, ("",), np.ones(1), False, 1.0))
        for field, scale in ((small, 1.0), (large, unit))
    )
    assert np.isfinite(near).any()
    np.testing.assert_allclose(far, unit * near, rtol=1e-4)


def test_an_orbit_looks_at_the_middle_with_depth(folder, tmp_path):
    words = ["render", str(folder), "--out", str(tmp_path / "out"), "--frames", "3", "--size", "33", "33", "--depth"]
    assert main([*words, "--up", "0", "1", "0", "--distance", "4", "--quiet"]) == 0
    result = json.loads((tmp_path / "out" / "render.json").read_text())
    check("render", result)
    for frame in result["frames"]:
        position, rotation = np.array(frame["position"]), np.array(frame["rotation"])
        np.testing.assert_allclose(rotation[:, 2], -position / 4, atol=1e-9)  # at the origin, from 4 away
        assert position[1] == pytest.approx(4 * np.sin(0.4))
        assert rotation[1, 1] < 0  # down in the picture is down in the scene
        depth = np.load(tmp_path / "out" / "depth" / f"{frame['name']}.npy")
        axis = -position / 4  # the middle ray meets the ball where (p + t a − c)² = r²
        along, off = (CENTRE - position) @ axis, np.linalg.norm(np.cross(axis, CENTRE - position))
        assert depth[16, 16] == pytest.approx(along - np.sqrt(RADIUS**2 - off**2), abs=2 / CELLS)
        assert np.isnan(depth[0, 0])


def test_a_mesh_and_splats_of_the_ball(tmp_path):
    SavedReconstruction(content(True), ball(3)).save(tmp_path / "scene")
    words = ["render", str(tmp_path / "scene"), "--out", str(tmp_path / "out"), "--frames", "1", "--size", "8", "8"]
    assert main([*words, "--mesh", "--splats", "--quiet"]) == 0
    mesh = read_ply(tmp_path / "out" / "mesh.ply")
    vertices = np.column_stack([mesh["vertex"][name] for name in "xyz"])
    normals = np.column_stack([mesh["vertex"][f"n{name}"] for name in "xyz"])
    faces = mesh["face"]["vertices"]
    assert (mesh["face"]["number"] == 3).all()
    outwards = (vertices - CENTRE) / np.linalg.norm(vertices - CENTRE, axis=1, keepdims=True)
    np.testing.assert_allclose(np.linalg.norm(vertices - CENTRE, axis=1), RADIUS, atol=2 / CELLS)
    assert (normals * outwards).sum(axis=1).min() > 0.8
    corner = vertices[faces]
    turned = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    volume = np.einsum("ni,ni->n", corner[:, 0] - CENTRE, turned).sum() / 6
    assert volume == pytest.approx(4 / 3 * np.pi * RADIUS**3, rel=0.1)  # closed, its faces turned outwards
    radiance = 0.4 + 0.3 * vertices[:, 0] + 0.05  # the second colour
    expected = 255 * (0.8 * (radiance + 0.05) ** 0.9 - 0.01)
    np.testing.assert_allclose(mesh["vertex"]["green"], expected, atol=2.5)
    splats = read_ply(tmp_path / "out" / "splats.ply")["vertex"]
    assert splats.dtype.names[:3] == ("x", "y", "z")
    assert {"f_dc_0", "f_dc_2", "opacity", "scale_2", "rot_0", "rot_3"} <= set(splats.dtype.names)
    r = np.linalg.norm(np.column_stack([splats[name] for name in "xyz"]) - CENTRE, axis=1)
    assert 0.4 < r.min() < r.max() < RADIUS + 4 / CELLS  # a shell: nobody sees inside
    np.testing.assert_allclose(np.exp(splats["scale_0"]), 2 / CELLS / np.sqrt(2 * np.pi), rtol=1e-5)
    assert (1 / (1 + np.exp(-splats["opacity"]))).max() > 0.99
    green = 0.5 + 0.28209479177387814 * splats["f_dc_1"]
    expected = 0.8 * (0.4 + 0.3 * splats["x"] + 0.05 + 0.05) ** 0.9 - 0.01
    np.testing.assert_allclose(green, expected, atol=2.5 / 255)


def theirs(direction: np.ndarray) -> np.ndarray:
    """(8,) harmonics of degree 1 and 2 as Kerbl et al. (2023) evaluate them."""
    x, y, z = direction
    first, second = 0.4886025119029199, (1.0925484305920792, 0.31539156525252005, 0.5462742152960396)
    return np.array([
        -first * y, first * z, -first * x, second[0] * x * y, -second[0] * y * z,
        second[1] * (2 * z * z - x * x - y * y), -second[0] * x * z, second[2] * (x * x - y * y),
    ])  # fmt: skip


@pytest.mark.parametrize("degree", [1, 2])
def test_splats_and_meshes_of_highlights_show_them_where_they_are_seen(tmp_path, degree):
    """Radiance that depends on the direction: evaluated as viewers do, splats have the colours of the field."""
    field, rng = ball(3), np.random.default_rng(degree)
    grid, _ = field.dense()
    coefficients = torch.zeros(*grid.shape[:3], 3, (degree + 1) ** 2 - 1)
    coefficients += torch.as_tensor(rng.normal(0, 0.03, coefficients.shape[3:]), dtype=torch.float32)
    field.hold_dense(torch.from_numpy(grid), coefficients)
    SavedReconstruction(content(True), field).save(tmp_path / "scene")
    read = SavedReconstruction.load(tmp_path / "scene").field
    torch.testing.assert_close(read.coefficients, field.coefficients, rtol=1e-3, atol=1e-6)
    words = ["render", str(tmp_path / "scene"), "--out", str(tmp_path / "out"), "--frames", "1", "--size", "8", "8"]
    assert main([*words, "--mesh", "--splats", "--quiet"]) == 0
    splats = read_ply(tmp_path / "out" / "splats.ply")["vertex"]
    assert sum(name.startswith("f_rest_") for name in splats.dtype.names) == 45
    for direction in rng.normal(size=(5, 3)):
        direction /= np.linalg.norm(direction)
        basis = harmonics(torch.from_numpy(direction[None]), coefficients.shape[-1])[0]
        tilt = float(coefficients[0, 0, 0, 1] @ basis.float())
        radiance = (0.4 + 0.3 * splats["x"] + 0.05) * np.exp(tilt) + 0.05  # the second colour, and the dark light
        rest = np.array([splats[f"f_rest_{15 + k}"] for k in range(8)])
        green = 0.5 + 0.28209479177387814 * splats["f_dc_1"] + theirs(direction) @ rest
        np.testing.assert_allclose(green, 0.8 * radiance**0.9 - 0.01, atol=3 / 255)
    mesh = read_ply(tmp_path / "out" / "mesh.ply")["vertex"]
    normals = np.column_stack([mesh[f"n{name}"] for name in "xyz"])
    tilts = harmonics(torch.from_numpy(-normals), coefficients.shape[-1]).float() @ coefficients[0, 0, 0, 1]
    radiance = (0.4 + 0.3 * mesh["x"] + 0.05) * np.exp(tilts.numpy()) + 0.05
    np.testing.assert_allclose(mesh["green"], 255 * (0.8 * radiance**0.9 - 0.01), atol=2.5)


def test_fields_without_harmonics_are_read_and_damaged_ones_refused(folder):
    arrays = dict(np.load(folder / "field.npz"))
    grid = arrays["grid"]
    np.savez(folder / "field.npz", **{name: value for name, value in arrays.items() if name != "coefficients"})
    assert SavedReconstruction.load(folder).field.dense()[1].shape == (*grid.shape[:3], 1, 0)
    for shape in ((*grid.shape[:3], 1, 5), (*grid.shape[:3], 2, 3), (3, 3, 3, 1, 3), (3,)):
        np.savez(folder / "field.npz", **arrays | {"coefficients": np.zeros(shape, np.float16)})
        with pytest.raises(InputError, match="coefficients"):
            SavedReconstruction.load(folder)


def test_an_unbounded_grid_that_holds_nothing_beyond_the_box_is_refused(folder, tmp_path, capsys):
    def written(vertices: int) -> None:
        few = Field(np.full(3, -1.0), np.full(3, 1.0), vertices, 1, [0.3], unbounded=True)
        write_field(few, folder)

    written(2)
    assert main(["render", str(folder), "--out", str(tmp_path / "out"), "--mesh", "--quiet"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "unbounded: expected at least 3 vertices per side, found 2" in line
    written(3)
    field = SavedReconstruction.load(folder).field
    assert np.isfinite(field.positions()).all()
    way = around([-1] * 3, [1] * 3, "orbit", 2, (6, 5))
    views = Views(np.empty((2, 5, 6, 1)), way.position, way.rotation, way.camera, ("",) * 2, np.ones(2), False, 1.0)
    assert np.isfinite(render_views(field, views, np.zeros(1))).all()


def test_a_video_plays_every_frame(folder, tmp_path):
    av = pytest.importorskip("av")
    words = ["render", str(folder), "--out", str(tmp_path / "out"), "--frames", "7", "--size", "33", "17", "--video"]
    assert main([*words, "--path", "spiral", "--depth", "--fps", "10", "--quiet"]) == 0
    for name in ("video.mp4", "depth.mp4"):
        with av.open(str(tmp_path / "out" / name)) as container:
            frames = list(container.decode(video=0))
            assert container.streams.video[0].codec_context.name == "h264"
        assert len(frames) == 7
        assert min(frames[0].width, frames[0].height) >= 256
        assert frames[0].width % 2 == frames[0].height % 2 == 0


@pytest.mark.parametrize("size", [(3, 401), (1024, 1), (1, 5000), (1, 1), (300, 257)])
def test_a_video_of_any_shape_shows_all_of_its_frames(size, tmp_path):
    """A frame of 1024 × 1 pixels enlarged to 256 rows would be wider than the codec goes."""
    av = pytest.importorskip("av")
    from pixelid.nerf.shown.video import LARGEST, write_video

    width, height = size
    ramp = np.add.outer(np.linspace(40, 120, height), np.linspace(0, 80, width))
    write_video(tmp_path / "video.mp4", [np.repeat(ramp.astype(np.uint8)[..., None], 3, axis=2)] * 2, 30)
    with av.open(str(tmp_path / "video.mp4")) as container:
        shown = next(container.decode(video=0)).to_ndarray(format="rgb24").astype(float)
    factor = min(shown.shape[0] // height, shown.shape[1] // width)
    assert factor >= 1
    assert max(shown.shape) <= max(LARGEST, max(size)) + 1
    enlarged = np.repeat(np.repeat(ramp, factor, axis=0), factor, axis=1)
    assert [a - b for a, b in zip(shown.shape, enlarged.shape, strict=False)] == [s % 2 for s in enlarged.shape]
    np.testing.assert_allclose(shown[: enlarged.shape[0], : enlarged.shape[1], 1], enlarged, atol=8)


def test_without_av_the_frames_remain(folder, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("pixelid.nerf.shown.video.can_write", lambda: False)
    words = ["render", str(folder), "--out", str(tmp_path / "out"), "--frames", "2", "--size", "8", "8", "--video"]
    assert main(words) == 0
    assert "pixelid[video]" in capsys.readouterr().out
    assert len(list((tmp_path / "out" / "frames").iterdir())) == 2
    assert not (tmp_path / "out" / "video.mp4").exists()


def test_a_scene_without_views_is_shown_by_its_own_brightness(tmp_path, capsys):
    SavedReconstruction(content(False, "misfit"), ball(1)).save(tmp_path / "scene")
    words = ["render", str(tmp_path / "scene"), "--out", str(tmp_path / "out"), "--frames", "1", "--size", "16", "16"]
    assert main(words) == 0
    printed = capsys.readouterr().out
    assert "no views" in printed
    assert "misfit" in printed


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["{none}"], "found nothing of that name"),
        (["{empty}"], "reconstruction.json"),
        (["{scene}", "--views", "{none}"], "no such file"),
        (["{scene}", "--views", "{empty}"], "neither views/ nor camera_poses.npz"),
        (["{scene}", "--views", "{empty}", "--path", "orbit"], "--path orbit"),
        (["{scene}", "--views", "{empty}", "--distance", "3"], "--distance"),
        (["{scene}", "--views", "{empty}", "--up", "0", "1", "0"], "--up"),
        (["{scene}", "--path", "zigzag"], "zigzag"),
        (["{scene}", "--up", "0", "0", "0"], "--up"),
        (["{scene}", "--frames", "0"], "--frames"),
        (["{clear}", "--mesh", "--frames", "1", "--size", "4", "4"], "no surface"),
        (["{clear}", "--splats", "--frames", "1", "--size", "4", "4"], "no splats"),
    ],
)
def test_wrong_usage_is_refused_before_frames_are_rendered(words, says, folder, tmp_path, capsys, monkeypatch):
    def refuse(*arguments, **options):
        raise AssertionError("a frame was rendered")

    for module in ("frames", "render"):
        monkeypatch.setattr(f"pixelid.nerf.shown.{module}.render_views", refuse)
    (tmp_path / "empty").mkdir()
    nothing = Field(np.full(3, -1.0), np.full(3, 1.0), 9, 1, [0.3])
    with torch.no_grad():
        nothing.grid[:, 0] = -9.0
    SavedReconstruction(content(True), nothing).save(tmp_path / "clear")
    names = {name: str(tmp_path / name) for name in ("none", "empty", "scene", "clear")}
    filled = [word.format(**names) for word in words]
    assert main(["render", filled[0], "--out", str(tmp_path / "out"), *filled[1:]]) == 2
    printed = capsys.readouterr().err
    assert 1 <= len(printed.splitlines()) <= 2
    assert says in printed
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("key", ["pixel", "correction"])
def test_a_result_that_lost_a_table_is_refused_in_a_line(key, folder, tmp_path, capsys):
    copy = shutil.copytree(folder, tmp_path / "copy")
    content = json.loads((copy / "reconstruction.json").read_text())
    del content[key]
    (copy / "reconstruction.json").write_text(json.dumps(content))
    assert main(["render", str(copy), "--out", str(tmp_path / "out"), "--quiet"]) == 2
    assert key in capsys.readouterr().err


@pytest.mark.parametrize(
    ("table", "key", "value", "says"),
    [
        ("correction", "a", [1, 2], "correction.a: expected 3 numbers, found [1, 2]"),
        ("correction", "b", None, "correction.b: expected a finite number, found None"),
        ("correction", "c", ["nan"] * 3, "correction.c: expected a finite number, found 'nan'"),
        ("pixel", "dark", [[0, 1], [1, 0]], "pixel.dark: expected 3 numbers, found [[0, 1], [1, 0]]"),
        ("pixel", "dark", ["nan"], "pixel.dark: expected a finite number of at least 0, found 'nan'"),
        ("pixel", "dark", -5, "pixel.dark: expected a finite number of at least 0, found -5"),
    ],
)
def test_a_result_with_numbers_that_cannot_be_is_refused_in_a_line(table, key, value, says, tmp_path, capsys):
    damaged = content(True)
    damaged[table] = {**damaged[table], key: value}
    SavedReconstruction(damaged, ball(3)).save(tmp_path / "scene")
    assert main(["render", str(tmp_path / "scene"), "--out", str(tmp_path / "out"), "--quiet"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"reconstruction.json: {says}" in line
    assert not (tmp_path / "out").exists()


def test_numbers_per_colour_and_unscored_scenes_are_read(tmp_path):
    whole = content(True) | {"correction": {"a": [1, 2, 3], "b": 0.9, "c": [0.0] * 3}, "pixel": {"dark": [0, 1, 2]}}
    SavedReconstruction(whole, ball(3)).save(tmp_path / "whole")
    read = SavedReconstruction.load(tmp_path / "whole")
    assert read.correction is not None
    np.testing.assert_array_equal(read.correction.a, [1, 2, 3])
    np.testing.assert_array_equal(read.dark, [0, 1, 2])
    for nothing in (None, [None] * 3):
        unscored = content(False) | {"correction": dict.fromkeys("abc", nothing), "pixel": {}}
        SavedReconstruction(unscored, ball(3)).save(tmp_path / "unscored", overwrite=True)
        read = SavedReconstruction.load(tmp_path / "unscored")
        assert read.correction is None
        np.testing.assert_array_equal(read.dark, [0, 0, 0])


def test_a_scene_that_diverged_is_refused_as_such(tmp_path, capsys):
    """As a training leaves it whose numbers ran away: no field, no scores."""
    field = ball(1)
    with torch.no_grad():
        field.grid[:] = math.nan
    gone = content(True, "diverged") | {"advice": "lower the learning rate"}
    SavedReconstruction(gone, field).save(tmp_path / "scene")
    assert main(["render", str(tmp_path / "scene"), "--out", str(tmp_path / "out"), "--quiet"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "diverged" in line
    assert "lower the learning rate" in line


def pictured(folder: Path, tmp_path: Path, brighter: float = 0.0, scale: float = 1.0) -> Path:
    """A data set of three views of the ball as corrected, of other exposures, and brighter on the right half."""
    from imageio.v3 import imwrite

    way = around([-1] * 3, [1] * 3, "spiral", 3, (24, 20), fov=0.7)
    views = Views(
        np.empty((3, 20, 24, 1)), way.position, way.rotation, way.camera, ("",) * 3, np.ones(3), False, 1.0
    )  # fmt: skip
    radiance = render_views(px.load_field(folder), views, np.array([0.05]))[..., 0]
    exposure, frames = np.array([1.0, 0.8, 1.2]), []
    (tmp_path / "scene" / "views" / "test").mkdir(parents=True)
    for k in range(3):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = way.rotation[k] @ np.diag([1.0, -1.0, -1.0]), way.position[k]
        frame = {"file_path": f"./test/r_{k}", "transform_matrix": pose.tolist(), "exposure_time": 3 * exposure[k]}
        frames.append(frame)
        image = exposure[k] * (0.8 * radiance[k] ** 0.9 - 0.01)
        image[:, 12:] += brighter
        image *= scale
        imwrite(tmp_path / "scene" / "views" / "test" / f"r_{k}.tiff", image.astype(np.float32))
    file = tmp_path / "scene" / "views" / "transforms_test.json"
    file.write_text(json.dumps({"camera_angle_x": 0.7, "frames": frames}))
    return file


def test_frames_of_pictured_views_come_with_their_errors(folder, tmp_path):
    from skimage.io import imread

    file = pictured(folder, tmp_path / "data", brighter=0.06)
    words = ["render", str(folder), "--views", str(file), "--quiet"]
    assert main([*words, "--out", str(tmp_path / "out"), "--frames", "2", "--depth"]) == 0
    result = json.loads((tmp_path / "out" / "render.json").read_text())
    check("render", result)
    assert result["errors"]["full_scale"] == pytest.approx(0.3)
    assert [frame["name"] for frame in result["errors"]["frames"]] == ["0000_r_0", "0002_r_2"]
    for frame in result["errors"]["frames"]:
        error = np.load(tmp_path / "out" / "errors" / f"{frame['name']}.npy")
        assert error.shape == (20, 24, 1)
        np.testing.assert_allclose(error[:, :12], 0.0, atol=1e-5)
        np.testing.assert_allclose(error[:, 12:], -0.06, atol=1e-5)
        assert frame["psnr"] == pytest.approx(-10 * np.log10(0.5 * 0.06**2), abs=1e-2)
        assert (frame["mean"], frame["mean_absolute"]) == pytest.approx((-0.03, 0.03), abs=1e-5)
        picture = imread(tmp_path / "out" / "errors" / f"{frame['name']}.png").astype(int)
        assert picture[:, :12].sum(axis=-1).max() < 10 < picture[:, 12:].sum(axis=-1).min()
    assert "errors/" in result["files"]
    assert main([*words, "--out", str(tmp_path / "small"), "--size", "12", "10"]) == 0
    other = json.loads((tmp_path / "small" / "render.json").read_text())
    assert other["errors"] is None
    assert any("no error maps: pictures have 24 × 20 pixels" in note for note in other["notes"])


def test_the_scale_of_errors_is_that_of_all_pictures_of_the_file(folder, tmp_path):
    """White of unquantised pictures, as scores have it, whichever frames are shown."""
    file = pictured(folder, tmp_path / "data", scale=30.0)
    images = read_views(tmp_path / "data" / "scene", 1)["test"]
    assert images.peak == pytest.approx(min(images.images.max() / 4.0, np.quantile(images.images, 0.999)))
    assert images.peak > 1.5
    for most in (1, 3):
        out = tmp_path / f"out{most}"
        assert main(["render", str(folder), "--views", str(file), "--out", str(out), "--frames", str(most),
                     "--quiet"]) == 0  # fmt: skip
        errors = json.loads((out / "render.json").read_text())["errors"]
        assert errors["full_scale"] == pytest.approx(0.3 * images.peak)
        assert len(errors["frames"]) == most


def test_frames_whose_pictures_are_lost_have_no_error_map(folder, tmp_path):
    """All others do; of quantised pictures, which are not looked at before."""
    from imageio.v3 import imwrite

    file = pictured(folder, tmp_path / "data")
    for k in range(3):
        imwrite(file.parent / "test" / f"r_{k}.png", np.full((20, 24), 100, np.uint8))
        (file.parent / "test" / f"r_{k}.tiff").unlink()
    (file.parent / "test" / "r_1.png").write_bytes(b"no picture")
    out = tmp_path / "out"
    assert main(["render", str(folder), "--views", str(file), "--out", str(out), "--quiet"]) == 0
    result = json.loads((out / "render.json").read_text())
    check("render", result)
    assert [frame["name"] for frame in result["errors"]["frames"]] == ["0000_r_0", "0002_r_2"]
    assert [note for note in result["notes"] if "1 of 3 frames have no error map; the first: 0001_r_1" in note]
    assert len(list((out / "errors").glob("*.npy"))) == 2
    assert len(list((out / "frames").iterdir())) == 3


@pytest.mark.parametrize("shared", [False, True])
def test_what_a_renderer_added_to_pictures_is_added_for_errors_too(folder, tmp_path, shared):
    """Views within their data set say it by themselves; of those beside it, the reconstruction remembers."""
    file, dark = pictured(folder, tmp_path / "data"), 0.02
    sequence = tmp_path / "data" / ("sequence" if shared else "scene")
    if shared:
        sequence.mkdir()
        shutil.move(file.parent, tmp_path / "data" / "views")
        file = tmp_path / "data" / "views" / file.name
    np.savez(sequence / "renderer_params.npz", interm_color_space="linear", log_eps=dark)
    views = read_views(sequence, 1)["test"]
    told = views.log_eps
    assert told == dark
    content = json.loads((folder / "reconstruction.json").read_text())
    content["log_eps"] = told if shared else 9.0  # of another data set
    (folder / "reconstruction.json").write_text(json.dumps(content))
    for name, asked in (("file", file), ("folder", sequence)):
        words = ["render", str(folder), "--views", str(asked), "--out", str(tmp_path / name), "--quiet"]
        assert main(words) == 0
        for frame in json.loads((tmp_path / name / "render.json").read_text())["errors"]["frames"]:
            assert frame["mean"] == pytest.approx(-dark, abs=1e-4)


def test_many_frames_take_no_more_memory_than_few(folder, tmp_path):
    """With depths and errors: what numbers are held at a time, besides a figure's few frames."""
    scene, frames, most = pictured(folder, tmp_path / "data"), [], {}
    document = json.loads(scene.read_text())
    for k in range(24):
        frames.append({**document["frames"][k % 3], "file_path": f"./test/r_{k % 3}.tiff"})
    saved = SavedReconstruction.load(folder)
    for number in (2, 6, 24):  # the first one compiles and imports
        scene.write_text(json.dumps({**document, "frames": frames[:number]}))
        way = way_of_file(scene, None)
        (tmp_path / str(number)).mkdir()
        tracemalloc.start()
        made = render(folder, saved, way, tmp_path / str(number), RenderOptions(depth=True))
        most[number] = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert len(made.content["errors"]["frames"]) == number
    of_a_frame = 20 * 24 * (3 + 4 + 4)  # bytes of the picture, its depth and its error
    assert most[24] - most[6] < 9 * of_a_frame  # half of what 18 frames more would take
