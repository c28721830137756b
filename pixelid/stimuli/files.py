"""Stimuli by name: a recording's own, measured light, a `.toml` description, or a built-in shape.

    [stimulus]
    kind = "sine"            one of the built-in shapes; the rest are its parameters
    level = 24.0
    frequency_hz = 10.0
    start_s = 0.2            when it begins (0 if left out)

or `kind = "samples"` with lists `t` (seconds) and `radiance`, or `kind = "file"` with the `path` of a table, array,
video or folder of frames next to the description.  Both take `unit`; frames also `fps`, `gamma`, `interpolation`,
`full_scale`, `background` (`frames.py`), tables `columns` (`light_tables.py`), both `time_unit`.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from pixelid.documents import interpreting, is_number, read_toml
from pixelid.errors import InputError, did_you_mean, shown
from pixelid.stimuli.frames import VIDEOS, FrameOptions, holds_pictures
from pixelid.stimuli.light_tables import Stated, is_light_table, is_text
from pixelid.stimuli.pixel_lights import Light
from pixelid.stimuli.sampled import TABLES, read_light
from pixelid.stimuli.shapes import SHAPES
from pixelid.stimuli.stimulus import Stimulus

_WHOLE = {"width", "height", "seed"}


def load_stimulus(spec: str | Path, also: Sequence[str] = ()) -> Light:
    """The stimulus of a recording file, a `.toml` description, or a built-in name.

    Raises InputError naming what is wrong, and for unknown names listing the known ones, with what the caller takes
    `also`.
    """
    text = str(spec)
    if text in SHAPES:
        return SHAPES[text]()
    path = Path(text)
    suffix = path.suffix.lower()
    if not path.exists():
        names = (*SHAPES, *also)
        known = f"a recording, a light trace, a .toml file, or one of {', '.join(names)}"
        raise InputError(f"no stimulus {text!r}: expected {known}{did_you_mean(text, names)}")
    if suffix == ".toml":
        return _from_toml(path)
    if not path.is_dir() and not path.is_file():
        raise InputError(f"{path}: expected a regular file, found a device, pipe or socket")
    if path.is_dir() and not holds_pictures(path):
        raise InputError(f"no stimulus {text!r}: expected a file, or a folder of pictures")
    if path.is_dir() or suffix == ".npy" or suffix in VIDEOS:
        return read_light(path)
    if ((suffix in TABLES or is_text(path)) and is_light_table(path)) or (suffix == ".npz" and _holds_light(path)):
        return read_light(path)
    from pixelid.recordings import open_recording

    stimulus = open_recording(path).stimulus
    if stimulus is None:
        raise InputError(f"{path}: this recording has no stimulus")
    return stimulus


def _holds_light(path: Path) -> bool:
    """Whether an archive holds light over time, not events."""
    import zipfile

    try:
        with zipfile.ZipFile(path) as archive:
            names = {name.removesuffix(".npy") for name in archive.namelist()}
    except Exception:  # zipfile raises many kinds for damaged archives; the reader says what is wrong
        return False
    return "radiance" in names and "x" not in names


def shape_parameters(kind: str) -> dict[str, float]:
    """The parameters of a built-in shape, with their defaults."""
    return {name: p.default for name, p in inspect.signature(SHAPES[kind]).parameters.items()}


def shape(kind: str, parameters: Mapping[str, object]) -> Stimulus:
    """A built-in shape with parameters.  Raises InputError for unknown kinds and parameters, listing the known."""
    if kind not in SHAPES:
        meant = did_you_mean(kind, SHAPES)
        raise InputError(f"stimulus kind: expected one of {', '.join(SHAPES)}, found {shown(kind)}{meant}")
    known = inspect.signature(SHAPES[kind]).parameters
    arguments = {}
    for name, value in parameters.items():
        if name not in known:
            meant = did_you_mean(name, known)
            raise InputError(f"stimulus {kind} has no parameter {shown(name)}; it has {', '.join(known)}{meant}")
        if not is_number(value):
            raise InputError(f"stimulus {kind}.{name}: expected a number, found {shown(value)}")
        if name in _WHOLE and not (0 <= value < 1 << 63 and value == int(value)):
            raise InputError(f"stimulus {kind}.{name}: expected a whole number, found {shown(value)}")
        arguments[name] = int(value) if name in _WHOLE else float(value)
    with np.errstate(all="ignore"), interpreting(f"stimulus {kind}", "numbers that make light"):
        return SHAPES[kind](**arguments)  # what overflows is refused as infinite


def _from_toml(path: Path) -> Stimulus:
    table = read_toml(path).get("stimulus")
    kinds = ", ".join((*SHAPES, "samples", "file"))
    if not isinstance(table, dict) or not isinstance(table.get("kind"), str):
        raise InputError(f"{path}: expected a [stimulus] table with a kind, one of {kinds}")
    values = {name: value for name, value in table.items() if name not in ("kind", "start_s")}
    start = table.get("start_s", 0.0)
    if not is_number(start) or not abs(start) < 1e9:
        raise InputError(f"{path}: start_s: expected a number, found {shown(start)}")
    try:
        if table["kind"] == "samples":
            stimulus = _samples(values)
        elif table["kind"] == "file":
            stimulus = _file(values, path.parent)
        else:
            stimulus = shape(table["kind"], values)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    return stimulus.shifted(float(start)) if start else stimulus


def _samples(values: dict) -> Stimulus:
    _refuse_others(values, ("t", "radiance", "unit", "interpolation"))
    lists = [values.get(name, []) for name in ("t", "radiance")]
    t, radiance = columns = [np.asarray(x if _numbers(x) else "no numbers") for x in lists]
    for name, column in zip(("t", "radiance"), columns, strict=True):
        if column.dtype.kind not in "fiu" or column.ndim != 1:
            raise InputError(f"stimulus samples.{name}: expected a list of numbers")
    unit, between = _text(values, "unit", "relative"), _text(values, "interpolation", "linear")
    return Stimulus.from_arrays(t, radiance, unit, between)


def _numbers(values: object) -> bool:
    return isinstance(values, list) and all(map(is_number, values))


def _text(values: dict, name: str, default: str) -> str:
    value = values.get(name, default)
    if not isinstance(value, str):
        raise InputError(f"stimulus.{name}: expected text, found {shown(value)}")
    return value


def _file(values: dict, folder: Path) -> Stimulus:
    of_frames = ("fps", "gamma", "interpolation", "full_scale", "background")
    _refuse_others(values, ("path", "unit", "time_unit", "columns", *of_frames))
    if not isinstance(values.get("path"), str):
        raise InputError("stimulus file.path: expected the name of a table, array, video or folder of frames")
    file = folder / values["path"]
    if not file.exists():
        raise InputError(f"stimulus file.path: {file} does not exist")
    for name in ("fps", "full_scale"):
        if name in values and not is_number(values[name]):
            raise InputError(f"stimulus file.{name}: expected a number, found {shown(values[name])}")
    words = {name: _text(values, name, "") for name in ("gamma", "interpolation", "background", "time_unit")}
    given = {name: values[name] for name in (*of_frames, "time_unit") if name in values}
    of_table = not (file.is_dir() or file.suffix.lower() in VIDEOS)
    if of_table and any(name in values for name in of_frames):
        raise InputError(f"stimulus file: {', '.join(of_frames)}: expected frames, found {file.name}")
    frames = FrameOptions(**{**given, **{name: word for name, word in words.items() if word}}) if not of_table else None
    return read_light(
        file, unit=_text(values, "unit", "") or None, frames=frames, table=Stated.of(values, "stimulus file")
    )


def _refuse_others(values: dict, known: tuple[str, ...]) -> None:
    for name in values:
        if name not in known:
            found = f"{shown(name)}; it has {', '.join(known)}{did_you_mean(name, known)}"
            raise InputError(f"stimulus has no entry {found}")
