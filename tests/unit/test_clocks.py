"""Clocks of recordings: what an alignment says of itself, and what a delay and a drift do to the likelihoods."""

from dataclasses import replace

import numpy as np
import pytest

from pixelid.errors import InputError
from pixelid.fit.bench import common_delay, held, rate_prior, with_bench
from pixelid.fit.coordinates import Coordinates
from pixelid.fit.event_times import EventTimesObjective
from pixelid.likelihood.clocks import clock_in
from pixelid.likelihood.event_times import EventTimes
from pixelid.likelihood.pooled_rate import PooledRate
from pixelid.model.model import CLOCK_RATE
from pixelid.model.shipped import find_model
from pixelid.recordings.bench import Bench, on_bench
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
        assert with_bench(MODEL, [recording]) is MODEL
        assert clock_in(recording, MODEL.circuit({CLOCK_RATE.name: 1e-5})) is None


def test_events_are_not_counted_twice(plain):
    """A prior of `auto` would be made of the events that the fit sees again; without one, only clocks are known."""
    recording = saying(plain[0], method="auto", prior=None, clock_rate_error=3e-5)
    nuisances = with_bench(MODEL, [recording]).nuisances
    assert nuisances["alignment.delay_s[level 0]"].prior is None
    rate = nuisances[CLOCK_RATE.name]
    assert rate.prior is not None
    assert (rate.prior.mean, rate.prior.sd, rate.prior.df) == (0.0, CRYSTAL, 4.0)
    assert "trigger" in common_delay([recording, recording])
    assert common_delay([recording, plain[1]]) == common_delay([recording, saying(plain[1])]) == ""


def test_levels_and_zeros_have_priors_where_a_bench_states_them(plain):
    stated = on_bench(plain[0], Bench(0.03, 0.2))
    nuisances = with_bench(MODEL, [stated, plain[1]]).nuisances
    assert set(nuisances) == {"light_gain[level 0]", "light_offset[level 0]"}
    assert nuisances["light_gain[level 0]"].prior.sd == 0.03
    offset = nuisances["light_offset[level 0]"]
    assert offset.upper == pytest.approx(0.5 * stated.stimulus.radiance.min())
    circuit = held(with_bench(MODEL, [stated]), {"light_offset[level 0]": 1.5}).circuit()
    assert circuit.in_recording("level 0").dark == 1.5
    assert circuit.in_recording("level 1").dark == 0.0
    with pytest.raises(InputError, match="light_gane"):
        held(with_bench(MODEL, [stated]), {"light_gane[level 0]": 1.0})


def test_one_wrong_edge_does_not_move_the_common_rate():
    """Eleven recordings agree within 1 ppm; the twelfth has an edge that stretches its clock by 60."""
    rng = np.random.default_rng(3)
    rates = [(44e-6 + 1e-6 * rng.normal(), 1e-6) for _ in range(11)]
    prior = rate_prior([*rates, (104e-6, 1e-6)])
    assert prior.mean == pytest.approx(44e-6, abs=1e-6)
    assert prior.sd < 1e-6
    assert rate_prior([(3e-5, CRYSTAL)]).mean == 0.0  # no better than what is known of crystals


@pytest.mark.parametrize(
    "changes",
    [{"offset_s": "late"}, {"clock_rate_error": None}, {"prior": 3}, {"prior": {**PRIOR, "span_s": 0.0}},
     {"prior": {**PRIOR, "rate_sd": float("nan")}}, {"prior": {**PRIOR, "delay_sd_s": -1.0}}],
)  # fmt: skip
def test_impossible_numbers_are_refused(plain, changes):
    with pytest.raises(InputError, match="alignment"):
        clock_of(saying(plain[0], **changes))


def test_a_rate_and_a_delay_undo_what_a_clock_did(plain):
    """Events of a camera that is late and fast, by their own clock, are as likely as the events were."""
    delay, slope = 30e-6, 20e-6 / 0.3
    t = plain[0].events.t
    moved = np.rint(t + 1e9 * (delay + slope * (t * 1e-9 - 0.15))).astype(np.int64)
    late = saying(replace(plain[0], events=replace(plain[0].events, t=moved)), clock_rate_error=0.0)
    before = EventTimes(plain[:1]).log_likelihood(MODEL.circuit())
    after = EventTimes([late])
    assert after.log_likelihood(MODEL.circuit()) < before - 10.0
    # t + δ + D (t − a), undone: δ and D about the late times; ρ = (R − r)/(1 + R) with r = 0
    rho = slope / (1 + slope)
    known = {"alignment.delay_s[level 0]": delay / (1 + slope), CLOCK_RATE.name: rho / (1 - rho)}
    circuit = held(with_bench(MODEL, [late]), known).circuit()
    # 1 ns of rounding moves a level by 1e-6 and 0.3 s of survival by as little
    assert after.log_likelihood(circuit) == pytest.approx(before, abs=0.02)
    previous, time = after.times_on_light(circuit)
    np.testing.assert_allclose(time, EventTimes(plain[:1]).time_s, atol=2e-9)
    assert (previous < time).all()


def test_gradients_along_clocks_and_levels_are_those_of_the_value(plain):
    recordings = [on_bench(saying(plain[0]), Bench(0.03, 0.2)), saying(plain[1])]
    coordinates = Coordinates.of(with_bench(MODEL, recordings))
    own = [name for name in coordinates.names if "align" in name or "light" in name]
    assert own == ["alignment.delay_s[level 0]", "light_gain[level 0]", "light_offset[level 0]",
                   "alignment.delay_s[level 1]", "alignment.clock_rate"]  # fmt: skip
    rng = np.random.default_rng(1)
    factor = rng.uniform(0.9, 1.1, EventTimes(recordings).events)
    objective = EventTimesObjective(EventTimes(recordings).with_threshold_factor(factor), coordinates)
    x = coordinates.start + 0.02 * rng.normal(size=len(coordinates)) * coordinates.longest_moves()
    gradient = objective.gradient(x)
    np.testing.assert_allclose(objective.local(x).gradient, gradient, rtol=1e-12)
    for i in range(-5, 0):
        step = 3e-5 * coordinates.longest_moves()[i]
        up, down = x.copy(), x.copy()
        up[i] += step
        down[i] -= step
        slope = (objective.value(up) - objective.value(down)) / (2 * step)
        assert gradient[i] == pytest.approx(slope, rel=1e-3, abs=1e-4 * abs(slope))


def test_pooled_counts_know_the_rate(plain):
    """A rate about a moment a million lengths away is a delay."""
    far = {**PRIOR, "at_s": -0.3e6}
    recording = saying(plain[0], prior=far, clock_rate_error=0.0)
    likelihood = PooledRate([recording])
    values = {p.name: p.value for p in likelihood.nuisances()}
    rate = 1e-4 / 0.3e6
    drifting = likelihood.output(0, MODEL.circuit({CLOCK_RATE.name: rate}), {**values, "delay_s": 0.0})
    late = likelihood.output(0, MODEL.circuit(), {**values, "delay_s": 1e-4})
    assert np.abs(late - likelihood.output(0, MODEL.circuit(), {**values, "delay_s": 0.0})).max() > 1e-3
    np.testing.assert_allclose(drifting, late, atol=1e-8)
