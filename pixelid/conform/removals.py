"""Effects that the base model has already: whether the recordings need them, by fitting without each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from pixelid import stages
from pixelid.errors import InputError
from pixelid.fit.maximise import Maximum, maximise
from pixelid.gap.attribute.pixels import PixelCandidates, candidates_of
from pixelid.gap.attribute.significance import chance_of_gain, leads
from pixelid.gap.options import Context
from pixelid.gap.state import State
from pixelid.model.model import Model, expected_parameters

BANDWIDTH = "photoreceptor_bandwidth"
IN_ANY_DENSITY = "threshold_noise"  # the density of event times needs it
STEPS = 25  # of the optimiser: what the missing effect did, the others have to learn


@dataclass(frozen=True)
class Removal:
    """What a fit loses without an effect.

    Attributes:
        gain, heldout_gain: Nats that the effect is worth, on pixels fitted and on pixels that no fit has seen.
        p: Chance of the gain, adjusted for all effects taken out.
        needed: Whether the gain is significant and holds on the pixels that no fit has seen.
    """

    gain: float
    heldout_gain: float
    p: float
    needed: bool


def removals(state: State, context: Context) -> dict[str, Removal]:
    """By name: effects of the final model that came with the base, and the photoreceptor's bandwidth as a whole."""
    fitted = state.hypothesis.fit.model
    named = {step.effect for step in state.steps}
    effects = [
        name
        for name, effect in stages.LIBRARY.items()
        if effect.in_event_times and fitted.has(name) and name not in {*named, IN_ANY_DENSITY}
    ]
    evidence = state.hypothesis.evidence.weighed(fitted.circuit())
    judged = candidates_of(evidence, fitted, None, context.cache, context.work)
    tried = len(effects) + 1
    told: dict[str, Removal] = {}
    for effect in effects:
        context.report(f"without {effect}", 0.97)
        less = _fitted(lambda effect=effect: judged.fit_without(effect, judged.base))
        if less is not None:
            told[effect] = _compared(judged, less, effect, tried, context)
    if fitted.photoreceptor != "unlimited":
        context.report(f"without {BANDWIDTH}", 0.98)
        less = _fitted(lambda: maximise(
            judged.evidence.fitting, without_bandwidth(fitted), tolerance=0.1, max_steps=STEPS, cache=context.cache
        ))  # fmt: skip
        if less is not None:
            told[BANDWIDTH] = _compared(judged, less, "second_order_photoreceptor", tried, context)
    return told


def without_bandwidth(model: Model) -> Model:
    """The model with a photoreceptor that follows the light at once, and without what needs another one."""
    effects = tuple(e for e in model.effects if "unlimited" in stages.effect(e).photoreceptors)
    wanted = expected_parameters("unlimited", effects)
    parameters = {name: model.parameters[name] for name in wanted}
    return replace(model, photoreceptor="unlimited", effects=effects, parameters=parameters)


def _fitted(fit: Callable[[], Maximum]) -> Maximum | None:
    try:
        return fit()
    except (InputError, FloatingPointError):
        return None


def _compared(judged: PixelCandidates, less: Maximum, effect: str, tried: int, context: Context) -> Removal:
    gain = judged.base.value - less.value
    held: np.ndarray = judged.held_out_gain(judged.base, less)
    p = chance_of_gain(effect, gain, tried)
    needed = p < context.options.alpha_each and leads(held, context.options.criteria)
    return Removal(gain, float(held.sum()), p, needed)
