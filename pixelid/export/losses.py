"""What a simulator cannot express of a circuit, said effect by effect."""

from __future__ import annotations

from collections.abc import Mapping

from pixelid import stages
from pixelid.model.model import Model


def losses(model: Model, carried: Mapping[str, str]) -> list[str]:
    """One sentence for each effect of the model that the simulator lacks or has in another form.

    carried: effect → what changes about it; "" where it is expressed exactly
    """
    sentences = []
    for name in model.effects:
        if name not in carried:
            own = stages.effect(name)
            values = ", ".join(_strength(p.name, model.values[p.name], p.unit) for p in own.parameters)
            sentences.append(f"{name} ({values}): not in this simulator. {own.sentence}")
        elif carried[name]:
            sentences.append(f"{name}: {carried[name]}")
    return sentences


def _strength(name: str, value: float, unit: str) -> str:
    return f"{name} = {value:.4g}" + (f" {unit}" if unit != "1" else "")
