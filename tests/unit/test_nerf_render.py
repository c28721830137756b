"""Rendering: a slab with a known answer, two engines that agree, gradients, scenes and cameras."""

from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.ndimage import distance_transform_cdt
from scipy.spatial.transform import Rotation, Slerp
from scipy.special import factorial, lpmv

from pixelid.errors import InputError
from pixelid.nerf.data.camera import Camera, pinhole, refuse_lens_without_inverse
from pixelid.nerf.data.scenes import procedural, random_views, spiral
from pixelid.nerf.data.trajectory import Trajectory
from pixelid.nerf.field.bricks import Bricks
from pixelid.nerf.field.harmonics import fill, harmonics, number_of
from pixelid.nerf.field.radiance import Field, blocks, render_kernels
from pixelid.nerf.field.render import Box, Rays, render
from pixelid.nerf.field.smoothness import mean_square, variation
from pixelid.nerf.shown.correction import fit_correction

LOW, HIGH = np.full(3, -1.0), np.full(3, 1.0)


def cube(vertices: int, step: float, occupied=None) -> Box:
    """A box whose bricks are all there."""
    bricks = Bricks.every(vertices)
    return Box(LOW, HIGH, step, np.ones(blocks(vertices), np.uint8) if occupied is None else occupied, bricks)


def rendered(grid, background, rays, box, engine="auto", coefficients=None):
    """`render` of values (n, n, n, …) at the vertices."""
    return render(
        box.bricks.gathered(grid), background, rays, box, engine,
        None if coefficients is None else box.bricks.gathered(coefficients),
    )  # fmt: skip


def random_rays(n: int, channels: int, seed=0) -> Rays:
    rng = np.random.default_rng(seed)
    position, rotation = random_views(n, seed)
    inside = pinhole(64, 64, 0.6).directions(rng.uniform(0, 63, (n, 2)))
    world = np.einsum("nij,nj->ni", rotation, inside)
    offsets = rng.random(n).astype(np.float32)
    return Rays(position.astype(np.float32), world.astype(np.float32), rng.integers(0, channels, n), offsets)


@pytest.mark.parametrize("engine", ["compiled", "tensors"])
def test_a_uniform_box_absorbs_exponentially(engine):
    grid = torch.zeros(17, 17, 17, 2)
    grid[..., 0], grid[..., 1] = np.log(0.7), np.log(2.0)
    rays = Rays(
        np.array([[-3, 0.1, 0.2]], np.float32), np.array([[1, 0, 0]], np.float32), np.zeros(1, int),
        np.full(1, 0.5, np.float32),
    )  # fmt: skip
    box = cube(17, 2 / 64)
    radiance, opacity = rendered(grid, torch.tensor([5.0]), rays, box, engine)
    through = np.exp(-0.7 * 2)
    assert float(radiance) == pytest.approx(2.0 * (1 - through) + 5.0 * through, rel=1e-4)
    assert float(opacity) == pytest.approx(1 - through, rel=1e-4)


@pytest.mark.parametrize("engine", ["compiled", "tensors"])
def test_a_speck_at_the_camera_is_not_seen_before_the_near_distance(engine):
    """The camera is inside the box, and the eight vertices about it are dense; beyond them all is clear."""
    grid = torch.full((17, 17, 17, 2), -12.0)
    grid[8:10, 8:10, 8:10] = torch.tensor([8.0, 1.0])
    rays = Rays(
        np.full((1, 3), 0.05, np.float32), np.array([[1, 0, 0]], np.float32), np.zeros(1, int), np.zeros(1, np.float32)
    )
    hidden, shown = (
        rendered(grid, torch.tensor([5.0]), rays, cube(17, 2 / 64)._replace(near=near), engine) for near in (0.0, 0.4)
    )
    assert float(hidden[1]) > 0.99
    assert float(shown[1]) < 1e-3
    assert float(shown[0]) == pytest.approx(5.0, rel=1e-3)


@pytest.mark.parametrize("away", [1e8, 9e18, np.inf])
@pytest.mark.parametrize("engine", ["compiled", "tensors"])
def test_from_too_far_away_there_is_only_the_background(engine, away):
    grid = torch.zeros(17, 17, 17, 2, requires_grad=True)
    rays = Rays(
        np.array([[-away, 0.1, 0.2]], np.float32), np.array([[1, 0, 0]], np.float32), np.zeros(1, int),
        np.full(1, 0.5, np.float32),
    )  # fmt: skip
    box = cube(17, 2 / 64)
    radiance, opacity = rendered(grid, torch.tensor([5.0]), rays, box, engine)
    radiance.sum().backward()
    assert (float(radiance.detach()), float(opacity)) == (5.0, 0.0)
    assert grid.grad is not None
    assert not grid.grad.any()


