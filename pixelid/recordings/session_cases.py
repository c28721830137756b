"""What is known of each recording of a session before it is aligned: its events against lights, its edges, the rate.

Where the events do not follow their own light, they are held against it with ON and OFF exchanged, and against the
other recordings' lights.  The clock rate is one of the whole session: what events, pairs of trigger edges and the prior
say together.  Edges may be misplaced: their likelihood is Student's t with 4 degrees of freedom, as is the prior.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pixelid.errors import InputError
from pixelid.recordings.alignment import trigger_edges
from pixelid.recordings.alignment_from_events import LARGEST_LOSS, LEAST_CHANGES, EventAlignment, align_events
from pixelid.recordings.alignment_search import correlation
from pixelid.recordings.clocks import CRYSTAL
from pixelid.recordings.recording import Recording
from pixelid.statistics import Z95
from pixelid.stimuli.pixel_lights import Light, lights_in

DEGREES = 4.0  # of Student's t: statements may be wrong
OTHER_LIGHTS = 3  # that are tried where events do not follow their own, by correlation
CONSTANT_SPAN, CONSTANT_RANGE = 0.05, 0.2  # of ln L, 1 to 99 % and all: below any threshold, above a trace's noise


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


def case_of(
    recording: Recording, light: Light, recordings: Sequence[Recording], lights: Sequence[Light], how: str
) -> Case:
    how = how or ("trigger" if recording.triggers is not None and len(recording.triggers) else "auto")
    name, polarity = recording.name, 1
    events = _events(recording, light)
    if not _explains(events) and len(recording.events) > LEAST_CHANGES:
        own = [] if events is None or not events.follows else [(events, light, name, 1)]
        hypotheses = [*own, *_other_hypotheses(recording, light, recordings, lights)]
        if hypotheses:
            events, light, name, polarity = min(hypotheses, key=lambda entry: entry[0].loss_of_all)
    edges, moments, stamp = np.empty(0), np.empty(0), 0.0
    if how.startswith("trigger"):
        edges, moments, stamp = trigger_edges(recording, light, how)
    return Case(recording, light, name, how, events, polarity, edges, moments, stamp)


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
    return spans < CONSTANT_SPAN and max(float(np.ptp(log)) for log in logs) < CONSTANT_RANGE


def _explains(events: EventAlignment | None) -> bool:
    """Whether nearly all events follow: another light may share a few edges."""
    return events is not None and events.follows and events.loss_of_all <= LARGEST_LOSS


def _other_hypotheses(
    recording: Recording, own: Light, recordings: Sequence[Recording], lights: Sequence[Light]
) -> list[tuple[EventAlignment, Light, str, int]]:
    """(events, light, its recording's name, polarity) that are followed; exchanged polarity alone where it explains."""
    both = 0 < np.count_nonzero(recording.events.p) < len(recording.events)
    exchanged = _events(recording, own, -1) if both else None  # events of one polarity follow an edge of either kind
    if exchanged is not None and _explains(exchanged):
        return [(exchanged, own, recording.name, -1)]
    others = [(correlation(recording, light), k) for k, light in enumerate(lights) if light is not own]
    tried: list[tuple[EventAlignment | None, Light, str, int]] = [(exchanged, own, recording.name, -1)]
    for _, k in sorted(others, reverse=True)[:OTHER_LIGHTS]:
        tried.append((_events(recording, lights[k]), lights[k], recordings[k].name, 1))
    return [
        (events, light, name, polarity)
        for events, light, name, polarity in tried
        if events is not None and events.follows
    ]


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
