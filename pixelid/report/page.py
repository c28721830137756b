"""What every page has: a kind of result by the JSON that marks it, and a card with a verdict and five numbers."""

from __future__ import annotations

import itertools
import shlex
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pixelid.errors import printable
from pixelid.provenance import COMMAND_FILE

Result = dict[str, Any]

TONES = {
    "converged": "good", "named": "good", "none": "good",
    "misfit": "warn", "at_bound": "warn", "not_identified": "warn", "ambiguous": "warn", "unknown": "warn",
}  # fmt: skip
VERDICTS = {
    "converged": "Converged", "misfit": "Misfit: the model does not describe the data",
    "at_bound": "A parameter sits on its bound", "not_identified": "Not identified", "not_converged": "Not converged",
    "diverged": "Diverged", "interrupted": "Interrupted", "none": "Nothing missing: the model describes the recordings",
    "named": "Missing effect named", "ambiguous": "Several effects explain the data equally well",
    "unknown": "Something is missing that no known effect explains",
}  # fmt: skip


@dataclass(frozen=True)
class Number:
    """One of the numbers on the card."""

    label: str
    value: str
    unit: str = ""


@dataclass(frozen=True)
class Summary:
    """What the card on top says.

    Attributes:
        kind: of the result, as its command is called.
        title: of the page.
        status: the closed word of the JSON; empty where the result has none.
        sentence: what it means here.
        numbers: the five that matter.
        command: how to make it again; empty where the result does not say.
        headline: what stands for the status where there is none.
        healthy: good or warn where there is no status; None says neither.
        next: (what for, command) of what to do with the result.
    """

    kind: str
    title: str
    status: str
    sentence: str
    numbers: tuple[Number, ...]
    command: str
    headline: str = ""
    healthy: bool | None = None
    next: tuple[tuple[str, str], ...] = ()

    @property
    def tone(self) -> str:
        """good, warn, bad or plain: the colour of the card; the words say the same."""
        if self.healthy is not None:
            return "good" if self.healthy else "warn"
        return TONES.get(self.status, "bad" if self.status else "plain")

    @property
    def verdict(self) -> str:
        """The status in words."""
        return self.headline or VERDICTS.get(self.status, self.status.replace("_", " ").capitalize())


@dataclass(frozen=True)
class Page:
    """A kind of result.

    Attributes:
        file: the JSON that marks it.
        template: in `templates/`.
        summarise: (result, folder) → what the card says.
        prepare: (result, folder) → further names for the template.
        like: a kind of result whose figures it shows too, by the name of its JSON.

    The captions of its figures are in `captions.toml`, under the name of the JSON.
    """

    file: str
    template: str
    summarise: Callable[[Result, Path], Summary]
    prepare: Callable[[Result, Path], dict[str, Any]] = lambda result, folder: {}
    like: str = ""


def recorded_command(folder: Path) -> str:
    """The command line kept in a result's folder; empty where there is none."""
    file = folder / COMMAND_FILE
    if not file.is_file() or file.is_symlink():
        return ""
    most_command = 10_000  # bytes shown of a command
    with file.open("rb") as stream:
        return printable(stream.read(most_command).decode("utf-8", errors="replace")).strip()


def command_line(name: str, result: Result, *words: str, out: Path, inputs: bool = True, seed: bool = True) -> str:
    """The command as it was given, where one made the result; else put together from what the result records."""
    if recorded := recorded_command(out):
        return recorded
    files = [f for f in result.get("inputs_sha256", {}) if not f.endswith((".toml", "fit.json"))] if inputs else []
    parts = ["pixelid", name, *files, *words, *(["--seed", str(result["seed"])] if seed and "seed" in result else [])]
    return shlex.join([*parts, "--out", folder_name(out)])


def inputs_of(result: Result, folder: Path) -> str:
    """The recordings of a result as a command names them."""
    words = shlex.split(recorded_command(folder))[2:] if recorded_command(folder) else []
    given = list(itertools.takewhile(lambda word: not word.startswith("-"), words))
    return shlex.join(given or [f for f in result.get("inputs_sha256", {}) if not f.endswith((".toml", "fit.json"))])


def folder_name(out: Path) -> str:
    """The name of a result's folder, also while it is written under a temporary one, `.NAME.random`."""
    name = out.resolve().name
    return (name[1:].rpartition(".")[0] if name.startswith(".") else name) or "out"


def identified(result: Result) -> Number:
    """How many of the free parameters are identified."""
    free = [p for p in result["parameters"].values() if not p.get("fixed")]
    return Number("parameters identified", f"{sum(bool(p['identified']) for p in free)} of {len(free)}")
