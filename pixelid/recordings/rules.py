"""The rules by which what a file does not state is inferred; where two readings are possible and matter, they refuse.

- Columns without names are in the one order that is consistent: p a polarity, whole x and y below 65536, x before y
  unless only the other fits the sensor, and t that increases (`t x y p` of most, Metavision's `x y p t`, …).
- Times that are whole numbers, however written, are microseconds, if they span a millisecond and are no denser than
  events are; with decimal fractions they are seconds, if two events lie nearer than 0.001 or all within 100.  Whole
  thousands, and fractions of whole thousandths, may be counts of another clock.
- Polarities 0 and 1 are OFF and ON, and so are −1 and 1.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import permutations
from typing import Any

import numpy as np

from pixelid.errors import InputError, shown
from pixelid.recordings.source import OPTION, ReadingOptions
from pixelid.time_units import TIMES, with_unit

NAMES = {
    "t": TIMES,
    "x": ("x", "xs", "col", "column", "x_pos", "x_coordinate", "x_coord", "coord_x", "pixel_x", "x_pixel", "px",
          "pix_x", "x_addr", "addr_x", "x_address", "u"),
    "y": ("y", "ys", "row", "y_pos", "y_coordinate", "y_coord", "coord_y", "pixel_y", "y_pixel", "py",
          "pix_y", "y_addr", "addr_y", "y_address", "v"),
    "p": ("p", "ps", "pol", "pols", "polarity", "polarities", "on", "is_on", "on_off"),
}  # fmt: skip
IN_PIXELS = re.compile(r"(\w+?)(?:\s*[\[(]\s*|_)(?:px|pix|pixels?)[\])]?")  # x [px]
WORDS = {"on": 1, "off": 0, "+": 1, "-": 0, "pos": 1, "neg": 0, "positive": 1, "negative": 0, "true": 1, "false": 0,
         "t": 1, "f": 0, "up": 1, "down": 0, "brighter": 1, "darker": 0, "increase": 1, "decrease": 0}  # fmt: skip
ORDERS = [o for o in map("".join, permutations("txyp")) if o.index("x") < o.index("y")]  # nobody writes y x
ROWS = 1 << 12  # of columns without names, by which their order is inferred
ENOUGH = 16  # events or distinct times that show something: all on a grid by chance in 1000⁻¹⁵
SHORT_TICKS, FULL = 100_000, 0.5  # and of a tenth of a second few hold so many events that half of the µs are taken
# Times with fractions: nearer than a nanosecond, were they µs; so few µs hold no recording.
NEAR, SHORT = 1e-3, 100.0
TALL = 0.9  # columns over rows, of addresses that may be exchanged: sensors are as wide as high at least
FALLS_KEPT, SHOWN_STREAMS = 1000, 8


def column_name(name: str) -> tuple[str, str | None]:
    """A column's plain name, and the unit that it states: `t [µs]` → t, us; `x [px]` → x."""
    name, unit = with_unit(name.partition("@")[0])  # faery writes x@346
    if unit is None and (found := IN_PIXELS.fullmatch(name)):
        name = found[1]
    return name, unit


def is_whole(times: np.ndarray) -> bool:
    """Whether times are counts of a clock, as a layout whose unit is known has them; fractions are of another unit."""
    return times.dtype.kind in "iu" or (times.dtype.kind == "f" and bool(np.all(times == np.rint(times))))


def numbers_of_words(column: np.ndarray) -> np.ndarray:
    """(n,) polarities from a column of words, ON and OFF, + and −; any other column as it is."""
    if column.dtype.kind not in "OU" or not {str(word).strip().lower() for word in column[:ROWS]} <= set(WORDS):
        return column
    values = [WORDS.get(str(word).strip().lower()) for word in column]
    return column if None in values else np.array(values, np.uint8)


