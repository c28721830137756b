"""Drawings say where their axes are, and which artists belong to which label."""

import html
import json
import re
from pathlib import Path

import browser
import numpy as np
import pytest

from pixelid.figures.style import OFF, ON, legend_above, new_axes, save_figure, styled

MOVE = """(x, y) => {
  const svg = document.querySelector('svg[data-axes]'), [l, t, r, b] = JSON.parse(svg.dataset.axes)[0].box;
  const p = new DOMPoint(l + x * (r - l), b - y * (b - t)).matrixTransform(svg.getScreenCTM());
  svg.dispatchEvent(new PointerEvent('pointermove', { clientX: p.x, clientY: p.y, bubbles: true }));
  return svg.closest('figure').querySelector('output').textContent.split('\\n'); }"""


@styled
def drawn():
    top, bottom = axes = new_axes(2, 1, 6.0, 2.0).ravel()
    x = np.geomspace(1.0, 1000.0, 4)
    for name, colour, size in (("ON", ON, 1.0), ("OFF", OFF, 10.0)):
        top.plot(x, size * x, "o", color=colour, label=name)
        top.plot(x, size * x, color=colour)
        bottom.bar([0, 1], [size, -size], color=colour, label=name)
    top.set(xscale="log", yscale="log", ylabel="rate (1/s)", xlim=(0.1, 1e5), ylim=(0.1, 1e5))
    bottom.set_xticks([0, 1], ["chirp", "steps"])
    legend_above(axes)
    return axes


def marks(path: Path, kind: str) -> list[str]:
    return sorted(n for n in re.findall(rf'id="{kind}-(\d+)\.\d+"', path.read_text()))


def test_axes_and_series_are_in_the_drawing(tmp_path):
    path = save_figure(drawn(), tmp_path / "a.svg")
    again = save_figure(drawn(), tmp_path / "b.svg")
    assert path.read_bytes() == again.read_bytes()
    (attribute,) = re.findall(r'data-axes="([^"]*)"', path.read_text())
    first, second = json.loads(html.unescape(attribute))
    assert first["x"] | {"label": ""} == {"ends": [0.1, 1e5], "scale": "log", "label": ""}
    assert first["y"]["label"] == "rate (1/s)"
    assert second["x"]["names"] == {"0.0": "chirp", "1.0": "steps"}
    assert first["box"][3] < second["box"][1]  # above it
    assert marks(path, "toggle") == ["0", "1"]
    assert marks(path, "series") == ["0"] * 4 + ["1"] * 4  # points, the line of their colour, two bars


@pytest.mark.skipif(browser.EXECUTABLE is None, reason="no Chromium")
def test_a_page_reads_values_and_hides_series(tmp_path):
    from pixelid.report.html import write_report

    data = Path(__file__).resolve().parents[1] / "data" / "fit.json"
    (tmp_path / "fit.json").write_text(data.read_text())
    save_figure(drawn(), tmp_path / "conditions.svg")
    with browser.Browser(tmp_path / "profile") as window:
        window.visit(write_report(tmp_path, command=""), 1200)
        middle = 0.5  # of six decades: 100, and on the line OFF 10 times that
        assert window.evaluate(f"({MOVE})({middle}, {middle} + 1 / 6 + 0.005)") == ["OFF", "100", "rate (1/s): 1000"]
        assert window.evaluate(f"({MOVE})({middle}, 0.9)") == ["100", "rate (1/s): 25120"]
        label = "document.querySelectorAll('[id*=\"toggle-\"]')[1]"
        click = f"{label}.dispatchEvent(new MouseEvent('click', {{ bubbles: true }}))"
        window.evaluate(click)
        assert window.evaluate("document.querySelectorAll('svg [hidden]').length") == 4
        assert window.evaluate(f"({MOVE})({middle}, {middle} + 1 / 6)")[0] == "100"
        window.evaluate(click)
        assert window.evaluate("document.querySelectorAll('svg [hidden]').length") == 0
        assert not window.complaints
