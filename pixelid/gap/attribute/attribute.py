"""Attribute: which effect of the library explains what is left, and whether another explains it as well.

Every missing effect is fitted together with all free parameters: first to a few units (screening), the leading ones to
all fit units.  Units are pixels, or stretches of time where events have no pixels.  The gain of an effect is what it
adds to the log-likelihood, on the fit units and again on the select units, which no fit has seen.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np

from pixelid.gap.attribute.significance import chance_of_gain, leads, negligible, own_values
from pixelid.gap.options import Options
from pixelid.model.model import Model

# Work that is saved: each leader costs a fit to all fit units, and what screening puts far behind does not lead there.
MAX_LEADERS = 4
MIN_SCREENED_NATS = 3.0  # a name needs 5.5 at alpha 0.01; screening stops early and sees part of the pixels
MIN_SHARE_OF_LEADER = 0.05  # of the best screened gain, for a third effect to be fitted
Report = Callable[[str], None]  # called with the effect that is tried
NO_START = "none of the strengths tried can be evaluated here, or is worth a fit"


class Fit(Protocol):
    """A model fitted to some units: the model, and its log-likelihood there in nats."""

    @property
    def model(self) -> Model: ...

    @property
    def value(self) -> float: ...


F = TypeVar("F", bound=Fit)


class Evidence(Protocol[F]):
    """What candidates are judged by: fits on a few units and on all fit units, and gains on units that no fit saw."""

    @property
    def base(self) -> F:
        """The model without any of the candidates, on the fit units."""
        ...

    def screen(self, effects: Sequence[str], report: Report) -> list[tuple[F, float] | None]:
        """For each effect (it fitted to a few units, nats gained there); None where no strength can be evaluated."""
        ...

    def fit(self, starts: Sequence[tuple[str, F]], report: Report) -> list[F]:
        """Screened candidates on the fit units; the first one, which leads, to the end."""
        ...

    def fit_without(self, effect: str, end: F) -> F | None:
        """The model without an effect again, from the values that it has with it; None where it cannot differ."""
        ...

    def held_out_gain(self, better: F, worse: F) -> np.ndarray:
        """(select units,) nats that one model gains on another."""
        ...


@dataclass(frozen=True)
class Candidate(Generic[F]):
    """One effect fitted.

    Attributes:
        effect: Its name.
        end: The model with it, fitted.
        gain: Nats on the fit units.
        p: Chance of the gain, adjusted for all effects tried.
        held_out: (select units,) nats gained.
    """

    effect: str
    end: F
    gain: float
    p: float
    held_out: np.ndarray

    @property
    def heldout_gain(self) -> float:
        """Nats gained on the select units."""
        return float(self.held_out.sum())


@dataclass(frozen=True)
class Attribution(Generic[F]):
    """What the missing effects would gain.

    Attributes:
        candidates: Effects fitted, by gain.
        screened: Effect → nats on the few units looked at first.
        winner: The effect to name, or None.
        runners_up: Effects that explain the data as well as the winner does.
        skipped: Effect → why it was not fitted to a few units.
    """

    candidates: tuple[Candidate[F], ...]
    screened: dict[str, float]
    winner: Candidate[F] | None
    runners_up: tuple[Candidate[F], ...]
    skipped: dict[str, str]


def attribute(
    evidence: Evidence[F],
    effects: Sequence[str],
    options: Options,
    report: Report = lambda what: None,
) -> Attribution[F]:
    """Try effects that the model of the evidence lacks."""
    base = evidence.base
    screened: dict[str, F] = {}
    gains: dict[str, float] = {}
    skipped: dict[str, str] = {}
    for effect, fitted in zip(effects, evidence.screen(effects, report), strict=True):
        if fitted is None:
            skipped[effect] = NO_START
        else:
            screened[effect], gains[effect] = fitted
    candidates = []
    leaders = _leaders(gains)
    ends = evidence.fit([(effect, screened[effect]) for effect in leaders], report)
    for effect, end in zip(leaders, ends, strict=True):
        if effect == leaders[0]:  # the model without it may owe its lower place to its other parameters
            again = evidence.fit_without(effect, end)
            base = again if again is not None and again.value > base.value else base
        gain = end.value - base.value
        p = chance_of_gain(effect, gain, len(effects), own_values(end.model, effect))
        candidates.append(Candidate(effect, end, gain, p, evidence.held_out_gain(end, base)))
    candidates.sort(key=lambda c: -c.gain)
    # of those that fitted units do not tell apart, the first that unseen ones do not speak against
    alike = [c for c in candidates if candidates[0].gain - c.gain <= options.criteria.min_lead_nats]
    winner = next((c for c in alike if may_be_named(c, options)), None)
    others = [c for c in candidates if c is not winner]
    runners_up = tuple(c for c in others if winner is not None and _as_good(c, winner, options))
    return Attribution(tuple(candidates), gains, winner, runners_up, skipped)


def _leaders(gains: dict[str, float]) -> list[str]:
    """The effects worth a fit to all fit units, best first."""
    leaders = sorted((e for e in gains if gains[e] > MIN_SCREENED_NATS), key=lambda e: -gains[e])[:MAX_LEADERS]
    return [e for i, e in enumerate(leaders) if i < 2 or gains[e] > MIN_SHARE_OF_LEADER * gains[leaders[0]]]


def may_be_named(candidate: Candidate, options: Options) -> bool:
    """Whether a candidate's gain is significant, holds on the select units, and is not that of a trifle."""
    criteria = options.criteria
    significant = candidate.p < options.alpha_each and leads(candidate.held_out, criteria)
    return significant and not negligible(candidate.effect, candidate.end.model, criteria)


def _as_good(other: Candidate, winner: Candidate, options: Options) -> bool:
    """Whether another effect explains the events about as well: nearly the same gain, or its own on unseen units.

    Unseen units that favour the winner count with those that were fitted to: nats of both add up.
    """
    lead, apart = winner.gain - other.gain, winner.held_out - other.held_out
    if leads(apart, options.criteria):
        return lead + float(apart.sum()) <= options.criteria.min_lead_nats
    return lead <= options.criteria.min_lead_nats or other.p < options.alpha_each
