"""The times of a table of light: seconds in any unit, dates, times of day, or samples that are counted.

A column whose unit is stated nowhere is in seconds, if its times have fractions and are less than a second apart.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from pixelid.documents import interpreting, words_of
from pixelid.errors import InputError, shown
from pixelid.time_units import SECONDS, SECONDS_PER, UNIT_OF, unit_in, with_unit

TIME_WORDS = ("t", "time", "timestamp", "seconds", "second", "x")
# Words in the name of a column of times that are no unit.
BESIDE_TIME = (
    "time", "t", "stamp", "timestamp", "since", "start", "of", "the", "in", "from", "elapsed", "relative", "rel", "abs",
    "absolute", "0", "zero", "clock", "axis", "value", "unit", "units", "camera", "sensor", "light", "photodiode",
    "led", "trigger",
)  # fmt: skip
DATE = re.compile(
    r"(?:(?:(?P<year>\d{4})-(?P<month>\d\d)-(?P<day>\d\d)|(?P<d>\d\d)\.(?P<m>\d\d)\.(?P<y>\d{4}))[ T])?"
    r"(?P<clock>\d\d:\d\d:\d\d)(?:[.,](?P<rest>\d{1,9}))?(?:Z|[+-]\d\d:?\d\d)?"
)
SETTING = re.compile(r"\b(t0|tInc)\s*[=:]\s*([-+]?[\d.]+(?:[eE][-+]?\d+)?)")
WAY = '; state it in {}: time_unit = "s", "ms", "us" or "ns"'


def states_time(name: str) -> bool:
    """Whether a column's name states a unit of time, in brackets or behind `in`: `Zeit [s]`."""
    return with_unit(name)[1] is not None and not re.search(r"_\w+$", name.strip())


def seconds(
    numbers: np.ndarray,
    name: str,
    comments: str,
    stated: str | None,
    say: Callable[[str], object],
    path: Path,
    place: str = "NAME.source.toml",
) -> np.ndarray:
    """(rows,) seconds of a column of numbers.

    Args:
        numbers: (rows,) of the column.
        name: of the column.
        comments: of the table.
        stated: a unit, by the user.
        say: called with what is inferred, in a line.
        path: named in errors.
        place: where the unit can be stated.

    Raises:
        InputError: a unit that is none of time, or one that must be stated.
    """
    if stated:
        return numbers * SECONDS_PER[stated]
    words = words_of(name)
    units = [UNIT_OF[word] for word in (*words[1:], *words[:1]) if word in UNIT_OF and (len(word) > 1 or words[1:])]
    unit = with_unit(name)[1] or (units[0] if units else None) or unit_in(comments)
    unknown = [word for word in words[1:] if word not in UNIT_OF and word not in BESIDE_TIME]
    if unit is None and unknown and words[0] in TIME_WORDS:
        raise InputError(
            f"{path}: unit of the times: expected s, ms, us, ns or min, found {shown(unknown[0], 30)}"
            f"{WAY.format(place)}"
        )
    return numbers * SECONDS[unit] if unit else _inferred(numbers, name, say, path, place)


def _inferred(numbers: np.ndarray, name: str, say: Callable[[str], object], path: Path, place: str) -> np.ndarray:
    """Seconds, where nothing else is likely.  Raises InputError elsewhere."""
    finite = numbers[np.isfinite(numbers)]  # others are refused with the light
    step = float(np.median(np.diff(finite))) if len(finite) > 1 else 0.0
    # Between samples whose unit is not stated: light is rarely measured as slowly, times in ms often are
    long_step_s = 1.0
    if step >= long_step_s:
        found = "whole numbers" if np.all(numbers == np.rint(numbers)) else f"steps of {step:g}"
        raise InputError(f"{path}: unit of the times not stated, found {found}: s, or ms or us{WAY.format(place)}")
    say(f"{path.name}: {name or 'time'} taken as s: no unit stated, {step:g} apart")
    return numbers


def of_dates(cells: Sequence[str], path: Path) -> np.ndarray:
    """(rows,) seconds since the first of dates, or of times of one day."""
    with interpreting(path, "a date and time in every row"):
        found = [match.groupdict() for cell in cells if (match := DATE.fullmatch(cell))]
        if len(found) != len(cells):
            raise ValueError("others")
        texts = [f"{f['year'] or f['y'] or '2000'}-{f['month'] or f['m'] or '01'}-{f['day'] or f['d'] or '01'}"
                 f"T{f['clock']}.{f['rest'] or '0'}" for f in found]  # fmt: skip
        dates = np.array(texts, "datetime64[ns]")
    return (dates - dates[0]).astype(np.int64) * 1e-9


def counted(head: Sequence[Sequence[str]]) -> tuple[float, float] | None:
    """Start and increment [s] of samples that are counted, as some oscilloscopes state in their header."""
    for names, values in pairwise(head):
        places = {name.strip().lower(): place for place, name in enumerate(names)}
        if {"start", "increment"} <= set(places) and max(places["start"], places["increment"]) < len(values):
            start, increment = _float(values[places["start"]]), _float(values[places["increment"]])
            if 0 < increment < np.inf:
                return start, increment
    found = dict(SETTING.findall(" ".join(cell for row in head for cell in row)))
    start, increment = _float(found.get("t0", "")), _float(found.get("tInc", ""))
    return (start, increment) if 0 < increment < np.inf else None


def _float(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return float("nan")
