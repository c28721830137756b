"""What might be missing: for every effect of the library the models that have it, at a few strengths to start from."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, product
from typing import Protocol

import numpy as np

from pixelid import stages
from pixelid.errors import InputError
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.model import Model
from pixelid.stages.circuit import Circuit
from pixelid.stages.effect import Effect

# Per event, below the best so far, from which no stronger one is tried: past the best the likelihood only falls.
MAX_LOSS_NATS = 0.1
# A slew limit is slow to fit: it is fitted where one of the strengths gains this much by itself.  A side that nothing
# slews at has no slope, so a fit leaves it where it is: sides are looked for one by one, from weak to tight.
MIN_SLEW_GAIN_NATS, SLEW_STEP, FINER_SLEW_STEPS = 0.5, 0.125, 8
UNFELT_NATS = 1e-3  # what a limit changes that nothing reaches, beside rounding of the likelihood
SLEW, RISE, FALL = "slew_limit", "slew_limit.rise_per_s", "slew_limit.fall_per_s"
SILENCE, DEAD_TIME = "dead_time_without_reset", "refractory_s"
# About the shipped β, for a second-order photoreceptor where there was none: of fast loops only one pole shows.
BETA_DECADES = (0.0, 1.0, 2.0)


def missing(model: Model) -> list[str]:
    """Effects of the library that the model lacks, can have, and the event-time likelihood knows."""
    return [name for name in _lacking(model) if why_not(model, name) is None]


def impossible(model: Model) -> dict[str, str]:
    """Effects of the library that a model of this structure cannot have (yet), and why."""
    reasons = {name: why_not(model, name) for name in _lacking(model)}
    return {name: reason for name, reason in reasons.items() if reason is not None}


def _lacking(model: Model) -> list[str]:
    return [name for name, effect in stages.LIBRARY.items() if effect.in_event_times and not model.has(name)]


def why_not(model: Model, effect: str) -> str | None:
    """Why a model of this structure cannot have the effect; None where it can."""
    if model.photoreceptor not in stages.effect(effect).photoreceptors:
        return f"a photoreceptor of kind {model.photoreceptor!r} cannot have it"
    asked = stages.effect(effect)
    if not all(map(model.has, asked.tried_after)):
        return f"as long as one of {' and '.join(asked.tried_after)} is missing, one more of its kind is that"
    if not all(map(model.has, asked.requires)):
        return f"the likelihood knows it with {' and '.join(asked.requires)} only"
    return None


def holds_together(model: Model) -> bool:
    """Whether a model of this structure can have all the effects that it has, and the likelihood knows them there."""
    there = [stages.effect(name) for name in model.effects]
    return all(model.photoreceptor in e.photoreceptors and all(map(model.has, e.requires)) for e in there)


def remove_effect(model: Model, effect: str, base: Model) -> Model:
    """The model without an effect that was added to a base: its photoreceptor is of the base's kind again."""
    kind = "one_pole" if base.photoreceptor == "second_order" else base.photoreceptor
    return model.without_effect(effect, photoreceptor_left=kind)


@dataclass(frozen=True)
class Tried:
    """A model with an effect at one strength, and what it explains.

    Attributes:
        model: With the effect.
        value: Log-likelihood.
        parts: (recordings,) of it, given the thresholds.
    """

    model: Model
    value: float
    parts: np.ndarray


def tried(likelihood: EventTimes, model: Model, effect: str) -> list[Tried]:
    """The model with the effect at each strength to try that can be evaluated.

    From weak to strong, until even what suits each recording best explains far less than a weaker one did.
    """
    if effect == SILENCE:
        return _evaluated(likelihood, _silences(likelihood, model))
    found: list[Tried] = []
    top = -np.inf
    for alike in by_strength(model, effect):
        some = _evaluated(likelihood, alike)
        found += some
        if some:
            shared = max(trial.value - trial.parts.sum() for trial in some)
            value = shared + float(np.max([trial.parts for trial in some], axis=0).sum())
            top = max(top, value)
            if value < top - MAX_LOSS_NATS * likelihood.events:
                break
    return found


def _evaluated(likelihood: EventTimes, trials: Iterable[Model]) -> list[Tried]:
    """Those of the trials that can be evaluated."""
    found = []
    for trial in trials:
        try:
            terms = likelihood.terms(trial.circuit())
        except (InputError, FloatingPointError):
            continue
        if np.isfinite(terms.total):
            found.append(Tried(trial, terms.total, terms.per_recording))
    return found


