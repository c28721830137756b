"""Pages: whole, safe, readable by machines and people, and nothing loaded from elsewhere."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from outline import outline

from pixelid.cli.main import main
from pixelid.figures.style import INK, ON, new_axis, save_figure, styled, without_control_characters
from pixelid.recordings import Events, Recording, write_recording
from pixelid.report import format as formats
from pixelid.report.html import write_report
from pixelid.report.pages import PAGES
from pixelid.report.pictures import read_picture
from pixelid.report.scripts import script


def flicker_like(folder: Path, name: str = "r") -> Path:
    rng = np.random.default_rng(0)
    t = np.sort(rng.integers(0, 10**9, 4000))
    pixel = rng.integers(0, 36, 4000)
    events = Events.from_columns(t, pixel % 6, pixel // 6, rng.integers(0, 2, 4000), 6, 6)
    write_recording(Recording(events), folder / f"{name}.h5")
    return folder / f"{name}.h5"


@pytest.fixture(scope="module")
def inspected(tmp_path_factory):
    folder = tmp_path_factory.mktemp("page")
    assert main(["inspect", str(flicker_like(folder)), "--out", str(folder / "out"), "--quiet"]) == 0
    return folder / "out"


def test_a_page_is_whole_and_loads_nothing(inspected):
    page = (inspected / "report.html").read_text()
    seen = outline(page)
    assert not seen.open
    assert not seen.outside
    assert not seen.mute
    assert "default-src 'none'" in page
    assert page.count("<svg") == 3
    assert page.count("<dt>") == 5
    assert "prefers-color-scheme: dark" in page
    assert 'href="inspect.json"' in page
    assert "pixelid inspect r.h5 --out out --quiet<" in page
    ids = re.findall(r'\bid="([^"]+)"', page)
    assert len(ids) == len(set(ids))


def test_text_of_a_result_cannot_break_out(inspected, tmp_path):
    folder = tmp_path / "out"
    shutil.copytree(inspected, folder)
    result = json.loads((folder / "inspect.json").read_text())
    result["sensor"] = "<script>alert(1)</script>\u0007\x1b[31m\u202eevil\u0000"
    result["name"] = '"><img src=x onerror=alert(1)>'
    (folder / "inspect.json").write_text(json.dumps(result))
    (folder / "rate.svg").write_text(
        '<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" onload="alert(1)">'
        '<script>alert(1)</script><a xlink:href="javascript:alert(1)"><text>here</text></a>'
        '<image xlink:href="https://elsewhere.example/x.png"/><path style="fill: url(https://elsewhere.example/y)"/></svg>'
    )
    page = write_report(folder).read_text()
    for own in (*(f"<script>{script(name).text!s}" for name in ("page", "figures", "events")),
                '<script type="application/json" id="event-data">'):  # fmt: skip
        assert page.count(own) == 1
        page = page.replace(own, "")
    for bad in ("<script", "onload", "onerror=alert(1)>", "javascript:", "elsewhere.example"):
        assert bad not in page.replace("&lt;script", "").replace("src=x onerror=alert(1)&gt;", "")
    assert not re.search(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e]", page)
    assert "&lt;script&gt;" in page


def test_a_broken_drawing_is_said_and_does_not_stop_the_page(inspected, tmp_path):
    folder = tmp_path / "out"
    shutil.copytree(inspected, folder)
    (folder / "rate.svg").write_text("<svg")
    assert "rate.svg is not a drawing" in write_report(folder).read_text()


def test_figures_take_the_colours_of_the_page_and_names_with_dollars(tmp_path):
    @styled
    def draw(axis=None):
        axis = axis if axis is not None else new_axis(3, 2)
        axis.plot([1, 10], [0.1, 1000.0], color=ON)
        axis.set(xscale="log", yscale="log", title="a$b_\x1b[1m")
        return axis

    path = save_figure(draw(), tmp_path / "f.svg")
    again = save_figure(draw(), tmp_path / "g.svg")
    assert path.read_bytes() == again.read_bytes()
    text = path.read_text()
    assert "a$b_[1m" in text
    assert "10³" in text
    assert "mathdefault" not in text
    markup = str(read_picture(path, "caption", 'what "it" shows').markup)
    assert "var(--ink)" in markup
    assert "var(--on)" in markup
    assert INK not in markup
    assert 'aria-label="what &quot;it&quot; shows"' in markup


def test_every_page_has_a_template_and_captions_name_real_kinds():
    import tomllib

    from pixelid.report.html import CAPTIONS, TEMPLATES

    kinds = {Path(page.file).stem for page in PAGES}
    assert all((TEMPLATES / page.template).is_file() for page in PAGES)
    assert set(tomllib.loads(CAPTIONS.read_text())) <= kinds
    assert kinds >= {
        "fit",
        "gap",
        "lowlight",
        "design",
        "rates",
        "flicker",
        "reconstruction",
        "inspect",
        "compare",
        "sensor",
    }


def test_numbers_have_the_digits_that_are_known():
    assert formats.value(1829.3456, (1822.71, 1835.98)) == "1829.3"
    assert formats.value(0.2510, (0.2474, 0.2547)) == "0.251"
    assert formats.number(float("nan")) == "–"
    assert formats.number(-1.5e-7) == "−1.5 × 10⁻⁷"
    assert formats.interval((None, 3.0)) == "–"
    assert formats.seconds(9.5e-5) == "95 µs"
    assert without_control_characters("a\x00b\tc\nd") == "ab\tc\nd"


def test_a_folder_without_a_result_is_one_plain_line(tmp_path, capsys):
    assert main(["report", str(tmp_path)]) == 2
    assert capsys.readouterr().err.count("\n") == 1
