"""Attribute: which effect of the library explains what is left, and whether a rival explains it as well.

Every missing effect is fitted together with all free parameters: first to a few pixels (screen), the leading ones to
all fit pixels.  The gain of an effect is what it adds to the log-likelihood; a strength of zero lies on the boundary,
so under no effect twice the gain is 0 or χ² with equal chance (Self & Liang 1987, JASA 82, 605), and the p-value of
the best is Bonferroni's over all effects tried.  Gains are judged again on the select pixels, which no fit has seen.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from pixelid import stages
from pixelid.gap.candidates import INVERSE, missing, strongest_start
from pixelid.gap.climb import Climbed, climbed, per_pixel
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.model import Model

LEADERS = 4  # effects fitted to all fit pixels
SCREEN_STEPS = (6, 15)  # of any effect, and of poles, which trade places with those that the model has
POLES = ("source_follower_pole", "extra_pole", "differencing_pole")
FIT_STEPS = (30, 10)  # of the leading effect, and of the others: they start where the screening left them
HOPEFUL = 0.05  # of the best screened gain: below it, a third effect has no chance
WORTH = 3.0  # nats below which a screened effect is not looked at again
TRIED_AT = {"mains_flicker": 2.0}  # amplitude and phase have no boundary between them, and two frequencies are tried
NEGLIGIBLE = 0.01  # of the typical strength: weaker effects are an error of the model or the stimulus, not a finding
FAINTEST = {"mains_flicker": 0.05}  # likewise: a modulation of 0.25 %
DISTINCT = 5.0  # nats by which the winner must lead on the fit pixels
SECURE = 1.0  # standard errors (paired over pixels) by which held-out gains must lead


@dataclass(frozen=True)
class Candidate:
    """One effect fitted.

    gain: nats on the fit pixels;  p: adjusted for all effects tried;  held_out: (select pixels,) nats gained
    """

    effect: str
    end: Climbed
    gain: float
    p: float
    held_out: np.ndarray

    @property
    def heldout_gain(self) -> float:
        """Nats gained on the select pixels."""
        return float(self.held_out.sum())


@dataclass(frozen=True)
class Attribution:
    """candidates: fitted effects by gain;  screened: effect → nats on the few pixels looked at first;
    winner: the effect to name, or None;  rivals: effects that explain the data as well as it does"""

    candidates: tuple[Candidate, ...]
    screened: dict[str, float]
    winner: Candidate | None
    rivals: tuple[Candidate, ...]


@dataclass(frozen=True)
class Pools:
    """The likelihoods of the pixels: a few to screen on, those to fit, those to judge on."""

    scout: EventTimes
    fit: EventTimes
    select: EventTimes


def attribute(
    pools: Pools,
    model: Model,
    alpha: float,
    *,
    restart: Model | None = None,
    skip: Sequence[str] = (),
    report: Callable[[str], None] = lambda what: None,
) -> Attribution:
    """Try every effect that `model` lacks.

    model: at its fitted values;  restart: the model at its shipped values, to start from as well when the fitted ones
    may be bent by what is missing;  skip: effects not to try.
    """
    base_scout = climbed(pools.scout, model, tolerance=0.1, max_steps=25)
    base_fit = climbed(pools.fit, model, tolerance=0.05, max_steps=25)
    for part in (pools.scout, pools.fit, pools.select):
        part.weigh_clock(base_fit.model.circuit())
    effects = [name for name in missing(model) if name not in skip]
    screened: dict[str, Climbed] = {}
    for effect in effects:
        report(effect)
        for origin in (base_scout.model, restart):
            start = None if origin is None else strongest_start(pools.scout, origin, effect, base_scout.value)
            if start is None:
                continue
            end = climbed(pools.scout, start, tolerance=0.3, max_steps=SCREEN_STEPS[effect in POLES])
            if effect not in screened or end.value > screened[effect].value:
                screened[effect] = end
    gains = {effect: end.value - base_scout.value for effect, end in screened.items()}
    leaders = sorted((e for e in gains if gains[e] > WORTH), key=lambda e: -gains[e])[:LEADERS]
    leaders = [e for i, e in enumerate(leaders) if i < 2 or gains[e] > HOPEFUL * gains[leaders[0]]]
    before = per_pixel(pools.select, base_fit.model)
    found = []
    for effect in leaders:
        report(effect)
        steps = FIT_STEPS[0] if effect == leaders[0] else FIT_STEPS[1]
        end = climbed(pools.fit, screened[effect].model, tolerance=0.02, max_steps=steps)
        if effect == leaders[0]:  # the model without it may owe its lower place to its other parameters
            again = climbed(pools.fit, end.model.without_effect(effect), tolerance=0.1, max_steps=10)
            if again.value > base_fit.value:
                base_fit, before = again, per_pixel(pools.select, again.model)
        gain = end.value - base_fit.value
        degrees = sum(p.free for p in stages.effect(effect).parameters)
        p = min(1.0, TRIED_AT.get(effect, 0.5) * len(effects) * float(chi2.sf(2.0 * max(gain, 0.0), degrees)))
        found.append(Candidate(effect, end, gain, p, per_pixel(pools.select, end.model) - before))
    found.sort(key=lambda c: -c.gain)
    winner = next((c for c in found[:1] if c.p < alpha and secure(c.held_out) and not _negligible(c)), None)
    rivals = tuple(c for c in found[1:] if winner is not None and _rivals(c, winner, alpha))
    return Attribution(tuple(found), gains, winner, rivals)


def secure(differences: np.ndarray) -> bool:
    """Whether paired differences over pixels are positive in sum, by `SECURE` standard errors."""
    n = len(differences)
    spread = differences.std(ddof=1) * np.sqrt(n) if n > 1 else 0.0
    return bool(differences.sum() > SECURE * spread)


def _negligible(found: Candidate) -> bool:
    """Whether the effect is far weaker than it ever is in a camera."""
    strength = next(p for p in stages.effect(found.effect).parameters if p.free)
    value = abs(found.end.values[strength.name])
    return (strength.value / value if found.effect in INVERSE else value / strength.value) < FAINTEST.get(
        found.effect, NEGLIGIBLE
    )


def _rivals(other: Candidate, winner: Candidate, alpha: float) -> bool:
    """Whether another effect explains the events about as well: nearly the same gain, or its own on unseen pixels."""
    if winner.gain - other.gain <= DISTINCT:
        return True
    return other.p < alpha and not secure(winner.held_out - other.held_out)
