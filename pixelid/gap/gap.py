"""Find the gap: lock, detect, attribute, accept, repeat, confirm, in one function."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from pixelid import stages
from pixelid.cluster import Where, Work, connected
from pixelid.errors import InputError
from pixelid.fit.cache import FitCache
from pixelid.fit.levels.pixel_levels import PixelLevelsLike, Wanted
from pixelid.gap.criteria import Criteria
from pixelid.gap.options import ALPHA, Context, Options, Report
from pixelid.gap.own_levels import search_with_levels
from pixelid.gap.pooled_counts.pooled import search_pooled
from pixelid.gap.result import GapReport
from pixelid.gap.search import search
from pixelid.gap.split import MIN_PIXELS
from pixelid.model.model import Model
from pixelid.recordings.recording import Recording
from pixelid.recordings.selection import named_apart, unit_of_light
from pixelid.status import Status


def gap(
    recordings: Sequence[Recording],
    model: Model,
    *,
    alpha: float = ALPHA,
    seed: int = 0,
    leave_out: Sequence[str] = (),
    criteria: Criteria | None = None,
    progress: Report | None = None,
    resume: Path | None = None,
    recommend: bool = True,
    pixel_levels: PixelLevelsLike = None,
    where: Where | None = None,
) -> GapReport:
    """Search the recordings for effects that the model lacks.

    Args:
        recordings: Of one sensor, with stimuli, full-field or (with pixels) of each pixel's own.
        model: The base, at its shipped values.
        alpha: Chance of naming anything, or of "unknown", when the model is right.
        seed: Decides the split of the pixels and every draw.
        leave_out: Effects that the library is to lack (to see what is said of what it does not know).
        criteria: Every other number that the verdict hangs on.
        progress: Called with what is being done and the fraction of the whole that is done.
        resume: A file that keeps the fits made so far: a search interrupted and called again reads them back and comes
            to the same result.  It is removed at the end.
        recommend: Also work out what to record next.
        pixel_levels: "gain", "background" or "both" of every pixel are not known, as in `fit`; the search takes them as
            they are told with the base, and again with what it names.
        where: Who fits candidates and simulates: this process, local ones or a cluster.  The result is the same.

    Raises:
        InputError: For recordings without pixels or stimulus, of several sensors, a model that the event-time
            likelihood cannot use, an effect to leave out that there is not, and a cluster that does not answer.
        UntrustworthyResult: The cluster was lost.

    Example:
        >>> from pixelid.gap.gap import gap
        >>> from pixelid.model.shipped import find_model
        >>> from pixelid.recordings import open_recordings
        >>> report = gap(open_recordings(["session/"]), find_model("dvs128"))  # doctest: +SKIP
        >>> report.verdict, [effect.name for effect in report.effects]  # doctest: +SKIP
        ('named', ['leak'])
    """
    check_searchable(recordings, model, alpha)
    recordings, model = named_apart(recordings), model.with_radiance_in(unit_of_light(recordings))
    wanted = Wanted.of(pixel_levels)
    lacking = (leave_out,) if isinstance(leave_out, str) else tuple(leave_out)
    for name in lacking:
        stages.effect(name)
    options = Options(alpha, seed, lacking, criteria or Criteria(), recommend)
    cache = FitCache(resume)
    pooled = all(r.pooled for r in recordings)
    with connected(where or Where()) as client:
        context = Context(options, cache, progress or (lambda what, fraction: None), Work(client))
        if wanted is not None:
            report = search_with_levels(
                recordings, model, wanted, seed, lambda seen: search(seen, model, context), context.report
            )
        else:
            report = (search_pooled if pooled else search)(recordings, model, context)
    cache.remove()
    return report if pooled else with_doubts(report, recordings)


def with_doubts(report: GapReport, recordings: Sequence[Recording]) -> GapReport:
    """The report, which says where there was too little to judge by."""
    pixel = np.concatenate([r.events.pixel for r in recordings])
    events, pixels = len(pixel), len(np.unique(pixel))
    said = [report.advice] if report.advice else []
    if pixels < MIN_PIXELS:
        said.append(f"{pixels} pixels are fewer than {MIN_PIXELS}: none was set aside to judge by.")
    status = report.status
    # An effect is named for some 20 nats; a strong one (12 % lost events, a knee) was seen to gain 0.13 an event.
    # With less than half a nat from each nothing can be named, and what is not named is not absent.
    least_events = 40
    if report.verdict == "none" and events < least_events:
        said.append(f"{events} events could not have shown an effect: record more of them.")
        status = Status.worst([status, Status.not_identified])
    return replace(report, status=status, advice=" ".join(said))


def check_searchable(recordings: Sequence[Recording], model: Model, alpha: float) -> None:
    """Check that a search can look at them.

    Raises:
        InputError: As `gap`.
    """
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
