"""Find the gap: lock, detect, localise, attribute, add, repeat, confirm (DESIGN §6), in one function."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from pixelid import stages
from pixelid.errors import InputError
from pixelid.fit.result import Stopwatch
from pixelid.gap.attribute import Attribution, Candidate, Pools, attribute, secure
from pixelid.gap.candidates import canonical, missing
from pixelid.gap.climb import Climbed, climbed, per_pixel
from pixelid.gap.covariates import factors
from pixelid.gap.directions import Direction, Space, direction, similarities, space
from pixelid.gap.distance import free_run
from pixelid.gap.flexible import Flexible, flexible
from pixelid.gap.hot import hot_pixels
from pixelid.gap.intervals import limits
from pixelid.gap.maps import Cell
from pixelid.gap.readout import Fingerprint, fingerprints
from pixelid.gap.recommend import blindest, recommended
from pixelid.gap.residuals import residuals
from pixelid.gap.restored import restored, unjittered
from pixelid.gap.result import GapReport, Named
from pixelid.gap.split import locked, only
from pixelid.gap.verdict import Shadow, sentence, shadowed, verdict
from pixelid.gap.words import where
from pixelid.gap.workbench import STRAYS_EXPECTED, Look, Workbench, based, look, reconsidered, relative_noise, workbench
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.model import Model
from pixelid.provenance import input_hashes, versions
from pixelid.recordings.recording import Recording
from pixelid.stimuli.resample import resampled

Progress = Callable[[str, float], None]
ALPHA = 0.01
MOST_ROUNDS = 4
CLOSES = 0.1  # of the gap that effects found on the way to `unknown` must close, or they are withdrawn
REMAINS = 0.5  # of its gain an effect must keep beside a nameless term that gains more than it does


@dataclass(frozen=True)
class Step:
    """One effect named: the candidate, what was tried beside it, where the model was wrong before, in words."""

    winner: Candidate
    found: Attribution
    where: str


def gap(
    recordings: Sequence[Recording],
    model: Model,
    *,
    alpha: float = ALPHA,
    seed: int = 0,
    leave_out: Sequence[str] = (),
    progress: Progress | None = None,
) -> GapReport:
    """Search the recordings for effects that the model lacks.

    recordings: of one sensor, full-field stimuli;  model: the base, at its shipped values
    leave_out: effects that the library is to lack (to see what is said of what it does not know)
    alpha: chance of naming anything, or of "unknown", when the model is right;  progress(what, fraction) reports.
    Raises InputError for recordings without pixels or stimulus, of several sensors, and a model that the event-time
    likelihood cannot use.
    """
    watch = Stopwatch()
    report = progress or (lambda what, fraction: None)
    _check(recordings, model, alpha)
    split = locked(recordings, seed)
    report("base model", 0.02)
    timely = [r.within_stimulus() for r in recordings]
    bench, base = based(timely, split, model, seed)
    seen = first = look(bench, base)
    rounds: list[dict] = []
    steps: list[Step] = []
    report("timestamps", 0.06)
    prints = [f for f in fingerprints(recordings) if f.effect not in leave_out]
    lost: tuple[str, ...] = ()
    told: dict[str, tuple[float, float]] = {}  # intervals of what is held from then on
    jitter, jittered = 0.0, ()  # what true times have been drawn behind, and so is no longer in the likelihood
    hot = None if "hot_pixels" in leave_out or model.has("hot_pixels") else hot_pixels(timely)
    if hot is not None:
        rounds.append(_stamped(hot.print, False))
        split = split.without(hot.pixels)
        timely = only(timely, split.everyone)
    for found in prints:
        rounds.append(_stamped(found, model.has(found.effect)))
        kept = restored(timely, found, model, seed, lambda what: report(what, 0.08))
        timely, lost = list(kept.recordings), lost + kept.lost
        model = model.with_effect(found.effect, {found.parameter: found.value}).fix({found.parameter: None})
    if prints or hot:
        bench, current = based(timely, split, model, seed)
        seen = look(bench, current, trust_strays=not prints)
    else:
        current = base
    start = bench.nominal
    new = [f for f in prints if f.effect not in base.model.effects]
    if hot is not None:
        new.append(hot.print)
    rivals: tuple[Candidate, ...] = ()
    for turn in range(MOST_ROUNDS):
        share = 0.1 + 0.6 * turn / MOST_ROUNDS
        bent = seen.stray_fraction > STRAYS_EXPECTED or not current.converged
        found = attribute(
            bench.pools, current.model, alpha, skip=(*jittered, *leave_out), restart=start if bent else None,
            report=lambda what, turn=turn, share=share: report(f"round {turn + 1}: {what}", share),
        )  # fmt: skip
        entry = _entry(turn, current, seen, found)
        rounds.append(entry)
        winner = found.winner
        if winner is None:
            break
        if not _stands_beside_nameless(bench, current, winner, alpha):
            entry["refused"] = f"{winner.effect}: a nameless term explains more, and leaves it little to explain"
            break
        entry["named"] = winner.effect
        steps.append(
            Step(winner, found, where(seen.maps, bench.train, seen.residual.stray, relative_noise(current.model)))
        )
        start = start.with_effect(winner.effect)
        bench.train.weigh_clock(current.model.circuit())
        current = climbed(bench.train, canonical(winner.end.model, model), tolerance=0.01, max_steps=40)
        bench, current = reconsidered(bench, timely, model, current)
        if winner.effect == "timestamp_jitter":
            bench.train.weigh_clock(current.model.circuit())
            current = climbed(bench.train, current.model, tolerance=0.01, max_steps=20)
            jitter = current.values["timestamp_jitter.sigma_s"]
            told["timestamp_jitter.sigma_s"] = limits(bench.train, current)["timestamp_jitter.sigma_s"]
            first_guess = jitter
            timely, jitter, exact = unjittered(timely, jitter, current.model, seed)
            low, high = told["timestamp_jitter.sigma_s"]
            # two estimates, by the width of levels and by the draws: what they differ by belongs to the interval
            told["timestamp_jitter.sigma_s"] = (
                min(low, low * jitter / first_guess),
                max(high, high * jitter / first_guess),
            )
            jittered = ("timestamp_jitter",)
            bench = workbench(timely, split, exact, bench.between, seed)
            current = climbed(bench.train, exact, tolerance=0.01, max_steps=40)
        seen = look(bench, current, trust_strays=not (prints or jittered))
        rivals = found.rivals
        if rivals:
            break
    report("what these stimuli can tell", 0.75)
    remainder = seen.p < alpha
    term = nameless(bench, current) if remainder else None
    at = space(bench.train, current)
    directions = [d for d in (direction(at, name) for name in missing(current.model)) if d is not None]
    shadow = shadowed(at, directions) if not steps and not new and not remainder else None
    said = verdict(bool(steps or new), bool(rivals), remainder, shadow)
    report("intervals", 0.8)
    selected = sum(int(np.isin(r.events.pixel, split.select).sum()) for r in recordings)
    whole = current.model if not jittered else current.model.with_effect(*jittered, {"sigma_s": jitter})
    if hot is not None:
        whole = whole.with_effect("hot_pixels", {"rate_hz": hot.print.value, "count": len(hot.pixels)})
    effects = (*(_printed(f, selected) for f in new), *_effects(bench, at, current, whole, steps, told))
    report("free run", 0.85)
    run = None
    if effects:
        fine = [r.with_stimulus(resampled(r.stimulus, bench.between)) for r in recordings]  # type: ignore[arg-type]
        sensor = len(np.union1d(split.train, split.confirm))
        undone = [r.with_stimulus(resampled(r.stimulus, bench.between)) for r in timely]  # type: ignore[arg-type]
        watched = split.confirm if hot is None else np.union1d(split.confirm, hot.pixels)
        sick = np.isin(watched, hot.pixels) if hot is not None else None
        run = free_run(fine, undone, watched, sensor, len(split.train), base.model, whole, seed, sick)
    withdrawn: list[str] = []
    if remainder and run is not None and run.closed is not None and run.closed < CLOSES:
        withdrawn = [effect.name for effect in effects]
        effects, run, whole = (), None, base.model
    report("what to record next", 0.95)
    place = where(seen.maps, bench.train, seen.residual.stray, relative_noise(current.model))
    advice = _advice(at, current, directions, steps, rivals, shadow, remainder, seen, bench)
    report("done", 1.0)
    return GapReport(
        verdict=said,
        sentence=sentence(said, effects, rivals, shadow, run, place, term, seen.p),
        remainder=bool(remainder),
        global_p=min([first.p, *(f.p for f in new)]),
        alpha=alpha,
        effects=effects,
        free_run=run,
        rounds=tuple(rounds),
        base=base.model,
        model=replace(whole, name=f"{model.name}_grown") if effects else whole,
        term=term,
        recommended_next=advice,
        seconds=watch.seconds(),
        seed=seed,
        details={
            "stimulus_between_samples": bench.between,
            "pixels": {"fit": len(split.fit), "select": len(split.select), "confirm": len(split.confirm)},
            "held_out": split.apart,
            "withdrawn": withdrawn,
            "recordings_whose_times_are_lost": list(lost),
            "remaining_p": seen.p,
            "remaining": [_cell(c) for c in seen.maps.cells[:8]],
            "seen_before": [_cell(c) for c in first.maps.cells[:8]],
            "shows_at_typical_strength_nats": {d.effect: 0.5 * d.seen for d in directions},
        },
        versions=versions(),
        inputs_sha256=input_hashes(r.source for r in recordings),
    )


def _check(recordings: Sequence[Recording], model: Model, alpha: float) -> None:
    if not recordings:
        raise InputError("no recordings to look at")
    if not 0.0 < alpha < 0.5:
        raise InputError(f"--alpha: expected a chance between 0 and 0.5, found {alpha:g}")
    if "threshold_noise" not in model.effects:
        raise InputError(f"model {model.name}: the search needs threshold_noise (add it with --with threshold_noise)")
    for recording in recordings:
        if recording.pooled:
            raise InputError(f"{recording.name}: pooled events have no pixels; the search compares pixels")
        recording.check_stimulus_covers_events()


def nameless(bench: Workbench, current: Climbed) -> Flexible | None:
    """The nameless term on what the fit pixels leave, judged on the select pixels."""
    held = bench.pools.select
    fit = bench.pools.fit
    parts = []
    for likelihood in (fit, held):
        here = residuals(likelihood, current.model.circuit())
        parts.append((likelihood, here, factors(likelihood, here)))
    return flexible(parts[0], parts[1])


def _stands_beside_nameless(bench: Workbench, current: Climbed, winner: Candidate, alpha: float) -> bool:
    """Whether the winner is still wanted when a nameless term may take its place.

    Asked only where the nameless term gains more on held-out pixels than the winner: then the term's shifts become
    part of the thresholds, the model is fitted with and without the effect, and the effect must keep enough gain.
    """
    term = nameless(bench, current)
    if term is None or float(term.held_out.sum()) < winner.heldout_gain:
        return True
    sigma = relative_noise(current.model)
    pools = Pools(
        *(_shifted(part, current, term, sigma) for part in (bench.pools.scout, bench.pools.fit, bench.pools.select))
    )
    without = climbed(pools.fit, current.model, tolerance=0.05, max_steps=25)
    beside = climbed(pools.fit, winner.end.model, tolerance=0.05, max_steps=25)
    gain = beside.value - without.value
    degrees = sum(p.free for p in stages.effect(winner.effect).parameters)
    p = len(missing(current.model)) * 0.5 * float(chi2.sf(2.0 * max(gain, 0.0), degrees))
    held = per_pixel(pools.select, beside.model) - per_pixel(pools.select, without.model)
    return p < alpha and secure(held) and gain > REMAINS * winner.gain


def _shifted(likelihood: EventTimes, current: Climbed, term: Flexible, sigma: float) -> EventTimes:
    """The same events with the nameless term's shifts as part of their thresholds."""
    here = residuals(likelihood, current.model.circuit())
    alike = (f for f in factors(likelihood, here) if f.name == term.factor and set(f.labels) & set(term.labels))
    factor = next(alike, None)
    if factor is None:  # slices follow the quantiles of each pool: these share none with the term's
        return likelihood
    shift = dict(zip(term.labels, term.shift, strict=True))
    by_cell = np.array([shift.get(label, 0.0) for label in factor.labels])
    moved = EventTimes(likelihood.recordings)
    moved.threshold_factor = np.exp(sigma * by_cell[factor.cell])
    return moved


