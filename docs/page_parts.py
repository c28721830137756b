"""Tables and numbers of pages made when the site is built."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def table(heads: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    """A Markdown table; pipes in cells are escaped."""
    heads = list(heads)
    lines = [heads, ["---"] * len(heads), *([str(cell).replace("|", "\\|") for cell in row] for row in rows)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def of_json(name: str):
    """The content of a results file, by its path in the repository."""
    return json.loads((ROOT / name).read_text())


def percent(share: float, digits: int = 1) -> str:
    """0.945 → 94.5 %."""
    return f"{100 * share:.{digits}f} %"
