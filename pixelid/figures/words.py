"""Names, times and exponents as they stand on axes: in words, with units, raised."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Mapping
from typing import Any

_WORDS = {
    "alpha": "α", "beta": "β", "gamma": "γ", "sf_cutoff_hz": "source follower's cutoff",
    "diff_cutoff_hz": "differencing amplifier's cutoff", "on_threshold": "ON threshold",
    "off_threshold": "OFF threshold", "threshold_sigma": "threshold noise", "refractory_s": "dead time",
    "threshold_mismatch.sigma": "threshold mismatch", "leak.rate_hz": "leak",
    "delay_s": "delay",
}  # fmt: skip
SYMBOLS = {  # (letter, index)
    "alpha": ("α", ""), "beta": ("β", ""), "gamma": ("γ", ""), "alpha_over_beta": ("α/β", ""),
    "sf_cutoff_hz": ("f", "sf"), "diff_cutoff_hz": ("f", "diff"),
    "on_threshold": ("C", "on"), "off_threshold": ("C", "off"),
    "threshold_sigma": ("σ", "C"), "threshold_mismatch.sigma": ("σ", "pixel"), "refractory_s": ("τ", "dead"),
}  # fmt: skip
RATES = ("leak.rate_hz", "off_background.rate_hz", "hot_pixels.rate_hz", "parasitic_photocurrent.rate_hz_per_radiance")
SUPERSCRIPT = str.maketrans("-−0123456789", "⁻⁻⁰¹²³⁴⁵⁶⁷⁸⁹")  # of exponents; either minus
SHORT = 13  # letters, as wide as a panel among many
UNIT = re.compile(r"(?<!per)_(hz|rad|s)$")  # at the end of a parameter's name
_UNITS = {"log radiance": "log radiance", "1": ""}


def in_words(parameter: str) -> str:
    """A parameter's name in words.

    >>> in_words("on_threshold"), in_words("threshold_mismatch.sigma")
    ('ON threshold', 'threshold mismatch')
    """
    return _WORDS.get(parameter, parameter.replace(".", ", ").replace("_", " "))


def symbol(parameter: str) -> str:
    """A parameter's symbol, or its name in short lines where it has none.

    >>> symbol("sf_cutoff_hz"), symbol("leak.rate_hz"), symbol("polarity_memory.strength")
    ('f sf', 'leak, rate', 'polarity\\nmemory,\\nstrength')
    """
    if parameter in SYMBOLS:
        return " ".join(SYMBOLS[parameter]).strip()
    return textwrap.fill(in_words(UNIT.sub("", parameter)), SHORT)


def with_unit(parameter: str, unit: str) -> str:
    """The label of an axis: the parameter in words, its unit in brackets where it has one.

    >>> with_unit("sf_cutoff_hz", "Hz"), with_unit("threshold_sigma", "1")
    ("source follower's cutoff (Hz)", 'threshold noise')
    """
    unit = _UNITS.get(unit, unit)
    return f"{in_words(parameter)} ({unit})" if unit else in_words(parameter)


def light_unit(parameters: Mapping[str, Mapping[str, Any]]) -> str:
    """The unit of the light, as that of γ or of the corner has it; "" where neither is there."""
    entry = parameters.get("gamma") or parameters.get("alpha_over_beta") or {}
    return str(entry.get("unit", "")).rpartition("/s/")[2]


def unit_of(parameter: str, unit: str) -> str:
    """A parameter's unit in words: events per second are no frequency.

    >>> unit_of("leak.rate_hz", "Hz"), unit_of("sf_cutoff_hz", "Hz")
    ('events/s', 'Hz')
    """
    return unit.replace("Hz", "events/s") if parameter in RATES else unit


def stimulus(name: str, parameters: Mapping[str, Any], light: str) -> str:
    """A stimulus of a menu in words, with its level in the unit of the light.

    >>> stimulus("long_chirp_390", {"level": 390.0}, "fA"), stimulus("chirp", {}, "fA")
    ('long chirp at 390 fA', 'chirp')
    """
    kind, _, level = name.rpartition("_")
    if level and level == f"{parameters.get('level', 0.0):g}":
        return f"{kind} at {level} {light}".replace("_", " ").strip()
    return name.replace("_", " ")


def in_short_unit(value: float, unit: str) -> tuple[float, str]:
    """(scale, unit) in which a value is written: short times in milli- or microseconds, no unit for a ratio.

    >>> in_short_unit(2.1e-4, "s"), in_short_unit(0.3, "log radiance"), in_short_unit(12.0, "Hz")
    ((1e-06, 'µs'), (1.0, 'log radiance'), (1.0, 'Hz'))
    """
    if unit == "s" and value:
        return next(((s, u) for s, u in ((1.0, "s"), (1e-3, "ms")) if abs(value) >= s), (1e-6, "µs"))
    return 1.0, "" if unit == "1" else unit


def seconds(time_s: float, digits: int = 3) -> str:
    """A time in the unit that suits it.

    >>> seconds(2.1e-4), seconds(95.0), seconds(1.5), seconds(0.0)
    ('210 µs', '95 s', '1.5 s', '0 s')
    """
    if not time_s:
        return "0 s"
    for scale, unit in ((1.0, "s"), (1e-3, "ms"), (1e-6, "µs")):
        if abs(time_s) >= scale:
            return f"{time_s / scale:.{digits}g} {unit}"
    return f"{time_s * 1e9:.{digits}g} ns"


def between(first_s: float, last_s: float) -> str:
    """A span of time, both ends in the unit that suits the later one.

    >>> between(7.17e-5, 1.57e-4), between(0.0394, 0.06), between(0.0, 1.5)
    ('71.7–157 µs', '39.4–60 ms', '0–1.5 s')
    """
    for scale, unit in ((1.0, "s"), (1e-3, "ms"), (1e-6, "µs"), (1e-9, "ns")):
        if abs(last_s) >= scale or unit == "ns":
            break
    return f"{first_s / scale:.3g}–{last_s / scale:.3g} {unit}"
