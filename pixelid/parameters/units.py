"""Units of parameters that go with the unit of the light: which they are, and how they are spelled in another one."""

from __future__ import annotations

import re
from functools import cache

RADIANCE = "radiance"  # the light's unit as the effect library spells it, which fixes none


@cache
def goes_with_light(unit: str, light: str) -> bool:
    """Whether a unit has that of the light in it.

    >>> goes_with_light("1/s²/fA", "fA"), goes_with_light("Hz/radiance", "fA"), goes_with_light("log radiance", "fA")
    (True, True, False)
    """
    return any(re.search(_factor(word), unit) for word in (light, RADIANCE))


@cache
def in_light_unit(unit: str, old: str, new: str) -> str:
    """The unit, spelled for light in `new` instead of `old` or of no unit in particular.

    >>> in_light_unit("1/s²/fA", "fA", "lux"), in_light_unit("radiance/Hz", "fA", "V")
    ('1/s²/lux', 'V/Hz')
    >>> in_light_unit("1/s²/radiance", "radiance", "W/m2"), in_light_unit("radiance", "radiance", "W/m2")
    ('1/s²/(W/m2)', 'W/m2')
    >>> in_light_unit("log radiance", "radiance", "lux")
    'log radiance'
    """
    for word in dict.fromkeys((old, RADIANCE)):
        spelled = f"({new})" if "/" in new and unit not in (word, f"({word})") else new
        unit = re.sub(_factor(word), spelled.replace("\\", r"\\"), unit) if word != new else unit
    return unit


def _factor(word: str) -> str:
    """A pattern of a unit's factor of that name, in brackets or not."""
    one = re.escape(word)
    return rf"(?:(?<=/)|^)(?:\({one}\)|{one})(?=/|$)"
