"""How numbers stand on a page: as many digits as are known, units beside them."""

from __future__ import annotations

import math
from collections.abc import Sequence

_SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def number(value: float | None, digits: int = 4) -> str:
    """So many significant digits, powers of ten where zeros would hide the number; a dash for None.

    >>> number(0.00012345), number(1234567.0), number(12.5), number(None)
    ('1.234 × 10⁻⁴', '1.235 × 10⁶', '12.5', '–')
    """
    if value is None or not isinstance(value, (int, float)) or not math.isfinite(value):
        return "–"
    if isinstance(value, int) and abs(value) < 10**7:
        return str(value)
    magnitude = math.floor(math.log10(abs(value))) if value else 0
    if -4 < magnitude < 6:
        text = f"{value:.{digits}g}"
        return (text if "e" not in text else f"{float(text):.0f}").replace("-", "−")
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    mantissa = mantissa.rstrip("0").rstrip(".") if "." in mantissa else mantissa
    return f"{mantissa.replace('-', '−')} × 10{str(int(exponent)).translate(_SUPERSCRIPT)}"


def value(estimate: float | None, interval: Sequence[float | None] | None = None) -> str:
    """An estimate to the second digit of its uncertainty, at most six.

    >>> value(1234.5678, (1200.0, 1270.0)), value(3.14159, None)
    ('1235', '3.142')
    """
    return number(estimate, _digits(estimate, interval))


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
    """A time in the unit that suits it.

    >>> seconds(2.1e-4), seconds(95.0), seconds(1.5)
    ('210 µs', '95 s', '1.5 s')
    """
    if time_s is None:
        return "–"
    for scale, unit in ((1.0, "s"), (1e-3, "ms"), (1e-6, "µs")):
        if abs(time_s) >= scale:
            return f"{time_s / scale:.3g} {unit}"
    return f"{time_s * 1e9:.3g} ns"


def count(many: int) -> str:
    """A number of things, in groups of three digits.

    >>> count(12500)
    '12 500'
    """
    return f"{many:,}".replace(",", " ")


def counted(many: int, noun: str) -> str:
    """A number with its noun.

    >>> counted(1, "pixel"), counted(2, "recording")
    ('1 pixel', '2 recordings')
    """
    return f"{count(many)} {noun}{'' if many == 1 else 's'}"


def percent(share: float | None, digits: int = 2) -> str:
    """A share in per cent; a dash for None."""
    return "–" if share is None else f"{100 * share:.{digits}g} %"


def _digits(estimate: float | None, ends: Sequence[float | None] | None) -> int:
    if not estimate or not ends or ends[0] is None or ends[1] is None or not ends[1] > ends[0]:
        return 4
    half = 0.5 * (ends[1] - ends[0])
    if not (math.isfinite(half) and math.isfinite(estimate)):
        return 4
    return min(max(math.floor(math.log10(abs(estimate))) - math.floor(math.log10(half)) + 2, 2), 6)
