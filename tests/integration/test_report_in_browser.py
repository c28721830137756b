"""Reports as a browser shows them: nothing to complain about, nothing asked from elsewhere, whole on a phone."""

import shutil
from pathlib import Path

import browser
import numpy as np
import pytest

from pixelid.cli.main import main
from pixelid.figures.style import new_axis, save_figure, styled
from pixelid.recordings import Events, Recording, write_recording
from pixelid.report.html import write_report

DATA = Path(__file__).resolve().parents[1] / "data"
WIDTHS = (1280, 768, 390)

pytestmark = pytest.mark.skipif(
    browser.EXECUTABLE is None, reason="no Chromium: install chromium (Debian) to look at the reports"
)


@pytest.fixture(scope="module")
def window(tmp_path_factory):
    with browser.Browser(tmp_path_factory.mktemp("profile")) as opened:
        yield opened


@styled
def _any_figure(axis=None):
    axis = axis if axis is not None else new_axis(8, 3)
    axis.plot([0, 1], [0, 1])
    axis.set(xlabel="time (s)", ylabel="events per second")
    return axis


def of_document(folder: Path, kind: str) -> Path:
    """The page of a result of `tests/data`, with figures of every name that its kind knows."""
    folder.mkdir()
    shutil.copy(DATA / f"{kind}.json", folder)
    for name in {"fit": ("conditions", "residuals", "corner"), "gap": ("map", "forest", "edges", "unknown")}[kind]:
        save_figure(_any_figure(), folder / f"{name}.svg")
    return write_report(folder)


def of_recording(folder: Path) -> Path:
    rng = np.random.default_rng(0)
    t = np.sort(rng.integers(0, 10**9, 2000))
    pixel = rng.integers(0, 36, 2000)
    events = Events.from_columns(t, pixel % 6, pixel // 6, rng.integers(0, 2, 2000), 6, 6)
    name = "a_recording_with_a_name_that_is_longer_than_any_telephone_is_wide_and_has_no_place_to_break_it"
    file = folder.with_name(f"{name}.h5")
    write_recording(Recording(events), file)
    assert main(["inspect", str(file), "--out", str(folder), "--quiet"]) == 0
    return folder / "report.html"


def of_still_scene(folder: Path) -> Path:
    rng = np.random.default_rng(1)
    for polarity in ("pos", "neg"):
        below = np.cumsum(rng.poisson(0.4, (40, 72)), axis=1)  # pixels, edges of 1/interval: as the files have them
        below[:, -1] = 0
        np.save(folder.with_name(f"n_{polarity}_0.1lux.npy"), below)
    files = [str(folder.with_name(f"n_{polarity}_0.1lux.npy")) for polarity in ("pos", "neg")]
    assert main(["inspect", *files, "--out", str(folder), "--quiet"]) == 0
    return folder / "report.html"


SMALLEST_TEXT_PX = 9.0
# the texts of drawings as large as they are on the screen: [pixels, text] of the smallest
SMALLEST_TEXT = """(() => {
  const shown = t => t.getClientRects().length && t.textContent.trim();
  const size = t => parseFloat(getComputedStyle(t).fontSize) * Math.hypot(t.getScreenCTM().a, t.getScreenCTM().b);
  const texts = [...document.querySelectorAll('svg text')].filter(shown).map(t => [size(t), t.textContent]);
  return texts.sort((a, b) => a[0] - b[0])[0];
})()"""


def look(window: browser.Browser, page: Path) -> None:
    """What must hold of a page at every width, by day and by night."""
    for width in WIDTHS:
        for dark in (False, True):
            window.visit(page, width, dark=dark)
            assert not window.complaints, (width, window.complaints)
            assert {address.partition(":")[0] for address in window.requests} <= {"file", "data"}, window.requests
            assert not window.sticking_out(), (width, window.sticking_out())
        size, text = window.evaluate(SMALLEST_TEXT) or (SMALLEST_TEXT_PX, "")
        assert size >= SMALLEST_TEXT_PX, (width, text)
    paper = window.evaluate("getComputedStyle(document.body).backgroundColor")
    window.visit(page, WIDTHS[0])
    assert window.evaluate("getComputedStyle(document.body).backgroundColor") != paper  # there is a dark one
    assert window.evaluate("document.querySelectorAll('.card dt').length") == 5
    assert window.evaluate("document.querySelectorAll('.card .again pre').length") == 1
    assert window.evaluate("[...document.querySelectorAll('figure svg')].every(s => s.getAttribute('aria-label'))")


@pytest.mark.parametrize("kind", ["fit", "gap", "recording", "still scene"])
def test_a_page_reads_everywhere(window, tmp_path, kind):
    folder = tmp_path / "out"
    made = {"recording": of_recording, "still scene": of_still_scene}
    page = made[kind](folder) if kind in made else of_document(folder, kind)
    look(window, page)


def test_the_page_of_a_calibration_reads_everywhere(window, calibration):
    page = calibration[1] / "report.html"
    look(window, page)
    window.visit(page, 1200)
    assert window.evaluate("document.querySelectorAll('button.copy:not([hidden])').length") == 5
    window.evaluate("document.querySelector('button.copy').click()")
    window.visit(page, 390)
    assert window.evaluate("getComputedStyle(document.querySelector('svg.pixel.wide')).display") == "none"


def test_what_is_wrong_is_seen(window, tmp_path):
    """The looker itself: an element too wide, a request, and an error are found."""
    page = tmp_path / "report.html"
    page.write_text(
        '<!doctype html><body><div class="wide" style="width: 900px">x</div>'
        '<img src="http://localhost:9/x.png"><script>console.error("no")</script></body>'
    )
    window.visit(page, 390)
    assert any("wide" in found for found in window.sticking_out())
    assert any(address.startswith("http:") for address in window.requests)
    assert window.complaints


@pytest.mark.slow
def test_the_page_of_every_command_reads_everywhere(window, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("session").mkdir()
    words = ["--with", "leak:rate_hz=5", "--pixels", "9", "--sensor-seed", "1", "--quiet"]
    for light in ("chirp", "steps"):
        assert main(["simulate", "dvs128", "--stimulus", light, *words, "--out", f"session/{light}.h5"]) == 0
    for command in (
        ["fit", "session", "--model", "dvs128"],
        ["gap", "session", "--model", "dvs128"],
        ["compare", "session", "--model", "dvs128", "--model", "photoreceptor"],
        ["sensor", "session", "--model", "dvs128"],
        ["lowlight", "dvs128"],
        ["design", "dvs128"],
        ["inspect", "session/chirp.h5"],
    ):
        assert main([*command, "--out", f"out_{command[0]}", "--quiet"]) in (0, 1)
        look(window, Path(f"out_{command[0]}/report.html"))
