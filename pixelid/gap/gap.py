"""Find the gap: lock, detect, localise, attribute, add, repeat, confirm (DESIGN §6), in one function."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pixelid import stages
from pixelid.errors import InputError
from pixelid.fit.result import Stopwatch
from pixelid.gap.candidates import missing
from pixelid.gap.directions import Direction, Space, confusion, direction, similarities, space
from pixelid.gap.distance import FreeRun, closes_nothing, free_run, leaves_much
from pixelid.gap.ledger import remembering
from pixelid.gap.maps import Cell
from pixelid.gap.nameless import nameless
from pixelid.gap.noise import STRENGTH
from pixelid.gap.pooled import pooled_gap
from pixelid.gap.readout import Fingerprint
from pixelid.gap.recommend import advice
from pixelid.gap.result import GapReport, Named
from pixelid.gap.search import Progress, Search, State
from pixelid.gap.verdict import sentence, shadowed, verdict
from pixelid.gap.words import where
from pixelid.gap.workbench import finer, relative_noise
from pixelid.model.model import Model
from pixelid.provenance import input_hashes, versions
from pixelid.recordings.recording import Recording

ALPHA = 0.01


def gap(
    recordings: Sequence[Recording],
    model: Model,
    *,
    alpha: float = ALPHA,
    seed: int = 0,
    leave_out: Sequence[str] = (),
    progress: Progress | None = None,
    resume: Path | None = None,
    recommend: bool = True,
) -> GapReport:
    """Search the recordings for effects that the model lacks.

    recordings: of one sensor, full-field stimuli;  model: the base, at its shipped values
    leave_out: effects that the library is to lack (to see what is said of what it does not know)
    alpha: chance of naming anything, or of "unknown", when the model is right;  progress(what, fraction) reports.
    resume: a file that keeps the fits made so far: a search interrupted and called again reads them back and comes to
    the same result; it is removed at the end;  recommend: also work out what to record next
    Raises InputError for recordings without pixels or stimulus, of several sensors, and a model that the event-time
    likelihood cannot use.
    """
    _check(recordings, model, alpha)
    report = progress or (lambda what, fraction: None)
    if all(r.pooled for r in recordings):
        return pooled_gap(recordings, model, alpha, seed, tuple(leave_out), report)
    with remembering(resume):
        return _searched(Search(recordings, model, alpha, seed, tuple(leave_out), report), recommend)


def _searched(search: Search, recommend: bool) -> GapReport:
    watch, report, alpha = Stopwatch(), search.report, search.alpha
    search.begin()
    search.read_timestamps()
    search.go_on()
    state, new = search.state, search.new_prints()
    remainder = search.remainder()
    term = nameless(state.bench, state.current, state.seen) if remainder else None
    report("what these stimuli can tell", 0.75)
    at = space(state.bench.train, state.current)
    directions = [d for d in (direction(at, name) for name in missing(state.current.model)) if d is not None]
    found = bool(search.steps or new or search.noise)
    shadow = shadowed(at, directions) if not found and not remainder else None
    rivals = [rival for _, rival in search.doubts]
    said = verdict(found, bool(rivals), remainder, shadow)
    report("intervals", 0.8)
    effects = (*(_printed(f, search) for f in new), *_effects(at, search), *_noise(search))
    report("free run", 0.85)
    run = _free_run(search) if effects else None
    withdrawn: list[str] = []
    if run is not None and closes_nothing(run, remainder):
        withdrawn = [effect.name for effect in effects]
        effects, run, remainder, said = (), None, True, "unknown"
    elif run is not None and search.noise is not None and leaves_much(run):  # its maps are compared roughly
        remainder, said = True, "unknown"
    report("what to record next", 0.95)
    noise = relative_noise(state.current.model)
    place = where(state.seen.maps, state.bench.train, state.seen.residual.stray, noise)
    report("done", 1.0)
    return GapReport(
        verdict=said,
        sentence=sentence(said, effects, rivals, shadow, run, place, term, state.seen.p),
        remainder=remainder,
        global_p=search.global_p,
        alpha=alpha,
        effects=effects,
        free_run=run,
        rounds=tuple(search.rounds),
        base=search.base.model,
        model=search.grown_model() if effects else search.base.model,
        term=term,
        recommended_next=advice(search, at, directions, shadow, remainder) if recommend else {},
        seconds=watch.seconds(),
        seed=search.seed,
        details=_details(search, directions, withdrawn),
        versions=versions(),
        inputs_sha256=input_hashes(r.source for r in search.recordings),
    )


def _check(recordings: Sequence[Recording], model: Model, alpha: float) -> None:
    if not recordings:
        raise InputError("no recordings to look at")
    if not 0.0 < alpha < 0.5:
        raise InputError(f"--alpha: expected a chance between 0 and 0.5, found {alpha:g}")
    pooled = [r.pooled for r in recordings]
    if any(pooled) and not all(pooled):
        raise InputError("some recordings are pooled and some have pixels; look for the gap of one kind at a time")
    if not all(pooled) and "threshold_noise" not in model.effects:
        raise InputError(f"model {model.name}: the search needs threshold_noise (add it with --with threshold_noise)")
    for recording in recordings:
        recording.check_stimulus_covers_events()


def _free_run(search: Search) -> FreeRun:
    """The gap before and after, on the pixels that nothing has looked at."""
    between, split = search.state.bench.between, search.split
    fine, undone = ([finer(r, between) for r in some] for some in (search.recordings, search.state.timely))
    watched = search.watched()
    sick = np.isin(watched, search.hot.pixels) if search.hot is not None else None
    everyone = np.union1d(split.train, split.confirm)
    return free_run(
        fine, undone, watched, everyone, len(split.train), search.base.model, search.grown_model(), search.seed, sick
    )


def _effects(at: Space, search: Search) -> tuple[Named, ...]:
    """Entries of the effects that the rounds named."""
    if not search.steps:
        return ()
    state: State = search.state
    interval = state.limits()
    found = []
    for step in search.steps:
        name = step.winner.effect
        others = [c for c in step.found.candidates if c.effect != name]
        second = max(others, key=lambda c: c.heldout_gain, default=None)
        alike = similarities(at, name, missing(state.current.model)) if state.current.model.has(name) else {}
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
                    p.name: (state.model.values[p.name], interval.get(p.name)) for p in stages.effect(name).parameters
                },
                where=step.where,
            )
        )
    return tuple(found)


def _printed(found: Fingerprint, search: Search) -> Named:
    """The entry of an effect read off timestamps or single pixels."""
    selected = sum(int(np.isin(r.events.pixel, search.split.select).sum()) for r in search.recordings)
    gain = found.nats_per_event * found.concerned * selected
    strength = {found.parameter: (found.value, found.interval)}
    return Named(found.effect, found.p, gain, None, None, 0.0, "", strength, found.where)


def _noise(search: Search) -> tuple[Named, ...]:
    """The entry of shot noise, whose gain is that of maps, not of a likelihood."""
    found = search.noise
    if found is None:
        return ()
    noise, stray = relative_noise(search.state.current.model), search.state.seen.residual.stray
    place = where(search.first.maps, search.state.bench.train, stray, noise)
    strength = {STRENGTH: (found.density, found.interval)}
    return (Named("shot_noise", search.noise_p, found.gain, None, None, 0.0, "", strength, place),)


def _details(search: Search, directions: Sequence[Direction], withdrawn: Sequence[str]) -> dict:
    split, seen = search.split, search.state.seen
    return {
        "stimulus_between_samples": search.state.bench.between,
        "pixels": {"fit": len(split.fit), "select": len(split.select), "confirm": len(split.confirm)},
        "held_out": split.apart,
        "withdrawn": list(withdrawn),
        "recordings_whose_times_are_lost": list(search.lost),
        "remaining_p": seen.p,
        "remaining": [_cell(c) for c in seen.maps.cells[:8]],
        "seen_before": [_cell(c) for c in search.first.maps.cells[:8]],
        "shows_at_typical_strength_nats": {d.effect: 0.5 * d.seen for d in directions},
        "confusion": confusion(directions),
    }


def _cell(cell: Cell) -> dict:
    return {
        "response": cell.response, "where": cell.label, "score": cell.score, "events": cell.events, "mean": cell.mean,
    }  # fmt: skip
