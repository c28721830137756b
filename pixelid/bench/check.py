"""The first steps of a calibration: read a bench, hold recordings against their lights, say what is wrong."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from pixelid.bench.files import Bench, find_bench
from pixelid.bench.session import Session, read_session
from pixelid.bench.statements import Statement, of_alignment
from pixelid.errors import InputError
from pixelid.fit.bench import dimmest_light
from pixelid.provenance import input_hashes, versions
from pixelid.recordings.alignment import aligned
from pixelid.recordings.bench import Bench as Exactness
from pixelid.recordings.bench import on_bench
from pixelid.recordings.recording import Recording
from pixelid.recordings.session_alignment import RecordingAlignment, align_session
from pixelid.results import Result, Table
from pixelid.status import Status
from pixelid.stimuli.pixel_lights import Light
from pixelid.stimuli.stimulus import Stimulus
from pixelid.stimuli.trace_noise import noise_sd, without_noise

Progress = Callable[[str, float], None]
NEGLIGIBLE = 3e-3  # of the dimmest light: a zero known so well moves a corner by a tenth of what its level may
OFFSET_STEPS = 2.0  # of a trace's converter: how well its zero is known


@dataclass(frozen=True)
class Row:
    """What is known of one recording after the first steps; `used` or not, and why."""

    name: str
    events: int
    pixels: int
    aligned: Mapping[str, Any] | None
    used: bool
    why: str

    def as_dict(self) -> dict[str, Any]:
        """The entry in check.json and calibration.json."""
        return {
            "name": self.name, "events": self.events, "pixels": self.pixels, "aligned": self.aligned,
            "used": self.used, "why": self.why,
        }  # fmt: skip


@dataclass(frozen=True, repr=False)
class CheckReport(Result):
    """A bench after its first steps.

    status, advice: whether a calibration can begin;  rows: one per recording;  statements: what the events contradict
    notes: what was inferred;  session: as read;  recordings: aligned, those that are used;  alignments: of all read
    """

    FILE: ClassVar[str] = "check.json"

    status: Status
    advice: str
    rows: tuple[Row, ...]
    statements: tuple[Statement, ...]
    notes: tuple[str, ...]
    session: Session
    recordings: tuple[Recording, ...]
    alignments: tuple[RecordingAlignment, ...]
    versions: Mapping[str, str]
    inputs_sha256: Mapping[str, str]

    @property
    def headline(self) -> str:
        """How many recordings can be used."""
        used = sum(row.used for row in self.rows)
        return f"bench {self.session.bench.folder}: {used} of {len(self.rows)} recordings used"

    def as_dict(self) -> dict[str, Any]:
        """The content of check.json."""
        return {
            "status": self.status,
            "advice": self.advice,
            "recordings": [row.as_dict() for row in self.rows],
            "bench": [statement.as_dict() for statement in self.statements],
            "notes": list(self.notes),
            "versions": dict(self.versions),
            "inputs_sha256": dict(self.inputs_sha256),
        }

    def tables(self) -> list[Table]:
        """One row per recording."""
        rows = tuple(
            (row.name, str(row.events), str(row.pixels), "yes" if row.used else "no", _alignment_cell(row), row.why)
            for row in self.rows
        )
        headings = ("recording", "events", "pixels", "used", "light starts at", "remarks")
        return [Table("", headings, rows, frozenset({"recording", "used", "light starts at", "remarks"}))]

    def records(self) -> list[dict[str, Any]]:
        """One row per recording."""
        return [row.as_dict() for row in self.rows]

    def sentences(self) -> list[str]:
        """Advice, what the events contradict, and what was inferred."""
        return [text for text in (self.advice, *(s.sentence for s in self.statements), *self.notes) if text]

    def write_companions(self, folder: Path) -> None:
        """Nothing."""


def check(
    bench: str | Path | Bench,
    *,
    roi: tuple[int, int, int, int] | None = None,
    pixels: int | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> CheckReport:
    """Read a bench and bring all of its recordings onto their lights' clock.

    Args:
        bench: A folder, a bench.toml, or what `find_bench` made of one.
        roi: (x0, y0, x1, y1) of the sensor to look at.
        pixels: How many pixels a fit will look at.
        seed: Chooses them.
        progress: Called with what is done and the fraction.

    Returns:
        One row per recording, what the events contradict, and the recordings that can be used, aligned.

    Raises:
        InputError: Nothing that can be read as a bench.

    Example:
        >>> import pixelid as px
        >>> print(px.check("bench/").summary())  # doctest: +SKIP
    """
    report = progress or (lambda what, fraction: None)
    found = bench if isinstance(bench, Bench) else find_bench(bench)
    session = read_session(found, roi, pixels, seed, lambda what, share: report(what, 0.6 * share))
    report("aligning", 0.6)
    stated = {e.name: clock for e in found.entries if (clock := e.clock or found.clock) not in ("auto", "one", "")}
    shared = {e.name for e in found.entries if (e.clock or found.clock) == "one"}
    clean = [without_noise(light) if isinstance(light, Stimulus) else light for light in session.lights]
    alignments = align_session(_few_events(session), clean, stated)
    report("checking", 0.95)
    usable, rows = [], []
    lights = {r.name: light for r, light in zip(session.recordings, session.lights, strict=True)}
    for recording, alignment in zip(session.recordings, alignments, strict=True):
        on_clock, row = _row(recording, lights[alignment.light], alignment, found, recording.name in shared)
        rows.append(row)
        if on_clock is not None:
            usable.append(on_clock)
    rows += [Row(name, 0, 0, None, False, why) for name, why in session.left_out.items()]
    statements = tuple(of_alignment(alignments))
    status, advice = _judged(rows, statements)
    notes = (*session.notes, *_light_notes(session.lights))
    report("done", 1.0)
    return CheckReport(
        status, advice, tuple(rows), statements, notes, session, tuple(usable), alignments, versions(),
        input_hashes(found.paths),
    )  # fmt: skip


def _few_events(session: Session) -> list[Recording]:
    """The recordings with the pixels that are fitted: an alignment needs no more."""
    from pixelid.recordings.selection import only

    return only(session.recordings, session.pixels)


def _row(
    recording: Recording, light: Light, alignment: RecordingAlignment, bench: Bench, shared: bool
) -> tuple[Recording | None, Row]:
    """(the recording aligned, None where it cannot be used; what is stated of it)."""
    events, pixels = len(recording.events), len(np.unique(recording.events.pixel))
    name = recording.name
    if shared:
        on_clock = replace(recording, stimulus=light).within_stimulus()
        return _exact(on_clock, light, bench), Row(name, events, pixels, None, True, "one clock, as stated")
    summary = {
        "method": alignment.method,
        "offset_s": alignment.offset_s,
        "interval_95": alignment.interval_95,
        "clock_rate_error": alignment.clock_rate_error,
    }
    if alignment.alignment is None:
        return None, Row(name, events, pixels, summary, False, alignment.sentence)
    if alignment.polarity < 0:
        recording = replace(recording, events=replace(recording.events, p=1 - recording.events.p))
    try:
        on_clock = aligned(recording, light, alignment.alignment)
    except InputError as error:
        return None, Row(name, events, pixels, summary, False, str(error))
    if alignment.method == "inherited" and isinstance(on_clock.stimulus, Stimulus) and len(on_clock.events):
        on_clock = _until_last_event(on_clock, on_clock.stimulus)
    inside = len(on_clock.events)
    if len(np.unique(on_clock.events.pixel)) == inside:
        why = "no pixel has two events within the light" if events else "no events"
        return None, Row(name, events, pixels, summary, False, why)
    outside = f"; {events - inside} events outside the light" if inside < events else ""
    return _exact(on_clock, light, bench), Row(name, events, pixels, summary, True, alignment.sentence + outside)


def _until_last_event(recording: Recording, light: Stimulus) -> Recording:
    """The recording under its light up to the first sample after its last event.

    When the camera stopped is not known: what it did not see later says nothing.  Samples stay evenly spaced, without
    which their noise is not estimated.
    """
    after = int(np.searchsorted(light.t, 1e-9 * (float(recording.events.t[-1]) + 1.0)))
    return recording if after >= len(light.t) else replace(recording, stimulus=light.until(float(light.t[after])))


def _exact(recording: Recording, light: Light, bench: Bench) -> Recording:
    """The recording, which says how well its light is known."""
    offset_sd = OFFSET_STEPS * converter_step(light)
    matters = offset_sd > NEGLIGIBLE * dimmest_light(recording)
    return on_bench(recording, Exactness(bench.level_sd, offset_sd if matters else 0.0))


def converter_step(light: Light) -> float:
    """The step of the converter that a trace was digitised with, in its unit; 0 where none shows.

    Digitised values are whole multiples of one step: of a thousand samples many are then alike.
    """
    if not isinstance(light, Stimulus) or noise_sd(light) == 0.0:
        return 0.0
    values = np.unique(light.radiance)
    if len(values) < 2 or len(values) > 0.5 * len(light.radiance):
        return 0.0
    return float(np.diff(values).min())


def _judged(rows: Sequence[Row], statements: Sequence[Statement]) -> tuple[Status, str]:
    if not any(row.used for row in rows):
        return Status.not_identified, (
            "no recording follows its light: are these its lights, and is the clock's unit right? "
            "State them in a bench.toml (`pixelid check BENCH --init`)"
        )
    if any(s.statement == "polarity" for s in statements):
        return Status.misfit, "ON and OFF are exchanged: state `--polarity swapped`, or correct what writes the files"
    return Status.converged, ""


def _light_notes(lights: Sequence[Light]) -> list[str]:
    noises = [noise_sd(light) for light in lights if isinstance(light, Stimulus)]
    largest = max(noises, default=0.0)
    if largest == 0.0:
        return []
    return [f"the traces of the light have noise of {100 * largest:.2g} %, which is filtered out"]


def _alignment_cell(row: Row) -> str:
    if row.aligned is None or row.aligned["offset_s"] is None:
        return "–"
    ends = row.aligned["interval_95"]
    half = "" if ends is None else f" ± {1e6 * 0.5 * (ends[1] - ends[0]):.0f} µs"
    return f"{row.aligned['offset_s']:.6f} s{half} ({row.aligned['method']})"
