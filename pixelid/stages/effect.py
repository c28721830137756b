"""What an effect is: a named deviation of one stage, with its parameters and its sentence."""

from __future__ import annotations

import math
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

    What a search for missing effects asks of it:

    vanishes_at: value of its first free parameter, its strength, at which it is not there: 0 or ∞;
    on_boundary: whether no strength of either sign lies beyond that, so that its gain by chance is a mixture with 0;
    in_event_times: whether the density of single events knows it;
    requires: effects without which the likelihood does not know it;
    tried_after: effects that one more of its kind would be taken for while they are missing;
    decades: of values of the strength to try, about the shipped one;
    tried_with: parameter → values that every strength is tried with;
    trades_places: whether it takes the place of what other parameters did, and its fit many steps;
    periodic: whether any periodic error of the light passes for it.
    """

    name: str
    stage: str
    sentence: str
    equation: str
    source: str
    parameters: tuple[Parameter, ...]
    photoreceptors: tuple[str, ...] = PHOTORECEPTORS
    starts_anew: ClassVar[tuple[str, ...]] = ()
    vanishes_at: ClassVar[float] = 0.0
    on_boundary: ClassVar[bool] = True
    in_event_times: ClassVar[bool] = True
    requires: ClassVar[tuple[str, ...]] = ()
    tried_after: ClassVar[tuple[str, ...]] = ()
    decades: ClassVar[tuple[float, ...]] = (-2.0, -1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 1.5)
    tried_with: ClassVar[Mapping[str, tuple[float, ...]]] = {}
    trades_places: ClassVar[bool] = False
    periodic: ClassVar[bool] = False

    @property
    def weakens(self) -> bool:
        """Whether it weakens as its strength grows: a pole, a limit."""
        return math.isinf(self.vanishes_at)

    @abstractmethod
    def apply(self, circuit: Circuit, values: Mapping[str, float]) -> Circuit:
        """The circuit with this effect in it; `values` maps full parameter names to values."""
