"""A response that is linear in low light: simulated, in the likelihood, among candidates; by hand calculations."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp

from pixelid.errors import InputError
from pixelid.fit.coordinates import Coordinates
from pixelid.fit.engines.frozen import freeze
from pixelid.fit.event_times import EventTimesObjective
from pixelid.gap.attribute.candidates import variants
from pixelid.gap.gap import gap
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.shipped import find_model
from pixelid.recordings.events import Events
from pixelid.recordings.recording import Recording
from pixelid.simulate import simulate
from pixelid.stages.circuit import Circuit
from pixelid.stimuli.resample import resampled
from pixelid.stimuli.shapes import chirp, steps
from pixelid.stimuli.stimulus import Stimulus

IDEAL = Circuit(photoreceptor="unlimited", on_threshold=0.2, off_threshold=0.2)
KNEE = 20.0
LINES = {  # slope, and the response below the knee
    "smooth": (1.0, lambda radiance: math.log(KNEE) + radiance / KNEE - 1.0),
    "v2e": (math.log(KNEE), lambda radiance: radiance * math.log(KNEE) / KNEE),
}


@pytest.mark.parametrize("shape", ["full_field", "video"])
@pytest.mark.parametrize("line", list(LINES))
def test_events_come_where_the_bent_response_has_moved_by_a_threshold(shape, line):
    """Light that grows linearly from below the knee to above it: every level is reached when the formula says so."""
    slope, below = LINES[line]
    t = np.linspace(0.0, 1.0, 20_001)
    light = Stimulus.from_arrays(t, 2.0 + 58.0 * t)
    if shape == "video":
        light = Stimulus.from_arrays(t, np.broadcast_to(light.radiance[:, None, None], (len(t), 1, 2)))
    events = simulate(IDEAL.with_(knee=KNEE, knee_slope=slope), light, synchronous=True).events
    times = events.t[events.pixel == 0] * 1e-9
    first, at_knee, last = below(2.0), math.log(KNEE), math.log(60.0)
    levels = np.arange(first + 0.2, last, 0.2)
    radiance = [math.exp(u) if u > at_knee else np.interp(u, (first, at_knee), (2.0, KNEE)) for u in levels]
    assert len(times) == len(levels)
    np.testing.assert_allclose(times, (np.array(radiance) - 2.0) / 58.0, atol=2e-6)


def test_changes_equal_an_adaptive_solver_whose_rates_see_the_light_itself():
    t = np.arange(0.0, 0.06, 2e-5)
    stimulus = Stimulus(t, 18.0 * (1.0 + 0.7 * np.sin(2 * np.pi * 20 * t)))
    model = find_model("dvs128_low_light").without_effect("source_follower_pole")
    circuit = model.circuit().with_(knee=KNEE, leak_hz_per_radiance=0.02)
    slow, wd = circuit.corner, circuit.differencing
    response = np.array([math.log(L) if L > KNEE else math.log(KNEE) + L / KNEE - 1.0 for L in stimulus.radiance])

    def rhs(now, x):
        light = np.exp(np.interp(now, t, np.log(stimulus.radiance)))
        return [slow * light * (np.interp(now, t, response) - x[0]), wd * (x[0] - x[1])]

    begin, end = 0.0203, 0.0411
    release, start = begin + circuit.refractory, math.log(KNEE) + 18.0 / KNEE - 1.0
    path = solve_ivp(
        rhs, (0.0, end), [start, start], method="LSODA", rtol=1e-9, atol=1e-11, max_step=5e-5, dense_output=True
    ).sol
    wanted = path(end)[1] - path(release)[0] - (path(release)[1] - path(release)[0]) * np.exp(-wd * (end - release))
    events = Events.from_columns(np.array([20_300_000, 41_100_000]), np.zeros(2, int), np.zeros(2, int), [1, 0], 1, 1)
    changes = EventTimes([Recording(events, stimulus, sensor="test")]).changes(circuit).events
    assert changes.change[0] == pytest.approx(wanted, abs=5e-6)
    leaked = quad(lambda s: np.interp(s, t, stimulus.radiance), release, end, epsabs=1e-9, limit=500)[0]
    assert changes.drift[0] == pytest.approx(0.02 * leaked, rel=1e-4)


def session(model):
    """Two recordings in low light."""
    made = []
    for i, light in enumerate((chirp(24.0, stop_hz=60.0, duration_s=0.6), steps(24.0, seed=1, duration_s=0.6))):
        r = simulate(model, resampled(light, "smooth"), width=2, height=2, seed=i, sensor_seed=3)
        made.append(replace(r, stimulus=light, condition=f"part_{i}", attributes={}))
    return made


def test_the_likelihood_prefers_the_knee_that_was_simulated():
    truth = find_model("dvs128").with_effect("linear_log", {"knee": 18.0})
    likelihood = EventTimes([r.with_stimulus(resampled(r.stimulus, "smooth")) for r in session(truth)])
    values = {k: likelihood.log_likelihood(truth.set({"linear_log.knee": k}).circuit()) for k in (15.0, 18.0, 21.0)}
    assert max(values, key=values.get) == 18.0
    objective = EventTimesObjective(likelihood, Coordinates.of(truth))
    with pytest.raises(InputError, match="linear_log"):
        freeze(objective, objective.coordinates.start)


def test_candidates_have_both_lines():
    slopes = {m.values["linear_log.slope"] for m in variants(find_model("dvs128"), "linear_log")}
    assert slopes == {1.0, math.log(20.0)}


@pytest.mark.slow
def test_a_linear_response_in_low_light_is_named():
    camera = find_model("dvs128").set({"threshold_sigma": 0.03}).with_effect("linear_log", {"knee": 18.0})
    report = gap(session(camera), find_model("dvs128"), recommend=False)
    assert (report.verdict, [e.name for e in report.effects]) == ("named", ["linear_log"])
    assert report.effects[0].parameters["linear_log.knee"][0] == pytest.approx(18.0, rel=0.03)
