"""The step that supposes shot noise where even the leading effect leaves most events without a cause.

To the likelihood of the rounds strong shot noise is threshold noise of half a threshold and more, beside which every
other effect is misread: what a base lacks goes unseen, and what is named stands in for the noise.  So the noise that
the filter finds in what the base leaves is supposed, and effects are looked for in the likelihood that knows it.  It is
kept where replicates with it, and with what was named beside it, leave nothing.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pixelid.fit.again import can_be_simulated
from pixelid.fit.shot_noise import EFFECT, NOISE
from pixelid.gap.options import Context
from pixelid.gap.phases import Phase
from pixelid.gap.rounds import entry, withdrawn
from pixelid.gap.shot_noise.beside import settled_under_noise
from pixelid.gap.shot_noise.replicates import Corrected
from pixelid.gap.shot_noise.shares import Guess, with_shot_noise
from pixelid.gap.shot_noise.shot_noise import ShotNoise
from pixelid.gap.state import Hypothesis, State
from pixelid.gap.steps.name_beside_shot_noise import name_beside_shot_noise
from pixelid.gap.steps.name_effect import is_astray
from pixelid.likelihood.shot_noise import share_out

LEAVE_TOO_MUCH = "with what is missing beside it, something else is left"


def suppose_shot_noise(state: State, context: Context) -> State:
    """The state with shot noise and effects beside it, where together they leave nothing, or as it is."""
    options, first = context.options, state.steps[0].before
    if EFFECT in options.leave_out or state.imputed or not is_astray(state, context):
        return state
    noise = _supposed(first, context)
    if noise is None:
        return state
    bare = replace(first, corrected=noise.corrected)
    found = state.then(Phase.BESIDE_SHOT_NOISE, steps=(), hypothesis=bare, shot_noise=noise)
    while found.phase is Phase.BESIDE_SHOT_NOISE:
        found = name_beside_shot_noise(found, context)
    noise = found.shot_noise
    if not found.steps or noise is None or found.remainder(options.alpha_each):
        told = entry(len(found.rounds) + 1, first.seen.p, refused=f"{EFFECT}: {LEAVE_TOO_MUCH}")
        rounds = (*found.rounds, told)
        for step in found.steps:
            rounds = withdrawn(rounds, step.effect, LEAVE_TOO_MUCH)
        return replace(state, rounds=rounds)
    left = {"name": EFFECT, "density": noise.density, "p_of_what_is_left": noise.corrected.seen.p}
    rounds = (*found.rounds, entry(len(found.rounds) + 1, first.seen.p, by_simulation=left, named=EFFECT))
    for step in state.steps:
        if step.effect not in [one.effect for one in found.steps]:
            rounds = withdrawn(rounds, step.effect, f"{EFFECT} explains it")
    steps = (replace(found.steps[0], before=first, noise_before=None), *found.steps[1:])
    return replace(found, steps=steps, rounds=rounds, shot_noise_p=first.seen.p)


def _supposed(hypothesis: Hypothesis, context: Context) -> ShotNoise | None:
    """Shot noise as the filter has it in what a hypothesis leaves; None where it tells none, or it is not to be
    simulated."""
    options, training, fit = context.options, hypothesis.evidence.training, hypothesis.fit
    if NOISE not in fit.coordinates.names or not can_be_simulated(training.recordings, fit.model):
        return None
    found = share_out(training, fit.model.circuit(), options.seed)
    if found is None or found.gain < options.criteria.min_shot_noise_gain_nats:
        return None
    guess = Guess.first(fit, found)
    # a fit that took the noise for the thresholds' may have ended far off
    starts = guess.model, with_shot_noise(hypothesis.start, guess.density)
    ends = [settled_under_noise(hypothesis.evidence, start, context.cache)[1] for start in starts]
    model = max(ends, key=lambda end: end.value).model
    corrected = Corrected(model, np.zeros_like(fit.x), hypothesis.seen)
    return ShotNoise(guess.density, (0.0, np.inf), corrected, found.gain, np.inf)