def named_columns(names: Sequence[str], columns: Sequence[str] = ()) -> tuple[list[int] | None, str | None]:
    """Where t, x, y, p are among named columns, and the unit that the name of t states.

    Args:
        names: of the columns in the file.
        columns: as `ReadingOptions.columns` states them.

    Returns:
        Indices, or None where any is missing; the unit or None.
    """
    shared = names[0][: names[0].rfind("_") + 1] if names else ""  # events_t, events_x, …
    shared = shared if all(name.startswith(shared) for name in names) else ""
    plain = [column_name(name.removeprefix(shared)) for name in names]
    place: list[int | None] = []
    for letter in "txyp":
        stated = next((k for k, word in enumerate(columns) if word.partition("=")[0].strip() == letter), None)
        if stated is None:
            found = sorted((NAMES[letter].index(name), k) for k, (name, _) in enumerate(plain) if name in NAMES[letter])
            place.append(found[0][1] if found and (letter != "t" or len(found) == 1) else None)  # times of two clocks
        elif "=" not in columns[stated]:
            place.append(stated if stated < len(names) else None)
        else:
            word = columns[stated].partition("=")[2].strip()
            found = [k for k, name in enumerate(names) if name.strip() == word or plain[k][0] == word.lower()]
            number = int(word) if word.isdecimal() and len(word) < 6 else -1
            place.append(found[0] if found else number if 0 <= number < len(names) else None)
    if any(k is None for k in place):
        return None, None
    order = [k for k in place if k is not None]
    return order, plain[order[0]][1]


def chosen_name(filled: Sequence[str], every: Sequence[str], options: ReadingOptions, where: str) -> str:
    """The stream that is stated, by its name or a part of its path; else the only one with events, else the first.

    Args:
        filled: streams with events.
        every: all streams, one at least.
        options: what the user states.
        where: named in errors.

    Raises:
        InputError: one must be stated, or another is.
    """
    wanted = options.stream
    if wanted is not None:
        parts = {part for part in wanted.split("/") if part}
        found = [name for name in every if name == wanted] or [n for n in every if parts <= set(n.split("/"))]
        if len(found) != 1 or not parts:
            raise InputError(f"{where}: --stream: expected one of {_listed(every)}, found {shown(wanted)}")
        return found[0]
    if len(filled) > 1:
        raise InputError(f"{where}: several streams of events: {_listed(filled)}; {OPTION['stream']}")
    return (filled or every)[0]


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:SHOWN_STREAMS]) + (" …" if len(names) > SHOWN_STREAMS else "")


def infer_order(
    sample: Sequence[np.ndarray], where: str, size: tuple[int | None, int | None] | None = None
) -> tuple[list[int], tuple[list[str], str]]:
    """Where t, x, y, p are among four columns without names.

    Args:
        sample: the first rows of each.
        where: named in errors.
        size: (width, height) of the sensor, as far as it is stated.

    Returns:
        Indices of t, x, y, p; the order in letters and why.

    Raises:
        InputError: no order is consistent, or several are.
    """
    if len(sample) != 4:
        raise InputError(f"{where}: expected four columns, or their names, found {len(sample)}; {_way('columns')}")
    for column in sample:
        if column.dtype.kind not in "iufb":
            raise InputError(f"{where}: expected lines of t x y p, found {shown(str(column[0]), 30)}")
    possible = [order for order in ORDERS if _is_consistent(order, sample)]
    rising = [order for order in possible if _rises(sample[order.index("t")])]
    fitting = rising or possible
    if len(fitting) != 1:
        listed = " or ".join(" ".join(order) for order in fitting[:3])
        found = f"{listed} are possible" if fitting else "no order of t, x, y, p fits"
        falls = "" if rising else ", and none has times that never fall: --clock sort, too"
        raise InputError(f"{where}: columns without names: {found}; {_way('columns')}{falls}")
    order, why = _by_shape(fitting[0], sample, size or (None, None), where)
    return [order.index(letter) for letter in "txyp"], (list(order), why)