def _effects(
    bench: Workbench,
    at: Space,
    current: Climbed,
    whole: Model,
    steps: Sequence[Step],
    told: dict[str, tuple[float, float]],
) -> tuple[Named, ...]:
    if not steps:
        return ()
    interval = {**limits(bench.train, current), **told}
    found = []
    for step in steps:
        name = step.winner.effect
        others = [c for c in step.found.candidates if c.effect != name]
        second = max(others, key=lambda c: c.heldout_gain, default=None)
        named_here = current.model.has(name)
        alike = similarities(at, name, missing(current.model)) if named_here else {}
        nearest = max(alike, key=lambda k: alike[k], default="")
        found.append(
            Named(
                name=name,
                p_value=step.winner.p,
                heldout_gain=step.winner.heldout_gain,
                runner_up=second.effect if second else None,
                runner_up_gain=second.heldout_gain if second else None,
                max_cosine=alike.get(nearest, 0.0),
                max_cosine_with=nearest,
                parameters={
                    p.name: (whole.values[p.name], interval.get(p.name)) for p in stages.effect(name).parameters
                },
                where=step.where,
            )
        )
    return tuple(found)


def _printed(found: Fingerprint, selected: int) -> Named:
    """The entry of an effect read off the timestamps; selected: events of the select pixels."""
    gain = found.nats_per_event * found.concerned * selected
    strength = {found.parameter: (found.value, found.interval)}
    return Named(found.effect, found.p, gain, None, None, 0.0, "", strength, found.where)


