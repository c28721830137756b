"""The step that asks whether a right model would leave as much: a parametric bootstrap of the maps.

Scores are standard normal under a right model to first order.  Where that fails (at the crests of a flicker, say, where
how fast the change is at an event goes with how late it was) sessions simulated from the fitted model show the same
scores, and these are taken out of the cells (Efron & Tibshirani 1993, ch. 6).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from pixelid.fit.again import can_be_simulated, simulate_again
from pixelid.fit.cache import FitCache, map_fits
from pixelid.fit.maximise import Maximum
from pixelid.gap.criteria import Criteria
from pixelid.gap.detect.diagnostics import Diagnostics, diagnose
from pixelid.gap.detect.maps import Scores
from pixelid.gap.options import Context
from pixelid.gap.rounds import entry
from pixelid.gap.shot_noise.replicates import subtract_replicates
from pixelid.gap.state import State
from pixelid.likelihood.event_times import EventTimes

REPLICATES = 4


def bootstrap_remainder(state: State, context: Context) -> State:
    """The state with nothing left, where what is left is no more than sessions simulated from the model leave."""
    hypothesis, options = state.hypothesis, context.options
    seen, fit, training = hypothesis.seen, hypothesis.fit, hypothesis.evidence.training
    exact = hypothesis.corrected is None and hypothesis.jitter is None and not state.imputed
    of_maps = seen.p == seen.maps.p  # and not of events without a cause
    if not (exact and of_maps and state.remainder(options.alpha_each)) or training.unknown_light is not None:
        return state
    if not can_be_simulated(training.recordings, fit.model):
        return state
    context.report("sessions simulated from the model", 0.68)
    one = _OneBootstrap(training, fit, seen, options.criteria)
    seed_offset = 9001  # of the simulated sessions: none of other replicates' (31 apart) or twins' (101 apart)
    seeds = [options.seed + seed_offset + 31 * turn for turn in range(REPLICATES)]
    # Standard errors from zero that a cell's mean score over the replicates must be: of a thousand cells one in
    # sixteen is so by chance, and taking it out costs the measurement little more than a score of 2.
    clear = 4.0
    cells, p = subtract_replicates(seen, map_fits(context.work, one, seeds, context.cache), clear)
    told = entry(len(state.rounds) + 1, seen.p, bootstrap={"replicates": REPLICATES, "p_of_what_is_left": p})
    state = replace(state, rounds=(*state.rounds, told))
    if p < options.alpha_each:
        return state
    left = replace(seen, maps=replace(seen.maps, cells=cells, p=p), p=p)
    driven = not state.steps and state.global_p == min(1.0, 2.0 * seen.p)
    global_p = min(1.0, 2.0 * p) if driven else state.global_p
    return replace(state, hypothesis=replace(hypothesis, seen=left), global_p=global_p)


@dataclass(frozen=True)
class _OneBootstrap:
    """The scores of a session simulated from the fitted model, under that model.

    Scores are projected off what parameters can absorb: it need not be fitted again.
    """

    training: EventTimes
    fit: Maximum
    seen: Diagnostics
    criteria: Criteria

    def __call__(self, seed: int, cache: FitCache | None) -> Scores:
        training, model = self.training, self.fit.model
        made = EventTimes(simulate_again(training.recordings, model, training.flat_pixels, None, seed))
        likelihood = made.weighed(model.circuit())
        seen = diagnose(likelihood, self.fit, self.criteria, seed, background_fraction=None, like=self.seen.factors)
        return seen.maps.scores
