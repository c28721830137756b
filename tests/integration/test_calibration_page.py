"""The page of a calibration, of a small session in which the camera has a leak that the start model lacks."""

import base64
import hashlib
import json
import re
import shutil

import pytest
from outline import outline, texts

from pixelid.report.html import write_report
from pixelid.report.quantities import STAGES


@pytest.fixture
def calibrated(calibration):
    """The folder of the calibration."""
    return calibration[1]


@pytest.fixture
def page(calibrated) -> str:
    return (calibrated / "report.html").read_text()


@pytest.fixture
def result(calibrated) -> dict:
    return json.loads((calibrated / "calibration.json").read_text())


def changed(calibrated, tmp_path, **entries) -> str:
    """The page with entries of the JSON replaced."""
    folder = tmp_path / "camera"
    shutil.copytree(calibrated, folder)
    document = json.loads((folder / "calibration.json").read_text()) | entries
    (folder / "calibration.json").write_text(json.dumps(document))
    return write_report(folder, command="").read_text()


def test_it_is_whole_small_and_loads_nothing(page):
    seen = outline(page)
    assert not seen.open
    assert not seen.outside
    assert not seen.mute
    assert len(page) < 3e6
    ids = re.findall(r'\bid="([^"]+)"', page)
    assert len(ids) == len(set(ids))
    inside = re.findall(r'href="#([\w-]+)"', page)
    assert {"pixel", "intervals", "recordings", "residuals", "next", "cite"} <= set(inside) & set(ids)


def test_only_its_own_scripts_may_run(page):
    scripts = re.findall(r"<script>(.*?)</script>", page, re.DOTALL)
    assert len(scripts) == 2
    digests = [base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() for script in scripts]
    assert "script-src " + " ".join(f"'sha256-{digest}'" for digest in digests) + '"' in page


def test_the_title_is_the_answer(page, result):
    assert re.search(r"<h1>(.*?)</h1>", page).group(1) == result["sentence"]
    assert "leak" in result["sentence"]


def test_the_pixel_is_drawn_with_every_parameter(page, result):
    drawings = texts(page, "pixel")
    assert len(drawings) == 2  # wide and narrow
    for drawing in drawings:
        assert all(title in drawing for title in STAGES.values())
        for name in ("α", "β", "γ", "ON threshold", "dead time", "added: leak"):
            assert name in drawing
    assert "not identified" not in drawings[0]


def test_what_is_not_identified_is_grey(result, calibrated, tmp_path):
    cutoff = {**result["parameters"]["diff_cutoff_hz"], "identified": False, "interval_95": [9e3, None]}
    open_page = changed(calibrated, tmp_path, parameters={**result["parameters"], "diff_cutoff_hz": cutoff})
    assert texts(open_page, "pixel")[0].count("not identified") == 2  # in its line, and where the mouse hovers
    row = next(text for text in texts(open_page, "row") if "diff" in text)
    assert "not identified" in row
    assert "Not identified: f_diff" in open_page  # in the methods paragraph


def test_intervals_are_relative_to_the_start(calibrated, page, result, tmp_path):
    from pixelid.report.forest import forest

    assert result["start"].keys() == {n for n in result["parameters"] if n in result["start"]}
    alpha = result["parameters"]["alpha"]
    drawn = forest(result["parameters"], result["start"], {"alpha": alpha["value"]}, ["leak"])
    rows = {row.quantity.parameter: row for row, _ in drawn.rows}
    assert rows["alpha"].at == pytest.approx(alpha["value"] / result["start"]["alpha"])
    assert rows["alpha"].truth == pytest.approx(rows["alpha"].at)
    assert rows["leak.rate_hz"].at == 1.0
    assert rows["leak.rate_hz"].start is None
    assert "truth.json" not in page.split("<footer>")[0]
    shutil.copytree(calibrated, tmp_path / "known")
    (tmp_path / "known" / "truth.json").write_text(json.dumps({"alpha": alpha["value"], "effects": {"leak": 4.0}}))
    known = write_report(tmp_path / "known", command="").read_text()
    assert known.count('class="truth"') == 2


