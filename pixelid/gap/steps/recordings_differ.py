"""The step that asks whether recordings differ in the level of their light, their clock, or where thresholds stand.

Recordings are made minutes apart.  Where one factor on the light of each, one delay, both, or one factor on its
thresholds (which a bias or a temperature has moved between them) explain all that is left, nothing is missing of the
pixel.  They have many values, so what explains as much with fewer comes first: effects that rounds name, which leave
nothing to ask for, and descriptions.

A drift of the thresholds goes on between recordings: each finds them where the drift has brought them.  Alone it leaves
that, and is not named; it is asked for once more together with such factors, and named where both leave nothing.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from pixelid.errors import InputError
from pixelid.fit.bench import is_of_bench
from pixelid.fit.maximise import Maximum, maximise
from pixelid.gap.attribute.attribute import Attribution, Candidate, may_be_named
from pixelid.gap.attribute.candidates import missing, remove_effect
from pixelid.gap.attribute.significance import chance_of_gain, leads, price
from pixelid.gap.detect.diagnostics import Diagnostics, diagnose
from pixelid.gap.detect.pixels import PixelEvidence, per_pixel
from pixelid.gap.options import Context
from pixelid.gap.phases import Phase
from pixelid.gap.rounds import attribution_entry, entry, withdrawn
from pixelid.gap.state import Hypothesis, State
from pixelid.gap.steps.describe_remainder import describe_remainder
from pixelid.gap.steps.name_effect import with_accepted
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.model import CLOCK_DELAY, LIGHT_GAIN, THRESHOLD_GAIN, Model

GAIN, DELAY, THRESHOLDS = LIGHT_GAIN.name, "delay_s", THRESHOLD_GAIN.name
KINDS = ((GAIN,), (DELAY,), (THRESHOLDS,), (GAIN, DELAY))
DRIFT = "threshold_drift"
# Delays tried of every recording.  Light of 400 Hz and a threshold of a fifth tell a quarter of a millisecond: from the
# nearest one a fit climbs to where the recording is.
DELAYS_S = tuple(2.5e-4 * k for k in range(-20, 21))
STEPS = 40
HOPELESS_P = 1e-4  # of what is left on a few pixels: on all of them more is.  It saves fits to those.
WHY = "recordings that differ explain it"


def ask_recordings(state: State, context: Context) -> State:
    """The state that is left to confirm where recordings that differ explain all; asked once."""
    if state.recordings_asked or not state.remainder(context.options.alpha_each):
        return state
    found = with_recordings_that_differ(state, context)
    if found is None:
        return replace(state, recordings_asked=True)
    amiss = state if state.turn else state.with_global_p()  # under the light and clocks as they were said
    return found.then(Phase.CONFIRM, global_p=amiss.global_p)


def with_recordings_that_differ(state: State, context: Context) -> State | None:
    """The state with the light's level or the clock of every recording its own, where that leaves nothing.

    None where something is left all the same, where the gain is chance, where descriptions explain as much with fewer
    values, and where recordings have no names of their own.
    """
    names = [r.name for r in state.hypothesis.recordings]
    if len(names) < 2 or len(set(names)) < len(names) or state.shot_noise is not None or state.imputed:
        return None
    trials = {0: state.steps[0].before} if state.steps else {}
    for kept, hypothesis in (trials | {len(state.steps): state.hypothesis}).items():
        if hypothesis.corrected is not None or hypothesis.jitter is not None or own_phases(hypothesis.fit.model):
            continue
        context.report("recordings that differ", 0.7)
        found, drift = _explained(hypothesis, context), None
        may_drift = DRIFT not in {*hypothesis.fit.model.effects, *context.options.leave_out, *state.given_up}
        if may_drift and (found is None or _own(found.fit.model, THRESHOLDS)):
            found, drift = _drifting(hypothesis, state.model, context) or (found, None)
        if found is not None:
            grown = describe_remainder(state, context).grown
            if grown is not None and _explains_more(grown.hypothesis.fit, found.fit, found.evidence.training):
                return None
            before = _without_later(state, kept)
            if drift is not None:
                before = _with_named(replace(before, hypothesis=hypothesis), drift)
            return _taken_over(before, found, context)
    return None


def _explains_more(one: Maximum, other: Maximum, events: EventTimes) -> bool:
    """Whether a fitted model is likelier than another by more than its values are worth, ½ ln n for each."""
    first, second = (
        events.log_likelihood(fit.model.circuit()) - price(len(fit.x), events.events) for fit in (one, other)
    )
    return first > second


def in_words(model: Model) -> str:
    """A sentence on how recordings differ; empty where they do not."""
    told = []
    gains = _own(model, GAIN)
    if gains:
        name = max(gains, key=lambda k: abs(math.log(gains[k])))
        told.append(
            f"light whose level is another than recordings say (by up to {100 * abs(gains[name] - 1.0):.2g} %, in "
            f"{name}, beside the recording with most events)"
        )
    delays = _own(model, DELAY)
    if delays:
        name = max(delays, key=lambda k: abs(delays[k]))
        told.append(f"clocks that are off (by up to {1e3 * abs(delays[name]):.3g} ms, in {name})")
    words = f" With {' and '.join(told)}: no part of the camera." if told else ""
    thresholds = _own(model, THRESHOLDS)
    if thresholds:
        name = max(thresholds, key=lambda k: abs(math.log(thresholds[k])))
        most = 100 * abs(thresholds[name] - 1.0)
        words += (
            f" With thresholds that differ from recording to recording (by up to {most:.2g} %, in {name}, beside the "
            "one with most events), as biases and temperature move them."
        )
    return words


def own_values(model: Model) -> dict[str, float]:
    """Of a model: what its recordings differ in, by the name of the parameter and the recording."""
    differ = (GAIN, DELAY, THRESHOLDS)
    return {n: p.value for n, p in model.nuisances.items() if n.split("[", 1)[0] in differ and p.prior is None}


def own_phases(model: Model) -> bool:
    """Whether recordings have values of their own that no bench states."""
    return any(not is_of_bench(name) or (p.prior is None and name in own_values(model))
               for name, p in model.nuisances.items())  # fmt: skip


def _own(model: Model, parameter: str) -> dict[str, float]:
    """Recording → its own value."""
    start = f"{parameter}["
    return {n[len(start) : -1]: p.value for n, p in model.nuisances.items() if n.startswith(start) and p.prior is None}


def _explained(hypothesis: Hypothesis, context: Context, among: Sequence[Sequence[str]] = KINDS) -> Hypothesis | None:
    """The hypothesis with what differs, of these kinds, where nothing is left then."""
    options = context.options
    evidence = hypothesis.evidence.weighed(hypothesis.fit.model.circuit())
    allowed = hypothesis.seen.allowed

    def left_by(fit: Maximum, pool: EventTimes) -> Diagnostics:
        return diagnose(pool, fit, options.criteria, options.seed, background_fraction=allowed)

    for kinds in among:
        roughly = _fitted(evidence.screening, _starts(evidence.screening, hypothesis, kinds), context)
        if roughly is None or left_by(roughly, evidence.screening).p < HOPELESS_P:
            continue
        fit = _fitted(evidence.training, [roughly.model], context)
        assert fit is not None
        seen = left_by(fit, evidence.training)
        if seen.p >= options.alpha_each and _is_no_chance(evidence, hypothesis, fit, context):
            start = replace(hypothesis.start, nuisances=fit.model.nuisances)
            return replace(hypothesis, evidence=evidence, fit=fit, seen=seen, start=start)
    return None


def _drifting(hypothesis: Hypothesis, base: Model, context: Context) -> tuple[Hypothesis, Candidate[Maximum]] | None:
    """(the hypothesis with a drift of thresholds that begins elsewhere in each recording, the drift), where both leave
    nothing and the drift may be named; None else.

    base: as shipped
    """
    grown = replace(
        hypothesis, start=hypothesis.start.with_effect(DRIFT),
        fit=replace(hypothesis.fit, model=hypothesis.fit.model.with_effect(DRIFT)),
    )  # fmt: skip
    found = _explained(grown, context, ((THRESHOLDS,),))
    if found is None:
        return None
    without = remove_effect(found.fit.model, DRIFT, base)
    end, less, held_out = _compared(found.evidence, found.fit.model, without, context)
    gain = end.value - less.value
    p = chance_of_gain(DRIFT, gain, len(missing(hypothesis.fit.model)))
    drift = Candidate(DRIFT, end, gain, p, held_out)
    return (found, drift) if may_be_named(drift, context.options) else None


def _compared(
    evidence: PixelEvidence, better: Model, worse: Model, context: Context
) -> tuple[Maximum, Maximum, np.ndarray]:
    """(one model, another on the fit pixels;  (pixels,) nats that the one gains on pixels that no fit has seen)."""
    one, other = (
        maximise(evidence.fitting, start, tolerance=0.05, max_steps=STEPS, cache=context.cache)
        for start in (better, worse)
    )
    return one, other, per_pixel(evidence.judging, one.model) - per_pixel(evidence.judging, other.model)


def _fitted(pool: EventTimes, starts: Iterable[Model], context: Context) -> Maximum | None:
    """The best end of fits from some starts; None without any."""
    ends = [maximise(pool, start, tolerance=0.02, max_steps=STEPS, cache=context.cache) for start in starts]
    return max(ends, key=lambda end: end.value, default=None)


def _starts(pool: EventTimes, hypothesis: Hypothesis, kinds: Sequence[str]) -> Iterator[Model]:
    """The model with what differs, from its fitted values and, as these may have been led astray, its shipped ones."""
    names = [r.name for r in pool.recordings]
    counts = np.bincount(pool.recording_of_event, minlength=len(names))
    most = names[int(np.argmax(counts))]
    stated = {name.split("[", 1)[0] for name in hypothesis.fit.model.nuisances}  # fitted already, about what is stated
    if (GAIN in kinds and GAIN in stated) or (DELAY in kinds and CLOCK_DELAY.name in stated):
        return
    for model in (hypothesis.fit.model, hypothesis.start):
        own: dict[str, dict[str, float]] = {}
        for factor in (GAIN, THRESHOLDS):
            if factor in kinds:  # one common to all is the camera's
                own[factor] = {name: 1.0 for name, n in zip(names, counts, strict=True) if name != most and n}
        if DELAY in kinds:
            best = np.argmax([_parts(pool, model.set({DELAY: delay})) for delay in DELAYS_S], axis=0)
            own[DELAY] = {name: DELAYS_S[k] for name, k, n in zip(names, best, counts, strict=True) if n}
        grown = model.with_nuisances(own)
        if np.isfinite(_parts(pool, grown)).all():
            yield grown


def _parts(pool: EventTimes, model: Model) -> np.ndarray:
    """(recordings,) log-likelihood of each, −∞ where it cannot be evaluated."""
    try:
        parts = pool.terms(model.circuit()).per_recording
    except (InputError, FloatingPointError):
        return np.full(len(pool.recordings), -np.inf)
    return np.where(np.isfinite(parts), parts, -np.inf)


def _is_no_chance(evidence: PixelEvidence, hypothesis: Hypothesis, fit: Maximum, context: Context) -> bool:
    """Whether the gain is significant, and there on pixels that no fit has seen, beyond what its values are worth."""
    options = context.options
    end, base, held_out = _compared(evidence, fit.model, hypothesis.fit.model, context)
    more = len(end.x) - len(base.x)
    p = len(KINDS) * float(chi2.sf(2.0 * max(end.value - base.value, 0.0), more))
    worth = float(held_out.sum()) > price(more, evidence.judging.events)
    return p < options.alpha_each and leads(held_out, options.criteria) and worth


def _without_later(state: State, kept: int) -> State:
    """The state with the first steps only."""
    rounds = state.rounds
    for step in state.steps[kept:]:
        rounds = withdrawn(rounds, step.effect, WHY)
    return replace(state, steps=state.steps[:kept], rounds=rounds)


def _with_named(state: State, drift: Candidate[Maximum]) -> State:
    """The state with a round more, which has named the drift; the hypothesis as it was."""
    hypothesis = state.hypothesis
    attribution = Attribution((drift,), {}, drift, (), {})
    told = attribution_entry(state.turn, hypothesis.fit, hypothesis.seen, attribution, {})
    asked = replace(state, rounds=(*state.rounds, told), turn=state.turn + 1)
    return with_accepted(asked, drift, attribution, True)


def _taken_over(state: State, found: Hypothesis, context: Context) -> State:
    """The state with what differs in its model and in its base."""
    own, left = own_values(found.fit.model), found.seen.p
    told = entry(len(state.rounds) + 1, state.hypothesis.seen.p, recordings_differ=own, p_of_what_is_left=left)
    base = found.fit
    if state.steps:
        start = replace(state.base.model, nuisances=found.fit.model.nuisances)
        base = maximise(found.evidence.training, start, tolerance=0.05, max_steps=STEPS, cache=context.cache)
    return replace(state, hypothesis=found, base=base, rounds=(*state.rounds, told))
