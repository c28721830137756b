"""The benchmark of speed runs in small, its rows have all keys, the page is made of them.  Nothing is timed here."""

import importlib
import json
import math
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = ROOT / "benchmarks" / "speed.py"
KEYS = {
    "section", "path", "size", "item", "items", "clock", "threads", "ours_s", "other", "ratio", "target", "bound",
    "load", "note",
}  # fmt: skip
ROWS = {"filter": 6, "video": 5, "likelihood": 2, "analysis": 3, "rays": 2, "growth": 7, "startup": 2}

pytestmark = pytest.mark.skipif(not SCRIPT.exists(), reason="needs a checkout")


def measure(out, *sections):
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    command = [sys.executable, str(SCRIPT), "--tiny", "--out", str(out), "--only", *sections]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(out.read_text()), done.stdout


def page_of(content):
    sys.path.insert(0, str(ROOT / "docs"))
    speed_page, generate = importlib.import_module("speed_page"), importlib.import_module("generate")
    return speed_page.page(content, generate.table)


@pytest.mark.parametrize(
    "section",
    [pytest.param(name, marks=[pytest.mark.slow] if name not in ("likelihood", "startup") else []) for name in ROWS],
)
def test_a_small_run_of_each_section(section, tmp_path):
    content, _ = measure(tmp_path / "speed.json", section)
    assert len(content["rows"]) == ROWS[section]
    for row in content["rows"]:
        assert set(row) >= KEYS
        assert row["section"] == section
        difference = row["note"].startswith("less")  # of two runs: on tiny files noise
        assert all(math.isfinite(seconds) and (seconds > 0 or difference) for seconds in row["ours_s"])
        assert row["clock"] == ("cpu" if row["threads"] == 1 else "wall")
        if row["other"]:
            assert len(row["other"]["seconds"]) == len(row["ours_s"])
            assert row["ratio"]["least"] <= row["ratio"]["median"] <= row["ratio"]["most"]
        if row["target"]:
            assert set(row["target"]) == {"of", "value", "measured", "met"}
    page = page_of(content)
    assert all(row["path"] in page for row in content["rows"])


def test_what_is_there_is_not_measured_again(tmp_path):
    before, _ = measure(tmp_path / "speed.json", "startup")
    after, said = measure(tmp_path / "speed.json", "startup")
    assert said == ""
    assert before == after
    again, said = measure(tmp_path / "speed.json", "startup", "--again")
    assert len(said.splitlines()) == len(again["rows"]) == len(before["rows"])


def test_the_page_of_what_was_measured():
    content = json.loads((ROOT / "docs" / "speed.json").read_text())
    page = page_of(content)
    for row in content["rows"]:
        assert set(row) >= KEYS
        assert len(row["ours_s"]) == content["runs"] or row["section"] in ("growth", "video", "analysis")
        assert row["path"] in page
    assert {row["section"] for row in content["rows"]} == set(ROWS)
