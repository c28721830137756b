"""What a recording's file states, what was inferred of it by which rule, and what its user states instead.

A file leaves things out: the order of its columns, the unit of its times, the size of the sensor, which of several
streams is meant.  `ReadingOptions` states them: in Python, on the command line, or in `NAME.source.toml` next to the
file.  `Source` is the record of how each was settled; it stays with the recording (`attributes["source"]`).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from pixelid.errors import InputError, did_you_mean, shown

ATTRIBUTE = "source"
TIME_UNITS, POLARITIES, CLOCKS = ("s", "ms", "us", "ns"), ("01", "pm1", "swapped"), ("strict", "sort", "split")
OPTION = {"time_unit": "--time-unit s|ms|us|ns", "size": "--size WxH", "columns": "--columns t,x,y,p",
          "polarity": "--polarity 01|pm1|swapped|OFF/ON", "clock": "--clock sort|split", "stream": "--stream NAME",
          "chip": "--chip NAME"}  # fmt: skip
SUBJECT = {"time_unit": "t taken as", "size": "size", "columns": "columns taken as", "polarity": "polarity",
           "stream": "stream", "clock": "clock goes back: stretch"}  # fmt: skip
LARGEST, EMPTY = " from the largest address", ", as there are no events"  # sizes that another recording may extend

# (width, height) of sensors by the beginning of their names: makers' data sheets
SENSOR_SIZES = {
    "DAVIS240": (240, 180), "DAVIS346": (346, 260), "DAVIS640": (640, 480), "DVS128": (128, 128),
    "DVXPLORERLITE": (320, 240), "DVXPLORERMICRO": (640, 480), "DVXPLORER": (640, 480), "ATIS": (304, 240),
    "GEN1": (304, 240), "GEN3": (640, 480), "GEN4": (1280, 720), "IMX636": (1280, 720), "IMX646": (1280, 720),
    "IMX637": (640, 512), "IMX647": (640, 512),
    "GENX320": (320, 320), "EVK4": (1280, 720), "CELEX4": (768, 640), "CELEX5": (1280, 800),
}  # fmt: skip


def size_of_chip(name: str) -> tuple[int, int] | None:
    """(width, height) of a sensor by its name, in any spelling; None where the name is not known."""
    plain = re.sub(r"[^A-Z0-9]", "", name.upper())
    return next((size for key, size in SENSOR_SIZES.items() if plain.startswith(key)), None)


@dataclass(frozen=True)
class ReadingOptions:
    """What a user states of a file; None or empty: what the file says, else what the rules infer.

    Attributes:
        size: (width, height) of the sensor [pixels].
        time_unit: "s", "ms", "us" or "ns".
        columns: names of the columns in their order ("t", "x", "y", "p"; any other name is skipped), or "t=NAME" for
            columns that have names.
        stream: which of several streams, topics or arrays.
        chip: name of the sensor, whose size and address layout are known.
        polarity: "01", "pm1" (−1 is OFF), "swapped" (ON and OFF exchanged), or both codes: "1/2" (2 is ON).
        clock: of times that fall: "strict" refuses, "sort" sorts, "split" or "split:K" reads the K-th stretch.
    """

    size: tuple[int, int] | None = None
    time_unit: str | None = None
    columns: tuple[str, ...] = ()
    stream: str | None = None
    chip: str | None = None
    polarity: str | None = None
    clock: str | None = None

    @classmethod
    def of(cls, values: Mapping[str, Any], where: str = "") -> ReadingOptions:
        """Checked options from words or values by name; what is None or empty is not stated.

        Raises:
            InputError: an unknown name or a value that none of them takes; `where` names the file.
        """
        names, checked = [f.name for f in fields(cls)], {}
        for name, value in values.items():
            if name not in names:
                raise InputError(f"{where}{name}: expected one of {', '.join(names)}{did_you_mean(name, names)}")
            if value is not None and value != "" and value != ():
                checked[name] = _checked(name, value, f"{where}{name.replace('_', '-') if where == '--' else name}")
        return cls(**checked)

    def over(self, other: ReadingOptions) -> ReadingOptions:
        """These options, and another's where these state nothing."""
        return replace(other, **self.as_dict())

    def as_dict(self) -> dict[str, Any]:
        """Those that are stated."""
        return {f.name: value for f in fields(self) if (value := getattr(self, f.name))}


def _checked(name: str, value: Any, where: str) -> Any:
    most_side = 1 << 16
    if name == "size":
        sides = re.fullmatch(r"(\d{1,9})\s*[x×,]\s*(\d{1,9})", value.strip()) if isinstance(value, str) else None
        sides = sides.groups() if sides else value if isinstance(value, list | tuple) else ()
        try:
            width, height = (int(side) for side in sides)
        except (TypeError, ValueError):
            width = height = 0
        if not (0 < width <= most_side and 0 < height <= most_side):
            raise InputError(f"{where}: expected WIDTHxHEIGHT in pixels, as 640x480, found {shown(value)}")
        return width, height
    if name == "columns":
        words = value.split(",") if isinstance(value, str) else value
        if not isinstance(words, list | tuple) or not all(isinstance(word, str) and word.strip() for word in words):
            raise InputError(f"{where}: expected names as t,x,y,p or t=NAME,…, found {shown(value)}")
        letters = [word.partition("=")[0].strip() for word in words]
        if any(letters.count(letter) != 1 for letter in "txyp"):
            raise InputError(f"{where}: expected each of t, x, y, p once, found {shown(','.join(words))}")
        return tuple(word.strip() for word in words)
    if not isinstance(value, str):
        raise InputError(f"{where}: expected text, found {shown(value)}")
    known: tuple[str, ...] = {"time_unit": TIME_UNITS, "polarity": POLARITIES, "clock": CLOCKS}.get(name, ())
    value = value.replace("µ", "u") if name == "time_unit" else value
    ok = value in known or re.fullmatch(
        {"clock": r"split:[1-9]\d{0,5}", "polarity": r"-?\d{1,5}/-?\d{1,5}"}.get(name, "(?!)"), value
    )
    if known and not ok:
        raise InputError(f"{where}: expected {', '.join(known)}, found {shown(value)}{did_you_mean(value, known)}")
    if name == "chip" and size_of_chip(value) is None:
        raise InputError(f"{where}: expected one of {', '.join(SENSOR_SIZES)}, found {shown(value)}")
    return value


