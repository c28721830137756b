"""Stimuli by name: a recording's own, a `.toml` description, or a built-in shape.

[stimulus]
kind = "sine"            one of the built-in shapes; the rest are its parameters
level = 24.0
frequency_hz = 10.0
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from pathlib import Path

from pixelid.errors import InputError, did_you_mean
from pixelid.stimuli.shapes import SHAPES
from pixelid.stimuli.stimulus import Stimulus

_WHOLE = {"width", "height", "seed"}


def load_stimulus(spec: str | Path) -> Stimulus:
    """The stimulus of a recording file, a `.toml` description, or a built-in name.

    Raises InputError naming what is wrong, and for unknown names listing the known ones.
    """
    text = str(spec)
    if text in SHAPES:
        return SHAPES[text]()
    path = Path(text)
    if path.suffix == ".toml":
        return _from_toml(path)
    if path.is_file():
        from pixelid.recordings import open_recording

        stimulus = open_recording(path).stimulus
        if stimulus is None:
            raise InputError(f"{path}: this recording has no stimulus")
        return stimulus
    raise InputError(
        f"no stimulus {text!r}: expected a recording, a .toml file, or one of {', '.join(SHAPES)}"
        f"{did_you_mean(text, SHAPES)}"
    )


def shape(kind: str, parameters: Mapping[str, object]) -> Stimulus:
    """A built-in shape with parameters.  Raises InputError for unknown kinds and parameters, listing the known."""
    if kind not in SHAPES:
        raise InputError(f"stimulus kind: expected one of {', '.join(SHAPES)}, found {kind!r}")
    known = inspect.signature(SHAPES[kind]).parameters
    arguments = {}
    for name, value in parameters.items():
        if name not in known:
            raise InputError(f"stimulus {kind} has no parameter {name!r}; it has {', '.join(known)}")
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise InputError(f"stimulus {kind}.{name}: expected a number, found {value!r}")
        if name in _WHOLE and (value != int(value) or value < 0):
            raise InputError(f"stimulus {kind}.{name}: expected a whole number, found {value!r}")
        arguments[name] = int(value) if name in _WHOLE else float(value)
    return SHAPES[kind](**arguments)


def _from_toml(path: Path) -> Stimulus:
    from pixelid.model.files import read_toml

    table = read_toml(path).get("stimulus")
    if not isinstance(table, dict) or not isinstance(table.get("kind"), str):
        raise InputError(f"{path}: expected a [stimulus] table with a kind, one of {', '.join(SHAPES)}")
    try:
        return shape(table["kind"], {name: value for name, value in table.items() if name != "kind"})
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
