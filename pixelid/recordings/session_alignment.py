"""All recordings of a session on their lights' clock at once.

Camera and light have one pair of clocks, so one clock rate error, and each recording a delay of its own.

1. Each recording is held against its light, and the clock rate found of all together (`session_cases.py`).
2. Delays follow: by the edge where there is one and the events do not contradict it, else by the events.  Of the
   offsets at which a periodic light fits equally well, the one counts at which the light covers the events.
3. Recordings without events or with constant light take the rate, and are placed so that the light covers the events.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from pixelid.recordings.alignment import GIVEN_SD_S, find_alignment, known_alignment
from pixelid.recordings.alignment_from_events import LEAST_CHANGES, EventAlignment, alignment_of
from pixelid.recordings.alignment_search import NEAR_S, is_too_long
from pixelid.recordings.clocks import Alignment
from pixelid.recordings.recording import Recording
from pixelid.recordings.session_cases import Case, SharedRate, cases_of, is_constant, shared_rate
from pixelid.statistics import Z95
from pixelid.stimuli.pixel_lights import Light

CONTRADICTED = 4.0  # standard errors: 6e-5 of a true statement, so that a session of a dozen has few false doubts


@dataclass(frozen=True)
class BenchDoubt:
    """A statement that the events contradict.

    statement: "delay", "light" or "polarity";  stated, found: seconds of a delay, names of lights, words of a polarity
    interval_95: of `found`, where it is a number
    """

    statement: str
    stated: float | str
    found: float | str
    interval_95: tuple[float, float] | None
    sentence: str


@dataclass(frozen=True)
class RecordingAlignment:
    """How one recording of a session is aligned.

    alignment: for `recordings.alignment.aligned`; None where nothing identifies it
    method: "trigger", "auto", "given", "first-event", "inherited" (the rate, and placed under the light) or "none"
    offset_s, interval_95: the light's first sample on the camera's clock
    clock_rate_error, clock_rate_interval_95: see `Alignment`
    evidence: (2, k) lags (s) from the offset chosen, and mean loss of the events' changes there
    light: name of the recording whose light it follows;  polarity: −1 where ON and OFF are exchanged
    """

    name: str
    alignment: Alignment | None
    method: str
    offset_s: float | None
    interval_95: tuple[float, float] | None
    clock_rate_error: float
    clock_rate_interval_95: tuple[float, float]
    evidence: np.ndarray | None
    sentence: str
    light: str
    polarity: int = 1
    doubts: tuple[BenchDoubt, ...] = field(default=())


def align_session(
    recordings: Sequence[Recording],
    lights: Sequence[Light],
    stated: Mapping[str, str] | None = None,
) -> tuple[RecordingAlignment, ...]:
    """Align all recordings of one pair of clocks.

    Args:
        recordings: on the camera's clock.
        lights: each recording's own, on the lights' clock.
        stated: of a recording's name, how it is aligned, as of `find_alignment`; others by their trigger edges where
            the file has some, else by their events.

    Returns:
        One per recording.

    Raises:
        InputError: statements that do not fit a recording, and lights of other sizes.
    """
    stated = stated or {}
    cases = cases_of(recordings, lights, stated)
    terms = [case.rate_terms() for case in cases]
    rate = shared_rate([term for mine in terms for term in mine])
    others = [shared_rate([t for k, mine in enumerate(terms) if k != i for t in mine]) for i in range(len(cases))]
    return tuple(_placed(case, rate, other) for case, other in zip(cases, others, strict=True))


def _placed(case: Case, rate: SharedRate, others: SharedRate) -> RecordingAlignment:
    """The alignment of one recording after the rate.

    Args:
        others: the rate without this recording, to be held against its edges.
    """
    doubts = list(_hypothesis_doubts(case))
    events = _identified(case, rate)
    if not case.how.startswith(("trigger", "auto")):
        given = _with_rate(find_alignment(case.recording, case.light, case.how), case, rate)
        contradiction = _delay_doubt(case, events, given) if given.start_half_s is not None else None
        if contradiction is None:
            return _result(case, given, rate, given.sentence(), doubts)
        doubts.append(contradiction)
    if len(case.edges_s):
        by_edges, edge_doubts = _by_edges(case, events, rate, others)
        doubts += edge_doubts
        if by_edges is not None:
            return _result(case, by_edges, rate, by_edges.sentence(), doubts)
    if events is not None:
        alignment = alignment_of(events, case.light)
        note = "" if not events.equal_rivals else "; the light repeats itself and covers the events only there"
        return _result(case, alignment, rate, alignment.sentence() + note, doubts)
    if case.events is not None and case.events.follows:
        count = len(case.events.equal_rivals) + 1
        return _result(case, None, rate, f"the light repeats itself: {count} starts fit equally well", doubts)
    if not is_constant(case.light) and len(case.recording.events):
        short = "too long a span to search" if is_too_long(case.recording, case.light) else "too few events to find"
        reason = short if case.events is None else "the events follow neither this nor another light"
        if case.events is not None or len(case.recording.events) > LEAST_CHANGES:
            return _result(case, None, rate, f"not aligned: {reason}", doubts)
    alignment = _inherited(case, rate)
    why = "constant light" if is_constant(case.light) else "too few events"
    why = why if len(case.recording.events) else "no events"
    return _result(case, alignment, rate, f"{why}: any start serves that covers the events", doubts)


def _identified(case: Case, rate: SharedRate) -> EventAlignment | None:
    """What the events say of the offset, given the rate; None where they do not follow, or equally well elsewhere."""
    if case.events is None or not case.events.follows:
        return None
    events = case.events.with_rate(rate.mean, rate.sd)
    covers = 0.98  # share of the changes within a light that covers the events
    if events.equal_rivals and events.inside < covers:
        return None
    equal = [rival for rival in events.equal_rivals if rival.inside >= covers]
    apart = max((abs(rival.offset_s - case.events.offset_s) for rival in equal), default=0.0)
    widest_s = 0.02  # equal offsets within this are one, known as badly: what a fit may move (likelihood/clocks.py)
    if apart > widest_s:
        return None
    return replace(events, covariance=events.covariance + np.diag([apart**2, 0.0]))


def _with_rate(given: Alignment, case: Case, rate: SharedRate) -> Alignment:
    """What was stated of the delay, with the session's rate."""
    if given.prior is None or given.prior.delay_sd_s is None:
        return given
    at_s, sd = given.prior.at_s, given.prior.delay_sd_s
    return known_alignment(given.offset_s, given.method, at_s, sd, case.light, rate.mean, rate.sd)


