"""Words and numbers that a reconstruction is given, checked where they are used: functions take any."""

from __future__ import annotations

import math
from collections.abc import Sequence
from numbers import Integral, Real
from typing import Any

from pixelid.errors import InputError, shown


def one_of(name: str, value: Any, known: Sequence[str]) -> str:
    """The word itself.  Raises InputError for one that is not known.

    >>> one_of("scale", "level", ("auto", "level", "free"))
    'level'
    """
    if not isinstance(value, str) or value not in known:
        raise InputError(f"{name}: expected {', '.join(known[:-1])} or {known[-1]}, found {shown(value)}")
    return value


def whole_number(name: str, value: Any, least: int, most: int, or_else: str = "") -> int:
    """The number.  Raises InputError for one below `least` or above `most`, and for anything else."""
    if isinstance(value, bool) or not isinstance(value, Integral) or not least <= int(value) <= most:
        raise InputError(f"{name}: expected a whole number from {least} to {most}{or_else}, found {shown(value)}")
    return int(value)


def number(name: str, value: Any, *, above: float = -math.inf, least: float = -math.inf) -> float:
    """The number.  Raises InputError for one that is not finite, not above `above` or below `least`, and for others."""
    try:
        found = float(value) if isinstance(value, Real) and not isinstance(value, bool) else math.nan
    except OverflowError:  # a whole number of hundreds of digits
        found = math.nan
    if not (math.isfinite(found) and found > above and found >= least):
        low = f" above {above:g}" if above > -math.inf else f" of at least {least:g}" if least > -math.inf else ""
        raise InputError(f"{name}: expected a finite number{low}, found {shown(value)}")
    return found


def numbers(name: str, values: Any, many: int, *, least: float = -math.inf) -> tuple[float, ...]:
    """So many numbers.  Raises InputError for more or fewer, and for one that `number` refuses."""
    try:
        given = () if isinstance(values, str) else tuple(values)
    except TypeError:
        given = ()
    if len(given) != many:
        raise InputError(f"{name}: expected {many} numbers, found {shown(values)}")
    return tuple(number(name, value, least=least) for value in given)