def test_harmonics_are_orthonormal_and_those_of_scipy():
    """Mean square 1 over the sphere; SciPy's Legendre functions times cos and sin, of either sign, in our order."""
    z, weight = np.polynomial.legendre.leggauss(8)
    angle = np.arange(16) * 2 * np.pi / 16
    z, angle, weight = np.repeat(z, 16), np.tile(angle, 8), np.repeat(weight / 32, 16)
    theta = np.arccos(z)
    directions = np.column_stack([np.sin(theta) * np.cos(angle), np.sin(theta) * np.sin(angle), z])
    ours = harmonics(torch.from_numpy(directions), number_of(2)).numpy()
    np.testing.assert_allclose(np.einsum("n,ni,nj->ij", weight, ours, ours), np.eye(8), atol=1e-12)
    np.testing.assert_allclose(weight @ ours, 0.0, atol=1e-12)
    for column, (degree, order) in enumerate([(1, 1), (1, -1), (1, 0), (2, -2), (2, -1), (2, 1), (2, 0), (2, 2)]):
        m, twice = abs(order), 2 if order else 1
        scale = np.sqrt(twice * (2 * degree + 1) * factorial(degree - m) / factorial(degree + m))
        expected = scale * lpmv(m, degree, z) * (np.cos(m * angle) if order >= 0 else np.sin(m * angle))
        sign = np.sign((expected * ours[:, column]).sum())
        np.testing.assert_allclose(ours[:, column], sign * expected, atol=1e-12)
    compiled = np.empty(8, np.float32)
    for k in range(0, len(directions), 7):
        fill(directions[k].astype(np.float32), compiled)
        np.testing.assert_allclose(compiled, ours[k], atol=1e-5)


@pytest.mark.parametrize("engine", ["compiled", "tensors"])
def test_a_uniform_box_shows_another_radiance_from_every_side(engine):
    """ln L = c + h · Y(d), by hand for one direction."""
    grid, coefficients = torch.zeros(9, 9, 9, 2), torch.zeros(9, 9, 9, 1, 3)
    grid[..., 0], grid[..., 1] = 6.0, np.log(0.5)
    coefficients[..., 0], coefficients[..., 2] = 0.2, -0.1
    ray = np.array([0.6, 0.0, 0.8])
    rays = Rays(-3 * ray[None].astype(np.float32), ray[None].astype(np.float32), np.zeros(1, int), np.zeros(1, "f4"))
    box = cube(9, 0.02)
    radiance, opacity = rendered(grid, torch.tensor([0.53]), rays, box, engine, coefficients)
    assert float(opacity) > 0.998  # the march ends where nothing more shows
    assert float(radiance) == pytest.approx(0.5 * np.exp(np.sqrt(3) * (0.2 * 0.6 - 0.1 * 0.8)), rel=3e-5)


def shown_with_gradients(
    channels: int, degree: int, engine: str = "auto", device: str = "cpu", near: float = 0.0
) -> list[torch.Tensor]:
    """Radiance and opacity of some rays through a field, and the gradients of a sum over them, on the CPU."""
    rng = np.random.default_rng(0)
    values = rng.normal(0, 1, (13, 13, 13, 1 + channels)).astype(np.float32)
    directional = 0.3 * rng.normal(0, 1, (13, 13, 13, channels, number_of(degree))).astype(np.float32)
    rays = random_rays(500, channels)
    box = cube(13, 0.11, (rng.random((3, 3, 3)) < 0.8).astype(np.uint8))._replace(near=near)
    arrays = (values, np.full(channels, 0.4, np.float32), directional, *rays[:2])
    moved = [torch.tensor(array, device=device, requires_grad=True) for array in arrays]
    grid, behind, coefficients, origins, directions = moved
    moving = rays._replace(origins=origins, directions=directions)
    radiance, opacity = rendered(grid, behind, moving, box, engine, coefficients)
    (radiance * torch.linspace(-1, 1, len(radiance), device=device)).sum().backward()
    slopes = [of.grad for of in moved if of.numel()]
    return [array.cpu() for array in (radiance.detach(), opacity, *slopes) if array is not None]


