"""Few events over many days: what they cost goes with the events, and their times keep their precision."""

import time
from dataclasses import replace

import numpy as np
import pytest

from pixelid.errors import InputError
from pixelid.fit.coordinates import Coordinates
from pixelid.fit.event_times import EventTimesObjective
from pixelid.inspection.health import inspect
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.shipped import find_model
from pixelid.recordings import Events, Recording
from pixelid.recordings.alignment_from_events import align_events
from pixelid.simulate import simulate
from pixelid.stimuli.drive import drive
from pixelid.stimuli.shapes import chirp
from pixelid.stimuli.stimulus import Stimulus

DAYS_S = 9 * 86400


def test_derivatives_of_late_events_are_those_of_early_ones():
    model = find_model("dvs128")
    early = simulate(model, chirp(duration_s=0.3), width=3, seed=1)
    events = early.events
    assert isinstance(early.stimulus, Stimulus)
    late = replace(
        early, events=replace(events, t=events.t + DAYS_S * 10**9), stimulus=early.stimulus.shifted(DAYS_S)
    )  # fmt: skip
    coordinates = Coordinates.of(model)
    objectives = [EventTimesObjective(EventTimes([recording]), coordinates) for recording in (early, late)]
    slopes = [objective.gradient(coordinates.start) for objective in objectives]
    errors = np.sqrt(np.diag(objectives[0].local(coordinates.start).information))
    assert np.all(np.abs(slopes[1] - slopes[0]) < 0.02 * errors)


def test_inspection_takes_as_long_as_the_events_do():
    rng = np.random.default_rng(0)
    t = np.sort(rng.integers(0, DAYS_S * 10**9, 400))
    pixel = rng.integers(0, 64, (2, 400))
    began = time.process_time()
    health = inspect(Recording(Events.from_columns(t, *pixel, t % 2, 64, 64)))
    assert time.process_time() - began < 2.0
    assert health.counts.events == 400


def test_what_would_grow_with_the_span_is_refused_with_a_way_out():
    light = Stimulus(np.array([0.0, 1.0, DAYS_S]), np.array([50.0, 80.0, 80.0]))
    flickering = find_model("dvs128").with_effect("mains_flicker").circuit()
    with pytest.raises(InputError, match=r"at most 5243 s.*time.*without"):
        drive(light, flickering)
    events = Events.from_columns(np.array([1, 2]) * 10**9, *np.zeros((3, 2), int), 1, 1)
    with pytest.raises(InputError, match="found 1 s and 777600 s"):
        align_events(Recording(events), light)
