"""Imports point one way, as docs/architecture.md draws them."""

import ast
from collections.abc import Iterable
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[2] / "pixelid"
BASE = {
    "arrays", "cluster", "delimited", "documents", "errors", "figures", "interruption", "outputs", "parallel",
    "provenance", "results", "statistics", "status", "time_units",
}  # fmt: skip
MAY_IMPORT = {
    "errors": set(),
    "delimited": {"errors"},
    "documents": {"delimited", "errors"},
    "arrays": {"documents", "errors"},
    "cluster": {"arrays", "errors", "outputs", "parallel"},
    "figures": set(),
    "interruption": set(),
    "outputs": {"documents", "errors"},
    "provenance": set(),
    "statistics": set(),
    "status": set(),
    "time_units": set(),
    "results": {"documents", "errors", "outputs", "status"},
    "options": {"errors"},
    "public": {"errors"},
    "parallel": {"errors"},
    "parameters": BASE,
    "stages": BASE | {"parameters"},
    "model": BASE | {"parameters", "stages"},
    "stimuli": BASE | {"stages"},
    "recordings": BASE | {"stimuli"},
    "dynamics": BASE | {"parameters", "stages"},
}
MAY_IMPORT["inputs"] = BASE | {"model", "recordings", "stimuli"}
MAY_IMPORT["compilation"] = set()  # everything else is imported when a function is called
for face in ("api", "api_analyses", "api_models", "api_recordings", "api_scenes", "api_tables"):
    MAY_IMPORT[face] = BASE | {"public"}  # everything else is imported when a function is called
MAY_IMPORT["api_scenes"] |= {"options", "nerf"}  # options are data; no code of the analysis comes with them
MAY_IMPORT["biases"] = {"documents", "errors", "statistics"}
MAY_IMPORT["inspection"] = BASE | {"biases", "recordings", "stimuli"}
MAY_IMPORT["simulate"] = MAY_IMPORT["likelihood"] = set(MAY_IMPORT) - {"inspection"}
MAY_IMPORT["fit"] = MAY_IMPORT["sensors"] = MAY_IMPORT["simulate"] | {"simulate", "likelihood"}
MAY_IMPORT["tables"] = MAY_IMPORT["simulate"] | {"simulate"}  # observation models of tables instead of events
for folder in ("sample", "compare", "lowlight", "design"):  # what follows from a fit
    MAY_IMPORT[folder] = MAY_IMPORT["fit"] | {"fit", "sample"}
for folder in ("lowlight", "design"):
    MAY_IMPORT[folder] = MAY_IMPORT[folder] | {"tables"}  # what tables of latencies and rates say of a sensor
MAY_IMPORT["design"] |= {"lowlight"}  # a chirp goes up to the bandwidth at its level
MAY_IMPORT["gap"] = MAY_IMPORT["fit"] | {"fit", "design", "inspection"}
MAY_IMPORT["conform"] = MAY_IMPORT["gap"] | {"gap"}  # the gap's verdict, effect by effect
MAY_IMPORT["bench"] = MAY_IMPORT["gap"] | {"gap"}  # from raw recordings to a checked model
MAY_IMPORT["export"] = BASE | {"model", "parameters", "stages", "tables"}  # rates of noise
MAY_IMPORT["nerf"] = MAY_IMPORT["fit"] | {"inspection", "options", "sensors"}  # report, demo, cli, face use it
MAY_IMPORT["report"] = set(MAY_IMPORT)
MAY_IMPORT["demo"] = set(MAY_IMPORT)
MAY_IMPORT["cli"] = set(MAY_IMPORT)


# Imports inside functions that point back on purpose: docs/architecture.md says why.
BACK = {
    ("fit", "report"), ("fit", "sample"), ("inspection", "report"), ("recordings", "inspection"),
    ("results", "inputs"), ("results", "report"), ("stimuli", "recordings"), ("tables", "sample"),
}  # fmt: skip
ON_CALL = {"compilation", "public", *(name for name in MAY_IMPORT if name.startswith("api"))}  # import when called
FILES = sorted(PACKAGE.rglob("*.py"))


def home_of(path: Path) -> str:
    """The folder (or lone module) of pixelid that a file belongs to."""
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imported(path: Path, nodes: Iterable[ast.AST]) -> set[str]:
    """Folders (or lone modules) of pixelid that these of a file's nodes import."""
    found: set[str] = set()
    for node in nodes:
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[1] for alias in node.names if alias.name.startswith("pixelid.")}
        elif isinstance(node, ast.ImportFrom) and node.module == "pixelid":
            found |= {alias.name for alias in node.names if not alias.name.startswith("__")}
        elif isinstance(node, ast.ImportFrom) and (node.module or "").startswith("pixelid."):
            found.add(str(node.module).split(".")[1])
        assert not (isinstance(node, ast.ImportFrom) and node.level), f"{path}: relative import"
    return found


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_point_one_way(path):
    home = home_of(path)
    if home.startswith("__"):
        return
    backwards = imported(path, ast.parse(path.read_text()).body) - MAY_IMPORT[home] - {home}
    assert not backwards, f"{home} must not import {backwards}"


def test_imports_inside_functions_that_point_back_are_those_of_the_plan():
    back = set()
    for path in FILES:
        home = home_of(path)
        if not home.startswith("__") and home not in ON_CALL:
            functions = (node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.FunctionDef))
            inside = imported(path, (inner for function in functions for inner in ast.walk(function)))
            back |= {(home, other) for other in inside - MAY_IMPORT[home] - {home}}
    assert back == BACK


def test_every_folder_is_on_the_plan():
    folders = {path.name for path in PACKAGE.iterdir() if (path / "__init__.py").is_file()}
    assert folders <= set(MAY_IMPORT)
    plan = (PACKAGE.parent / "docs" / "architecture.md").read_text()
    for folder in folders:
        assert f"`{folder}/`" in plan