def _hypothesis_doubts(case: Case) -> list[BenchDoubt]:
    name, doubts = case.recording.name, []
    if case.of != name and case.events is not None and case.events.follows:
        doubts.append(
            BenchDoubt("light", name, case.of, None, f"{name}: the events follow the light of {case.of}, not their own")
        )
    if case.polarity < 0:
        sentence = f"{name}: ON events where the light falls: the polarity is exchanged"
        doubts.append(BenchDoubt("polarity", "as in the file", "exchanged", None, sentence))
    return doubts


def _delay_doubt(case: Case, events: EventAlignment | None, given: Alignment) -> BenchDoubt | None:
    """Where the events put the light's first sample elsewhere than a statement with an error of its own does."""
    if events is None:
        return None
    assert given.start_s is not None and given.start_half_s is not None  # noqa: PT018
    late, sd = _later(events, given.start_s, case.light.start_s, given.start_half_s / Z95)
    return None if abs(late) <= CONTRADICTED * sd else _delay(case, late, sd, "the start stated for the light")


def _by_edges(
    case: Case, events: EventAlignment | None, rate: SharedRate, others: SharedRate
) -> tuple[Alignment | None, list[BenchDoubt]]:
    """(the alignment by the edge that stands, None where none does; what contradicts the others)."""
    stamps = zip(case.edges_s.tolist(), case.moments_s.tolist(), strict=True)
    late = [] if events is None else [_later(events, at_s, moment, case.stamp_s) for at_s, moment in stamps]
    edge, doubts = 0, []
    if len(case.edges_s) == 2:
        between = float(np.diff(case.moments_s)[0])
        stretched = float(np.diff(case.edges_s)[0]) - (1.0 + others.mean) * between
        sd = float(np.hypot(np.sqrt(2.0) * case.stamp_s, others.sd * between))
        if abs(stretched) > CONTRADICTED * sd:
            ppm = 1e6 * (float(np.diff(case.edges_s)[0]) / between - 1.0 - others.mean)
            why = f"alone they stretch the clock by {ppm:.0f} ppm against the other recordings"
            squares = [(value / error) ** 2 for value, error in late]
            if late and abs(squares[0] - squares[1]) > 2.0 * Z95:
                edge = int(np.argmin(squares))
                which = ("last", "first")[edge]
                size = stretched if edge == 0 else -stretched
                doubts.append(_delay(case, size, sd, f"the {which} trigger edge", why))
            else:
                doubts.append(_delay(case, stretched, sd, "the last trigger edge (or the first, the other way)", why))
                if events is not None and events.sd_at(case.moments_s[0]) < abs(stretched):
                    return None, doubts
                edge = -1
    # two edges that agree outweigh events, unless these put the light elsewhere altogether
    least = NEAR_S if len(case.edges_s) == 2 and not doubts else 0.0
    if late and edge >= 0 and abs(late[edge][0]) > max(CONTRADICTED * late[edge][1], least):
        which = "the trigger edge" if len(late) == 1 else f"the {('first', 'last')[edge]} trigger edge"
        return None, [*doubts, _delay(case, *late[edge], which)]
    stamp = case.stamp_s if edge >= 0 else float(np.hypot(case.stamp_s, np.ptp(case.edges_s - case.moments_s) + 1e-6))
    at, moment = float(case.edges_s[edge]), float(case.moments_s[edge])
    offset = at - (1.0 + rate.mean) * moment
    return known_alignment(offset, "trigger", moment, stamp, case.light, rate.mean, rate.sd), doubts


