"""What a simulator cannot express of a circuit, said effect by effect."""

from __future__ import annotations

from collections.abc import Mapping

from pixelid import stages
from pixelid.model.model import Model
from pixelid.stages.described import Described


def losses(model: Model, carried: Mapping[str, str]) -> list[str]:
    """One sentence for each effect of the model that the simulator lacks or has in another form.

    carried: effect → what changes about it; "" where it is expressed exactly
    """
    sentences = []
    for name, known in known_as(model).items():
        own = stages.effect(name)
        if known not in carried:
            values = ", ".join(_strength(p.name, model.values[p.name], p.unit) for p in own.parameters)
            sentences.append(f"{name} ({values}): not in this simulator. {own.sentence}")
        elif carried[known]:
            sentences.append(f"{name}: {carried[known]}")
    return sentences


def known_as(model: Model) -> dict[str, str]:
    """Each effect of the model → the one of the library that has the same equation: itself, but for descriptions."""
    found = {}
    for name in model.effects:
        own = stages.effect(name)
        found[name] = own.twin if isinstance(own, Described) and own.twin is not None else name
    return found


def _strength(name: str, value: float, unit: str) -> str:
    return f"{name} = {value:.4g}" + (f" {unit}" if unit != "1" else "")
