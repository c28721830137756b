"""From a bench to a checked model: read and align, fit, search for what is missing, fit all together again.

Each stage takes plain values and gives plain values, kept in a folder of its own (`stages.py`).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pixelid.bench.check import CheckReport, check
from pixelid.bench.files import Bench, find_bench
from pixelid.bench.result import Calibration
from pixelid.bench.stages import Stages
from pixelid.bench.statements import Statement, of_fit
from pixelid.errors import InputError
from pixelid.figures.words import unit_of
from pixelid.fit.bench import with_stated_only
from pixelid.fit.data import as_fitted
from pixelid.fit.engines import engine as engine_named
from pixelid.fit.event_times import EventTimesObjective
from pixelid.fit.field import field_of
from pixelid.fit.fit import STARTS, fit
from pixelid.fit.judge import LARGEST_BACKGROUND_FRACTION, residual_tests, significant
from pixelid.fit.light_unit import unit_sentence
from pixelid.fit.prepare import prepare
from pixelid.fit.result import FitResult, Stopwatch
from pixelid.fit.search import Settings, search_event_times
from pixelid.gap.gap import gap
from pixelid.gap.result import GapReport
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.model import Model
from pixelid.outputs import write_json
from pixelid.provenance import versions
from pixelid.recordings.bench import FIELD as GAINS
from pixelid.recordings.bench import pixel_gains, with_pixel_gains
from pixelid.recordings.own_light import with_fine_light
from pixelid.recordings.recording import Recording
from pixelid.recordings.selection import few, only
from pixelid.status import Status

Progress = Callable[[str, float], None]
MODEL = "dvs128"  # where a fit starts when nothing else is stated; the unit of its light does not matter
# Shares of the whole time, for the progress that is shown.
CHECKED, EVENED, SEARCHED, REFITTED = 0.05, 0.15, 0.75, 0.98
FIELD = "field.json"  # of the stage that keeps the gains of pixels
ROUGH_EVENTS = 10_000  # of the pixels that a first fit looks at: every parameter to a few percent
BETWEEN = "linear"  # how light runs between its samples there


def calibrate(
    bench: str | Path | Bench,
    *,
    model: Model | None = None,
    roi: tuple[int, int, int, int] | None = None,
    pixels: int | None = None,
    search: bool = True,
    seed: int = 0,
    resume: Path | None = None,
    progress: Progress | None = None,
) -> Calibration:
    """Calibrate the pixel of a camera from a bench session.

    Args:
        bench: A folder or a bench.toml.
        model: Where the fit starts; the bench's, or dvs128, by default.
        roi: (x0, y0, x1, y1) of the sensor to look at.
        pixels: How many pixels are fitted.
        search: Whether to search for what the model lacks.
        seed: Of every choice and draw.
        resume: A folder that keeps every finished stage: called again with the same inputs, it goes on there.
        progress: Called with what is done and the fraction of the whole.

    Returns:
        The calibrated model, what the events contradict of what was stated, and how far all can be trusted.

    Raises:
        InputError: Nothing that can be read as a bench, recordings that cannot be fitted together.
    """
    from pixelid.model.shipped import find_model

    watch, report = Stopwatch(), progress or (lambda what, fraction: None)
    found = bench if isinstance(bench, Bench) else find_bench(bench)
    base = model or find_model(found.model or MODEL)
    checked = check(found, roi=roi, pixels=pixels, seed=seed, progress=_part(report, 0.0, CHECKED))
    if not checked.recordings:
        raise InputError(f"{found.folder}: {checked.advice} ({'; '.join(f'{r.name}: {r.why}' for r in checked.rows)})")
    session = checked.session
    recordings = only(checked.recordings, session.pixels)
    stages = Stages(resume, _inputs(checked, base, roi, pixels, search, seed))

    def evened(name: str, make: Callable[[], list[Recording]]) -> list[Recording]:
        return stages.run(
            name,
            make,
            lambda made, folder: write_json(folder / FIELD, [r.attributes.get(GAINS) for r in made]),
            lambda folder: _with_gains(recordings, json.loads((folder / FIELD).read_text())),
        )

    recordings = evened("field", lambda: with_even_field(recordings, base, seed, _part(report, CHECKED, EVENED)))
    searched: GapReport | None = None
    begin, starts = base, STARTS
    if search:  # fits the base on its way, so that what follows begins at an optimum
        searched = stages.run(
            "gap",
            lambda: gap(recordings, base, seed=seed, progress=_part(report, EVENED, SEARCHED)),
            lambda made, folder: made.write(folder),
            GapReport.load,
        )
        begin, starts = with_stated_only(searched.base), 0

    def fitted(name: str, start: Model, share: float) -> FitResult:
        return stages.run(
            name,
            lambda: fit(recordings, start, starts=starts, seed=seed, progress=_part(report, share, REFITTED)),
            lambda made, folder: made.write(folder),
            FitResult.load,
        )

    grown = searched is not None and bool(searched.effects or searched.described)
    if searched is not None and grown:
        recordings = evened("grown field", lambda: with_field_under(recordings, searched.model))
    last = fitted("fit", with_stated_only(searched.model) if searched is not None and grown else begin, SEARCHED)
    first = fitted("base", begin, SEARCHED) if grown else last
    report("checking on other pixels", REFITTED)
    held_out = on_other_pixels(last, only(checked.recordings, session.checking)) if len(session.checking) else None
    statements = (*checked.statements, *_new(of_fit(last), checked.statements))
    status, advice = judged(checked, last, searched, held_out)
    report("done", 1.0)
    return Calibration(
        status=status,
        advice=advice,
        sentence=sentence_of(status, last, searched),
        fit=last,
        first=first,
        gap=searched,
        statements=statements,
        rows=checked.rows,
        notes=(*checked.notes, *field_note(recordings)),
        held_out=held_out,
        unit=unit_sentence(last.model, base),
        recommended_next={} if searched is None else searched.recommended_next,
        recordings=tuple(recordings),
        seconds=watch.seconds(),
        seed=seed,
        start=base.in_light(first.model.light_scale / base.light_scale).values,
        alignments=checked.alignments,
        versions=versions(),
        inputs_sha256=checked.inputs_sha256,
    )


def with_even_field(recordings: Sequence[Recording], base: Model, seed: int, report: Progress) -> list[Recording]:
    """The recordings, which know how the field differs from pixel to pixel, where it shows.

    A fit of few pixels says how all of them respond; where it lacks an effect, pixels still differ by their light.
    """
    if not _of_full_field(recordings):
        return list(recordings)
    rng, settings = np.random.default_rng(seed), Settings(engine_named("casadi"), between=BETWEEN, seed=seed)
    ready = prepare(few(recordings, ROUGH_EVENTS, rng), base, None, None, settings.form, False)
    rough = search_event_times(ready.recordings, ready.model, None, settings, rng, report)
    return with_field_under(recordings, rough.objective.coordinates.model_at(rough.optimum.x))


def _of_full_field(recordings: Sequence[Recording]) -> bool:
    return all(r.stimulus is not None and r.stimulus.full_field for r in recordings)


def with_field_under(recordings: Sequence[Recording], model: Model) -> list[Recording]:
    """The recordings, which know how pixels differ where that shows under a fitted model."""
    if not _of_full_field(recordings):
        return list(recordings)
    fine = [with_fine_light(recording, BETWEEN) for recording in as_fitted(recordings)]
    field = field_of(EventTimes(fine), model.circuit())
    return list(recordings) if field is None else field.on(recordings)


def _with_gains(recordings: Sequence[Recording], gains: Sequence[Any]) -> list[Recording]:
    """Recordings with the gains of pixels that a stage has kept."""
    return [
        r if own is None else with_pixel_gains(r, np.asarray(own["pixel"]), np.asarray(own["ln_gain"]))
        for r, own in zip(recordings, gains, strict=True)
    ]


def field_note(recordings: Sequence[Recording]) -> list[str]:
    """A sentence on an uneven field; none where it is even."""
    _, gains = pixel_gains(recordings[0])
    if not len(gains):
        return []
    spread, most = float(np.std(gains)), float(np.abs(gains).max())
    return [f"the field is uneven: what pixels see differs by {100 * spread:.2g} % (at most {100 * most:.2g} %)"]


def on_other_pixels(result: FitResult, recordings: Sequence[Recording]) -> dict[str, Any]:
    """How a fitted model describes pixels that no fit has seen, with thresholds of their own.

    Returns:
        pixels, events, background_fraction (events without a cause) and the significant residual tests.
    """
    between = result.details.get("stimulus_between_samples", "linear")
    fine = [with_fine_light(r, between) for r in as_fitted(recordings)]
    objective = EventTimesObjective(EventTimes(fine), result.coordinates)
    background = objective.terms(result.x).unexplained
    alarms = significant(residual_tests(objective, result.x))
    return {
        "pixels": objective.likelihood.pixels,
        "events": objective.likelihood.events,
        "background_fraction": float(np.mean(background)),
        "significant_tests": [test.as_dict() for test in alarms],
    }


def judged(
    checked: CheckReport, last: FitResult, searched: GapReport | None, held_out: Mapping[str, Any] | None
) -> tuple[Status, str]:
    """The status of the whole and what to do: the worst of its parts."""
    statuses, advice = [checked.status, last.status], [checked.advice, last.advice]
    if searched is not None:
        statuses.append(searched.status)
        if searched.verdict in ("unknown", "ambiguous") or searched.remainder:
            statuses.append(Status.misfit)
            advice.append(searched.sentence)
    if held_out is not None and _fails(held_out):
        statuses.append(Status.misfit)
        advice.append(f"{held_out['pixels']} pixels that no fit has seen are not described: see held_out")
    return Status.worst(statuses), "; ".join(text for text in advice if text)


def sentence_of(status: Status, last: FitResult, searched: GapReport | None) -> str:
    """The answer in one sentence."""
    circuit = [last.estimates[name] for name in last.model.parameters if not last.estimates[name].fixed]
    share = f"{sum(e.identified for e in circuit)} of {len(circuit)} parameters identified"
    usable = "Usable" if status is Status.converged else "Not usable as it is"
    missing = "" if searched is None else _missing(searched, last)
    return f"{usable}: {share}.{missing}"


def _missing(searched: GapReport, last: FitResult) -> str:
    if not searched.effects:
        described = " It is described, not named." if searched.described else ""
        return {
            "none": " Nothing is missing.", "unknown": f" Something is missing that has no name.{described}",
        }.get(searched.verdict, f" {searched.sentence}")  # fmt: skip
    parts = []
    for effect in searched.effects:
        free = [last.estimates[n] for n in effect.parameters if n in last.estimates and not last.estimates[n].fixed]
        value = f" {free[0].value:.3g} {unit_of(free[0].name, free[0].unit)}" if free else ""
        ends = free[0].interval_95 if free else None
        known = f" ({ends[0]:.3g} to {ends[1]:.3g})" if ends and None not in ends else ""
        parts.append(f"{effect.name.replace('_', ' ')}{value}{known}")
    return f" Missing from {last.model.name.removesuffix('_grown')}, and added: {', '.join(parts)}."


def _fails(held_out: Mapping[str, Any]) -> bool:
    return held_out["background_fraction"] > LARGEST_BACKGROUND_FRACTION or bool(held_out["significant_tests"])


def _new(statements: Sequence[Statement], known: Sequence[Statement]) -> list[Statement]:
    """Statements that are not among the known ones."""
    there = {(s.statement, s.recording) for s in known}
    return [s for s in statements if (s.statement, s.recording) not in there]


def _inputs(checked: CheckReport, base: Model, roi, pixels, search: bool, seed: int) -> dict[str, Any]:
    from pixelid.model.files import to_document

    stated = checked.session.bench
    return {
        "files": dict(checked.inputs_sha256), "versions": versions(), "model": to_document(base), "roi": roi,
        "pixels": pixels, "search": search, "seed": seed,
        "stated": [stated.unit, stated.clock, stated.level_sd, stated.source.as_dict()],
        "entries": [[e.name, str(e.events), str(e.light), e.level, e.clock, e.skip] for e in stated.entries],
    }  # fmt: skip


def _part(report: Progress, begin: float, end: float) -> Progress:
    """Progress of a stage as a part of the whole."""
    return lambda what, fraction: report(what, begin + (end - begin) * fraction)
