"""Search the gap of recordings, then say of every effect of the signal path whether they have it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pixelid import stages
from pixelid.cluster import Where, Work, connected
from pixelid.conform.fold import Beside, rows_of
from pixelid.conform.removals import removals
from pixelid.conform.result import ConformReport
from pixelid.fit.cache import FitCache
from pixelid.gap.criteria import Criteria
from pixelid.gap.fold import fold
from pixelid.gap.gap import check_searchable, with_doubts
from pixelid.gap.options import ALPHA, Context, Options, Report
from pixelid.gap.phases import Phase
from pixelid.gap.pooled_counts.pooled import search_pooled
from pixelid.gap.result import GapReport
from pixelid.gap.search import STEPS, begin
from pixelid.gap.state import State
from pixelid.gap.steps.confirm import confirm, without
from pixelid.gap.steps.numbers import intervals_of
from pixelid.inspection.hot_pixels import MIN_PIXELS, MIN_SILENT_EVENTS, quiet_seconds
from pixelid.inspection.tick import MIN_EVENTS
from pixelid.inspection.timestamps import MIN_ATOM_EVENTS, TimestampSignature
from pixelid.model.model import Model
from pixelid.recordings.recording import Recording
from pixelid.recordings.selection import named_apart


def conform(
    recordings: Sequence[Recording],
    model: Model,
    *,
    alpha: float = ALPHA,
    seed: int = 0,
    progress: Report | None = None,
    resume: Path | None = None,
    where: Where | None = None,
) -> ConformReport:
    """What of the signal path recordings of a simulator or a camera have.

    The search is `gap`'s, number for number.  Effects that the model has from the beginning are then taken out one by
    one, so that the table says of them too whether the recordings need them.

    Args:
        recordings: Of one sensor, with full-field stimuli.
        model: Where to begin; what it has is tested by taking it out, what it lacks by adding it.
        alpha: Chance of a false alarm.
        seed: Decides the split of the pixels and every draw.
        progress: Called with what is being done and the fraction of the whole that is done.
        resume: A file that keeps the fits made so far; removed at the end.
        where: Who fits and simulates, as for `gap`.

    Raises:
        InputError: As `gap`.
    """
    check_searchable(recordings, model, alpha)
    recordings = named_apart(recordings)
    cache = FitCache(resume)
    report = progress or (lambda what, fraction: None)
    criteria = Criteria()
    with connected(where or Where()) as client:
        context = Context(Options(alpha, seed), cache, report, Work(client))
        if all(r.pooled for r in recordings):
            found = search_pooled(recordings, model, context)
            beside = Beside(found.model, doubted=found.details["rivals"], pixels=False)
        else:
            found, beside = _searched(recordings, model, context)
            found = with_doubts(found, recordings)
    sensor = ", ".join(dict.fromkeys(r.sensor for r in recordings if r.sensor))
    table = ConformReport(found, rows_of(found, beside, criteria), sensor, context.watch.seconds())
    cache.remove()
    return table


def _searched(recordings: Sequence[Recording], model: Model, context: Context) -> tuple[GapReport, Beside]:
    """The search's report, and what the table needs of the state that it ended in."""
    ends: list[State] = []

    def keep_and_confirm(state: State, context: Context) -> GapReport:
        ends.append(state)
        return confirm(state, context)

    found = fold(begin(recordings, model, context), {**STEPS, Phase.CONFIRM: keep_and_confirm}, context)
    end = without(found.details["withdrawn"], ends[0])
    doubted: dict[str, list[str]] = {}
    for step, other in end.doubts:
        doubted.setdefault(step.effect, []).append(other.effect)
    hypothesis = end.hypothesis
    return found, Beside(
        hypothesis.model, intervals_of(hypothesis), removals(end, context), doubted, _readout(end), _signatures(end)
    )  # fmt: skip


def _readout(state: State) -> dict[str, str | None]:
    """Effect that stamps or single pixels would show, and do not → why it is absent; None where they are too few."""
    events = sum(len(r.events) for r in state.recordings)
    unit = max((r.events.tick_ns for r in state.recordings), default=1) * 1e-9
    pixels = len(np.unique(np.concatenate([np.unique(r.events.pixel) for r in state.recordings])))
    quiet_s = quiet_seconds(state.recordings)
    shows_hz = 2.0 * MIN_SILENT_EVENTS / max(quiet_s, 1e-300)
    usual_hz = stages.effect("hot_pixels").parameters[0].value
    model = state.base.model
    own_tick = model.values["timestamp_quantisation.tick_s"] if model.has("timestamp_quantisation") else math.inf
    told: dict[str, str | None] = {
        "timestamp_quantisation": f"no grid coarser than the file's unit of {unit:.3g} s, nor one that intervals of "
        "pixels would show" if events >= MIN_EVENTS and own_tick > 1.5 * unit else None,
        "readout_latency": "no shortest wait between pixels" if events >= 5 * MIN_ATOM_EVENTS and pixels > 1 else None,
        "hot_pixels": f"no pixel fires while the others are silent, {quiet_s:.3g} s in all, in which one hot at "
        f"{shows_hz:.3g} Hz or more would show" if pixels >= MIN_PIXELS and shows_hz <= usual_hz else None,
    }  # fmt: skip
    if state.shot_noise_tried:
        nowhere = all(noise is None for _, noise in state.shot_noise_tried)
        told["shot_noise"] = "simulated replicates with it come no nearer" if nowhere else None
    return told


def _signatures(state: State) -> dict[str, TimestampSignature]:
    """By effect, what timestamps and single pixels show."""
    hot = [] if state.hot is None else [state.hot.signature]
    return {each.effect: each for each in (*state.undone, *hot)}