def strongest_start(
    likelihood: EventTimes, model: Model, effect: str, least: float = -np.inf, trials: Sequence[Tried] | None = None
) -> Model | None:
    """The model with the effect, at the strength among those tried that explains the events best.

    None if none can be evaluated, or (slew_limit, slow to fit) none explains more than `least`.  trials: `tried`, where
    known
    """
    if effect == SLEW:
        return strongest_slew_start(likelihood, model, least)
    known = tried(likelihood, model, effect) if trials is None else trials
    best = max(known, key=lambda trial: trial.value, default=None)
    return None if best is None else best.model


class Likelihood(Protocol):
    """Of events, by a circuit: of their times, or of their stamps."""

    @property
    def events(self) -> int: ...

    def log_likelihood(self, circuit: Circuit) -> float: ...


def strongest_slew_start(likelihood: Likelihood, model: Model, least: float) -> Model | None:
    """The model with the limits of both sides where they explain the events best, one looked for after the other.

    From limits far off, or those that the model has.  None if nothing explains more than `least`.
    """
    shipped = stages.effect(SLEW).parameters[0].value
    decades = stages.effect(SLEW).decades
    limits = (shipped * 10.0 ** np.arange(decades[-1], decades[0] - 1e-9, -SLEW_STEP)).tolist()  # from weak to tight
    best = model if model.has(SLEW) else model.with_effect(SLEW, {RISE: limits[0], FALL: limits[0]})
    top, found = max(_value(likelihood, best), least), False
    for turn, side in enumerate((RISE, FALL, RISE, FALL)):  # again, beside what was found of the other
        if turn == 2 and not found:
            return None
        peak, others = -np.inf, best
        for limit in _onward(limits, _last_unfelt(likelihood, others, side, limits)):
            value = _value(likelihood, trial := others.set({side: limit}))
            peak = max(peak, value)
            if value < peak - MAX_LOSS_NATS * likelihood.events:
                break  # the tighter the limit, the worse from here on
            if value > top + MIN_SLEW_GAIN_NATS:
                best, top, found = trial, value, True
    return best if found else None


def _onward(limits: Sequence[float], unfelt: int) -> list[float]:
    """Falling limits from the last one that is unfelt, finer up to the next: one that the fastest changes just touch
    may already be too tight there."""
    if unfelt + 1 == len(limits):
        return []
    finer = np.geomspace(limits[unfelt], limits[unfelt + 1], FINER_SLEW_STEPS + 1)
    return [*finer[:-1], *limits[unfelt + 1 :]]


def _last_unfelt(likelihood: Likelihood, model: Model, side: str, limits: Sequence[float]) -> int:
    """Index of the last of falling limits of a side at which nothing slews, by halving: tighter ones all act."""
    free = _value(likelihood, model.set({side: limits[0]}))
    unfelt, felt = 0, len(limits)
    while felt - unfelt > 1:
        middle = (unfelt + felt) // 2
        if abs(_value(likelihood, model.set({side: limits[middle]})) - free) < UNFELT_NATS:
            unfelt = middle
        else:
            felt = middle
    return unfelt


def _value(likelihood: Likelihood, model: Model) -> float:
    """Log-likelihood, −∞ where it cannot be evaluated."""
    try:
        value = likelihood.log_likelihood(model.circuit())
    except (InputError, FloatingPointError):
        return -np.inf
    return value if np.isfinite(value) else -np.inf


def _silences(likelihood: EventTimes, model: Model) -> Iterator[Model]:
    """The model with a dead time without reset, of each length to try on these events.

    Its end is sharp: it is looked for where intervals recur.  A dead time that resets may have stood in for it, and is
    tried as shipped as well.
    """
    grown = model.with_effect(SILENCE)
    silence = grown.parameter(f"{SILENCE}.s")
    for wait in likelihood.commonest_intervals_s():
        if silence.lower < wait < silence.upper:
            sized = grown.set({silence.name: wait})
            yield sized
            if DEAD_TIME in sized.free:
                shipped = next(p for p in stages.effect("refractory_period").parameters)
                yield sized.set({DEAD_TIME: min(sized.values[DEAD_TIME], shipped.value)})