def _by_shape(order: str, sample: Sequence[np.ndarray], size: tuple[int | None, int | None], where: str):
    """The order, or the one with rows before columns where only that fits the sensor; and why.

    Raises:
        InputError: addresses that are higher than wide, on a sensor whose size is not stated.
    """
    wide, high = (int(sample[order.index(letter)].max()) + 1 for letter in "xy")
    exchanged = order.translate(str.maketrans("xy", "yx"))
    if size[0] and size[1]:
        if (wide > size[0] or high > size[1]) and high <= size[0] and wide <= size[1]:
            return exchanged, f": the only order within {size[0]} × {size[1]}"
    elif wide < TALL * high and all(len(np.unique(sample[order.index(letter)])) >= ENOUGH for letter in "xy"):
        raise InputError(
            f"{where}: columns without names: {' '.join(order)} or {' '.join(exchanged)} are possible, as the first "
            f"addresses reach {wide - 1}, the second {high - 1}; {_way('columns')}"
        )
    return order, ": the only order that fits, x before y"


def _is_consistent(order: str, sample: Sequence[np.ndarray]) -> bool:
    p, *addresses = (sample[order.index(letter)] for letter in "pxy")
    codes = set(np.unique(p).tolist()) if len(p) else set()
    most_address = 1 << 16
    whole = all(np.all((a >= 0) & (a < most_address) & (a == np.rint(a))) for a in addresses)
    return whole and (codes <= {0, 1} or codes <= {-1, 1} or codes <= {-1, 0, 1})


def _rises(t: np.ndarray) -> bool:
    return len(t) > 1 and bool(np.all(t[1:] >= t[:-1])) and bool(t[-1] > t[0])


@dataclass
class Statistics:
    """What the rules look at, of all events of a file, block by block.

    Attributes:
        falls: indices of events that are earlier than the one before, the first `FALLS_KEPT`.
        spacing: of floating times as large as the largest, in their unit.
    """

    events: int = 0
    low: float = np.inf
    high: float = -np.inf
    last: Any = None
    floating: bool = False
    spacing: float = 0.0
    whole: bool = True
    on_grid: bool = True
    distinct: int = 0
    least_step: float = np.inf
    fall_count: int = 0
    falls: list[int] = field(default_factory=list)
    side: tuple[int, int] = (0, 0)
    least: tuple[float, float] = (np.inf, np.inf)
    codes: set[float] = field(default_factory=set)

    def add(self, t: np.ndarray, x: np.ndarray, y: np.ndarray, p: np.ndarray, where: str) -> None:
        """Take in a block that follows those before."""
        if not len(t) == len(x) == len(y) == len(p):
            raise InputError(f"{where}: t, x, y, p must have one length, found {len(t)}, {len(x)}, {len(y)}, {len(p)}")
        if not len(t):
            return
        for name, column in zip("txyp", (t, x, y, p), strict=True):
            if column.dtype.kind not in "iufb":
                found = f"{shown(str(column[0]), 30)}; write numbers, or state another column: {OPTION['columns']}"
                raise InputError(f"{where}/{name}: expected numbers, found {found}")
        if t.dtype.kind == "u":  # differences of unsigned numbers do not fall
            t = t.astype(np.int64 if t.max() < 1 << 63 else np.float64)
        steps = np.diff(t, prepend=t[0] if self.last is None else self.last)
        fallen = np.flatnonzero(steps < 0)
        self.falls += (self.events + fallen[: FALLS_KEPT - len(self.falls)]).tolist()
        self.fall_count += len(fallen)
        risen = steps[steps > 0]
        self.least_step = min(self.least_step, float(risen.min()) if len(risen) else np.inf)
        self.distinct += len(risen)
        if t.dtype.kind == "f":
            self.floating = True
            self.spacing = max(self.spacing, float(np.spacing(np.abs(t).max())))
            self.whole &= bool(np.all(t == np.rint(t)))
        self.on_grid &= _all_on_grid(t, self.whole)
        self.low, self.high = min(self.low, float(t.min())), max(self.high, float(t.max()))
        self.side = (
            max(self.side[0], int(np.nan_to_num(x.max())) + 1),
            max(self.side[1], int(np.nan_to_num(y.max())) + 1),
        )
        self.least = min(self.least[0], float(x.min())), min(self.least[1], float(y.min()))
        self.codes |= set(np.unique(p).tolist()[:10])
        self.events, self.last = self.events + len(t), t[-1]


