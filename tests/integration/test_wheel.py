"""The built packages carry the shipped circuits and recipes, and work away from the checkout."""

import os
import subprocess
import sys
import sysconfig
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not (ROOT / "pyproject.toml").is_file(), reason="needs a checkout"),
]


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> Path:
    """A folder with the wheel and the source archive."""
    pytest.importorskip("hatchling")
    folder = tmp_path_factory.mktemp("dist")
    subprocess.run([sys.executable, "-m", "hatchling", "build", "-d", str(folder)], cwd=ROOT, check=True)
    return folder


def only(folder: Path, pattern: str) -> Path:
    (path,) = folder.glob(pattern)
    return path


def shipped() -> set[str]:
    paths = [path for kind in ("models", "fits") for path in (ROOT / kind).rglob("*.toml")]
    return {path.relative_to(ROOT).as_posix() for path in paths}


def bench() -> set[str]:
    """The files of the demo's session: raw events, light traces, the truth."""
    names = {str(path.relative_to(ROOT)) for path in (ROOT / "pixelid" / "demo" / "bench").iterdir()}
    assert "pixelid/demo/bench/truth.json" in names
    return names


def test_the_wheel_carries_models_fits_and_the_demo(built):
    names = set(zipfile.ZipFile(only(built, "*.whl")).namelist())
    assert {f"pixelid/_data/{name}" for name in shipped()} | bench() <= names
    assert any(name.endswith("licenses/LICENSE") for name in names)
    assert not [name for name in names if name.startswith(("tests/", "benchmarks/")) or "__pycache__" in name]


def test_the_source_archive_is_complete(built):
    with tarfile.open(only(built, "*.tar.gz")) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    modules = {str(path.relative_to(ROOT)) for path in (ROOT / "pixelid").rglob("*.py")}
    assert (
        shipped() | bench() | modules | {"LICENSE", "README.md", "pyproject.toml", "constraints.txt", "Makefile"}
        <= names
    )


def test_an_installed_wheel_runs_outside_the_checkout(built, tmp_path):
    """Installed into an empty environment; its dependencies are borrowed from this one, pixelid is not."""
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(tmp_path / "env")], check=True)
    python = tmp_path / "env" / "bin" / "python"
    site = tmp_path / "env" / "lib" / f"python{sys.version_info.major}.{sys.version_info.minor}" / "site-packages"
    install = [sys.executable, "-m", "pip", "--python", str(python), "install", "--no-deps", "--no-index", "--quiet"]
    subprocess.run([*install, str(only(built, "*.whl"))], check=True)
    # a .pth line adds a folder without reading the .pth files in it, so this checkout stays out of sight
    (site / "borrowed.pth").write_text(sysconfig.get_paths()["purelib"] + "\n")

    def run(*words: str) -> str:
        environment = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
        return subprocess.check_output(words, cwd=tmp_path, text=True, env=environment)

    where = run(str(python), "-c", "import pixelid; print(pixelid.__file__)")
    assert Path(where.strip()).is_relative_to(site)
    assert "dvs128" in run(str(tmp_path / "env" / "bin" / "pixelid"), "models", "--quiet").split()
    assert "0.7 A_amp" in run(str(tmp_path / "env" / "bin" / "pixelid"), "models", "dvs128")
