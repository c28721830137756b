"""What is known of each recording of a session before it is aligned: its events against lights, its edges, the rate.

Where the events do not follow their own light, they are held against the other recordings' lights, and all of them with
ON and OFF exchanged.  The clock rate is one of the whole session: what events, pairs of trigger edges and the prior
say together.  Edges may be misplaced: their likelihood is Student's t with 4 degrees of freedom, as is the prior.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pixelid.errors import InputError
from pixelid.recordings.alignment import trigger_edges
from pixelid.recordings.alignment_filter import soft_loss
from pixelid.recordings.alignment_from_events import LARGEST_LOSS, LEAST_CHANGES, EventAlignment, align_events
from pixelid.recordings.alignment_search import correlation
from pixelid.recordings.clocks import CRYSTAL
from pixelid.recordings.recording import Recording
from pixelid.statistics import Z95
from pixelid.stimuli.pixel_lights import Light, lights_in

DEGREES = 4.0  # of Student's t: statements may be wrong
UNEXPLAINED = float(soft_loss(np.ones(1))[0])  # mean loss of changes that follow no light
AS_STATED = 1e-3  # of a loss, that the light stated may be worse: half of what a right one leaves


@dataclass(frozen=True)
class SharedRate:
    """A clock rate error and its standard deviation."""

    mean: float
    sd: float

    @property
    def interval_95(self) -> tuple[float, float]:
        return self.mean - Z95 * self.sd, self.mean + Z95 * self.sd


@dataclass(frozen=True)
class Case:
    """A recording with the light that its events follow; `events` None where they cannot be held against it.

    edges_s: trigger edges at the light's moments `moments_s`, first and perhaps last;  stamp_s: their standard error
    """

    recording: Recording
    light: Light
    of: str
    how: str
    events: EventAlignment | None
    polarity: int
    edges_s: np.ndarray
    moments_s: np.ndarray
    stamp_s: float

    def rate_terms(self) -> list[tuple[float, float, bool]]:
        """(rate, standard deviation, whether it may be wrong) of events and of a pair of edges."""
        terms = []
        if self.events is not None and self.events.follows:
            terms.append((self.events.rate_error, float(np.sqrt(self.events.covariance[1, 1])), False))
        if len(self.edges_s) == 2:
            between = float(np.diff(self.moments_s)[0])
            terms.append((float(np.diff(self.edges_s)[0]) / between - 1.0, np.sqrt(2.0) * self.stamp_s / between, True))
        return terms


@dataclass(frozen=True)
class _Hypothesis:
    """That events follow light number `light`, with this polarity;  as_stated: whether nothing speaks against what was
    stated."""

    events: EventAlignment | None
    light: int
    polarity: int = 1
    as_stated: bool = False

    @property
    def follows(self) -> bool:
        """Whether they follow it at all."""
        return self.events is not None and self.events.follows

    @property
    def loss(self) -> float:
        """Mean loss of the changes; as if nothing were explained where they do not follow."""
        return self.events.loss_of_all if self.events is not None and self.follows else UNEXPLAINED


def cases_of(recordings: Sequence[Recording], lights: Sequence[Light], stated: Mapping[str, str]) -> list[Case]:
    """One case per recording, each with a light of its own.

    A camera has one polarity: where not all events follow the lights stated, they are held against them with ON and OFF
    exchanged in all recordings, too.  Lights may have been exchanged, not shared: of all ways to give every recording
    one light, the one counts under which the events are explained best (Kuhn 1955, Naval Res. Logist. 2, 83).

    Args:
        recordings, lights: in the order that is stated.
        stated: of a recording's name, how it is aligned.
    """
    chosen, loss = _assigned(recordings, lights, 1)
    if not all(one.as_stated for one in chosen):
        exchanged, lower = _assigned(recordings, lights, -1)
        chosen = exchanged if lower < loss - AS_STATED else chosen
    return [
        _case(recording, lights[one.light], recordings[one.light].name, one, stated.get(recording.name, ""))
        for recording, one in zip(recordings, chosen, strict=True)
    ]


def _assigned(
    recordings: Sequence[Recording], lights: Sequence[Light], polarity: int
) -> tuple[list[_Hypothesis], float]:
    """The best way to give every recording one light, with a polarity of the session.

    Returns:
        One hypothesis for each recording, and the loss of those with both polarities: others say nothing of these.
    """
    from scipy.optimize import linear_sum_assignment

    tried = [_hypotheses(i, recordings, lights, polarity) for i in range(len(recordings))]
    loss = np.full((len(recordings), len(lights)), UNEXPLAINED)
    for i, hypotheses in enumerate(tried):
        if not hypotheses:  # too few events: its own, unless another takes that
            loss[i] = 0.5 * UNEXPLAINED
            loss[i, i] = 0.0
        for one in hypotheses:
            loss[i, one.light] = min(loss[i, one.light], one.loss)
        loss[i, i] -= AS_STATED
    rows, columns = linear_sum_assignment(loss)
    chosen = []
    for i, k in zip(rows, columns, strict=True):
        able = [one for one in tried[i] if one.light == k]
        events = _events(recordings[i], lights[k], polarity) if k != i and not tried[i] else None
        there = _Hypothesis(events, int(k), polarity, as_stated=k == i)
        chosen.append(min(able, key=lambda one: one.loss, default=there))
    both = np.array([_has_both(recording) for recording in recordings])
    return chosen, float(loss[rows, columns][both].sum())


def _has_both(recording: Recording) -> bool:
    """Whether there are ON and OFF events: those of one polarity follow light that rises, or falls half a period on."""
    return 0 < int(np.count_nonzero(recording.events.p)) < len(recording.events)


def _case(recording: Recording, light: Light, of: str, best: _Hypothesis, how: str) -> Case:
    how = how or ("trigger" if recording.triggers is not None and len(recording.triggers) else "auto")
    edges, moments, stamp = np.empty(0), np.empty(0), 0.0
    if how.startswith("trigger"):
        edges, moments, stamp = trigger_edges(recording, light, how)
    return Case(recording, light, of, how, best.events, best.polarity, edges, moments, stamp)


def _hypotheses(i: int, recordings: Sequence[Recording], lights: Sequence[Light], polarity: int) -> list[_Hypothesis]:
    """What recording i may follow with the session's polarity; none where it has too few events.

    Its own light alone, where that explains it.
    """
    recording = recordings[i]
    if len(recording.events) <= LEAST_CHANGES:
        return []
    constant = is_constant(lights[i])
    own = _Hypothesis(_events(recording, lights[i], polarity), i, polarity)
    if _explains(own.events):
        return [replace(own, as_stated=polarity > 0)]
    tried = [replace(own, as_stated=constant)]
    if _has_both(recording):
        exchanged = _Hypothesis(_events(recording, lights[i], -polarity), i, -polarity)
        tried += [exchanged] if exchanged.follows else []
    others = sorted(((correlation(recording, light), k) for k, light in enumerate(lights) if k != i), reverse=True)
    other_lights = 3  # that are tried where events do not follow their own, by correlation
    rest = [_Hypothesis(_events(recording, lights[k], polarity), k, polarity) for _, k in others[:other_lights]]
    return [*tried, *(one for one in rest if one.follows)]


def _events(recording: Recording, light: Light, polarity: int = 1) -> EventAlignment | None:
    """None where there are too few events, or the light is constant."""
    if len(recording.events) <= LEAST_CHANGES or is_constant(light):
        return None
    try:
        return align_events(recording, light, polarity)
    except InputError:
        return None


def is_constant(light: Light) -> bool:
    """Whether the light changes by no more than the noise of its trace."""
    logs = [np.log(np.maximum(one.radiance, 1e-300)) for one in lights_in(light)]
    spans = max(float(np.diff(np.quantile(log, (0.01, 0.99)))[0]) for log in logs)
    constant_span, constant_range = 0.05, 0.2  # of ln L, 1 to 99 % and all: below any threshold, above a trace's noise
    return spans < constant_span and max(float(np.ptp(log)) for log in logs) < constant_range


def _explains(events: EventAlignment | None) -> bool:
    """Whether nearly all events follow: another light may share a few edges."""
    return events is not None and events.follows and events.loss_of_all <= LARGEST_LOSS


def shared_rate(terms: Sequence[tuple[float, float, bool]]) -> SharedRate:
    """Median and spread of the rate's posterior, on a grid that resolves each term near its mean."""
    grids = [np.linspace(-10.0 * CRYSTAL, 10.0 * CRYSTAL, 4001)]
    grids += [mean + sd * np.linspace(-8.0, 8.0, 161) for mean, sd, _ in terms]
    grid = np.unique(np.concatenate(grids))
    log = _student(grid / CRYSTAL)
    for mean, sd, may_be_wrong in terms:
        z = (grid - mean) / sd
        log += _student(z) if may_be_wrong else -0.5 * z**2
    density = np.exp(log - log.max())
    mass = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(grid))])
    low, median, high = np.interp(np.array([0.025, 0.5, 0.975]) * mass[-1], mass, grid)
    return SharedRate(float(median), float(high - low) / (2.0 * Z95))


def _student(z: np.ndarray) -> np.ndarray:
    return -0.5 * (DEGREES + 1.0) * np.log1p(z**2 / DEGREES)
