"""Identifiability: designs that cannot tell are said so, and their parameters are not called known."""

from dataclasses import replace

import numpy as np
import pytest

from pixelid.fit import fit
from pixelid.fit.coordinates import Coordinates
from pixelid.fit.newton import maximise
from pixelid.fit.uncertainty.curvature import combination
from pixelid.fit.uncertainty.profiles import objective_of, profile, profiled
from pixelid.fit.uncertainty.small_sample import intervals
from pixelid.fit.uncertainty.stimulus_design import caveats, design_of, exchanged_poles
from pixelid.model.shipped import find_model
from pixelid.recordings.events import Events
from pixelid.recordings.recording import Recording
from pixelid.simulate import simulate
from pixelid.stimuli.shapes import chirp, sine, steps
from pixelid.stimuli.stimulus import Stimulus


def under(*stimuli):
    return [Recording(Events.empty(1, 1), stimulus) for stimulus in stimuli]


def test_designs():
    one = design_of(under(sine(50.0, 0.3, 20.0, 0.5)))
    assert one.one_level
    assert one.one_frequency
    assert one.frequency_hz == pytest.approx(20.0, rel=0.05)
    rich = design_of(under(chirp(5.0), steps(100.0)))
    assert not rich.poor
    assert design_of(under(chirp(50.0), steps(50.0))).one_level
    assert not design_of(under(sine(50.0, 0.3, 20.0), sine(50.0, 0.3, 80.0))).one_frequency
    shape = design_of(under(Stimulus.from_arrays([0.0, 1.0], [0.0, 1.0], "shape")))
    assert shape.shape
    assert not shape.poor


def test_exchanged_poles_have_the_same_characteristic_polynomial():
    values = {"alpha": 1e4, "beta": 3000.0, "gamma": 1.0, "sf_cutoff_hz": 300.0}
    level = 100.0

    def polynomial(v):
        pair = [1.0, v["beta"] + v["gamma"] * level, v["alpha"] * level]
        return np.polymul(pair, [1.0, 2 * np.pi * v["sf_cutoff_hz"]])

    exchanged = exchanged_poles(values, level)
    assert len(exchanged) == 2
    for other in exchanged:
        np.testing.assert_allclose(polynomial(other), polynomial(values), rtol=1e-12)
        assert other["sf_cutoff_hz"] != pytest.approx(300.0)
    assert exchanged_poles({**values, "alpha": 1e6}, level) == []  # a complex pair has no pole to give away


def test_caveats_in_words():
    values = {"alpha": 1e4, "beta": 3000.0, "gamma": 1.0, "sf_cutoff_hz": 300.0}
    said = " ".join(caveats(design_of(under(sine(100.0, 0.3, 20.0, 0.5))), values, values))
    for words in ("one radiance level", "exchanged", "one frequency", "contrast × threshold"):
        assert words in said
    assert caveats(design_of(under(chirp(50.0), steps(50.0))), values, {"alpha", "beta"}) == []  # gamma is held
    assert caveats(design_of(under(chirp(5.0), steps(100.0))), values, values) == []


def test_eigenvectors_in_words():
    assert combination(["alpha", "beta", "gamma"], np.array([0.8, -0.4, 0.01])) == "alpha × k with beta × k^-0.5"


def test_few_pixels_widen_thresholds_and_only_them():
    """Toy: n thresholds of unknown mean and spread.  Normal intervals miss too often, the corrected ones do not."""
    rng = np.random.default_rng(0)
    n, spread, hits, plain = 9, 0.05, np.zeros(2), 0
    names = ["alpha", "on_threshold", "off_threshold", "threshold_mismatch.sigma"]
    for _ in range(4000):
        thresholds = spread * rng.normal(size=(2, n))
        estimate = np.sqrt(thresholds.var(axis=1).mean())  # maximum likelihood, one spread for ON and OFF
        x = np.array([0.0, *thresholds.mean(axis=1), np.log(estimate)])
        sd = np.array([0.1, estimate / np.sqrt(n), estimate / np.sqrt(n), 1 / np.sqrt(4 * n)])
        low, high = intervals(names, x, sd, n)
        hits += [low[1] <= 0 <= high[1], low[3] <= np.log(spread) <= high[3]]
        plain += abs(x[1]) < 1.96 * sd[1]
        assert high[0] == pytest.approx(0.196, rel=1e-3)
    assert plain / 4000 < 0.93
    assert 0.94 < hits[0] / 4000 < 0.965
    assert 0.935 < hits[1] / 4000 < 0.965


