"""Pixels that wait for a readout they share, against pools that another simulator made."""

import numpy as np
import pytest

from pixelid.errors import InputError
from pixelid.fit.fit import fit
from pixelid.fit.pooled import read_out
from pixelid.gap.gap import gap
from pixelid.gap.pooled_counts.candidates import effects_to_try
from pixelid.gap.pooled_counts.stretches import cut_into_stretches
from pixelid.likelihood.pooled_rate import PooledRate
from pixelid.model.shipped import find_model
from pixelid.recordings import Recording
from pixelid.recordings.bursts import bursts_of
from pixelid.recordings.events import Events
from pixelid.simulate import simulate
from pixelid.stimuli.stimulus import Stimulus
from tests.oracles import shared_readout as shared
from tests.oracles import whole_pixel as oracle

BIT_S, PIXELS, SECONDS = 2e-3, 49, 0.2
CYCLE_S, EVENT_S, SPREAD = 6e-6, 1.9e-6, 0.05
PIXEL = oracle.Pixel(
    61287.0, 1851.0, 1.1236, 2 * np.pi * 3122, 2 * np.pi * 16000, 0.2, 0.22, 1e-5, 0.04, 0.03
)  # fmt: skip
BITS = np.where(np.random.default_rng(3).integers(0, 2, round(SECONDS / BIT_S)) > 0, 600.0, 60.0)
LIGHT = Stimulus(BIT_S * np.arange(len(BITS) + 1), np.append(BITS, BITS[-1]), "relative", "previous")
FREE = find_model("dvs128").set(
    {
        "alpha": PIXEL.alpha, "beta": PIXEL.beta, "gamma": PIXEL.gamma, "on_threshold": PIXEL.on,
        "off_threshold": PIXEL.off, "refractory_s": PIXEL.dead_s, "threshold_sigma": PIXEL.sigma,
        "threshold_mismatch.sigma": PIXEL.mismatch,
    }
)  # fmt: skip
MODEL = FREE.with_effect("shared_readout", {"cycle_s": CYCLE_S, "event_s": EVENT_S, "spread": SPREAD})


def recording(cycle_s=CYCLE_S, event_s=EVENT_S, spread=SPREAD, seed=3):
    t, _, p = shared.pool(
        PIXEL, PIXELS, lambda t: BITS[np.minimum((t / BIT_S + 1e-9).astype(int), len(BITS) - 1)], SECONDS, seed,
        cycle_s, event_s, spread,
    )  # fmt: skip
    zeros = np.zeros(len(t), np.uint16)
    return Recording(Events(t, zeros, zeros, p, 1, 1), LIGHT, condition="pool", pooled=True)


@pytest.fixture(scope="module")
def read():
    return recording()


@pytest.fixture(scope="module")
def free():
    return recording(0.0, 0.0, 0.0)


def sizes(t):
    """(4,) share of the events in cycles of few pixels, of several, of most and of all."""
    n = np.unique(t, return_counts=True)[1]
    return np.array([n[(n >= a) & (n < b)].sum() for a, b in ((1, 5), (5, 25), (25, 49), (49, 50))]) / len(t)


def test_a_simulated_pool_is_read_in_the_same_cycles(read):
    run = simulate(MODEL, LIGHT, width=PIXELS, height=1, seed=1).events
    assert len(run) == pytest.approx(len(read.events), rel=0.05)
    assert run.p.mean() == pytest.approx(read.events.p.mean(), abs=0.02)
    assert np.abs(sizes(run.t) - sizes(read.events.t)).max() < 0.06
    cycles = np.unique(run.t)
    assert np.diff(cycles).min() > 0.7 * (CYCLE_S + EVENT_S) * 1e9
    assert len(run) < 0.85 * len(simulate(FREE, LIGHT, width=PIXELS, height=1, seed=1).events)


def test_a_simulated_pool_does_not_depend_on_threads(read):
    one, two = (simulate(MODEL, LIGHT, width=PIXELS, height=1, seed=1, threads=n).events for n in (1, 2))
    assert np.array_equal(one.t, two.t)


def test_a_shared_readout_needs_light_that_all_share():
    with pytest.raises(InputError, match="light that all pixels share"):
        simulate(MODEL.with_effect("light_spread"), LIGHT, width=PIXELS, height=1)


def test_bursts_show_how_long_a_cycle_lasts(read, free):
    cycle = bursts_of(read).cycle
    assert cycle is not None
    assert cycle.cycle_s == pytest.approx(CYCLE_S, rel=0.5)  # where a fit starts
    assert cycle.event_s == pytest.approx(EVENT_S, rel=0.05)
    assert 0.03 < cycle.spread < 0.15
    assert bursts_of(free).cycle is None


def values(likelihood, model):
    quiet = {"pooled.pixels": float(PIXELS), "pooled.background_on_hz": 10.0, "pooled.background_off_hz": 10.0}
    return {**model.values, **{p.name: p.value for p in likelihood.nuisances()}, **quiet}


def test_expected_counts_and_their_variance_know_who_waits(read):
    likelihood = PooledRate([read])
    scatter = []
    for model in (MODEL, MODEL.set({"shared_readout.event_s": 1.5 * EVENT_S}), FREE):
        known = values(likelihood, model)
        near = likelihood.near(model.circuit(), known)
        expected = near.expected(model.circuit(), known)
        scatter.append(near.dispersion(expected))
        if model is MODEL:
            assert expected.sum() == pytest.approx(near.observed.sum(), rel=0.03)  # terms of 1/N are left out
    assert scatter[0] == pytest.approx(1.0, abs=0.4)
    assert min(scatter[1:]) > 5.0


def test_a_readout_is_looked_for_where_bursts_show_one(read, free):
    for pool, wanted in ((read, True), (free, False)):
        likelihood = PooledRate([pool])
        stretches = cut_into_stretches(likelihood, 1.0, likelihood.nuisances(), 0)
        assert ("shared_readout" in effects_to_try(stretches, FREE, [])) is wanted
        assert "shared_readout" not in effects_to_try(stretches, FREE, ["shared_readout"])
    begun = read_out(MODEL, [bursts_of(read)]).values
    assert begun["shared_readout.event_s"] == pytest.approx(EVENT_S, rel=0.05)


@pytest.mark.slow
def test_a_fit_finds_the_readout_and_the_dead_time(read):
    end = fit([read], find_model("dvs128").with_effect("shared_readout"))
    found = {name: estimate.value for name, estimate in end.estimates.items()}
    assert end.details["dispersion"] < 1.5
    assert found["shared_readout.event_s"] == pytest.approx(EVENT_S, rel=0.03)
    assert found["refractory_s"] == pytest.approx(PIXEL.dead_s, rel=0.5)
    assert found["alpha"] == pytest.approx(PIXEL.alpha, rel=0.002)
    assert found["on_threshold"] == pytest.approx(PIXEL.on, rel=0.02)
    assert found["off_threshold"] == pytest.approx(PIXEL.off, rel=0.02)


@pytest.mark.slow
def test_the_gap_names_the_readout(read):
    report = gap([read], find_model("dvs128").without_effect("refractory_period"))
    assert report.effects[0].name == "shared_readout"
    assert report.free_run.closed > 0.8
