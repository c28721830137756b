"""Versions and input hashes: complete, stable, and cheap."""

import hashlib
import subprocess
import sys

from pixelid import __version__
from pixelid.cli.main import main
from pixelid.provenance import input_hashes, provenance, versions


def test_versions_name_what_numbers_depend_on():
    stated = versions()
    assert stated["pixelid"] == __version__
    assert {"python", "numpy", "scipy", "numba", "torch", "casadi"} <= set(stated)


def test_inputs_are_hashed_by_name(tmp_path):
    (tmp_path / "a.h5").write_bytes(b"events")
    result = provenance(tmp_path / "a.h5")
    assert set(result) == {"versions", "inputs_sha256"}
    assert result["inputs_sha256"] == {"a.h5": hashlib.sha256(b"events").hexdigest()}


def test_two_inputs_of_one_name_are_both_kept(tmp_path):
    for folder in ("one", "two"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "a.h5").write_text(folder)
    hashes = input_hashes([tmp_path / "one" / "a.h5", tmp_path / "two" / "a.h5", None, tmp_path / "one" / "a.h5"])
    assert len(hashes) == 2
    assert len(set(hashes.values())) == 2


def test_looking_up_versions_imports_none_of_them():
    code = "import sys, pixelid.provenance as p; p.versions(); print(set(sys.modules) & {'numpy', 'torch'})"
    assert subprocess.check_output([sys.executable, "-c", code], text=True).strip() == "set()"


def test_a_result_keeps_the_command_that_made_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["design", "dvs128", "--draws", "1", "--pixels", "1", "--out", "next one", "--quiet"]) == 0
    words = "pixelid design dvs128 --draws 1 --pixels 1 --out 'next one' --quiet"
    assert (tmp_path / "next one" / "command.txt").read_text().strip() == words
    page = (tmp_path / "next one" / "report.html").read_text()
    assert "--draws 1 --pixels 1" in page
    assert "does not record" not in page
    assert main(["report", "next one", "--quiet"]) == 0  # a page made again keeps it
    assert (tmp_path / "next one" / "command.txt").read_text().strip() == words
    (tmp_path / "next one" / "command.txt").unlink()
    assert main(["report", "next one", "--quiet"]) == 0
    assert "does not record" in (tmp_path / "next one" / "report.html").read_text()
