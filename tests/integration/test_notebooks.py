"""The notebooks run from a clean kernel, from first to last cell, and are stored small, with their figures."""

import re
from pathlib import Path

import nbformat
import pytest

NOTEBOOKS = Path(__file__).resolve().parents[2] / "notebooks"
QUICK = ("gauge.ipynb",)
SLOW = ("calibrate.ipynb", "hidden_effect.ipynb", "reconstruction.ipynb")
LARGEST_OUTPUT = 140_000  # characters of base64: 100 kB of picture
LIMIT_S = 900  # for a loaded machine; the longest takes three and a half minutes on two idle cores


def execute(name: str, folder: Path) -> nbformat.NotebookNode:
    """The notebook after a run in a kernel of its own, in an empty folder."""
    from nbclient import NotebookClient

    notebook = nbformat.read(NOTEBOOKS / name, as_version=4)
    client = NotebookClient(notebook, timeout=LIMIT_S, kernel_name="python3", resources={"metadata": {"path": folder}})
    return client.execute()


def printed(notebook: nbformat.NotebookNode) -> str:
    """What its cells have printed."""
    outputs = (output for cell in notebook.cells for output in cell.get("outputs", []))
    return "".join(output.get("text", "") for output in outputs if output.output_type == "stream")


def shown(notebook: nbformat.NotebookNode) -> list[str]:
    """The results that its cells end with, as text."""
    outputs = (output for cell in notebook.cells for output in cell.get("outputs", []))
    return [output.data["text/plain"] for output in outputs if "text/html" in output.get("data", {})]


def known(table: str, name: str) -> bool:
    """Whether a fit's table calls a parameter known within so many per cent."""
    return "known within" in next(line for line in table.splitlines() if line.startswith(f"{name} "))


def figures(notebook: nbformat.NotebookNode) -> list[str]:
    """The pictures among its outputs, base64."""
    outputs = (output for cell in notebook.cells for output in cell.get("outputs", []))
    return [output.data["image/png"] for output in outputs if "image/png" in output.get("data", {})]


def test_every_notebook_is_run_by_a_test():
    assert {path.name for path in NOTEBOOKS.glob("*.ipynb")} == {*QUICK, *SLOW}


@pytest.mark.parametrize("name", [*QUICK, *SLOW])
def test_stored_outputs_are_small_and_hold_the_figures(name):
    notebook = nbformat.read(NOTEBOOKS / name, as_version=4)
    nbformat.validate(notebook)
    assert figures(notebook)
    assert all(len(figure) < LARGEST_OUTPUT for figure in figures(notebook))
    errors = [o for cell in notebook.cells for o in cell.get("outputs", []) if o.output_type == "error"]
    assert not errors


def test_gauge_shows_flat_directions_and_sharp_invariants(tmp_path):
    text = printed(execute("gauge.ipynb", tmp_path))
    assert "6 unknowns, 4 statements (3 invariants, q_in), rank 4" in text
    assert "flat directions: []" in text


@pytest.mark.slow
def test_calibration_recovers_the_camera_and_says_what_it_cannot(tmp_path):
    session, posterior, gentle = (text for text in shown(execute("calibrate.ipynb", tmp_path)) if "of dvs128" in text)
    for name in ("alpha", "beta", "gamma"):
        assert known(session, name)
        assert not known(gentle, name)
    assert posterior.startswith("posterior of dvs128: converged")


@pytest.mark.slow
def test_the_hidden_effect_is_found_and_without_its_name_unknown(tmp_path):
    text = printed(execute("hidden_effect.ipynb", tmp_path))
    assert "NAMED" in text
    assert "UNKNOWN" in text


@pytest.mark.slow
def test_a_reconstruction_gains_by_its_pixel(tmp_path):
    text = printed(execute("reconstruction.ipynb", tmp_path))
    psnr = [float(value) for value in re.findall(r"([\d.]+) dB", text)]  # none, nominal, fitted: 19.6, 22.7, 24.7 seen
    assert psnr[2] > psnr[1] + 0.5
    assert psnr[2] > psnr[0] + 2.0
