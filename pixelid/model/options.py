"""How a model is changed from a command line or a recipe: effects with values, and assignments."""

from __future__ import annotations

import math
from collections.abc import Iterable

from pixelid import stages
from pixelid.errors import InputError
from pixelid.model.model import Model


def assignment(text: str) -> tuple[str, float]:
    """("leak.rate_hz", 0.3) from "leak.rate_hz=0.3".  Raises InputError for anything else."""
    name, sign, value = text.partition("=")
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not sign or not name.strip() or not math.isfinite(number):
        raise InputError(f"expected name=value with a finite number, found {text!r}")
    return name.strip(), number


def effect_with_values(text: str) -> tuple[str, dict[str, float]]:
    """("leak", {"rate_hz": 0.3}) from "leak:rate_hz=0.3"; several values separated by commas.

    Raises InputError for an unknown effect, listing the known ones, and for malformed values.
    """
    name, sign, values = text.partition(":")
    name = name.strip()
    stages.effect(name)
    if sign and not values.strip():
        raise InputError(f"--with {text!r}: expected parameter=value after the colon")
    return name, _once(f"--with {name}", [assignment(part) for part in values.split(",")]) if sign else {}


def assignments(option: str, texts: Iterable[str]) -> dict[str, float]:
    """Numbers by name from several "name=value".  Raises InputError for anything else, and for one name twice."""
    return _once(option, [assignment(text) for text in texts])


def _once(where: str, assigned: Iterable[tuple[str, float]]) -> dict[str, float]:
    """Assignments by name.  Raises InputError for one name twice."""
    found: dict[str, float] = {}
    for name, value in assigned:
        if name in found:
            raise InputError(f"{where}: expected {name} once, found {found[name]:g} and {value:g}")
        found[name] = value
    return found


def changed(
    model: Model, with_: Iterable[str] = (), without: Iterable[str] = (), set_: Iterable[str] = ()
) -> tuple[Model, list[str]]:
    """The model without, then with effects, then with values set; and remarks to pass on to the user.

    Raises InputError for unknown effects and parameters, values out of bounds, and an effect both added and removed.
    """
    remarks = []
    added = [effect_with_values(text) for text in with_]
    twice = [name for k, (name, _) in enumerate(added) if name in (other for other, _ in added[:k])]
    if twice:
        raise InputError(f"--with {twice[0]}: expected an effect once, with all its values")
    for name in without:
        if name in (other for other, _ in added):
            raise InputError(f"effect {name} is in both --with and --without")
        if not model.has(name):
            remarks.append(f"--without {name}: the model {model.name} does not have it")
        model = model.without_effect(name)
    for name, values in added:
        model = model.with_effect(name, values)
    return model.set(assignments("--set", set_)), remarks