@dataclass(frozen=True)
class Source:
    """How everything that a file may leave out was settled.

    Attributes:
        stated: by the user, by the names of `ReadingOptions`.
        inferred: name → (value, the rule in words).
        notes: of events that were lost, sorted or left out.
        streams: those that could be chosen, where there are several.
    """

    stated: dict[str, Any] = field(default_factory=dict)
    inferred: dict[str, tuple[Any, str]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    streams: tuple[str, ...] = ()

    def line(self) -> str:
        """One line of what was inferred and noted; empty where everything was stated."""
        said = [f"{SUBJECT[name]} {_words(value)}{why}" for name, (value, why) in self.inferred.items()]
        return "; ".join([*said, *self.notes])

    def as_dict(self) -> dict[str, Any]:
        """The attribute (docs/formats.md)."""
        inferred = {name: {"value": value, "why": why} for name, (value, why) in self.inferred.items()}
        every = {"stated": self.stated, "inferred": inferred, "notes": list(self.notes), "streams": list(self.streams)}
        return {name: value for name, value in every.items() if value}

    def kept_in(self, attributes: dict[str, Any]) -> dict[str, Any]:
        """A recording's attributes with this on top of what they hold of an earlier file."""
        if not self.as_dict():
            return attributes
        old = Source.from_dict(attributes.get(ATTRIBUTE))
        both = Source({**old.stated, **self.stated}, {**old.inferred, **self.inferred},
                      (*old.notes, *self.notes), self.streams or old.streams)  # fmt: skip
        return {**attributes, ATTRIBUTE: both.as_dict()}

    @classmethod
    def from_dict(cls, value: object) -> Source:
        """Of an attribute; empty where it is none: files are not trusted."""
        try:
            entries: dict[str, Any] = dict(value)  # type: ignore[call-overload]
            inferred = {
                name: (entry["value"], str(entry["why"])) for name, entry in entries.get("inferred", {}).items()
            }
            notes, streams = (tuple(map(str, entries.get(name, ()))) for name in ("notes", "streams"))
            known = {name: entry for name, entry in inferred.items() if name in SUBJECT}
            return cls(dict(entries.get("stated", {})), known, notes, streams)
        except (AttributeError, LookupError, TypeError, ValueError):
            return cls()


def _words(value: Any) -> str:
    if isinstance(value, list | tuple):
        return (" × " if len(value) == 2 and not isinstance(value[0], str) else ", ").join(map(str, value))
    return {"us": "µs", "pm1": "−1/1"}.get(value, str(value))


NOTHING = ReadingOptions()
_STATED: ContextVar[ReadingOptions] = ContextVar("reading options", default=NOTHING)
_SAY: ContextVar[Callable[[str], object] | None] = ContextVar("hears what is inferred", default=None)


@contextmanager
def stating(options: ReadingOptions, printing: Callable[[str], object] | None = None) -> Iterator[None]:
    """Let `options` hold for every file that is opened inside the block, and `printing` show a line of each.

    Args:
        options: over those of a block around this one.
        printing: called with one line of every file of which something was inferred.
    """
    tokens = _STATED.set(options.over(_STATED.get())), _SAY.set(printing)
    try:
        yield
    finally:
        _STATED.reset(tokens[0])
        _SAY.reset(tokens[1])


def say(line: str) -> None:
    """Print a line of what was inferred, where the caller of the readers asks for it."""
    if (printing := _SAY.get()) is not None:
        printing(line)


def announce(path: Path, attributes: Mapping[str, Any], doubts: Callable[[], list[str]] = list) -> None:
    """Print what was inferred of a file, and what speaks against it, where its caller asks for it."""
    if _SAY.get() is not None:
        for line in (Source.from_dict(attributes.get(ATTRIBUTE)).line(), *doubts()):
            if line:
                say(f"{path.name}: {line}")


def options_for(path: Path, options: ReadingOptions | None = None) -> ReadingOptions:
    """What is stated of a file: the caller's options, those of the block around it, those of `NAME.source.toml`.

    Raises:
        InputError: a damaged description, or one of unknown keys.
    """
    from pixelid.documents import read_toml

    stated = (options or ReadingOptions()).over(_STATED.get())
    for file in (path.with_suffix(".source.toml"), path.with_name(f"{path.name}.source.toml")):
        if file.is_file():
            stated = stated.over(ReadingOptions.of(read_toml(file), f"{file}: "))
    return stated
