"""Search the gap of recordings, then say of every effect of the signal path whether they have it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from pixelid.cluster import Where, Work, connected
from pixelid.conform.fold import Beside, rows_of
from pixelid.conform.removals import removals
from pixelid.conform.result import ConformReport
from pixelid.fit.cache import FitCache
from pixelid.gap.criteria import Criteria
from pixelid.gap.fold import fold
from pixelid.gap.gap import check_searchable
from pixelid.gap.options import ALPHA, Context, Options, Report
from pixelid.gap.phases import Phase
from pixelid.gap.pooled_counts.pooled import search_pooled
from pixelid.gap.result import GapReport
from pixelid.gap.search import STEPS, begin
from pixelid.gap.state import State
from pixelid.gap.steps.confirm import confirm, intervals_of
from pixelid.inspection.hot_pixels import MIN_PIXELS
from pixelid.inspection.tick import MIN_EVENTS
from pixelid.inspection.timestamps import MIN_ATOM_EVENTS
from pixelid.model.model import Model
from pixelid.recordings.recording import Recording


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
    cache = None if resume is None else FitCache(resume)
    report = progress or (lambda what, fraction: None)
    criteria = Criteria()
    with connected(where or Where()) as client:
        context = Context(Options(alpha, seed), cache, report, Work(client))
        if all(r.pooled for r in recordings):
            found = search_pooled(recordings, model, context)
            beside = Beside(found.model, doubted=found.details["rivals"], pixels=False)
        else:
            found, beside = _searched(recordings, model, context)
    if cache is not None:
        cache.remove()
    sensor = ", ".join(dict.fromkeys(r.sensor for r in recordings if r.sensor))
    return ConformReport(found, rows_of(found, beside, criteria), sensor, context.watch.seconds())


def _searched(recordings: Sequence[Recording], model: Model, context: Context) -> tuple[GapReport, Beside]:
    """The search's report, and what the table needs of the state that it ended in."""
    ends: list[State] = []

    def keep_and_confirm(state: State, context: Context) -> GapReport:
        ends.append(state)
        return confirm(state, context)

    found = fold(begin(recordings, model, context), {**STEPS, Phase.CONFIRM: keep_and_confirm}, context)
    end = _without_withdrawn(ends[0], found)
    doubted: dict[str, list[str]] = {}
    for step, other in end.doubts:
        doubted.setdefault(step.effect, []).append(other.effect)
    hypothesis = end.hypothesis
    return found, Beside(
        hypothesis.model, intervals_of(hypothesis), removals(end, context), doubted, _readout(end)
    )  # fmt: skip


def _without_withdrawn(state: State, found: GapReport) -> State:
    """The state as it was before the steps that the report has taken back."""
    if not found.details["withdrawn"] or not state.steps:
        return state
    return replace(state, hypothesis=state.steps[0].before, steps=())


def _readout(state: State) -> dict[str, str | None]:
    """Effect that stamps or single pixels would show, and do not → why it is absent; None where they are too few."""
    events = sum(len(r.events) for r in state.recordings)
    unit = max((r.events.tick_ns for r in state.recordings), default=1) * 1e-9
    pixels = len(np.unique(np.concatenate([np.unique(r.events.pixel) for r in state.recordings])))
    told: dict[str, str | None] = {
        "timestamp_quantisation": f"no grid coarser than the file's unit of {unit:.3g} s, nor one that intervals of "
        "pixels would show" if events >= MIN_EVENTS else None,
        "readout_latency": "no shortest wait between pixels" if events >= 5 * MIN_ATOM_EVENTS else None,
        "hot_pixels": "no pixel fires where the others are silent" if pixels >= MIN_PIXELS else None,
    }  # fmt: skip
    if state.shot_noise_tried:
        told["shot_noise"] = "simulated replicates with it come no nearer"
    return told