@pytest.fixture(scope="module")
def single():
    """One level, one frequency: what data cannot say."""
    model = find_model("dvs128").without_effect("threshold_mismatch")
    recording = simulate(model, sine(24.0, 0.5, 20.0, 0.5, dt=2e-4), width=3, height=1, seed=1)
    return [recording], fit([recording], model, starts=0, between="linear")


def test_one_level_one_frequency_is_not_reported_as_known(single):
    _, result = single
    for name in ("alpha", "beta", "gamma", "sf_cutoff_hz", "diff_cutoff_hz"):
        assert not result.estimates[name].identified, name
    said = " ".join(result.as_dict()["unidentified"])
    for words in ("one radiance level", "one frequency", "exchanged", "contrast × threshold"):
        assert words in said
    assert result.details["condition_number"] > 1e3
    assert result.details["directions_best_to_least_known"][-1]["sd"] > 0.5


@pytest.mark.parametrize("seed", [1, 2])
def test_one_frequency_at_two_levels_gives_no_tight_wrong_numbers(seed):
    truth = find_model("dvs128")
    light = [sine(level, 0.5, 25.0, 0.4, dt=2e-4) for level in (10.0, 300.0)]
    recordings = [simulate(truth, s, width=4, height=2, seed=10 * seed + i, sensor_seed=seed)
                  for i, s in enumerate(light)]  # fmt: skip
    result = fit(recordings, truth, starts=1, between="linear", seed=seed)
    assert "one frequency" in " ".join(result.unidentified)
    assert not result.estimates["diff_cutoff_hz"].identified
    for name in ("alpha", "beta", "gamma", "sf_cutoff_hz"):
        e = result.estimates[name]
        assert not e.identified or abs(np.log(e.value / truth.values[name])) < 4.0 * e.std / e.value, name


def test_profiles_are_bounded_one_sided_or_flat(single):
    recordings, result = single
    truth = find_model("dvs128").values
    objective = objective_of(result, recordings)
    for name in ("threshold_sigma", "on_threshold", "off_threshold"):
        threshold = profile(objective, result.x, name, result.covariance)
        assert threshold.kind == "bounded"
        low, high = threshold.interval_95
        assert low < truth[name] < high
        assert threshold.sentence() == ""
    at_least = profile(objective, result.x, "diff_cutoff_hz", result.covariance)
    assert at_least.kind == "one-sided"
    low, high = at_least.interval_95
    assert high is None
    assert low < truth["diff_cutoff_hz"]
    assert "at least" in at_least.sentence()
    at_most = profile(objective, result.x, "refractory_s", result.covariance)
    assert at_most.kind == "one-sided"
    assert at_most.interval_95[0] is None
    assert truth["refractory_s"] < at_most.interval_95[1]
    # within these bounds a slow light says nothing about the amplifier's pole
    model = result.model.set({"diff_cutoff_hz": 16e3})
    narrow = replace(model.parameter("diff_cutoff_hz"), lower=5e3, upper=1e5)
    model = replace(model, parameters={**model.parameters, "diff_cutoff_hz": narrow})
    within = type(objective)(objective.likelihood, Coordinates.of(model))
    end = maximise(within, within.coordinates.start, max_steps=400)
    flat = profile(within, end.x, "diff_cutoff_hz", result.covariance)
    assert flat.kind == "flat"
    assert flat.interval_95 == (None, None)
    assert "flat" in flat.sentence()


@pytest.mark.slow
def test_profiles_reach_the_result(single):
    recordings, result = single
    profiles = profiled(result, recordings)
    kinds = {name: entry["kind"] for name, entry in profiles.as_dict()["details"]["profiles"].items()}
    assert set(kinds) == set(result.coordinates.names)
    for name, kind in kinds.items():
        assert not profiles.estimates[name].identified or kind == "bounded"
    assert any("one-sided" in sentence for sentence in profiles.unidentified)
