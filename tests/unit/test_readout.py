"""Readout as pure functions: queue, jitter, grid."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.stats import binom

from pixelid.inspection.timestamps import find_service_time
from pixelid.recordings.events import Events
from pixelid.recordings.recording import Recording
from pixelid.simulate.readout import Readout, jitter, quantise, queue
from pixelid.stages.circuit import Circuit


def burst(n=4000, seed=0):
    rng = np.random.default_rng(seed)
    t = np.sort(rng.integers(0, 2_000_000, n))
    return Events.from_columns(t, rng.integers(0, 20, n), rng.integers(0, 10, n), rng.integers(0, 2, n), 20, 10)


def test_queue_is_first_come_first_served():
    t, out = burst().t, np.empty(4000, np.int64)
    last = queue(t, 700.0, -np.inf, out)
    expected, busy = [], -np.inf
    for arrival in t:
        busy = max(arrival, busy) + 700
        expected.append(busy)
    np.testing.assert_array_equal(out, expected)
    assert last == expected[-1]
    assert np.diff(out).min() == 700


def test_queue_keeps_fractions_of_a_nanosecond():
    out = np.empty(1000, np.int64)
    queue(np.zeros(1000, np.int64), 0.4, -np.inf, out)
    assert out[-1] == 400


def test_jitter_is_gaussian_and_counted():
    t = np.full(100_000, 10_000_000)
    moved = jitter(t, 5000.0, 0, 3) - t
    assert abs(moved.std() / 5000 - 1) < 0.01
    assert abs(moved.mean()) < 60
    np.testing.assert_array_equal(jitter(t, 5000.0, 40, 3)[:10], jitter(t, 5000.0, 0, 3)[40:50])
    assert jitter(np.zeros(1000, np.int64), 5000.0, 0, 3).min() == 0


def test_grid_is_to_the_nearest_tick():
    t = np.array([0, 499, 501, 1499, 2500])
    np.testing.assert_array_equal(quantise(t, 1000.0), [0, 0, 1000, 1000, 2000])
    scan = quantise(np.arange(0, 10_000_000, 777), 197_333.3)
    assert np.unique(np.diff(np.unique(scan))).tolist() == [197_333, 197_334]


def test_chunks_change_nothing_and_order_is_kept():
    events = burst()
    circuit = Circuit(service=3e-7, jitter=2e-5, tick=1e-6)
    whole = Readout(circuit, 9)(events, 3e6, True)
    readout, parts = Readout(circuit, 9), []
    edges = [0, 500, 501, 2000, 4000]
    for a, b in pairwise(edges):
        until = events.t[b] if b < 4000 else 3_000_000
        parts.append(readout(events.select(slice(a, b)), until, b == 4000))
    for name in "txyp":
        np.testing.assert_array_equal(getattr(whole, name), np.concatenate([getattr(part, name) for part in parts]))
    assert (np.diff(whole.t) >= 0).all()
    assert len(whole) == 4000
    assert whole.tick_ns == 1000


def test_nothing_to_do_leaves_events_alone():
    events = burst()
    out = Readout(Circuit(), 0)(events, 3e6, True)
    np.testing.assert_array_equal(out.t, events.t)
    assert out.tick_ns == 1


@pytest.mark.parametrize(("arrivals", "unit"), [("whole nanoseconds", 1), ("any", 1), ("any", 1000)])
def test_a_service_time_lies_in_its_interval(arrivals, unit):
    """A queue written out event by event, its stamps rounded once; simulators' arrivals are rounded before."""
    rng, inside, trials = np.random.default_rng(7), 0, 40
    for _ in range(trials):
        service = rng.uniform(2500.0, 30_000.0)
        clusters = np.repeat(rng.uniform(0, 2e9, 400), 4)
        t = np.sort(clusters + rng.exponential(2.0 * service, len(clusters)))
        t = np.rint(t) if arrivals == "whole nanoseconds" else t
        out, busy = np.empty(len(t)), -np.inf
        for k, arrival in enumerate(t):
            busy = max(arrival, busy) + service
            out[k] = busy
        stamps = (unit * np.rint(out / unit)).astype(np.int64)
        x = np.arange(len(t)) % 25  # no two neighbours from one pixel
        events = Events.from_columns(stamps, x, 0 * x, rng.integers(0, 2, len(t)), 25, 1)
        found = find_service_time([Recording(replace(events, tick_ns=unit))])
        assert found is not None
        low, high = found.interval
        inside += low <= 1e-9 * service <= high
        assert high - low < 2.5e-9 * unit
    assert inside >= binom.ppf(0.001, trials, 0.95)
