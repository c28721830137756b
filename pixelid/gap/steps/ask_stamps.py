"""The step that asks the stamps for what times drawn without it hide.

Times behind a jitter or a coarse tick follow the model that they are drawn from, and speak against every other.  A
limit of the slew forbids them outright: no limit is worth a fit beside them, and many events are left without a cause.
A pole more hides behind slower ones that the model has: between them lies a valley, in which times drawn follow
neither.  So both are looked for on the stamps, with all times summed over that they can stand for
(`imputation/lattice.py`): the model is followed to times of its own, and what it gains is asked of the stamps again.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from pixelid.fit.maximise import Maximum
from pixelid.gap.attribute.attribute import Attribution, Candidate, may_be_named
from pixelid.gap.attribute.candidates import SLEW, canonical, missing, remove_effect, strongest_slew_start
from pixelid.gap.attribute.significance import chance_of_gain
from pixelid.gap.imputation.impute import FAST, impute_with_effect, with_nominal_fast_poles
from pixelid.gap.imputation.imputed import Imputation
from pixelid.gap.imputation.paths import Lights, draw_paths, is_summed_whole
from pixelid.gap.options import Context, Options
from pixelid.gap.phases import Phase
from pixelid.gap.rounds import attribution_entry
from pixelid.gap.state import State
from pixelid.gap.steps.name_effect import at_times_anew, is_astray, with_accepted
from pixelid.model.model import Model
from pixelid.stages.circuit import Circuit


@dataclass(frozen=True)
class Stamps:
    """The stamps of some recordings as evidence: each pixel's chain of events is summed over its windows.

    imputation: Their windows, and the times drawn last: these tell each pixel's thresholds and the order of its stamps.
    lights: What circuits made of the light before.
    """

    imputation: Imputation
    lights: Lights = field(default_factory=Lights)

    @property
    def events(self) -> int:
        """Number of stamps."""
        return sum(len(r.events) for r in self.imputation.fine)

    def per_pixel(self, circuit: Circuit) -> np.ndarray:
        """(pixels,) nats, in order of the pixels."""
        imputation, rng = self.imputation, np.random.default_rng(0)  # of times that are not used
        return draw_paths(imputation.fine, imputation.windows, imputation.times, circuit, rng, self.lights).per_pixel

    def log_likelihood(self, circuit: Circuit) -> float:
        """Nats."""
        return float(self.per_pixel(circuit).sum())


POLE = "extra_pole"
EVENTS = 1_500  # of the pixels that limits are tried on: some forty of them, half a second each


def ask_stamps(state: State, context: Context) -> State:
    """The state with an effect named that the stamps ask for, and another round; else as it is."""
    imputation, model = state.imputation, state.hypothesis.fit.model
    if imputation is None or not imputation.by_paths or not is_summed_whole(model.circuit()):
        return state
    effect = SLEW if is_astray(state, context) else POLE
    if effect not in missing(model) or effect in {*context.options.leave_out, *state.given_up, *state.stamps_asked}:
        return state
    state = replace(state, stamps_asked=state.stamps_asked | {effect})
    context.report(f"{effect}, of the stamps", 0.6)
    if effect == POLE:
        start = split_pole(model, state.hypothesis.start)
    else:
        few = Stamps(imputation.of(state.split.fit).few(EVENTS, np.random.default_rng(0)))
        start = strongest_slew_start(few, model, few.log_likelihood(model.circuit()))
    return state if start is None else _asked(state, imputation, effect, start, context)


def split_pole(model: Model, nominal: Model) -> Model | None:
    """The model with a pole more and its others as shipped, in all as late as before; None where that is no later.

    nominal: as shipped, with every effect that the model has
    """
    shipped = with_nominal_fast_poles(model, nominal)
    late, usual = (sum(1.0 / each.values[name] for name in FAST) for each in (model, shipped))
    least_split = 0.1  # of the lateness of the poles, that a pole more must take: less is how cameras differ
    if late - usual < least_split * late:
        return None
    return shipped.with_effect(POLE, {"cutoff_hz": 1.0 / (late - usual)})


def _asked(state: State, before: Imputation, effect: str, start: Model, context: Context) -> State:
    """The state with a round more; with the effect, and times drawn with it, where the stamps ask for it."""
    hypothesis, options = state.hypothesis, context.options
    imputation, model = impute_with_effect(before, start, options, context.cache)
    model = canonical(model, state.model)
    base = _Followed(before, hypothesis.fit.model)
    winner = _candidate(state, base, _Followed(imputation, model), effect)
    able = _gains(winner, options)
    if able:  # the model without it may owe its lower place to its other values, which went on moving with the effect
        less = remove_effect(model, effect, state.model)
        again = _Followed(*impute_with_effect(imputation, less, options, context.cache))
        fairer = _candidate(state, again, _Followed(imputation, model), effect)
        winner = min(winner, fairer, key=lambda c: c.gain)
        able = _gains(winner, options)
    attribution = Attribution((winner,), {}, winner if able else None, (), {})
    told = attribution_entry(state.turn, hypothesis.fit, hypothesis.seen, attribution, {})
    asked = replace(state, rounds=(*state.rounds, {**told, "by_stamps": True}), turn=state.turn + 1)
    if not able:
        return asked
    asked = replace(with_accepted(asked, winner, attribution, True), imputation=imputation)
    return at_times_anew(asked, model, hypothesis.start.with_effect(effect), context).then(Phase.NAME)


@dataclass(frozen=True)
class _Followed:
    """Times that a model was followed to, and where it ended."""

    imputation: Imputation
    model: Model

    def explained(self, pixels: np.ndarray) -> np.ndarray:
        """(pixels,) log-likelihood of their stamps."""
        return Stamps(self.imputation.of(pixels)).per_pixel(self.model.circuit())


def _gains(candidate: Candidate, options: Options) -> bool:
    return candidate.gain > options.criteria.min_stamps_gain_nats and may_be_named(candidate, options)


def _candidate(state: State, without: _Followed, with_effect: _Followed, effect: str) -> Candidate[Maximum]:
    """What a model with an effect gains on stamps, with and without it at times of its own."""
    fit, split = state.hypothesis.fit, state.split
    gain, held_out = (with_effect.explained(part) - without.explained(part) for part in (split.fit, split.select))
    p = chance_of_gain(effect, float(gain.sum()), len(missing(fit.model)))
    return Candidate(effect, replace(fit, model=with_effect.model), float(gain.sum()), p, held_out)
