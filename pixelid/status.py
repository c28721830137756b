"""How a computation ended: one closed list for every result, each member with what to do about it."""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum


class Status(StrEnum):
    """How a computation ended.  Members are strings: they go to JSON as they are.

    >>> Status("converged").exit_code
    0
    >>> Status.not_converged.advice
    'The optimiser stopped early: start again with another --seed, or from a model closer to the recording.'
    """

    converged = "converged"
    misfit = "misfit"
    at_bound = "at_bound"
    not_identified = "not_identified"
    not_converged = "not_converged"
    diverged = "diverged"
    interrupted = "interrupted"

    @property
    def advice(self) -> str:
        """What to do, as one sentence; empty for `converged`.  Results put their own, more specific words first."""
        return _ADVICE[self]

    @property
    def at_rest(self) -> bool:
        """Whether the search came to a maximum; only there do curvatures say what the data identify."""
        return self not in (Status.not_converged, Status.interrupted, Status.diverged)

    @property
    def exit_code(self) -> int:
        """What the command line returns: 0 for `converged`, 1 for all others."""
        return 0 if self is Status.converged else 1

    @classmethod
    def worst(cls, statuses: Iterable[Status]) -> Status:
        """The most serious of several; `converged` of none.

        >>> Status.worst([Status.converged, Status.at_bound])
        <Status.at_bound: 'at_bound'>
        """
        return max(statuses, key=_SERIOUSNESS.index, default=cls.converged)


# Among what a result leaves open, where its search is not at rest.
STOPPED = "no parameter is reliable: the optimiser stopped early; values are those of where it stopped"
_ADVICE = {
    Status.converged: "",
    Status.misfit: "The model does not describe the data: look at the residuals, then search for what it lacks with "
    "`pixelid gap`.",
    Status.at_bound: "A parameter sits on its bound: check the units of the stimulus, fix the parameter, or widen its "
    "bounds in the model file.",
    Status.not_identified: "The data do not identify what was asked for: fix it from elsewhere, or record what "
    "`pixelid design` recommends.",
    Status.not_converged: "The optimiser stopped early: start again with another --seed, or from a model closer to the "
    "recording.",
    Status.diverged: "The numbers ran away: check units, thresholds and dead time of the input, and start nearer.",
    Status.interrupted: "The computation was stopped before its end: run it again; what has been kept is continued.",
}
# From harmless to useless.  A result that stands on a bound or leaves something open can still be read; one that does
# not describe the data, has not arrived, or has run away cannot, in that order.
_SERIOUSNESS = (
    Status.converged,
    Status.not_identified,
    Status.at_bound,
    Status.misfit,
    Status.not_converged,
    Status.interrupted,
    Status.diverged,
)