@pytest.mark.parametrize(("channels", "degree", "near"), [(1, 0, 0.0), (3, 0, 3.0), (1, 1, 0.0), (3, 2, 3.0)])
def test_both_engines_agree_with_their_gradients(channels, degree, near):
    found = [shown_with_gradients(channels, degree, engine, near=near) for engine in ("compiled", "tensors")]
    assert len(found[0]) == (7 if degree else 6)
    for compiled, tensors in zip(*found, strict=True):
        torch.testing.assert_close(compiled, tensors, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize(("step", "density", "value"), [(0.004, -1.0, 0.0), (0.11, 13.0, 0.0), (0.11, 0.0, 13.0)])
def test_both_engines_agree_in_fog_and_beyond_the_highest_values(step, density, value):
    """Hundreds of samples per ray, more than there is room for at first; and values that are cut off have no slope."""
    rng = np.random.default_rng(3)
    values = 0.1 * rng.normal(size=(13, 13, 13, 2)).astype(np.float32) + np.array([density, value], np.float32)
    rays, box, slopes = random_rays(60, 1), cube(13, step), []
    for engine in ("compiled", "tensors"):
        grid = torch.tensor(values, requires_grad=True)
        radiance, _ = rendered(grid, torch.tensor([0.4]), rays, box, engine)
        (radiance * torch.linspace(-1, 1, len(radiance))).sum().backward()
        slopes.append((radiance.detach(), grid.grad))
    for compiled, tensors in zip(*slopes, strict=True):
        torch.testing.assert_close(compiled, tensors, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("of", ["grid", "coefficients"])
def test_gradients_are_those_of_finite_differences(of):
    rng = np.random.default_rng(1)
    arrays = {"grid": rng.normal(0, 0.5, (9, 9, 9, 2)).astype(np.float32)}
    arrays["coefficients"] = rng.normal(0, 0.2, (9, 9, 9, 1, 8)).astype(np.float32)
    rays, box = random_rays(200, 1), cube(9, 0.25)
    behind, weight = torch.tensor([0.4]), torch.tensor(rng.normal(size=200))

    def value(given):
        both = {name: torch.as_tensor(array) for name, array in (arrays | {of: given}).items()}
        return (rendered(both["grid"], behind, rays, box, coefficients=both["coefficients"])[0].double() * weight).sum()

    values = arrays[of]
    at = torch.tensor(values, requires_grad=True)
    value(at).backward()
    assert at.grad is not None
    strongest = np.argsort(-at.grad.abs().numpy().ravel())[:12]
    for flat in strongest:
        up, down = values.copy().ravel(), values.copy().ravel()
        up[flat] += 0.01
        down[flat] -= 0.01
        slope = float(value(up.reshape(values.shape)) - value(down.reshape(values.shape))) / 0.02
        assert float(at.grad.ravel()[flat]) == pytest.approx(slope, rel=2e-2)


def rays_from_inside(rng, number: int) -> Rays:
    directions = rng.normal(size=(number, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return Rays(
        rng.uniform(-0.3, 0.3, (number, 3)).astype(np.float32), directions.astype(np.float32),
        np.zeros(number, int), rng.random(number).astype(np.float32),
    )  # fmt: skip


def assert_slopes_of_rays(value, rays: Rays, of: str, step: float, within: float) -> None:
    """The gradient of radiance (n,) by what rays are `of` is that of differences, in four of five rays."""
    at = torch.tensor(getattr(rays, of), requires_grad=True)
    value(rays._replace(**{of: at})).sum().backward()
    assert at.grad is not None
    for j in range(3):
        shift = np.zeros(3, np.float32)
        shift[j] = step
        up, down = (value(rays._replace(**{of: getattr(rays, of) + s})) for s in (shift, -shift))
        by_hand = ((up - down) / (2 * step)).numpy()
        close = np.abs(by_hand - at.grad[:, j].numpy()) < within * float(at.grad.abs().max())
        assert close.mean() > 0.8


@pytest.mark.parametrize("of", ["origins", "directions"])
def test_gradients_of_rays_are_those_of_finite_differences(of):
    """From inside the box, where the march begins at the camera wherever that is; nothing is opaque or skipped."""
    rng = np.random.default_rng(2)
    grid = torch.tensor(rng.normal(0, 0.5, (9, 9, 9, 2)).astype(np.float32))
    grid[..., 0] -= 0.5
    coefficients = torch.tensor(rng.normal(0, 0.2, (9, 9, 9, 1, 8)).astype(np.float32))
    rays, box = rays_from_inside(rng, 40), cube(9, 0.05)

    def value(given):
        return rendered(grid, torch.tensor([1.0]), given, box, coefficients=coefficients)[0]

    # the far end of the box comes and goes by a sample of one step, in some rays
    assert_slopes_of_rays(value, rays, of, 2e-3, 0.02)


def test_skipping_empty_blocks_changes_nothing_that_shows():
    field = Field(LOW, HIGH, 17, 1, [0.4])
    grid = torch.zeros(17, 17, 17, 2)
    grid[..., 0], grid[..., 1] = -12.0, np.log(0.2)
    grid[5:9, 6:11, 7:12, 0] = 3.0
    field.hold_dense(grid)
    rays = random_rays(300, 1)
    before = field(rays)[0]
    assert field.look_for_empty_blocks() < 0.5
    torch.testing.assert_close(field(rays)[0], before, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize(("vertices", "share"), [(33, 0.02), (34, 0.002), (50, 0.2), (17, 0.0), (9, 2.0), (4, 4.0)])
def test_strides_end_before_whatever_is_not_clear(vertices, share):
    """Blocks are as far from the nearest filled one as another library says, and strides miss nothing."""
    rng = np.random.default_rng(vertices)
    box, step = cube(vertices, 2 / 64), 2 / 64
    specks = rng.random((vertices,) * 3) < share / 64
    dense = np.where(specks, 4.0, -12.0).astype(np.float32)
    densities = box.bricks.gathered(torch.tensor(dense)[..., None])[:, 0].numpy()
    filled, away = np.empty(box.bricks.rows, np.uint8), np.empty(box.occupied.shape, np.int16)
    render_kernels.filled_cells(densities, vertices, box.bricks.index, step, box.occupied, filled, away)
    cells = np.lib.stride_tricks.sliding_window_view(dense, (2, 2, 2)).max(axis=(3, 4, 5)) > -12.0
    wide = np.zeros(4 * np.array(box.occupied.shape), bool)
    wide[tuple(slice(0, n) for n in cells.shape)] = cells
    some = wide.reshape(len(away), 4, len(away), 4, len(away), 4).any(axis=(1, 3, 5))
    expected = distance_transform_cdt(~some, "chessboard") if some.any() else np.full(some.shape, len(away))
    np.testing.assert_array_equal(away, expected)
    assert filled.sum() == cells.sum()
    looks = box.bricks.gathered(torch.tensor(rng.normal(size=(vertices,) * 3 + (1, 1)), dtype=torch.float32))
    rays, seen = random_rays(500, 1), []
    for strides in (away, np.zeros_like(away)):
        radiance, opacity, none = np.empty(500, np.float32), np.empty(500, np.float32), np.empty(0, np.int64)
        render_kernels.forward(
            *rays, densities, looks.numpy(), vertices, box.bricks.index, filled, strides, LOW, HIGH, None, 0.0, step,
            np.ones(1, np.float32), radiance, opacity, none, np.empty(0, np.int32), *[np.empty(0, np.float32)] * 2,
        )  # fmt: skip
        seen.append((radiance, opacity))
    np.testing.assert_array_equal(seen[0], seen[1])
    assert (np.max(seen[0][1]) > 0) == some.any()


def test_refining_keeps_the_scene():
    field = Field(LOW, HIGH, 17, 3, [0.4] * 3, degree=1)
    generator = torch.Generator().manual_seed(0)
    field.hold_dense(
        torch.randn(17, 17, 17, 4, generator=generator), torch.randn(17, 17, 17, 3, 3, generator=generator)
    )
    before = [values[::2, ::2, ::2] for values in field.dense()]
    field.refine(33)
    for values, was in zip(field.dense(), before, strict=True):
        np.testing.assert_allclose(values[::4, ::4, ::4], was, atol=1e-6)


@pytest.mark.parametrize("degrees", [180.0, 8.0, 4.0, 0.1, 0.0])
def test_poses_are_interpolated_linearly_and_by_slerp(degrees):
    """At any times in any order; small angles are interpolated by a series."""
    rng = np.random.default_rng(2)
    t, rotations = np.array([0.0, 0.3, 1.0]), Rotation.from_quat(rng.normal(size=(3, 4)))
    if degrees < 180:
        turned = Rotation.from_rotvec(np.radians(degrees) * np.array([[0, 0, 0], [0.6, 0, 0.8], [0.6, 1.0, 0.8]]))
        rotations = rotations[0] * turned
    quaternions = rotations.as_quat() * np.array([[1], [-1], [1]])
    trajectory = Trajectory(t, rng.normal(size=(3, 3)), quaternions)
    times = rng.permutation(np.linspace(0, 1, 23))
    position, rotation = trajectory.at(times)
    np.testing.assert_allclose(rotation, Slerp(t, rotations)(times).as_matrix(), atol=1e-9)
    for j in range(3):
        np.testing.assert_allclose(position[:, j], np.interp(times, t, trajectory.position[:, j]), atol=1e-12)


@pytest.mark.parametrize(
    ("model", "numbers"), [("plumb_bob", [-0.3, 0.1, 1e-3, -2e-3, 0.02]), ("equidistant", [0.02, -0.01, 0.003, -0.001])]
)
def test_lens_distortion_is_undone(model, numbers):
    ideal = pinhole(64, 48, 1.0)
    k = np.array(numbers)
    camera = Camera(ideal.intrinsics, 64, 48, k, model)
    rng = np.random.default_rng(0)
    x, y = rng.uniform(-0.4, 0.4, (2, 50))
    r2 = x * x + y * y
    if model == "plumb_bob":
        radial = 1 + k[0] * r2 + k[1] * r2**2 + k[4] * r2**3
        xd = x * radial + 2 * k[2] * x * y + k[3] * (r2 + 2 * x * x)
        yd = y * radial + k[2] * (r2 + 2 * y * y) + 2 * k[3] * x * y
    else:
        theta = np.arctan(np.sqrt(r2))
        distorted = theta * (1 + k[0] * theta**2 + k[1] * theta**4 + k[2] * theta**6 + k[3] * theta**8)
        xd, yd = x * distorted / np.sqrt(r2), y * distorted / np.sqrt(r2)
    pixels = np.column_stack([xd, yd, np.ones(50)]) @ ideal.intrinsics.T
    directions = camera.directions(pixels[:, :2])
    np.testing.assert_allclose(directions[:, :2] / directions[:, 2:], np.column_stack([x, y]), atol=1e-8)


def with_lens(model: str, numbers, f: float, width: int, height: int) -> Camera:
    intrinsics = np.array([[f, 0, width / 2 - 0.5], [0, f, height / 2 - 0.5], [0, 0, 1]])
    return Camera(intrinsics, width, height, np.array(numbers), model)


STRONG = {  # lenses in use, and as wide as the model goes
    "DAVIS346": ("plumb_bob", [-0.48, 0.26, 0.0, 0.0], 225.0, 346, 260),
    "121 degrees": ("plumb_bob", [-0.35, 0.12, 0.0, 0.0], 200.0, 640, 480),
    "decentred": ("plumb_bob", [-0.37, 0.12, 3e-3, -2e-3, 1e-3], 200.0, 346, 260),
    "160 degrees": ("equidistant", [-0.1, 0.03, -0.01, 0.002], 600.0, 1280, 720),
    "176 degrees": ("equidistant", [0.0, 0.0, 0.0, 1e-9], 260.0, 640, 480),
}


@pytest.mark.parametrize("name", STRONG)
def test_every_pixel_of_a_strong_lens_is_where_it_is_seen(name):
    camera = with_lens(*STRONG[name])
    refuse_lens_without_inverse(Path("here"), "distortion_params", camera)
    rays = camera.all_directions()
    assert (rays[:, 2] > 0).all()
    seen = camera.distorted(rays[:, :2] / rays[:, 2:]) @ camera.intrinsics[:2, :2].T + camera.intrinsics[:2, 2]
    y, x = np.mgrid[: camera.height, : camera.width]
    np.testing.assert_allclose(seen, np.column_stack([x.ravel(), y.ravel()]), atol=1e-6)
    angle = np.arccos(rays[:, 2]).reshape(camera.height, camera.width)
    middle = angle[camera.height // 2, camera.width // 2 :]
    assert (np.diff(middle) > 0).all()  # no pixel sees what another one does


@pytest.mark.parametrize(
    "lens",
    [
        ("equidistant", [0.01, 0.0, 0.0, 0.0], 200.0, 640, 480),  # 220 degrees
        ("equidistant", [0.0, 0.0, -0.3, 0.0], 200.0, 640, 480),  # turns back
        ("plumb_bob", [-0.35, 0.0, 0.0, 0.0], 200.0, 640, 480),  # what Newton finds lies across the middle
        ("plumb_bob", [1e300, 1e300, 0.0, 0.0], 200.0, 640, 480),
    ],
)
def test_a_lens_that_cannot_be_undone_is_refused(lens):
    says = r"^here: distortion_params: the lens cannot be undone at pixel \(0, 0\): its field of view there is no plane"
    with pytest.raises(InputError, match=says):
        refuse_lens_without_inverse(Path("here"), "distortion_params", with_lens(*lens))


def test_scenes_are_deterministic_and_hdr():
    camera = pinhole(32, 32, 0.6911)
    position, rotation = random_views(4, 1)
    images = procedural(5).render(camera, position, rotation)
    np.testing.assert_array_equal(images, procedural(5).render(camera, position, rotation))
    assert np.abs(images - procedural(6).render(camera, position, rotation)).max() > 0.1
    assert images.max() / images.min() > 100
    assert len(procedural(5).items) >= 5


def test_the_spiral_looks_at_the_scene():
    trajectory = spiral(2.0, 3)
    position, rotation = trajectory.at([0.0, 0.71, 2.0])
    axis = rotation[:, :, 2]
    np.testing.assert_allclose(axis, -position / np.linalg.norm(position, axis=1, keepdims=True), atol=1e-3)
    assert (rotation[:, 2, 1] < 0).all()  # y points down


def test_the_correction_is_found():
    rng = np.random.default_rng(0)
    radiance = rng.uniform(0.02, 2.0, (3, 8, 8, 2))
    exposure = np.array([1.0, 0.5, 1.5])
    a, b, c = np.array([0.7, 1.3]), np.array([0.8, 1.4]), np.array([0.05, 0.1])
    images = exposure[:, None, None, None] * (a * radiance**b - c)
    correction = fit_correction(radiance, images, exposure)
    np.testing.assert_allclose([correction.a, correction.b, correction.c], [a, b, c], rtol=1e-3)
    np.testing.assert_allclose(correction(radiance, exposure), images, atol=1e-4)


@pytest.mark.parametrize("channels", [1, 3])
def test_both_forms_of_the_total_variation_agree_with_their_gradients(channels):
    rng = np.random.default_rng(0)
    values = rng.normal(size=(7, 7, 7, 1 + channels)).astype(np.float32)
    values[2, 3, :, 1] = 0.5  # neighbours alike: no slope
    found, bricks = [], Bricks.every(7)
    for engine in ("compiled", "tensors"):
        grid = torch.tensor(values, requires_grad=True)
        radiance = variation(bricks.gathered(grid), bricks, engine)
        (3.0 * radiance).backward()
        found.append((radiance.detach(), grid.grad))
    for compiled, tensors in zip(*found, strict=True):
        torch.testing.assert_close(compiled, tensors)
    by_hand = [np.abs(np.diff(values[..., 1:].astype(float), axis=axis)).mean() for axis in range(3)]
    assert float(found[0][0]) == pytest.approx(np.sum(by_hand), rel=1e-5)


def test_slopes_of_the_variation_are_those_of_finite_differences():
    """By a dense statement of its own in double precision; the density has none."""
    rng, n = np.random.default_rng(1), 5
    values = rng.normal(0.0, 5.0, size=(n, n, n, 2)).astype(np.float32)

    def by_hand(log_radiance: np.ndarray) -> float:
        return sum(np.abs(np.diff(log_radiance, axis=axis)).mean() for axis in range(3))

    grid, bricks = torch.tensor(values, requires_grad=True), Bricks.every(n)
    variation(bricks.gathered(grid), bricks, "compiled").backward()
    assert grid.grad is not None
    slope, log_radiance = grid.grad[..., 1].numpy(), values[..., 1].astype(float)
    for place in np.ndindex(n, n, n):
        moved = np.zeros_like(log_radiance)
        moved[place] = 1e-4
        difference = (by_hand(log_radiance + moved) - by_hand(log_radiance - moved)) / 2e-4
        assert slope[place] == pytest.approx(difference, abs=1e-6)
    assert not grid.grad[..., 0].any()


def test_the_mean_square_and_its_gradient():
    bricks = Bricks.every(8)
    values = torch.randn(8, 8, 8, 2, 3, generator=torch.Generator().manual_seed(0), requires_grad=True)
    rows = bricks.gathered(values).detach()
    rows[:64] = 0.0
    rows.requires_grad_()
    (4.0 * mean_square(rows, bricks)).backward()
    assert float(mean_square(rows, bricks).detach()) == pytest.approx(float(values.detach().square().mean()), rel=1e-6)
    assert rows.grad is not None
    torch.testing.assert_close(rows.grad, 8.0 * rows.detach() / values.numel())
    assert float(mean_square(torch.zeros(bricks.rows, 1, 0), bricks)) == 0.0
