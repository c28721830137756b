"""Prophesee's bias settings next to a recording: `NAME.bias` of every generation, or Metavision Studio's JSON.

194   % bias_diff_off   % v        bias_fo = 1477        {"ll_biases_state": {"bias": [{"name": …, "value": …}]}}
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

MOST_BYTES, MOST_NAME = 1 << 20, 40
BY_PERCENT = re.compile(r"\s*(-?\d{1,9}|0x[0-9a-f]{1,8})\s*%\s*([a-z_]\w*)\s*(?:%.*)?", re.I)
BY_NAME = re.compile(r"\s*%?\s*\"?(\w*bias\w*)\"?\s*[:=,;\s]\s*(-?\d{1,9}|0x[0-9a-f]{1,8})\s*(?:[%#,;].*)?", re.I)


def biases_beside(path: Path) -> dict[str, int]:
    """Biases by name, of the first file next to `path` that holds any; nothing where there is none."""
    for file in (path.with_suffix(".bias"), path.with_name(f"{path.name}.bias"), path.with_suffix(".json")):
        if file.is_file() and (found := _read(file)):
            return found
    return {}


def _read(file: Path) -> dict[str, int]:
    with file.open("rb") as opened:
        text = opened.read(MOST_BYTES).decode("utf-8-sig", "replace")
    try:
        document = json.loads(text)
    except (ValueError, RecursionError):
        return {} if file.suffix == ".json" else _lines(text)
    return dict(_entries(document))


def _lines(text: str) -> dict[str, int]:
    """Lines of value and name, in either order; others are a header."""
    biases = {}
    for line in text.splitlines():
        if found := BY_PERCENT.fullmatch(line):
            biases[found[2][:MOST_NAME]] = _number(found[1])
        elif found := BY_NAME.fullmatch(line):
            biases[found[1][:MOST_NAME]] = _number(found[2])
    return biases


def _number(text: str) -> int:
    return int(text, 16 if text.lower().startswith("0x") else 10)


def _entries(document: Any) -> list[tuple[str, int]]:
    """The biases of Studio's state, or of an object that maps their names to numbers."""
    state = document.get("ll_biases_state", document) if isinstance(document, dict) else {}
    listed = state.get("bias", []) if isinstance(state, dict) else []
    pairs = [(entry.get("name"), entry.get("value")) for entry in listed if isinstance(entry, dict)]
    pairs = pairs or (list(state.items()) if isinstance(state, dict) else [])
    return [(name[:MOST_NAME], value) for name, value in pairs
            if isinstance(name, str) and "bias" in name and type(value) is int]  # fmt: skip
