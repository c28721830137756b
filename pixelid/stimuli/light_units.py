"""Units of light in the names and comments of a table: `radiance_lux`, `irradiance [W/m²]`, `C1 in V`, `# unit: fA`."""

from __future__ import annotations

import re
from pathlib import Path

from pixelid.documents import words_of
from pixelid.errors import InputError, shown
from pixelid.stimuli.stimulus import UNITS as USUAL
from pixelid.time_units import UNIT_OF, plain

# Words behind a column's name that are a unit; another may be a part of the name.
UNITS = (*USUAL, "klux", "cd/m2", "W", "mW", "uW", "nW", "W/cm2", "mW/cm2", "uW/cm2", "V", "mV", "A", "mA", "uA", "nA",
         "pA", "counts", "DN", "photons/s")  # fmt: skip
LIGHT_WORDS = "radiance", "irradiance", "illuminance", "light", "photodiode", "luminance", "intensity", "lux"
UNIT_WORDS = {
    **{unit.lower(): unit for unit in UNITS}, "lx": "lux", "klx": "klux", "w/m²": "W/m2", "w/m^2": "W/m2",
    "w_m2": "W/m2", "wm2": "W/m2", "volt": "V", "volts": "V", "µa": "uA", "µw": "uW", "ampere": "A", "cd/m²": "cd/m2",
    "µw/cm²": "uW/cm2", "µw/cm2": "uW/cm2", "mw/cm²": "mW/cm2", "w/cm²": "W/cm2", "count": "counts", "adu": "DN",
}  # fmt: skip
NO_UNIT = ("", "au", "a.u.", "arb", "arb.", "1", "-", "norm", "normalised", "normalized")
IN_BRACKETS = re.compile(r"[\[(]\s*([^\])]+?)\s*[\])]|\bin\s+(\S+)$")
SUFFIX = re.compile(r"_([^\W\d_][\w/²^]*)$")
SETTING = re.compile(r"(vertical|y|v)[ _-]?units?", re.I)  # of an oscilloscope's header: the unit of its channel


def is_unit(cell: str) -> bool:
    """Whether a cell is a unit of light or of time, or says that there is none."""
    word = plain(cell.strip().strip("()[]"))
    return word in UNIT_OF or word in UNIT_WORDS or word in NO_UNIT


def bracketed(name: str) -> str | None:
    """What stands in brackets, or behind `in`, of a column's name."""
    found = IN_BRACKETS.search(name.strip())
    return plain(found[1] or found[2]) if found else None


def has_unit_of_light(name: str) -> bool:
    """Whether a column's name states a unit of light in brackets or behind `in`."""
    return bracketed(name) in UNIT_WORDS


def unit_of_light(name: str, comments: str, head: list[list[str]], path: Path) -> str:
    """The unit of a column of light: in its name, a comment or an oscilloscope's settings; else "relative".

    Raises:
        InputError: the name states one that is not known.
    """
    bracket, suffix = bracketed(name), SUFFIX.search(name.strip())
    for word in (bracket, plain(suffix[1]) if suffix else None):
        if word in NO_UNIT:
            return "relative"
        if word in UNIT_WORDS:
            return UNIT_WORDS[word]
        if word is not None and word is bracket:
            raise InputError(f"{path}: unit of the light: expected one of {', '.join(UNITS)}, found {shown(bracket)}")
    named = unit_in(name) or unit_in(" ".join(re.findall(r"unit\s*[:=]\s*(\S+)", comments, re.I)))
    if named is None and suffix and words_of(name)[0] in LIGHT_WORDS:
        raise InputError(
            f"{path}: unit of the light: {shown(suffix[1])} of {shown(name)} is none of {', '.join(UNITS)}; "
            'state it in NAME.source.toml: unit = "relative"'
        )
    settings = (UNIT_WORDS.get(plain(row[1])) for row in head if len(row) > 1 and SETTING.fullmatch(row[0]))
    return named or next(filter(None, settings), "relative")


def unit_in(text: str) -> str | None:
    """A unit among the words of a text."""
    text = text.lower()
    for word, unit in UNIT_WORDS.items():
        if len(word) > 1 and re.search(rf"(^|[^a-z/]){re.escape(word)}($|[^a-z0-9²/])", text):
            return unit
    return None