def _stamped(found: Fingerprint, known: bool) -> dict:
    return {
        "round": 0,
        "p": found.p,
        "timestamps": found.where,
        "candidates": [],
        "named": None if known else found.effect,
        "refused": None,
    }


def _entry(turn: int, current: Climbed, seen: Look, found: Attribution) -> dict:
    return {
        "round": turn + 1,
        "p": seen.p,
        "strays": seen.maps.strays,
        "model_effects": list(current.model.effects),
        "screened_nats": found.screened,
        "candidates": [
            {"name": c.effect, "gain_nats": c.gain, "p_value": c.p, "heldout_gain_nats": c.heldout_gain}
            for c in found.candidates
        ],
        "named": None,
        "refused": None,
    }


def _cell(cell: Cell) -> dict:
    return {
        "response": cell.response, "where": cell.label, "score": cell.score, "events": cell.events, "mean": cell.mean,
    }  # fmt: skip


def _advice(
    at: Space, current: Climbed, directions: Sequence[Direction], steps: Sequence[Step],
    rivals: Sequence[Candidate], shadow: Shadow | None, remainder: bool, seen: Look, bench: Workbench,
) -> dict:  # fmt: skip
    if remainder:
        cell = seen.maps.cells[0] if seen.maps.cells else None
        where_ = cell.label if cell else "the recordings as they are"
        return {
            "why": f"the remainder is clearest here: {where_}; record more pixels and longer there",
            "stimulus": None,
        }
    if shadow is not None:
        why = f"to tell {shadow.effect} from unequal thresholds"
        return recommended(at, current.model, shadow.effect, None, why, bench.seed)
    if rivals:
        without = current.model.without_effect(steps[-1].winner.effect)
        lacking = space(bench.train, climbed(bench.train, without, tolerance=0.1, max_steps=5))
        why = f"to tell {steps[-1].winner.effect} from {rivals[0].effect}"
        return recommended(lacking, without, steps[-1].winner.effect, rivals[0].effect, why, bench.seed)
    blind = blindest(directions)
    if blind is None:
        return {"why": "nothing: every effect of the library is in the model", "stimulus": None}
    why = f"to see {blind.effect}, the effect these recordings would show least at its typical strength"
    return recommended(at, current.model, blind.effect, None, why, bench.seed)