def test_recordings_have_a_light_curve_and_a_verdict(page, result, calibrated, tmp_path):
    cards = texts(page, "recording")
    assert len(cards) == len(result["recordings"])
    assert all("events/s" in card and "offset from the chosen start" in card for card in cards)
    assert all("The light starts at" in card for card in cards)
    first = result["recordings"][0]
    statement = {
        "statement": "level", "recording": first["name"], "stated": 1.0, "found": 1.6, "interval_95": [1.5, 1.7],
        "sentence": f"{first['name']}: the light is 1.6 times what was stated (1.5 to 1.7): wrong filter?",
    }  # fmt: skip
    unused = {**result["recordings"][1], "used": False, "why": "the events follow neither this nor another light"}
    rows = [first, unused, *result["recordings"][2:]]
    doubted = changed(calibrated, tmp_path, bench=[statement], recordings=rows)
    assert [card.split("used")[0].split()[-1] for card in texts(doubted, "recording")][1] == "not"
    assert "used, see remark" in texts(doubted, "recording")[0]
    assert "wrong filter? The fit uses the level found." in texts(doubted, "contradicted")[0]
    assert not texts(page, "contradicted")


def test_statements_of_a_kind_stand_together(calibrated, tmp_path):
    level = {"statement": "level", "stated": 1.0, "found": 1.6, "interval_95": [1.5, 1.7]}
    many = [level | {"recording": f"r{k}", "sentence": f"r{k}: the light is 1.6 times"} for k in range(5)]
    text = texts(changed(calibrated, tmp_path, bench=many), "contradicted")[0]
    assert text.count("The fit uses the level found") == 1
    assert "2 more of this kind" in text
    assert all(f"r{k}:" in text for k in range(5))


def test_residuals_before_and_after_have_one_scale(calibrated):
    text = (calibrated / "residuals.svg").read_text()
    assert ">before: dvs128<" in text
    assert ">after: dvs128 + leak<" in text


def test_the_axes_of_before_and_after_agree(calibration):
    from pixelid.bench.figures import draw_before_after

    axes = draw_before_after(calibration[0], calibration[0].recordings)
    for before, after in axes.T:
        assert before.get_xlim() == after.get_xlim()
        assert before.get_ylim() == after.get_ylim()


def test_what_comes_next_can_be_copied_and_downloaded(page, calibrated, result):
    for command in ("pixelid design camera", "pixelid export camera --to v2e", "pixelid lowlight camera"):
        assert command in page
    assert page.count('<button class="copy"') == 5
    for name in ("model.toml", "calibration.json"):
        data = re.search(rf'download="{name}" href="data:[\w/]+;base64,([\w+/=]+)"', page).group(1)
        assert base64.b64decode(data) == (calibrated / name).read_bytes()
    assert "@inproceedings{low2024deblur" in page
    assert f"({result['events']} events of {result['pixels']} pixels)" in page.replace("\N{NARROW NO-BREAK SPACE}", "")


def test_texts_cannot_break_out(calibrated, tmp_path):
    bad = '"><img src=x onerror=alert(1)><script>alert(1)</script>'
    page = changed(calibrated, tmp_path, sentence=bad, notes=[bad], unit=bad, base=bad)
    assert "<img" not in page
    assert page.count("<script>") == 2
    assert len(outline(page).open) == 0


def test_report_makes_it_again(calibrated, tmp_path):
    from pixelid.cli.main import main

    shutil.copytree(calibrated, tmp_path / "camera")
    before = (tmp_path / "camera" / "report.html").read_text()
    assert main(["report", str(tmp_path / "camera"), "--quiet"]) == 0
    assert (tmp_path / "camera" / "report.html").read_text() == before
