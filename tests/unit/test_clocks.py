"""Clocks of recordings: what an alignment says of itself, and what a delay and a drift do to the likelihoods."""

from dataclasses import replace

import numpy as np
import pytest

from pixelid.errors import InputError
from pixelid.fit.coordinates import Coordinates
from pixelid.fit.event_times import EventTimesObjective
from pixelid.likelihood.clocks import Clock, clock_parameters, clocks_of, unseparated
from pixelid.likelihood.event_times import EventTimes
from pixelid.likelihood.pooled_rate import PooledRate
from pixelid.model.shipped import find_model
from pixelid.recordings.clocks import CRYSTAL, clock_of
from pixelid.recordings.recording import Recording
from pixelid.simulate import simulate
from pixelid.stimuli.shapes import steps

MODEL = find_model("dvs128")
PRIOR = {"at_s": 0.15, "span_s": 0.3, "delay_sd_s": 3e-7, "rate_mean": 5e-5, "rate_sd": 1e-6}
TOLD = {"method": "trigger", "offset_s": 7.0, "clock_rate_error": 5e-5, "offset_interval_95": [6.9, 7.1]}
TOLD["prior"] = PRIOR


@pytest.fixture(scope="module")
def plain() -> list[Recording]:
    """Two recordings of four pixels, on their light's clock."""
    lights = [steps(level, duration_s=0.3, dt=1e-4, seed=k) for k, level in enumerate((100.0, 500.0))]
    made = [simulate(MODEL, light, width=2, height=2, seed=k, sensor_seed=0) for k, light in enumerate(lights)]
    return [replace(recording, condition=f"level {k}", sensor="one") for k, recording in enumerate(made)]


def saying(recording: Recording, **changes) -> Recording:
    """The recording with an attribute `alignment`."""
    return replace(recording, attributes={"alignment": {**TOLD, **changes}})


def test_what_has_no_interval_is_exact(plain):
    for attributes in ({}, {"alignment": "by hand"}, {"alignment": {**TOLD, "method": "first-event"}},
                       {"alignment": {**TOLD, "offset_interval_95": None}}):  # fmt: skip
        recording = replace(plain[0], attributes=attributes)
        assert clock_of(recording) is None
        assert clock_parameters([recording]) == ()
    assert clocks_of(plain, {"delay_s": 0.0, "alpha": 1.0}) is None


def test_events_are_not_counted_twice(plain):
    """A prior of `auto` would be made of the events that the fit sees again; without one, only clocks are known."""
    recording = saying(plain[0], method="auto", prior=None, clock_rate_error=3e-5)
    delay, drift = clock_parameters([recording])
    assert delay.prior is None
    assert drift.prior is not None
    assert drift.prior.sd == pytest.approx(0.3 * CRYSTAL, rel=1e-3)
    assert drift.prior.mean == pytest.approx(-0.3 * 3e-5, rel=1e-3)  # the clocks' own rate is about 0
    assert "trigger" in unseparated([recording, recording])
    assert unseparated([recording, plain[1]]) == unseparated([recording, saying(plain[1])]) == ""


@pytest.mark.parametrize(
    "changes",
    [{"offset_s": "late"}, {"clock_rate_error": None}, {"prior": 3}, {"prior": {**PRIOR, "span_s": 0.0}},
     {"prior": {**PRIOR, "rate_sd": float("nan")}}, {"prior": {**PRIOR, "delay_sd_s": -1.0}}],
)  # fmt: skip
def test_impossible_numbers_are_refused(plain, changes):
    with pytest.raises(InputError, match="alignment"):
        clock_of(saying(plain[0], **changes))


def test_recordings_of_one_name_have_clocks_of_their_own(plain):
    twins = [replace(saying(r), condition="twin") for r in plain]
    names = [p.name for p in clock_parameters(twins)]
    assert len(set(names)) == 4
    clocks = clocks_of(twins, {names[2]: 1e-6})
    assert clocks is not None
    assert clocks[0] is None
    assert clocks[1] == Clock(0.15, 0.3, 1e-6, 0.0)
    with pytest.raises(InputError, match="twin"):
        clocks_of(plain, {names[2]: 1e-6})


def test_a_clock_undoes_what_a_clock_did(plain):
    """Events of a camera that is late and fast, by their own clock, are as likely as the events were."""
    delay, drift = 30e-6, 20e-6
    t = plain[0].events.t
    moved = np.rint(t + 1e9 * (delay + drift * (t * 1e-9 - 0.15) / 0.3)).astype(np.int64)
    late = [replace(plain[0], events=replace(plain[0].events, t=moved))]
    slope = drift / 0.3  # t + δ + D (t − a)/T, undone: δ and D about the late times
    clock = Clock(0.15, 0.3, delay / (1 + slope), drift / (1 + slope))
    circuit = MODEL.circuit()
    before = EventTimes(plain[:1]).log_likelihood(circuit)
    after = EventTimes(late)
    assert after.log_likelihood(circuit) < before - 10.0
    # 1 ns of rounding moves a level by 1e-6 and 0.3 s of survival by as little
    assert after.with_clocks((clock,)).log_likelihood(circuit) == pytest.approx(before, abs=0.02)


def test_gradients_along_clocks_are_those_of_the_value(plain):
    recordings = [saying(plain[0]), plain[1]]
    coordinates = Coordinates.of(MODEL, clock_parameters(recordings))
    assert [name for name in coordinates.names if "align" in name] == [
        "alignment.delay_s[level 0]", "alignment.drift_s[level 0]"
    ]  # fmt: skip
    rng = np.random.default_rng(1)
    factor = rng.uniform(0.9, 1.1, EventTimes(recordings).events)
    objective = EventTimesObjective(EventTimes(recordings).with_threshold_factor(factor), coordinates)
    x = coordinates.start + 0.02 * rng.normal(size=len(coordinates)) * coordinates.longest_moves()
    gradient = objective.gradient(x)
    np.testing.assert_allclose(objective.local(x).gradient, gradient, rtol=1e-12)
    for i in (-2, -1):
        step = 3e-8
        up, down = x.copy(), x.copy()
        up[i] += step
        down[i] -= step
        assert gradient[i] == pytest.approx((objective.value(up) - objective.value(down)) / (2 * step), rel=1e-4)


def test_recordings_without_a_clock_are_as_likely_as_ever(plain):
    likelihood = EventTimes(plain)
    assert likelihood.with_clocks(None) is likelihood
    still = likelihood.with_clocks((Clock(0.15, 0.3), None))
    assert still.log_likelihood(MODEL.circuit()) == likelihood.log_likelihood(MODEL.circuit())


def test_pooled_counts_know_the_drift(plain):
    """A drift about a moment a million lengths away is a delay."""
    far = {**PRIOR, "at_s": -0.3e6}
    likelihood = PooledRate([saying(plain[0], prior=far)])
    values = {p.name: p.value for p in likelihood.nuisances()}
    assert "alignment.drift_s[level 0]" in values
    drifting = likelihood.output(0, MODEL.circuit(), {**values, "delay_s": 0.0, "alignment.drift_s[level 0]": 1e-10})
    late = likelihood.output(0, MODEL.circuit(), {**values, "delay_s": 1e-4})
    assert np.abs(late - likelihood.output(0, MODEL.circuit(), {**values, "delay_s": 0.0})).max() > 1e-3
    np.testing.assert_allclose(drifting, late, atol=1e-8)