def start_in_each(
    likelihood: EventTimes, model: Model, effect: str, trials: Sequence[Tried] | None = None
) -> tuple[Model, float] | None:
    """(the model with the effect, what starts anew in each recording free there;  its log-likelihood).

    Of the strengths tried, each with the values that suit each recording best, the one that explains the events best.
    None where nothing starts anew, or there are no several recordings of names of their own.  trials: `tried`, where
    known
    """
    anew = stages.effect(effect).starts_anew
    names = [recording.name for recording in likelihood.recordings]
    if not anew or len(names) < 2 or len(set(names)) < len(names):
        return None
    tables: dict[tuple, list[Tried]] = defaultdict(list)
    for trial in tried(likelihood, model, effect) if trials is None else trials:
        if np.isfinite(trial.parts).all():
            tables[tuple(v for name, v in trial.model.values.items() if name not in anew)].append(trial)
    best = max(tables.values(), key=lambda rows: np.max([row.parts for row in rows], axis=0).sum(), default=None)
    if best is None:
        return None
    which = np.argmax([row.parts for row in best], axis=0)
    values = {p: {name: best[i].model.values[p] for name, i in zip(names, which, strict=True)} for p in anew}
    grown = best[0].model.with_nuisances(values)
    return grown, likelihood.log_likelihood(grown.circuit())


def variants(model: Model, effect: str) -> Iterator[Model]:
    """The model with the effect at each strength to try, its own parameters free, from weak to strong."""
    return chain.from_iterable(by_strength(model, effect))


def by_strength(model: Model, effect: str, decades: Sequence[float] | None = None) -> Iterator[list[Model]]:
    """For each strength to try, from weak to strong, the models that have the effect at it, its own parameters free.

    They differ in sign, and in what is no strength: slope below a knee, frequency and phase of mains flicker.  decades:
    of the shipped strength, weaker ones negative; None: those where an effect is looked for
    """
    grown, asked = model.with_effect(effect), stages.effect(effect)
    if effect == "second_order_photoreceptor":
        yield from _second_orders(model, grown)
        return
    strength = grown.parameter(next(p.name for p in asked.parameters if p.free))
    signs = (1.0,) if strength.transform == "log" else (1.0, -1.0)
    if decades is None:
        decades = asked.decades[::-1] if asked.weakens else asked.decades
    elif asked.weakens:
        decades = [-decade for decade in decades]
    for decade in decades:
        values = [sign * 10.0**decade * strength.value for sign in signs]
        alike = [grown.set({strength.name: v}) for v in values if strength.lower < v < strength.upper]
        if effect == SLEW:
            alike = [sized.set({RISE: sized.values[RISE], FALL: sized.values[RISE]}) for sized in alike]
        others = [dict(zip(asked.tried_with, values, strict=True)) for values in product(*asked.tried_with.values())]
        yield [sized.set(other) for sized in alike for other in others]


def _second_orders(model: Model, grown: Model) -> Iterator[list[Model]]:
    """A second-order photoreceptor with the corner α/β of the one pole it grows from, or of any where there is none."""
    shipped = grown.parameter("alpha").value / grown.parameter("beta").value
    one_pole = model.photoreceptor == "one_pole"
    corners = [model.values["alpha_over_beta"]] if one_pole else [shipped * 10.0**d for d in reversed(Effect.decades)]
    betas = [grown.parameter("beta").value * 10.0**d for d in reversed(Effect.decades if one_pole else BETA_DECADES)]
    for corner in corners:
        made = [grown.set({"alpha": corner * beta, "beta": beta}) for beta in betas]
        yield from ([sized] for sized in made) if one_pole else [made]


def canonical(model: Model, nominal: Model) -> Model:
    """The model with the poles of follower and extra_pole in the order that suits the nominal follower better.

    Two first-order poles in a row change places without a trace: which is which is a convention.
    """
    if not (model.has("extra_pole") and model.has("source_follower_pole") and nominal.has("source_follower_pole")):
        return model
    follower, extra = model.values["sf_cutoff_hz"], model.values["extra_pole.cutoff_hz"]
    usual = nominal.values["sf_cutoff_hz"]
    if abs(math.log(extra / usual)) >= abs(math.log(follower / usual)):
        return model
    return model.set({"sf_cutoff_hz": extra, "extra_pole.cutoff_hz": follower})
