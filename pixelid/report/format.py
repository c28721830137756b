"""How numbers stand on a page: as many digits as are known, units next to them."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pixelid.figures import words

_NAMES = ("alpha", "beta", "gamma", "leak")  # of parameters and effects: never capitals
_POWER = re.compile(r"(?<![\w.])(-?\d+(?:\.\d+)?)e([+-]\d+)\b")
_NO_CHANCE = re.compile(r"\bp = 0(?![.\d])")  # a probability that doubles cannot hold
_THIN = "\N{NARROW NO-BREAK SPACE}"


def number(value: float | None, digits: int = 4) -> str:
    """So many significant digits, powers of ten where zeros would hide the number; a dash for None.

    >>> number(0.00012345), number(1234567.0), number(12.5), number(None)
    ('1.234 × 10⁻⁴', '1.235 × 10⁶', '12.5', '–')
    >>> number(123456.0) == "123\N{NARROW NO-BREAK SPACE}500"
    True
    """
    if value is None or not isinstance(value, (int, float)) or not math.isfinite(value):
        return "–"
    if isinstance(value, int) and abs(value) < 10**7:
        return count(value)
    magnitude = math.floor(math.log10(abs(value))) if value else 0
    if -4 < magnitude < 6:
        text = f"{value:.{digits}g}"
        return _grouped(text if "e" not in text else f"{float(text):.0f}").replace("-", "−")
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    mantissa = mantissa.rstrip("0").rstrip(".") if "." in mantissa else mantissa
    return f"{mantissa.replace('-', '−')} × 10{str(int(exponent)).translate(words.SUPERSCRIPT)}"


def value(estimate: float | None, interval: Sequence[float | None] | None = None) -> str:
    """An estimate to the second digit of its uncertainty, at most six.

    >>> value(1234.5678, (1200.0, 1270.0)), value(3.14159, None)
    ('1235', '3.142')
    """
    return number(estimate, _digits(estimate, interval))


@dataclass(frozen=True)
class Shown:
    """A parameter as a table shows it."""

    value: str
    interval: str
    unit: str
    scale: float

    def of(self, other: float | None) -> str:
        """Another value in the same unit."""
        return number(None if other is None else other / self.scale)


def in_its_unit(entry: Mapping[str, Any]) -> Shown:
    """A parameter's value and interval, short times in milli- or microseconds; no unit where it is a ratio.

    >>> in_its_unit({"value": 1.017e-4, "interval_95": [9.974e-5, 1.038e-4], "unit": "s"})
    Shown(value='101.7', interval='99.74 … 103.8', unit='µs', scale=1e-06)
    """
    estimate, ends, unit = entry["value"], entry["interval_95"], entry["unit"]
    scale, unit = words.in_short_unit(estimate or 0.0, unit)
    if scale != 1.0:
        estimate = estimate / scale
        ends = ends and [None if end is None else end / scale for end in ends]
    return Shown(value(estimate, ends), interval(ends), unit, scale)


def interval(ends: Sequence[float | None] | None) -> str:
    """Lower and upper end, to the digits in which they differ; a dash for None.

    >>> interval((0.98123, 1.02345))
    '0.9812 … 1.023'
    """
    if not ends or ends[0] is None or ends[1] is None:
        return "–"
    digits = _digits(max(abs(ends[0]), abs(ends[1])), ends)
    return f"{number(ends[0], digits)} … {number(ends[1], digits)}"


def seconds(time_s: float | None) -> str:
    """A time in the unit that suits it; a dash for None."""
    return "–" if time_s is None else words.seconds(time_s)


def count(many: int) -> str:
    """A number of things, in groups of three digits from five digits on.

    >>> count(12500) == "12\N{NARROW NO-BREAK SPACE}500", count(1250)
    (True, '1250')
    """
    return _grouped(str(many)).replace("-", "−")


def counted(many: int, noun: str) -> str:
    """A number with its noun.

    >>> counted(1, "pixel"), counted(2, "recording")
    ('1 pixel', '2 recordings')
    """
    return f"{count(many)} {noun}{'' if many == 1 else 's'}"


def chance(p: float | None) -> str:
    """A probability to two digits; one too small to distinguish from nothing as a bound.

    >>> chance(0.0123), chance(0.0)
    ('0.012', '< 10⁻¹⁵')
    """
    smallest_chance = 1e-15  # what arithmetic of doubles can tell from nothing
    return "< 10⁻¹⁵" if p is not None and p < smallest_chance else number(p, 2)


def sentence(text: object, capital: bool = True) -> str:
    """A result's sentence as it stands on a page: capital, full stop, numbers as people write them.

    >>> sentence("between 1.28e+03 and 2e-06 Hz")
    'Between 1280 and 2 × 10⁻⁶ Hz.'
    >>> sentence("alpha stays open")
    'alpha stays open.'
    >>> sentence("an effect is missing (p = 0)")
    'An effect is missing (p < 10⁻¹⁵).'
    """
    said = _NO_CHANCE.sub(f"p {chance(0.0)}", with_powers(str(text).strip()))
    first = re.match(r"[a-z]+(?=[\s,:;-]|$)", said)
    if capital and first and first[0] not in _NAMES:
        said = said[:1].upper() + said[1:]
    return said + ("." if said and said[-1] not in ".!?:" else "")


def with_powers(text: str) -> str:
    """A text whose numbers like 1.7e+07 are written as people write them.

    >>> with_powers("6.1e+07 … 2e-6")
    '6.1 × 10⁷ … 2 × 10⁻⁶'
    """
    return _POWER.sub(lambda m: number(float(m[0]), len(m[1].replace(".", "").lstrip("-"))), text)


def percent(share: float | None, digits: int = 2) -> str:
    """A share in per cent; a dash for None.

    >>> percent(1.163), percent(0.0123)
    ('120 %', '1.2 %')
    """
    return "–" if share is None else f"{number(100 * float(share), digits)} %"


def _grouped(digits: str) -> str:
    """Digits before the point in groups of three, from five on, so that numbers of a column compare at a glance."""
    whole, point, rest = digits.partition(".")
    return (f"{int(whole):,}".replace(",", _THIN) if len(whole.lstrip("-")) > 4 else whole) + point + rest


def _digits(estimate: float | None, ends: Sequence[float | None] | None) -> int:
    if not estimate or not ends or ends[0] is None or ends[1] is None or not ends[1] > ends[0]:
        return 4
    half = 0.5 * (ends[1] - ends[0])
    if not (math.isfinite(half) and math.isfinite(estimate)):
        return 4
    return min(max(math.floor(math.log10(abs(estimate))) - math.floor(math.log10(half)) + 2, 2), 6)
