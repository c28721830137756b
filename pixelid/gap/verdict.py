"""From what was found to a verdict, and to sentences that say it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from pixelid import stages
from pixelid.gap.attribute.attribute import Candidate
from pixelid.gap.attribute.directions import Direction, Space
from pixelid.gap.attribute.flexible import Flexible
from pixelid.gap.confirm.free_run import FreeRun
from pixelid.gap.options import Options
from pixelid.gap.result import DescribedEffect, Limits, Named

TELLING_NATS = 3.0  # a likelihood ratio of 20; less is no finding


@dataclass(frozen=True)
class Confounder:
    """An effect that these stimuli cannot tell from an asymmetry of the thresholds.

    strength: of the effect that would explain the whole asymmetry found;  asymmetry: ln(C_on/C_off)
    """

    effect: str
    strength: float
    asymmetry: float


def confounded(at: Space, directions: Sequence[Direction], options: Options) -> Confounder | None:
    """The effect that may hide behind the thresholds' asymmetry; None when there is none.

    It must move the two thresholds apart, hide behind the free parameters, and explain the asymmetry found: in sign,
    within its bounds, and unseen by these recordings at that strength.
    """
    names = at.fit.coordinates.names
    if "on_threshold" not in names or "off_threshold" not in names:
        return None
    on, off = names.index("on_threshold"), names.index("off_threshold")
    asymmetry = float(at.fit.x[on] - at.fit.x[off])
    covariance = np.linalg.pinv(at.fit.information)
    error = float(np.sqrt(covariance[on, on] + covariance[off, off] - 2.0 * covariance[on, off]))
    if abs(asymmetry) < float(norm.isf(0.5 * options.alpha_each)) * error:
        return None
    for effect in directions:
        moved = float(effect.bias[on] - effect.bias[off])
        seen = effect.hidden < options.criteria.min_hidden_cosine
        if seen or abs(moved) <= abs(float(effect.bias[on] + effect.bias[off])):
            continue
        strength = asymmetry / moved * effect.strength
        parameter = next(p for p in at.fit.model.library(effect.effect) if p.free)
        would_show = 0.5 * effect.seen * (strength / parameter.value) ** 2
        if parameter.lower < strength < parameter.upper and would_show <= options.criteria.min_lead_nats:
            return Confounder(effect.effect, strength, asymmetry)
    return None


def judge(named: bool, runners_up: bool, remainder: bool, confounder: Confounder | None) -> str:
    """One of `result.VERDICTS`."""
    if remainder:
        return "unknown"
    if runners_up or confounder is not None:
        return "ambiguous"
    return "named" if named else "none"


def describe(
    said: str,
    effects: Sequence[Named],
    runners_up: Sequence[Candidate],
    confounder: Confounder | None,
    run: FreeRun | None,
    where: str,
    term: Flexible | None,
    p: float,
    described: Sequence[DescribedEffect] = (),
) -> str:
    """The verdict in words."""
    listed = "; ".join(f"{effect.name} ({_strengths(effect)})" for effect in effects)
    if said == "none":
        return f"The model explains these recordings: nothing significant is left (p = {p:.2g})."
    if said == "named":
        closed = ""
        if run is not None and run.closed is not None and run.interval is not None:
            closed = (
                f" Adding {'it' if len(effects) == 1 else 'them'} closes {100 * run.closed:.0f} % of the free-run gap "
                f"({100 * run.interval[0]:.0f}–{100 * run.interval[1]:.0f} %)."
            )
        return f"Missing: {listed}. {' '.join(stages.effect(e.name).sentence for e in effects)}{closed}"
    if said == "ambiguous" and confounder is not None:
        return (
            f"Under these stimuli {confounder.effect} and unequal thresholds look the same: ln(C_on/C_off) = "
            f"{confounder.asymmetry:.3g} may be just that, or {confounder.effect} of {confounder.strength:.3g}."
        )
    if said == "ambiguous":
        others = ", ".join(other.effect for other in runners_up)
        return f"Something is missing, and these recordings cannot say which: {listed}, or {others}."
    text = f"Something is missing that no effect of the library explains: {where}."
    if described:
        closed = ""
        if run is not None and run.closed is not None and run.interval is not None:
            closed = (
                f", which closes {100 * run.closed:.0f} % of the free-run gap "
                f"({100 * run.interval[0]:.0f}–{100 * run.interval[1]:.0f} %)"
            )
        text += f" Described: {'; '.join(one.words for one in described)}{closed}."
    elif term is not None and (gain := float(term.held_out.sum())) > TELLING_NATS:
        text += f" Thresholds that depend on {term.factor} gain {gain:.3g} nats on pixels not used to find them."
    if effects:
        text = f"Found on the way: {listed}. " + text
    return text


def _strengths(effect: Named) -> str:
    shown = []
    for name, (value, interval) in effect.parameters.items():
        if "[" in name:  # a recording's own, in the tables
            continue
        shown.append(f"{name} = {value:.4g}{_within(interval)}")
    return "; ".join(shown)


def _within(limits: Limits) -> str:
    """The 95 % interval behind a value, in words where a side is open."""
    match limits:
        case None:
            return ""
        case None, None:
            return ", which these recordings do not tell"
        case low, None:
            return f", 95 % above {low:.4g}"
        case None, high:
            return f", 95 % below {high:.4g}"
        case low, high:
            return f", 95 % {low:.4g}–{high:.4g}"
