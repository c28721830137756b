"""Every code block of README and docs runs, page by page, in a folder of its own.

Blocks in `sh` and `python` are executed in order; a `toml` block whose first line is `# NAME.toml` becomes that file.
A page with a comment `<!-- slow -->` is part of `make test-all` only.  `<!-- needs the command NAME -->` before a block
leaves it out where there is no such command.
"""

from __future__ import annotations

import importlib
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from pixelid.cli.main import COMMANDS

sybil = pytest.importorskip("sybil")
from sybil.parsers.myst import CodeBlockParser  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]
SOURCES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
PAGES = [path for path in SOURCES if path.exists() and not {"_build", "_generated"} & set(path.parts)]
SHOWN_ONLY = {"text", "json"}  # output, layouts, equations
NEEDS_PUBLIC_NAMES = "<!-- needs the public names -->"
NEEDS_COMMAND = re.compile(r"<!-- needs the command (\w+) -->")
PUBLIC_NAMES = hasattr(importlib.import_module("pixelid"), "find_model")

pytestmark = pytest.mark.skipif(not (ROOT / "docs" / "index.md").exists(), reason="needs a checkout")


def run_shell(example) -> None:
    """Run a block as one script; its output is shown when it fails."""
    needed = NEEDS_COMMAND.fullmatch(comment_before(example))
    if needed and needed[1] not in COMMANDS:
        return
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    environment = os.environ | {
        "PATH": path,
        "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]),
    }
    command = ["bash", "-euo", "pipefail", "-c", str(example.parsed)]
    done = subprocess.run(command, cwd=Path.cwd(), env=environment, text=True, capture_output=True)
    assert done.returncode == 0, f"{where(example)}: exit code {done.returncode}\n{done.stdout}\n{done.stderr}"


def run_python(example) -> None:
    """Run a block in the page's own namespace."""
    if comment_before(example) == NEEDS_PUBLIC_NAMES and not PUBLIC_NAMES:
        return
    code = "\n" * (example.line - 1) + str(example.parsed)
    exec(compile(code, example.path, "exec"), example.namespace)


def write_toml(example) -> None:
    """Check that a block is TOML, and write it to the file that its first line names."""
    text = str(example.parsed)
    tomllib.loads(text)
    if named := re.match(r"# (\S+\.toml)\n", text):
        Path(named[1]).write_text(text)


def where(example) -> str:
    return f"{example.path}:{example.line}"


def comment_before(example) -> str:
    return example.document.text[: example.region.start].rstrip().rpartition("\n")[2]


RUN = {"sh": run_shell, "python": run_python, "toml": write_toml}
PARSER = sybil.Sybil([CodeBlockParser(language, evaluator) for language, evaluator in RUN.items()], pattern="*.md")


def pages() -> list:
    """The pages with blocks that run, slow ones marked."""
    params = []
    for path in PAGES:
        text = path.read_text()
        if re.search(r"^```(sh|python|toml)$", text, re.MULTILINE):
            marks = [pytest.mark.slow] if "<!-- slow -->" in text else []
            params.append(pytest.param(path, id=str(path.relative_to(ROOT)), marks=marks))
    return params


@pytest.mark.parametrize("path", pages())
def test_every_block_runs(path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "agg")
    for example in PARSER.parse(path).examples():
        example.evaluate()


@pytest.mark.parametrize("path", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_blocks_are_of_a_kind_that_runs(path):
    """No block escapes: a language that does not run must be one that is only shown."""
    languages = re.findall(r"^```(\w[\w-]*)", path.read_text(), re.MULTILINE)
    assert set(languages) <= set(RUN) | SHOWN_ONLY
    outside = re.sub(r"^```.*?^```$", "", path.read_text(), flags=re.MULTILINE | re.DOTALL)
    assert not re.search(r"^    (pixelid|python|pip|make) ", outside, re.MULTILINE), "use a fenced block"


@pytest.mark.parametrize("path", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_documents_cited_exist(path):
    """Links to files of the repository lead somewhere."""
    for target in re.findall(r"\]\((?!https?:|#)([^)#]+)", path.read_text()):
        assert (path.parent / target).exists(), f"{path}: {target}"


def test_the_readme_of_the_package_index():
    """It renders there, where there is no repository beside it: nothing in it points to a file."""
    markdown = pytest.importorskip("readme_renderer.markdown")
    pytest.importorskip("hatch_fancy_pypi_readme")
    command = [sys.executable, "-m", "hatchling", "metadata", "readme"]
    text = subprocess.check_output(command, cwd=ROOT, text=True)
    page = markdown.render(text)
    assert page is not None
    assert "The main job" in page
    assert not re.findall(r'(?:src|href)="(?!https://|#)[^"]*"', page)


def test_citation_file():
    """The required keys of the Citation File Format 1.2.0, and the version of the package."""
    import yaml

    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert {"cff-version", "message", "title", "authors"} <= set(citation)
    assert citation["cff-version"] == "1.2.0"
    assert citation["version"] == importlib.import_module("pixelid").__version__
