"""Pages answer in their titles, and the commands that they recommend are commands with these options."""

import json
import re
import shlex
from html import unescape
from pathlib import Path

import click
import pytest

from pixelid.cli.main import cli
from pixelid.report.html import write_report

DATA = Path(__file__).resolve().parents[1] / "data"
DOCUMENTS = sorted([*DATA.glob("*.json"), *(DATA / "results").glob("*.json")])


@pytest.fixture(params=DOCUMENTS, ids=lambda path: path.stem)
def page(request, tmp_path) -> str:
    folder = tmp_path / "a result"
    folder.mkdir()
    (folder / request.param.name).write_text(request.param.read_text())
    return write_report(folder, command="").read_text()


def title_of(page: str) -> str:
    return unescape(re.search(r"<h1>(.*?)</h1>", page).group(1))


def page_of(folder: Path, file: str, **changed) -> str:
    (folder / file).write_text(json.dumps(json.loads((DATA / file).read_text()) | changed))
    return write_report(folder, command="").read_text()


def check_understood(line: str) -> None:
    """The command is there, and has the options."""
    _, name, *words = shlex.split(line)
    command = cli.get_command(click.Context(cli), name)
    assert command is not None, line
    known = {option for parameter in command.params for option in parameter.opts}
    assert {word for word in words if word.startswith("--")} <= known, line


def test_commands_are_understood(page):
    lines = [unescape(text) for text in re.findall(r"<pre[^>]*>(pixelid .*?)</pre>", page, re.DOTALL)]
    assert lines
    for line in lines:
        check_understood(line)


def test_an_option_that_is_not_there_is_found():
    with pytest.raises(AssertionError):
        check_understood("pixelid render scene --orbit 60")


def test_the_title_of_a_gap_has_effect_strength_and_interval(tmp_path):
    assert title_of(page_of(tmp_path, "gap.json")) == "Missing effect: leak, 3.1 (2.8 to 3.4)"
    unknown = page_of(tmp_path, "gap.json", effects=[], verdict="unknown")
    assert title_of(unknown) == "Something is missing that no known effect explains"


@pytest.mark.parametrize(
    ("status", "start"),
    [("converged", "Usable: "), ("not_identified", "Usable in part: "), ("misfit", "Not usable as it is: ")],
)
def test_the_title_of_a_fit_is_whether_it_can_be_used(tmp_path, status, start):
    title = title_of(page_of(tmp_path, "fit.json", status=status))
    assert title == f"{start}8 of 10 parameters identified"
