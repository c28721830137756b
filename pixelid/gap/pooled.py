"""The gap of pooled recordings: events without pixels, counted in bins, explained by the pooled rate.

What pooled counts cannot show is not tried: thresholds of single pixels, dead time, leaks (a background per polarity is
always fitted).  `stretches.py` holds the counts, their cells and their maps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from pixelid import stages
from pixelid.errors import InputError
from pixelid.fit.pooled import fit_pooled
from pixelid.fit.pooled_rate import PooledRateObjective
from pixelid.fit.result import Stopwatch
from pixelid.gap.attribute import LEADERS, WORTH, secure
from pixelid.gap.candidates import missing, variants
from pixelid.gap.distance import closes_nothing
from pixelid.gap.result import GapReport, Named
from pixelid.gap.stretches import (
    Fitted,
    Seen,
    Stretches,
    closed_gap,
    cut,
    mapped,
    nameless_factor,
    profiles,
    sorted_cells,
)
from pixelid.gap.verdict import sentence, verdict
from pixelid.model.model import Model
from pixelid.provenance import input_hashes, versions
from pixelid.recordings.recording import Recording

MOST_S = 3.0  # of each recording that the search looks at
UNSEEN = {"leak", "parasitic_photocurrent", "timestamp_jitter", "threshold_drift", "differencing_pole",
          "refractory_period", "threshold_mismatch", "threshold_noise"}  # fmt: skip
MOST_ROUNDS, STEPS = 3, 12
FLUID = "Part of it may be the pooled rate itself, a limit of many small thresholds that forgets the last one crossed."


@dataclass(frozen=True)
class Tried:
    """An effect fitted: quasi nats gained on the stretches fitted, adjusted p, quasi nats per select stretch."""

    effect: str
    end: Fitted
    gain: float
    p: float
    held_out: np.ndarray


@dataclass(frozen=True)
class Step:
    """An effect named: how it was tried, the runner-up, where the model was wrong before."""

    winner: Tried
    second: Tried | None
    where: str


def pooled_gap(
    recordings: Sequence[Recording], model: Model, alpha: float, seed: int, leave_out: Sequence[str],
    report: Callable[[str, float], None],
) -> GapReport:  # fmt: skip
    """Search pooled recordings for effects that the model lacks; arguments as of `gap`.

    Raises InputError for fewer than 100 events and stimuli that are missing or differ from pixel to pixel.
    """
    watch = Stopwatch()
    recordings = [_shortened(r) for r in recordings]
    report("base model", 0.02)
    objective, optimum, details, _ = fit_pooled(recordings, model, {}, lambda what, share: report(what, 0.3 * share))
    search = cut(objective.likelihood, details["dispersion"], seed)
    fitted = objective.coordinates.model_at(optimum.x)
    base = current = search.fitted(fitted, objective.coordinates.nuisances_at(optimum.x), search.part(0, 1), STEPS)
    cells = sorted_cells(search, base)
    first = seen = mapped(search, cells, base, seed)
    steps: list[Step] = []
    rounds: list[dict] = []
    rivals: list[str] = []
    for turn in range(MOST_ROUNDS):
        if seen.p >= alpha or rivals:
            break
        report(f"round {turn + 1}", 0.3 + 0.15 * turn)
        tried, screened = _tried(search, current, leave_out)
        rounds.append(_entry(turn, seen, current, tried, screened))
        if not tried or tried[0].p >= alpha or not secure(tried[0].held_out):
            break
        winner, second = tried[0], tried[1] if len(tried) > 1 else None
        rounds[-1]["named"] = winner.effect
        steps.append(Step(winner, second, seen.words))
        if second and second.p < alpha and not secure(winner.held_out - second.held_out):
            rivals.append(second.effect)
        current = search.fitted(winner.end.model, winner.end.nuisances, search.part(0, 1), STEPS)
        seen = mapped(search, cells, current, seed)
    report("confirm", 0.9)
    remainder = seen.p < alpha
    run = closed_gap(search, cells[0], base, current, seed) if steps else None
    withdrawn: list[str] = []
    if run is not None and closes_nothing(run, remainder):
        withdrawn = [step.winner.effect for step in steps]
        steps, current, run, seen, remainder = [], base, None, first, True
    effects = tuple(_named(step, current, _errors(search, current)) for step in steps)
    said = verdict(bool(effects), bool(rivals), remainder, None)
    report("done", 1.0)
    return GapReport(
        verdict=said,
        sentence=_words(said, effects, rivals, run, seen, nameless_factor(search, cells, current)),
        remainder=remainder,
        global_p=first.p,
        alpha=alpha,
        effects=effects,
        free_run=run,
        rounds=tuple(rounds),
        base=base.model,
        model=replace(current.model, name=f"{model.name}_grown") if effects else base.model,
        term=None,
        recommended_next={
            "why": "events with pixel addresses, under known light: pooled counts show neither thresholds nor resets",
            "stimulus": None,
        },
        seconds=watch.seconds(),
        seed=seed,
        details={
            "dispersion": search.dispersion,
            "seconds_used": MOST_S,
            "stimulus_between_samples": "as recorded",
            "held_out": True,
            "withdrawn": withdrawn,
            "remaining_p": seen.p,
            "remaining": seen.cells[:8],
            "seen_before": first.cells[:8],
            "shows_at_typical_strength_nats": {},
            "nuisances": current.nuisances,
            "not_in_pooled_counts": sorted(UNSEEN),
            "after_jumps": profiles(search, cells[0], base, current),
        },
        versions=versions(),
        inputs_sha256=input_hashes(r.source for r in recordings),
    )


def _entry(turn: int, seen: Seen, current: Fitted, tried: Sequence[Tried], screened: dict[str, float]) -> dict:
    return {
        "round": turn + 1,
        "p": seen.p,
        "screened_nats": screened,
        "model_effects": list(current.model.effects),
        "candidates": [
            {"name": t.effect, "gain_nats": t.gain, "p_value": t.p, "heldout_gain_nats": float(t.held_out.sum())}
            for t in tried
        ],
        "named": None,
        "refused": None,
    }


def _shortened(recording: Recording) -> Recording:
    """The first `MOST_S` of a recording."""
    stimulus = recording.stimulus
    if stimulus is None:
        raise InputError(f"{recording.name}: no stimulus; the gap is between a model's events and the measured ones")
    end = stimulus.t[0] + MOST_S
    shown = stimulus.t <= end + 0.1
    if shown.all():
        return recording
    events = recording.events.select(recording.events.t * 1e-9 <= end)
    return replace(recording, events=events).with_stimulus(
        replace(stimulus, t=stimulus.t[shown], radiance=stimulus.radiance[shown])
    )


def _tried(search: Stretches, current: Fitted, leave_out: Sequence[str]) -> tuple[list[Tried], dict[str, float]]:
    """(the leading effects, best first; quasi nats that each effect gains)."""
    shaped = any(r.stimulus is not None and r.stimulus.unit == "shape" for r in search.whole.recordings)
    skip = {*leave_out, *UNSEEN, *(("dark_current",) if shaped else ())}  # unknown offset of the light: the same thing
    effects = [e for e in missing(current.model) if e not in skip]
    part, nuisances = search.part(0), current.nuisances
    base = search.fitted(current.model, nuisances, part, STEPS)
    ends: dict[str, Fitted] = {}
    for effect in effects:
        best: tuple[float, Model] | None = None
        for trial in variants(base.model, effect):
            try:
                value = part.log_likelihood(part.expected(trial.circuit(), {**base.nuisances, **trial.values}))
            except (InputError, FloatingPointError):
                continue
            if np.isfinite(value) and (best is None or value > best[0]):
                best = value, trial
        if best is not None:
            ends[effect] = search.fitted(best[1], base.nuisances, part, STEPS)
    gains = {effect: end.value - base.value for effect, end in ends.items()}
    found = []
    for effect in sorted((e for e in gains if gains[e] > WORTH), key=lambda e: -gains[e])[:LEADERS]:
        degrees = sum(p.free for p in stages.effect(effect).parameters)
        p = min(1.0, 0.5 * len(effects) * float(chi2.sf(2.0 * gains[effect], degrees)))
        found.append(Tried(effect, ends[effect], gains[effect], p, search.by_stretch(1, ends[effect], base)))
    return found, gains


def _errors(search: Stretches, model: Fitted) -> dict[str, float]:
    """Standard errors of the coordinates, scaled by the dispersion."""
    objective = PooledRateObjective(search.part(0, 1), model.coordinates)
    covariance = np.linalg.pinv(objective.local(model.x).information) * search.dispersion
    return dict(zip(model.coordinates.names, np.sqrt(np.maximum(np.diag(covariance), 0.0)), strict=True))


def _named(step: Step, model: Fitted, errors: dict[str, float]) -> Named:
    parameters = {}
    for parameter in stages.effect(step.winner.effect).parameters:
        value, interval = model.model.values[parameter.name], None
        if parameter.name in errors:
            x, reach = parameter.to_coordinate(value), 1.96 * errors[parameter.name]
            low, high = (float(parameter.from_coordinate(float(np.clip(c, -300, 300)))) for c in (x - reach, x + reach))
            interval = max(low, parameter.lower), min(high, parameter.upper)
        parameters[parameter.name] = value, interval
    second = step.second
    return Named(
        step.winner.effect, step.winner.p, float(step.winner.held_out.sum()), second.effect if second else None,
        float(second.held_out.sum()) if second else None, 0.0, "", parameters, step.where,
    )  # fmt: skip


def _words(said, effects: Sequence[Named], rivals: Sequence[str], run, seen: Seen, term: tuple[str, float]) -> str:
    if said == "unknown":
        text = f"Something is missing that no effect of the library explains: {seen.words}."
        if term[0]:
            text += f" Rates that depend on {term[0]} gain {term[1]:.3g} nats on stretches not used to find them."
        text += f" {FLUID}"
        listed = "; ".join(e.name for e in effects)
        return (f"Found on the way: {listed}. " if listed else "") + text
    if said == "ambiguous":
        return (
            f"Something is missing, and these recordings cannot say which: {effects[0].name}, or {', '.join(rivals)}."
        )
    return sentence(said, effects, (), None, run, seen.words, None, seen.p)
