"""A search as a fold: each step takes the state and gives the next one, until one gives the report."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol, TypeVar

from pixelid.gap.options import Context
from pixelid.gap.phases import Phase
from pixelid.gap.result import GapReport


class HasPhase(Protocol):
    """A state that says which step comes next."""

    @property
    def phase(self) -> Phase: ...


S = TypeVar("S", bound=HasPhase)
Step = Callable[[S, Context], "S | GapReport"]


def fold(state: S, steps: Mapping[Phase, Step[S]], context: Context) -> GapReport:
    """Step after step, until one gives the report."""
    outcome: S | GapReport = state
    while not isinstance(outcome, GapReport):
        outcome = steps[outcome.phase](outcome, context)
    return outcome
