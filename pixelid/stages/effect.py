"""What an effect is: a named deviation of one stage, with its parameters and its sentence."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import ClassVar

from pixelid.parameters.parameter import Parameter
from pixelid.stages.circuit import PHOTORECEPTORS, Circuit


class Effect(ABC):
    """One effect.  Subclasses are final; an instance does not change.

    name: the stable identifier;  stage: where it sits on the signal path;
    sentence: one line for the report;  equation, source: what it does and who says so;
    parameters: with shipped value, unit, bounds and transform;
    photoreceptors: kinds of photoreceptor that it can be added to;
    starts_anew: names of those parameters that every recording has of its own, as recordings are made minutes apart.
    """

    name: str
    stage: str
    sentence: str
    equation: str
    source: str
    parameters: tuple[Parameter, ...]
    photoreceptors: tuple[str, ...] = PHOTORECEPTORS
    starts_anew: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def apply(self, circuit: Circuit, values: Mapping[str, float]) -> Circuit:
        """The circuit with this effect in it; `values` maps full parameter names to values."""