def _later(events: EventAlignment, at_s: float, moment: float, sd_s: float) -> tuple[float, float]:
    """(seconds by which a moment of the light, stated at `at_s`, is later than by the events; standard error)."""
    late = at_s - events.offset_s - (1.0 + events.rate_error) * moment
    return late, float(np.hypot(events.sd_at(moment), sd_s))


def _delay(case: Case, late_s: float, sd: float, what: str, why: str = "") -> BenchDoubt:
    interval = late_s - Z95 * sd, late_s + Z95 * sd
    size = sorted(1e6 * abs(edge) for edge in interval)
    text = f"{case.recording.name}: {what} is {1e6 * abs(late_s):.0f} µs {'late' if late_s > 0 else 'early'}"
    text += f" ({size[0]:.0f} to {size[1]:.0f})" + (f"; {why}" if why else "")
    return BenchDoubt("delay", 0.0, late_s, interval, text)


def _inherited(case: Case, rate: SharedRate) -> Alignment:
    """Middle of the light at the middle of the events; without any, its first sample at the camera's time zero."""
    light, events = case.light, case.recording.events
    middle = 0.5 * (light.start_s + light.end_s)
    if len(events):
        offset = 0.5e-9 * float(events.t[0] + events.t[-1]) - (1.0 + rate.mean) * middle
    else:
        offset = -(1.0 + rate.mean) * light.start_s
    return known_alignment(offset, "inherited", middle, GIVEN_SD_S, light, rate.mean, rate.sd)


def _result(
    case: Case, alignment: Alignment | None, rate: SharedRate, sentence: str, doubts: Sequence[BenchDoubt]
) -> RecordingAlignment:
    start, half = (None, None) if alignment is None else (alignment.start_s, alignment.start_half_s)
    stated = alignment is not None and alignment.rate_interval_95 is not None
    return RecordingAlignment(
        name=case.recording.name,
        alignment=alignment,
        method="none" if alignment is None else alignment.method,
        offset_s=start,
        interval_95=None if start is None or half is None else (start - half, start + half),
        clock_rate_error=alignment.rate_error if alignment is not None and stated else rate.mean,
        clock_rate_interval_95=rate.interval_95,
        evidence=_evidence(case, alignment),
        sentence=sentence,
        light=case.of,
        polarity=case.polarity,
        doubts=tuple(doubts),
    )


def _evidence(case: Case, alignment: Alignment | None) -> np.ndarray | None:
    if case.events is None:
        return None
    lags, loss = case.events.profile
    if alignment is not None:  # as it differs at the events' middle
        apart = alignment.offset_s - case.events.offset_s
        lags = lags - apart - (alignment.rate_error - case.events.rate_error) * case.events.middle_s
    drawn_s = 0.05  # of the evidence, on either side
    return np.stack([lags, loss])[:, (np.abs(lags) <= drawn_s) & np.isfinite(loss)]
