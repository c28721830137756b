"""The page of a reconstructed scene: its renderer against ours, its events, and its flight in a browser."""

import json
import shutil
import subprocess

import browser
import numpy as np
import pytest
import torch
from scipy.ndimage import binary_erosion
from test_nerf_shown import CENTRE, RADIUS, ball, content

import pixelid as px
from pixelid.cli.main import main
from pixelid.nerf.data.camera import Camera, pinhole
from pixelid.nerf.shown.evaluate import render_views
from pixelid.nerf.shown.saved import SavedReconstruction
from pixelid.nerf.shown.ways import Way
from pixelid.report import scene_view
from pixelid.report.html import TEMPLATES

NODE = shutil.which("node")
WIDTH, HEIGHT = 240, 180


@pytest.fixture
def folder(tmp_path):
    SavedReconstruction(content(True), ball(1)).save(tmp_path / "scene")
    return tmp_path / "scene"


def in_node(page: str, expression: str):
    """An expression over `splats` and `head` of a page, with the functions of scene.js."""
    parts = {name: page.partition(f'id="{name}">')[2].partition("</script>")[0] for name in ("scene", "splats")}
    code = f"""const {{ unpack, cameraOf, render, eventsOf }} = require({json.dumps(str(TEMPLATES / "scene.js"))});
      const head = {parts["scene"]}, splats = unpack(head, Uint8Array.from(Buffer.from("{parts["splats"]}", "base64")));
      process.stdout.write(JSON.stringify((() => {{ {expression} }})()));"""
    return json.loads(subprocess.check_output([str(NODE), "-"], input=code, text=True))


@pytest.mark.skipif(NODE is None, reason="no node")
def test_a_picture_is_that_of_the_renderer(folder):
    """Blended splats against the march through the field: light, and distance to the ball where the ball is."""
    seen = in_node(scene_view.scene_page(folder), f"""
      const focal = 0.5 * {WIDTH} / Math.tan(head.fov / 2), camera = cameraOf(head.start);
      const {{ light, depth }} = render(splats, camera, {WIDTH}, {HEIGHT}, focal);
      return {{ camera, focal, light: [...light], depth: [...depth] }};""")  # fmt: skip
    camera = seen["camera"]
    axes = np.array([camera[name] for name in ("right", "down", "forward")]).T
    np.testing.assert_allclose(axes.T @ axes, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1.0)
    here = np.array(camera["position"])
    model: Camera = pinhole(WIDTH, HEIGHT, scene_view.FIELD_OF_VIEW)
    assert seen["focal"] == pytest.approx(model.intrinsics[0, 0])
    way = Way(here[None], axes[None], model, ("a",))
    from pixelid.nerf.shown.frames import view_of

    saved = SavedReconstruction.load(folder)
    with torch.no_grad():
        truth = render_views(saved.field, view_of(way, 0, 1), np.zeros(1))[0][..., 0]
    light = np.array(seen["light"]).reshape(HEIGHT, WIDTH)
    error, own = np.abs(light - truth), np.abs(truth - 0.3) > 0.01
    cell = int(np.ceil(seen["focal"] * 2.0 / 32 / np.linalg.norm(CENTRE - here)))  # pixels: the rim is so much wider
    inside, outside = (binary_erosion(part, iterations=2 * cell, border_value=1) for part in (own, ~own))
    assert min(inside.sum(), outside.sum()) > 1000
    assert error[inside].max() < 0.03  # of radiances from 0.3 to 0.6
    assert error[outside].max() < 0.01
    depth = np.array([np.nan if d is None else d for d in seen["depth"]]).reshape(HEIGHT, WIDTH)
    middle = CENTRE - here
    u, v = (seen["focal"] * (middle @ axes[:, k]) / (middle @ axes[:, 2]) for k in (0, 1))
    nearest = depth[int(HEIGHT / 2 + v), int(WIDTH / 2 + u)]
    assert nearest == pytest.approx(middle @ axes[:, 2] - RADIUS, abs=1.5 * 2.0 / 32)  # cells


@pytest.mark.skipif(NODE is None, reason="no node")
def test_events_are_whole_thresholds_of_change(folder):
    counts, reference = in_node(scene_view.scene_page(folder), """
      const reference = Float32Array.from([0, 0, 0, 0]);
      const counts = eventsOf([1, Math.exp(0.65), Math.exp(-0.45), Math.exp(0.1)], reference, 0.3, 0.2, 0);
      return [[...counts], [...reference]];""")  # fmt: skip
    assert counts == [0, 2, -2, 0]
    np.testing.assert_allclose(reference, [0, 0.6, -0.4, 0], atol=1e-6)


def test_many_splats_are_thinned_and_widened(folder, monkeypatch):
    monkeypatch.setattr(scene_view, "MOST_SPLATS", 500)
    page = scene_view.scene_page(folder)
    head = json.loads(page.partition('id="scene">')[2].partition("</script>")[0])
    assert head["count"] == 500
    assert "500 of " in page
    assert "times as wide" in page


def test_a_page_from_the_command_line_and_from_python(folder, tmp_path, capsys):
    assert main(["view", str(folder), "--out", str(tmp_path / "scene.html")]) == 0
    assert capsys.readouterr().out.strip() == str(tmp_path / "scene.html")
    assert px.view(folder, tmp_path / "again.html").read_text() == (tmp_path / "scene.html").read_text()
    assert len((tmp_path / "scene.html").read_bytes()) < 3e6
    assert main(["view", str(folder), "--with", "leak", "--out", str(tmp_path / "other.html")]) == 2
    assert "change a pixel" in capsys.readouterr().err


@pytest.mark.skipif(browser.EXECUTABLE is None, reason="no Chromium")
def test_one_flies_through_the_scene(folder, tmp_path):
    page = px.view(folder, tmp_path / "scene.html")
    shown = "['view', 'depth', 'events'].map(id => element(id).toDataURL())"
    with browser.Browser(tmp_path / "profile") as window:
        for width in (1280, 768, 390):
            for dark in (False, True):
                window.visit(page, width, dark=dark)
                assert not window.complaints
                assert [address.partition(":")[0] for address in window.requests] == ["file"]
                assert not window.sticking_out()
        window.evaluate("still(); reset(); draw()")
        before = window.evaluate(shown)
        window.evaluate("for (let k = 0; k < 6; k++) { step('right', 0.05 * head.distance); draw(); }")
        assert all(one != other for one, other in zip(before, window.evaluate(shown), strict=True))
        assert window.evaluate("total") > 100
        window.evaluate("element('reset').click(); draw()")
        assert window.evaluate(shown)[:2] == before[:2]
        assert not window.complaints
