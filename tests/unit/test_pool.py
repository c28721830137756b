"""Expected counts of a finite pool, and their variance, against pixels simulated one by one, independently."""

from dataclasses import replace

import numpy as np
import pytest

from pixelid.fit.coordinates import Coordinates
from pixelid.fit.pooled_rate import PooledRateObjective
from pixelid.likelihood.pool import Comparator, divide, flow, places, queued, signals
from pixelid.likelihood.pool_kinds import normal_points
from pixelid.likelihood.pooled_rate import PooledRate
from pixelid.model.shipped import find_model
from pixelid.recordings import Recording
from pixelid.recordings.bursts import find_bursts
from pixelid.simulate import simulate
from pixelid.stimuli.stimulus import Stimulus
from tests.oracles import whole_pixel as oracle

BIN_S, DURATION_S, PIXELS = 50e-6, 0.03, 1500
BITS = np.random.default_rng(7).integers(0, 2, 15)


def pixel(on=0.25, dead_s=1e-4, sigma=0.04):
    return oracle.Pixel(61287.0, 1851.0, 1.1236, 2 * np.pi * 3122, 2 * np.pi * 16000, on, 1.1 * on, dead_s, sigma)


def light(t):
    return np.where(BITS[np.minimum((t / 2e-3).astype(int), len(BITS) - 1)] > 0, 600.0, 60.0)


def chain(of, follower, amplifier):
    """(2, bins) expected ON and OFF counts, and their factorial moments, from signals on the oracle's grid."""
    bins = round(DURATION_S / BIN_S)
    grid = np.arange(len(follower)) * oracle.STEP_S
    edges = BIN_S * np.arange(bins + 1)
    rate = of.differencing * BIN_S
    steps = divide(np.interp(edges, grid, follower), np.interp(edges, grid, amplifier), of.on * of.sigma, rate)
    times = places(steps) * BIN_S
    shared = signals(steps, np.interp(times, grid, follower), np.interp(times, grid, amplifier))
    comparator = Comparator(of.on, of.off, of.sigma, 0.0, 0.0, of.dead_s / BIN_S, 0.0, rate)
    events, twice = flow(shared, comparator)
    return np.add.reduceat(events, shared.first[:-1], axis=1), twice


@pytest.mark.parametrize(("dead_s", "sigma"), [(1e-4, 0.04), (1e-5, 0.04), (1e-3, 0.08)])
def test_expected_counts_and_variances_are_those_of_simulated_pixels(dead_s, sigma):
    of = pixel(dead_s=dead_s, sigma=sigma)
    rng = np.random.default_rng(1)
    seen = oracle.signals(of, light, DURATION_S)
    t, which, sign = oracle.events(of, np.tile([of.on, of.off], (PIXELS, 1)), seen, rng)
    mean, twice = chain(of, seen.follower, seen.amplifier)
    for row, polarity in enumerate((1, -1)):
        counts = np.zeros((PIXELS, mean.shape[1]))
        mine = sign == polarity
        np.add.at(counts, (which[mine], np.minimum(t[mine] / BIN_S, mean.shape[1] - 1).astype(int)), 1)
        variance = twice[row] + mean[row] - mean[row] ** 2
        shown = mean[row] > 0.01
        off = (counts.mean(axis=0) - mean[row]) / np.sqrt(np.maximum(variance, 1e-3) / PIXELS)
        assert np.mean(off[shown] ** 2) < 2.5  # bins share pixels: with few events per pixel they err together
        assert variance.sum() == pytest.approx(counts.var(axis=0).sum(), rel=0.1)
        assert variance.sum() < 0.75 * mean[row].sum()  # Poisson's would be the mean


