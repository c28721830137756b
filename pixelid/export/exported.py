"""The parameters of a simulator made from a circuit, with what is lost, as text, JSON or arrays."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from pixelid.export.light import Light
from pixelid.outputs import plain
from pixelid.results import Table

Setting = float | int


@dataclass(frozen=True)
class Entry:
    """One parameter of a simulator.

    Attributes:
        name: As the simulator calls it.
        value: In its unit.
        unit: "" for pure numbers.
        meaning: What it was made from.
    """

    name: str
    value: Setting
    unit: str
    meaning: str


@dataclass(frozen=True)
class Exported:
    """A circuit in another simulator's parameters.

    Attributes:
        target: The simulator, as `--to` names it.
        simulator: Its name, where its source is, and the version that was read.
        model: Name of the circuit.
        light: How images show radiance.
        entries: Its parameters, in its order.
        lost: What it cannot express, one sentence each; empty: nothing.
        usage: How the parameters are handed to it, and what the images must be.
    """

    target: str
    simulator: str
    model: str
    light: Light
    entries: tuple[Entry, ...]
    lost: tuple[str, ...]
    usage: tuple[str, ...]
    provenance: dict[str, Any] = field(default_factory=dict)

    @property
    def parameters(self) -> dict[str, Setting]:
        """Values by name."""
        return {entry.name: entry.value for entry in self.entries}

    def table(self) -> Table:
        """The parameters with units and origin."""
        rows = tuple((e.name, spelt(e.value), e.unit, e.meaning) for e in self.entries)
        headings = ("parameter", "value", "unit", "made from")
        return Table(
            f"{self.model} for {self.simulator}", headings, rows, frozenset({"parameter", "unit", "made from"})
        )

    def remarks(self) -> list[str]:
        """What is stated with the parameters, in the file and on the terminal."""
        head = f"white, 255 grey levels: {self.light.white:g} {self.light.unit}; level: {self.light.level:g}"
        lost = [f"lost: {sentence}" for sentence in self.lost] or ["lost: nothing"]
        return [head, *self.usage, *lost]

    def as_dict(self) -> dict[str, Any]:
        """The content of a JSON export."""
        return {
            "status": "converged",
            "advice": "",
            "to": self.target,
            "simulator": self.simulator,
            "model": self.model,
            "light": {"white": self.light.white, "level": self.light.level, "unit": self.light.unit},
            "parameters": {
                e.name: {"value": e.value, "unit": e.unit, "meaning": e.meaning} for e in self.entries
            },
            "lost": list(self.lost),
            "usage": list(self.usage),
            **self.provenance,
        }  # fmt: skip


def spelt(value: Setting) -> str:
    """A value as simulators read it: whole numbers without a point, others to ten digits."""
    return f"{value:.10g}" if isinstance(value, float) else str(value)


def comments(exported: Exported) -> list[str]:
    """The remarks and the origin of each value as comment lines."""
    made = [f"{e.name}: {e.meaning}{f' [{e.unit}]' if e.unit else ''}" for e in exported.entries]
    lines = [f"{exported.model} for {exported.simulator}", *exported.remarks(), *made]
    return [f"# {' '.join(line.split())}" for line in lines]


def write_json(exported: Exported, path: Path) -> None:
    """The export as JSON."""
    path.write_text(json.dumps(plain(exported.as_dict()), indent=2, ensure_ascii=False) + "\n", encoding="utf-8")


def write_lines(exported: Exported, path: Path, lines: Sequence[str]) -> None:
    """Lines of settings under the comments."""
    path.write_text("\n".join([*comments(exported), "", *lines]) + "\n", encoding="utf-8")


def write_arrays(exported: Exported, path: Path) -> None:
    """The parameters as a NumPy archive; `lost` and `remarks` are text arrays with them."""
    arrays = {e.name: np.array(e.value, dtype=np.int64 if isinstance(e.value, int) else np.float32)
              for e in exported.entries}  # fmt: skip
    words = {"lost": np.array(exported.lost, dtype=str), "remarks": np.array(exported.remarks(), dtype=str)}
    with path.open("wb") as file:
        np.savez(file, allow_pickle=False, **arrays, **words)
