"""What a search looks at anew or takes back: effects that noise covered for, or that better times do not ask for."""

from dataclasses import replace

import pytest

from pixelid.fit.maximise import maximise
from pixelid.gap.attribute.attribute import Attribution, Candidate
from pixelid.gap.attribute.candidates import strongest_start
from pixelid.gap.criteria import Criteria
from pixelid.gap.options import Context, Options
from pixelid.gap.rounds import entry
from pixelid.gap.search import begin
from pixelid.gap.state import NamedStep
from pixelid.gap.steps.name_effect import NOTHING_LEFT_FOR_IT, restart, without_negligible
from pixelid.model.shipped import find_model
from pixelid.simulate import simulate
from pixelid.stimuli.resample import resampled
from pixelid.stimuli.shapes import chirp, steps

MODEL = find_model("dvs128")
CONTEXT = Context(Options(0.01, 1, (), Criteria(), False), None, lambda what, fraction: None)


def begun(model):
    """A search of two recordings of a camera, its base fitted."""
    lights = [chirp(400.0, stop_hz=400.0), steps(400.0, seed=3)]
    made = [
        simulate(model, resampled(light, "smooth"), width=3, height=3, seed=i, sensor_seed=3)
        for i, light in enumerate(lights)
    ]
    return begin([replace(r, stimulus=light) for r, light in zip(made, lights, strict=True)], MODEL, CONTEXT)


@pytest.fixture(scope="module")
def complete():
    """Nothing is missing."""
    return begun(MODEL)


def test_an_effect_that_noise_has_covered_for_is_looked_for_from_the_shipped_noise(complete):
    """A seventh of the events lost behind a slew limit: noise of thresholds takes the place of both, and keeps it."""
    lossy = MODEL.with_effect("lost_events", {"fraction": 0.15})
    state = begun(lossy.with_effect("slew_limit", {"rise_per_s": 2000.0, "fall_per_s": 2000.0}))
    pool, fit = state.hypothesis.evidence.screening, state.hypothesis.fit
    assert fit.values["threshold_sigma"] > 2.0 * MODEL.values["threshold_sigma"]
    again = restart(state, CONTEXT)
    assert again is not None
    assert again.values["threshold_sigma"] == MODEL.values["threshold_sigma"]
    ends = []
    for origin in (fit.model, again):
        start = strongest_start(pool, origin, "lost_events")
        assert start is not None
        ends.append(maximise(pool, start, tolerance=0.1, max_steps=15))
    assert ends[1].value > ends[0].value + 1000.0
    assert ends[1].values["threshold_sigma"] < 2.0 * MODEL.values["threshold_sigma"]
    assert restart(complete, CONTEXT) is None


@pytest.mark.parametrize(("fraction", "stays"), [(1e-5, False), (0.02, True)])
def test_an_effect_that_times_drawn_anew_leave_nothing_is_withdrawn(complete, fraction, stays):
    hypothesis = complete.hypothesis
    model = hypothesis.fit.model.with_effect("lost_events", {"fraction": fraction})
    fit = maximise(hypothesis.evidence.training, model, tolerance=1.0, max_steps=0)
    winner = Candidate("lost_events", fit, 600.0, 0.0, hypothesis.fit.x)
    step = NamedStep(winner, Attribution((), {}, None, (), {}), "", True, hypothesis)
    state = replace(
        complete, hypothesis=replace(hypothesis, fit=fit, start=hypothesis.start.with_effect("lost_events")),
        steps=(step,), rounds=(entry(1, 0.0, named="lost_events"),),
    )  # fmt: skip
    left = without_negligible(state, CONTEXT)
    assert left.hypothesis.fit.model.has("lost_events") == left.hypothesis.start.has("lost_events") == stays
    assert len(left.steps) == int(stays)
    assert left.rounds[0].get("withdrawn") == (None if stays else NOTHING_LEFT_FOR_IT)