def test_simulated_pixels_are_delayed_as_the_counts_are():
    """A clock two bins late shifts expected counts and simulated pixels alike: the mean of their score stays."""
    t = 2e-3 * np.arange(16)
    stimulus = Stimulus(t, light(np.minimum(t, DURATION_S - 1e-9)), "relative", "previous")
    model = find_model("dvs128")
    run = simulate(model, stimulus, width=20, height=1, seed=1)
    zeros = np.zeros(len(run.events), np.uint16)
    pooled = Recording(replace(run.events, x=zeros, width=1), stimulus, condition="pool", pooled=True)
    likelihood = PooledRate([pooled])
    own = tuple(p.at(20.0) if p.name == "pooled.pixels" else p for p in likelihood.nuisances())
    means = []
    for delay_s in (0.0, 2 * BIN_S):
        coordinates = Coordinates.of(model.release(["delay_s"]).set({"delay_s": delay_s}), own)
        x = coordinates.start
        objective = PooledRateObjective(likelihood, coordinates).near(x)
        local = objective.local(x)
        information, mean = objective.scatter(x, local, 0)
        move = np.linalg.pinv(local.information) @ mean
        means.append(move @ information @ move)
    assert means[1] == pytest.approx(means[0], rel=0.01)


def test_many_small_thresholds_are_the_fluid_rate():
    """Without what a reset leaves behind: an amplifier as fast as the follower follows."""
    of = replace(pixel(on=0.02, dead_s=1e-9, sigma=0.1), differencing=1e12)
    follower = oracle.signals(pixel(), light, DURATION_S).follower
    mean, _ = chain(of, follower, follower)
    edges = BIN_S * np.arange(mean.shape[1] + 1)
    output = np.interp(edges, np.arange(len(follower)) * oracle.STEP_S, follower)
    assert mean[0].sum() == pytest.approx(np.maximum(np.diff(output), 0.0).sum() / of.on, rel=0.04)


def test_a_queue_delays_and_loses_nothing():
    events = np.zeros((2, 100))
    events[0, 10], events[1, 10] = 30.0, 10.0
    times = 1e-6 * np.arange(101)
    out = queued(events, times, 1e-6)
    assert out.sum() == pytest.approx(40.0)
    assert out[0].sum() == pytest.approx(30.0)
    assert 10 + np.flatnonzero(out.sum(axis=0) > 0.5)[-1] - 10 == pytest.approx(50, abs=2)


def test_points_of_kinds_are_centred_and_distinct():
    points = normal_points(24, 3)
    assert np.allclose(points.mean(axis=0), 0.0)
    assert np.allclose(points.std(axis=0), 1.0)
    assert np.abs(np.corrcoef(points.T) - np.eye(3)).max() < 0.15


def test_bursts_show_pixels_rows_and_dead_time():
    """49 pixels in rows of 7, 2 µs apart, every 120 µs; some rows are missing, and single events come between."""
    rng = np.random.default_rng(3)
    begin = np.cumsum(120_000 + rng.integers(0, 20_000, 400))
    rows = (begin[:, None] + 2_000 * np.arange(7)).ravel()
    rows = rows[rng.random(len(rows)) > 0.02]
    t = np.concatenate([np.repeat(rows, 7), rng.integers(0, begin[-1], 300)])
    bursts = find_bursts(np.sort(t), np.ones(len(t), np.uint8))
    assert bursts.pixels == 49
    assert bursts.row == 7
    assert bursts.spacing_s == pytest.approx(120e-6, rel=0.03)


def polled(busy_ns):
    """(t, p) of 49 pixels that a readout polls: busy for so long per event, 3 µs apart else.

    Half the time all fire as soon as they can, half the time with pauses.
    """
    rng, t, now, waits = np.random.default_rng(4), [], 0, np.zeros(49)
    while len(t) < 30_000:
        fire = np.flatnonzero(waits <= now)
        t += [now + 2_000 * int(row) for row in fire // 7]
        waits[fire] = now + 30_000 + (rng.exponential(60_000, len(fire)) if now // 4_000_000 % 2 else 0.0)
        now += 9_000 + busy_ns * len(fire) if len(fire) else 3_000
    t = np.sort(np.array(t))
    return t, np.ones(len(t), np.uint8)


def test_silences_that_grow_with_bursts_show_a_shared_readout():
    assert find_bursts(*polled(2_000)).silence_s == pytest.approx(9e-6 + 25 * 2e-6 - 12e-6, rel=0.3)
    assert find_bursts(*polled(0)).silence_s is None


def test_events_at_random_have_no_bursts():
    t = np.sort(np.random.default_rng(5).integers(0, 10**9, 40_000))
    assert find_bursts(t, np.ones(len(t), np.uint8)).pixels is None
