"""Options that are data: what a field states is what function, command and checks hold a value to."""

from __future__ import annotations

import inspect
from dataclasses import dataclass, fields
from pathlib import Path

import click
import numpy as np
import pytest

import pixelid as px
from pixelid.cli import options as command_line
from pixelid.cli.reconstruct_command import command
from pixelid.errors import InputError
from pixelid.nerf.options import Options
from pixelid.options import Checked, option, options_of


@dataclass(frozen=True)
class Few(Checked):
    place: Path | None = option(None, "Where.")
    way: str = option("on", "Which way.", choices=("on", "off"))
    parts: tuple[str, ...] = option((), "Which parts.", choices=("a", "b"))
    corners: tuple[float, ...] | None = option(None, "Corners.", count=2, low=0.0)
    steps: int | str = option(3, "Steps.", low=1, high=9, word="auto")
    rate: float | None = option(None, "Hz.", above=0.0)
    loud: bool = option(False, "Whether.")
    name: str = option("", "Any text.")
    size: tuple[int, ...] | None = option(None, "Pixels.", low=1, high=9, count=2)


def test_values_are_taken_as_they_are_meant():
    few = Few(place="a/b", parts=["b"], corners=np.array([1, 2]), steps=np.int64(4), rate=1)  # type: ignore[arg-type]
    assert (few.place, few.parts, few.corners, few.steps, few.rate) == (Path("a/b"), ("b",), (1.0, 2.0), 4, 1.0)
    assert [type(value) for value in (few.steps, few.rate)] == [int, float]
    assert Few(steps="auto").steps == "auto"
    assert Few() == Few(place=None, corners=None)


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("place", 3, "a path"), ("way", "up", "on or off"), ("way", None, "on or off"), ("parts", ["c"], "a or b"),
        ("parts", "a", "a list of a, b"), ("corners", (1.0,), "2 numbers"), ("corners", (1.0, -1.0), "at least 0"),
        ("corners", "12", "2 numbers"), ("steps", 0, "from 1 to 9 or 'auto'"), ("steps", "many", "from 1 to 9"),
        ("steps", 2.0, "whole number"), ("steps", True, "whole number"), ("rate", 0.0, "above 0"),
        ("rate", float("nan"), "finite"), ("rate", 10**400, "finite"), ("loud", 1, "True or False"),
        ("name", 3, "text"),
        ("size", (1, 0), "from 1 to 9"), ("size", (1.0, 2.0), "from 1 to 9"), ("size", 3, "2 numbers"),
    ],
)  # fmt: skip
def test_others_are_refused_by_name(name, value, expected):
    with pytest.raises(InputError, match=rf"^{name}: expected .*{expected}"):
        Few(**{name: value})


def test_the_command_line_takes_what_fields_state():
    @click.command()
    @command_line.of(Few)
    def show(asked):
        click.echo(asked)

    def answer(*words: str) -> str:
        from click.testing import CliRunner

        return CliRunner().invoke(show, words).output

    assert answer() == f"{Few()}\n"
    asked = Few(Path("x"), "off", ("a", "b"), (1.0, 2.0), "auto", 2.0, True, "n", (3, 4))
    words = "--place x --way off --parts a --parts b --corners 1 2 --steps auto --rate 2 --loud --name n --size 3 4"
    assert answer(*words.split()) == f"{asked}\n"
    for wrong in ("--way up", "--parts c", "--corners 1 -2", "--steps 10", "--rate 0"):
        assert "Error" in answer(*wrong.split())


def test_function_and_command_of_a_reconstruction_have_every_option():
    shown = inspect.signature(px.reconstruct).parameters
    offered = {parameter.name: parameter for parameter in command.params}
    for of in options_of(Options):
        assert shown[of.name].default == of.default
        assert f"        {of.name}: " in (inspect.getdoc(px.reconstruct) or "").replace("    ", "        ")
        assert of.stated.help
        help = getattr(offered[of.name], "help", "")
        assert help == of.stated.help
    assert [*offered][2 : 2 + len(fields(Options))] == [f.name for f in fields(Options)]
    with pytest.raises(TypeError, match="cell"):
        px.reconstruct("scene", cell=3)
