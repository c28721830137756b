"""Pooled pixels with different light: their counts against a sum over pixels, recovery, and what refuses it."""

import math
from dataclasses import replace

import numpy as np
import pytest

from pixelid.errors import InputError
from pixelid.fit.fit import fit
from pixelid.gap.pooled_counts.candidates import effects_to_try
from pixelid.likelihood.event_times import EventTimes
from pixelid.likelihood.pooled_rate import PooledRate, binned
from pixelid.model.shipped import find_model
from pixelid.recordings import Recording
from pixelid.recordings.crop import Crop
from pixelid.simulate import simulate
from pixelid.stimuli.stimulus import Stimulus

MODEL = find_model("dvs128").set({"on_threshold": 0.02, "off_threshold": 0.02, "refractory_s": 1e-6})
PLAIN = MODEL.without_effect("refractory_period").without_effect("threshold_mismatch").without_effect("threshold_noise")


def bits(seconds=1.0, seed=1):
    """A random sequence of two light levels, 60 and 300, one every 4 ms."""
    t = np.arange(0.0, seconds, 0.004)
    light = np.where(np.random.default_rng(seed).random(len(t)) > 0.5, 300.0, 60.0)
    return Stimulus(t, light, "relative", "previous")


def pool_of(factors, stimulus, model=MODEL, seed=0):
    """What pixels fire together whose light is multiplied by hand, each simulated alone."""
    events = []
    for i, factor in enumerate(factors):
        seen = Stimulus(stimulus.t, factor * stimulus.radiance, "relative", "previous")
        events.append(simulate(model, seen, seed=seed + i).events)
    t, p = (np.concatenate([getattr(e, name) for e in events]) for name in "tp")
    order = np.argsort(t, kind="stable")
    zeros = np.zeros(len(t), np.uint16)
    together = replace(events[0], t=t[order], p=p[order], x=zeros, y=zeros)
    return Recording(together, stimulus, condition="bits", pooled=True)


@pytest.mark.parametrize(("sigma", "error"), [(0.3, 0.012), (0.6, 0.04)])
def test_expected_counts_are_the_mean_over_pixels(sigma, error):
    """A sum over 400 quantiles of the normal distribution, each with its own light, against the quadrature."""
    from scipy.special import ndtri

    light = bits(0.3)
    recording = pool_of([1.0], light)
    circuit = PLAIN.circuit()

    def counts(brighter, spread):
        seen = replace(light, radiance=brighter * light.radiance)
        likelihood = PooledRate([recording.with_stimulus(seen)]).fluid()  # PLAIN has no threshold noise
        values = {**PLAIN.values, **{p.name: p.value for p in likelihood.nuisances()}}
        return likelihood.expected(circuit.with_(light_spread=spread), values)

    factors = np.exp(sigma * ndtri((np.arange(400) + 0.5) / 400))
    mean = np.mean([counts(factor, 0.0) for factor in factors], axis=0)
    found = counts(1.0, sigma)
    assert np.sqrt(((found - mean) ** 2).sum() / (mean**2).sum()) < error
    assert found.sum() == pytest.approx(mean.sum(), rel=5e-3)
    assert np.abs(found - counts(1.0, 0.0)).max() > 0.1 * mean.max()


def test_a_finite_pool_is_the_mean_over_its_pixels():
    """The same with thresholds that have noise, against the dozen kinds of pixel that stand for a pool."""
    from scipy.special import ndtri

    noisy = PLAIN.with_effect("threshold_noise", {"threshold_sigma": 0.1}).set(
        {"on_threshold": 0.2, "off_threshold": 0.2}
    )
    light = bits(0.1)
    recording = pool_of([1.0] * 9, light, noisy)

    def counts(brighter, spread):
        likelihood = PooledRate([recording.with_stimulus(replace(light, radiance=brighter * light.radiance))])
        values = {**noisy.values, **{p.name: p.value for p in likelihood.nuisances()}}
        return likelihood.expected(noisy.circuit().with_(light_spread=spread), values)

    factors = np.exp(0.3 * ndtri((np.arange(60) + 0.5) / 60))
    mean = np.mean([counts(factor, 0.0) for factor in factors], axis=0)
    found = counts(1.0, 0.3)
    assert np.sqrt(((found - mean) ** 2).sum() / (mean**2).sum()) < 0.03  # without a spread it is 0.19
    assert found.sum() == pytest.approx(mean.sum(), rel=5e-3)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_the_spread_comes_back_from_light_multiplied_by_hand(seed):
    sigma = 0.6
    factors = np.exp(sigma * np.random.default_rng(seed).standard_normal(150))
    recording = pool_of(factors, bits(seed=seed), seed=1000 * seed)
    held = MODEL.fix({"alpha": None, "beta": None, "gamma": None, "sf_cutoff_hz": None})
    end = fit([recording], held.with_effect("light_spread", {"sigma": 0.3}))
    assert end.estimates["light_spread.sigma"].value == pytest.approx(np.log(factors).std(), rel=0.15)


def test_the_simulator_gives_each_pixel_its_light():
    """Leak in proportion to light: the rates of pixels are log-normal."""
    model = MODEL.with_effect("parasitic_photocurrent", {"rate_hz_per_radiance": 1.0})
    model = model.with_effect("light_spread", {"sigma": 0.4}).set({"threshold_sigma": 1e-5})
    light = Stimulus(np.array([0.0, 1.0]), np.array([100.0, 100.0]))
    recording = simulate(model.without_effect("threshold_mismatch"), light, width=30, height=20, seed=3)
    rates = np.bincount(recording.events.pixel, minlength=600)
    assert np.log(rates).std() == pytest.approx(0.4, abs=0.05)
    assert np.log(np.median(rates) / 100.0) == pytest.approx(0.0, abs=0.08)
    assert recording.stimulus is light


def test_what_has_no_pool_refuses_it():
    model = find_model("dvs128").with_effect("light_spread")
    light = Stimulus(np.linspace(0.0, 1.0, 101), 100.0 * np.exp(np.sin(np.linspace(0.0, 20.0, 101))))
    recording = simulate(find_model("dvs128"), light, width=2, height=2)
    with pytest.raises(InputError, match="light_spread"):
        EventTimes([recording]).log_likelihood(model.circuit())
    with pytest.raises(InputError, match="light_spread"):
        fit([recording], model, starts=0)
    video = Stimulus(light.t, np.tile(light.radiance[:, None, None], (1, 2, 2)))
    with pytest.raises(InputError, match="light_spread"):
        simulate(model, video)


def test_only_the_gap_of_pooled_counts_looks_for_it():
    from types import SimpleNamespace
    from typing import Any

    recording = pool_of([1.0], bits(0.3))
    stretches: Any = SimpleNamespace(whole=PooledRate([recording]))
    assert "light_spread" in effects_to_try(stretches, PLAIN, ())
    assert "light_spread" not in effects_to_try(stretches, PLAIN.with_effect("light_spread"), ())


def test_pooled_counts_begin_where_a_cut_does():
    """The light before a cut stays, the events do not: its bins are no silence."""
    whole = pool_of([1.0, 1.0], bits(), PLAIN)
    seen, all_seen = (binned(r, 1e-3, math.inf) for r in (Crop(time_s=(0.4, 0.9)).applied(whole), whole))
    assert seen.edges[[0, -1]] == pytest.approx([0.4, 0.9], abs=1e-3)
    first = round((seen.edges[0] - all_seen.edges[0]) / 1e-3)
    np.testing.assert_array_equal(seen.on, all_seen.on[first : first + len(seen.on)])
    assert len(seen.on) >= 499
