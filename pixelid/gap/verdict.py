"""From what was found to a verdict, and to sentences that say it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pixelid import stages
from pixelid.gap.attribute import Candidate
from pixelid.gap.directions import COLLINEAR, Direction, Space
from pixelid.gap.distance import FreeRun
from pixelid.gap.flexible import Flexible
from pixelid.gap.result import Named

FAINT = 5.0  # nats below which an effect goes unseen
SIGNIFICANT = 3.0  # standard errors


@dataclass(frozen=True)
class Shadow:
    """An effect that these stimuli cannot tell from an asymmetry of the thresholds.

    strength: of the effect that would explain the whole asymmetry found;  asymmetry: ln(C_on/C_off)
    """

    effect: str
    strength: float
    asymmetry: float


def shadowed(at: Space, directions: Sequence[Direction]) -> Shadow | None:
    """The effect that may hide behind the thresholds' asymmetry; None when there is none.

    It must move the two thresholds apart, hide behind the free parameters, and explain the asymmetry found: in sign,
    within its bounds, and unseen by these recordings at that strength.
    """
    names = at.climbed.coordinates.names
    if "on_threshold" not in names or "off_threshold" not in names:
        return None
    on, off = names.index("on_threshold"), names.index("off_threshold")
    asymmetry = float(at.climbed.x[on] - at.climbed.x[off])
    covariance = np.linalg.pinv(at.climbed.information)
    error = float(np.sqrt(covariance[on, on] + covariance[off, off] - 2.0 * covariance[on, off]))
    if abs(asymmetry) < SIGNIFICANT * error:
        return None
    for found in directions:
        moved = float(found.bias[on] - found.bias[off])
        if found.hidden < COLLINEAR or abs(moved) <= abs(float(found.bias[on] + found.bias[off])):
            continue
        strength = asymmetry / moved * found.strength
        parameter = next(p for p in stages.effect(found.effect).parameters if p.free)
        would_show = 0.5 * found.seen * (strength / parameter.value) ** 2
        if parameter.lower < strength < parameter.upper and would_show <= FAINT:
            return Shadow(found.effect, strength, asymmetry)
    return None


def verdict(named: bool, rivals: bool, remainder: bool, shadow: Shadow | None) -> str:
    """One of `result.VERDICTS`."""
    if remainder:
        return "unknown"
    if rivals or shadow is not None:
        return "ambiguous"
    return "named" if named else "none"


def sentence(
    said: str,
    effects: Sequence[Named],
    rivals: Sequence[Candidate],
    shadow: Shadow | None,
    run: FreeRun | None,
    where: str,
    term: Flexible | None,
    p: float,
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
    if said == "ambiguous" and shadow is not None:
        return (
            f"Under these stimuli {shadow.effect} and unequal thresholds look the same: ln(C_on/C_off) = "
            f"{shadow.asymmetry:.3g} may be just that, or {shadow.effect} of {shadow.strength:.3g}."
        )
    if said == "ambiguous":
        others = ", ".join(rival.effect for rival in rivals)
        return f"Something is missing, and these recordings cannot say which: {listed}, or {others}."
    text = f"Something is missing that no effect of the library explains: {where}."
    if term is not None:
        gain = float(term.held_out.sum())
        text += f" Thresholds that depend on {term.factor} gain {gain:.3g} nats on pixels not used to find them."
    if effects:
        text = f"Found on the way: {listed}. " + text
    return text


def _strengths(effect: Named) -> str:
    shown = []
    for name, (value, interval) in effect.parameters.items():
        bounds = f", 95 % {interval[0]:.4g}–{interval[1]:.4g}" if interval else ""
        shown.append(f"{name} = {value:.4g}{bounds}")
    return "; ".join(shown)