def _all_on_grid(t: np.ndarray, whole: bool) -> bool:
    """Whether all times are whole thousands, or with fractions whole thousandths."""
    if whole:
        return bool(np.all(t % 1000 == 0))
    thousandths = t * 1000.0
    return bool(np.all(np.abs(thousandths - np.rint(thousandths)) <= 4 * np.spacing(np.abs(thousandths))))


def infer_unit(s: Statistics, where: str) -> tuple[str, str]:
    """The unit of times that none states, and why.

    Raises:
        InputError: two readings are possible.
    """
    gridded = s.on_grid and s.distinct >= ENOUGH
    most_per_tick = 10  # events a µs, on average: the fastest readouts do so in bursts
    least_ticks = 1000  # of whole numbers: so few µs hold no recording
    if s.whole:
        if gridded:
            raise _two_readings(where, "whole thousands", "µs of a millisecond clock or ns of a microsecond clock")
        if s.high >= 9.2e15:
            raise _two_readings(where, f"numbers up to {s.high:g}", "no µs that fit 64 bits in nanoseconds")
        ticks = s.high - s.low + 1
        if s.events >= ENOUGH and s.distinct and (ticks < least_ticks or s.events > most_per_tick * ticks):
            found = f"{s.events} events within {s.high - s.low:g}"
            raise _two_readings(where, found, "ms or s, as no recording is so short or dense in µs")
        if s.events >= ENOUGH and ticks < SHORT_TICKS and s.distinct > FULL * ticks:
            raise _two_readings(where, f"{s.events} events within {s.high - s.low:g}", "ms, or µs of a full readout")
        return "us", ": whole numbers"
    if gridded:
        raise _two_readings(where, "whole thousandths", "s of a millisecond clock or ms of a microsecond clock")
    if s.least_step >= NEAR and s.high - s.low >= SHORT:
        raise _two_readings(where, f"decimal fractions, {s.high - s.low:g} long", "s of a slow recording, or ms or µs")
    return "s", ": decimal fractions"


def _two_readings(where: str, found: str, readings: str) -> InputError:
    return InputError(f"{where}/t: unit not stated, found {found}: {readings}; {_way('time_unit')}")


def infer_polarity(codes: set[float], where: str) -> str:
    """The code of polarities that none states: "01" or "pm1".

    Raises:
        InputError: other numbers than 0 and 1, or −1 and 1.
    """
    if codes <= {0, 1}:
        return "01"
    if codes <= {-1, 1}:
        return "pm1"
    raise InputError(
        f"{where}/p: polarity must be 1 (ON) or 0 (OFF), or 1 and −1, found {shown(sorted(codes))}; remove the events "
        f"that are neither, or {_way('polarity')}"
    )


def decoded_polarity(p: np.ndarray, code: str, where: str) -> np.ndarray:
    """(n,) 0 and 1 from a column in a code.  Raises InputError for other values."""
    if code == "pm1" or "/" in code:
        off, on = map(int, ("-1/1" if code == "pm1" else code).split("/"))
        if not np.all((p == on) | (p == off)):
            must, found = f"{on} (ON) or {off} (OFF)".replace("-", "−"), shown(np.unique(p)[:5].tolist())
            raise InputError(f"{where}/p: polarity must be {must}, found {found}")
        return (p == on).astype(np.uint8)
    if code == "swapped":
        values = p > 0
        return (~values).astype(np.uint8) if np.isin(p, (-1, 0, 1)).all() else p
    return p


def _way(name: str) -> str:
    return f"state it: {OPTION[name]}"
