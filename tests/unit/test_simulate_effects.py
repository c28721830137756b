"""Each effect does what its equation says, against expectations computed without the simulator."""

import numpy as np
import pytest

from pixelid.errors import InputError
from pixelid.model.shipped import find_model
from pixelid.simulate import simulate
from pixelid.simulate.laws import rules_of
from pixelid.simulate.light import blocks
from pixelid.simulate.tiles import Tiles
from pixelid.stages.circuit import Circuit
from pixelid.stimuli import shapes
from pixelid.stimuli.stimulus import Stimulus

PLAIN = Circuit(
    alpha=61287.0, beta=1851.0, gamma=1.1236, follower=2 * np.pi * 3122, differencing=2 * np.pi * 16000,
    on_threshold=0.2, off_threshold=0.25,
)  # fmt: skip
IDEAL = Circuit(photoreceptor="unlimited", on_threshold=0.2, off_threshold=0.2)


def intervals(events):
    """Inter-event intervals [s] of every pixel, and the pixel of each."""
    order = np.lexsort((events.t, events.pixel))
    t, pixel = events.t[order], events.pixel[order]
    same = pixel[1:] == pixel[:-1]
    return np.diff(t)[same] * 1e-9, pixel[1:][same]


def ramp(slope, duration=1.0, level=100.0):
    t = np.linspace(0, duration, 1001)
    return Stimulus.from_arrays(t, level * np.exp(slope * t))


@pytest.mark.parametrize("shape", ["full_field", "video"])
def test_leak_and_parasitic_rates(shape):
    for level in (10.0, 200.0):
        circuit = PLAIN.with_(leak_hz=3.0, leak_hz_per_radiance=0.05, refractory=2e-3)
        light = shapes.constant(level, 2.0)
        if shape == "video":
            light = Stimulus.from_arrays([0.0, 1.0, 2.0], np.full((3, 4, 5), level))
        events = simulate(circuit, light, width=5, height=4).events
        assert (events.p == 1).all()
        np.testing.assert_allclose(intervals(events)[0], 1 / (3.0 + 0.05 * level) + 2e-3, atol=2e-9)


def test_mismatch_spreads_pixels_and_noise_spreads_events():
    light = shapes.constant(50.0, 2.0)
    events = simulate(PLAIN.with_(leak_hz=20.0, mismatch=0.1), light, width=60, height=50).events
    dt, pixel = intervals(events)
    per_pixel = np.bincount(pixel, dt) / np.bincount(pixel)
    assert abs(per_pixel.mean() * 20 - 1) < 0.006
    assert abs(per_pixel.std() * 20 - 0.1) < 0.005
    assert np.ptp(dt[pixel == 7]) < 3e-9
    events = simulate(PLAIN.with_(leak_hz=20.0, noise=0.1), light, width=30, height=30).events
    dt, pixel = intervals(events)
    assert abs(dt.mean() * 20 - 1) < 0.003
    assert abs(dt.std() * 20 - 0.1) < 0.003
    assert abs(np.corrcoef(dt[:-1], dt[1:])[0, 1]) < 0.03


def test_threshold_drift_lengthens_intervals():
    events = simulate(
        PLAIN.with_(leak_hz=20.0, threshold_drift=0.5), shapes.constant(50.0, 4.0), synchronous=True
    ).events
    t = np.concatenate([[0.0], events.t * 1e-9])
    np.testing.assert_allclose(20 * np.diff(t), 1 + 0.5 * t[1:], rtol=1e-7)


@pytest.mark.parametrize("shape", ["full_field", "video"])
def test_polarity_memory_acts_from_the_second_event_on(shape):
    """Leak alone: ON events only, the first after 1/rate, the others after (1 + strength)/rate."""
    light = shapes.constant(50.0, 2.0)
    if shape == "video":
        light = Stimulus.from_arrays([0.0, 2.0], np.full((2, 1, 1), 50.0))
    events = simulate(PLAIN.with_(leak_hz=20.0, polarity_memory=0.1), light, synchronous=True).events
    dt = np.diff(np.concatenate([[0.0], events.t * 1e-9]))
    np.testing.assert_allclose(20 * dt, [1.0] + [1.1] * (len(dt) - 1), rtol=1e-6)


def test_polarity_memory_goes_with_each_pixels_own_threshold_and_leaves_its_noise():
    """Leak alone: every ON event but the first of a pixel waits (1 + strength) C_i, with the noise of C_i."""
    circuit = PLAIN.with_(leak_hz=20.0, mismatch=0.1)
    light, size = shapes.constant(50.0, 20.0), {"width": 6, "height": 1, "synchronous": True, "seed": 4}

    def waits(circuit):
        events = simulate(circuit, light, **size).events
        return [np.diff(events.t[events.x == x] * 1e-9) for x in range(6)]

    without = [w.mean() for w in waits(circuit)]
    assert np.std(without) > 0.03 * np.mean(without)
    for memory in (-0.4, 0.3):
        for own, w in zip(without, waits(circuit.with_(polarity_memory=memory)), strict=True):
            np.testing.assert_allclose(w, (1.0 + memory) * own, rtol=1e-6)
    noisy = [waits(circuit.with_(noise=0.05, polarity_memory=memory)) for memory in (0.0, -0.4)]
    spread = [np.concatenate([w - w.mean() for w in every]).std() / np.mean(without) for every in noisy]
    assert spread == pytest.approx([0.05, 0.05], rel=4.0 / np.sqrt(2 * 6 * 400))


def test_polarity_memory_of_turns_and_runs():
    """Ideal pixel, triangular light: each event's change over the one before it is C_p (1 + strength p p_before)."""
    t = np.linspace(0.0, 1.0, 9)
    light = Stimulus.from_arrays(t, 100.0 * np.exp(1.5 * (np.arange(9) % 2)))
    events = simulate(IDEAL.with_(polarity_memory=-0.2), light, synchronous=True, as_sampled=True).events
    level = np.interp(events.t * 1e-9, t, np.log(light.radiance))
    sign = np.where(events.p == 1, 1.0, -1.0)
    expected = 0.2 * (1.0 - 0.2 * sign[1:] * sign[:-1])
    assert (sign[1:] != sign[:-1]).sum() >= 5
    np.testing.assert_allclose(sign[1:] * np.diff(level), expected, rtol=1e-6)


def test_dead_time_is_the_shortest_interval():
    events = simulate(PLAIN.with_(refractory=7e-4), shapes.chirp(400.0), width=8, height=8).events
    shortest = intervals(events)[0].min()
    assert 7e-4 < shortest < 7.6e-4


def test_dark_current_adds_to_the_light():
    light = shapes.chirp(20.0, duration_s=0.2)
    brighter = Stimulus.from_arrays(light.t, light.radiance + 7.0)
    dark = simulate(PLAIN.with_(dark=7.0), light, width=4, height=4).events
    plain = simulate(PLAIN, brighter, width=4, height=4).events
    np.testing.assert_allclose(dark.t, plain.t, atol=2000)  # ns


@pytest.mark.parametrize("shape", ["full_field", "video"])
def test_mains_flicker_fires_at_its_phase(shape):
    """An ideal pixel under flickering constant light: event times solve ln(1 + m sin 2πft) = k C by hand."""
    circuit = IDEAL.with_(flicker_modulation=0.4, flicker_hz=120.0)
    light = shapes.constant(50.0, 0.1)
    if shape == "video":
        light = Stimulus.from_arrays([0.0, 0.03, 0.1], np.full((3, 1, 1), 50.0))
    events = simulate(circuit, light, synchronous=True).events
    assert events.t[0] * 1e-9 == pytest.approx(np.arcsin(np.expm1(0.2) / 0.4) / (2 * np.pi * 120), abs=1e-5)
    phasor = np.exp(2j * np.pi * 120 * events.t[events.p == 1] * 1e-9).mean()
    assert abs(phasor) > 0.3
    assert abs(len(events) / 12 - np.round(len(events) / 12)) < 0.1


@pytest.mark.parametrize("level", [5.0, 100.0])
def test_shot_noise_variance_behind_the_photoreceptor(level):
    """∫ PSD |H|² df of the second-order photoreceptor is density/L · ωn²/(4·2ζωn)."""
    circuit = PLAIN.with_(shot_density=1e-3, on_threshold=50.0, off_threshold=50.0)
    rules = rules_of(circuit, 3, False, 1.0)
    tiles = Tiles(rules, 20_000, held=False)
    duration = 12 * (circuit.beta + circuit.gamma * level) / (circuit.alpha * level)
    for block in blocks(shapes.constant(level, duration), rules, 20_000):
        for first in tiles.firsts:
            tiles.events(first, block)
    y = tiles._states[1, :20_000]
    expected = 1e-3 / level * circuit.alpha * level / (4 * (circuit.beta + circuit.gamma * level))
    assert y.mean() == pytest.approx(np.log(level), abs=4 * np.sqrt(expected / 20_000))
    assert y.var() == pytest.approx(expected, rel=0.04)  # sampling error of the variance: 1 %
    assert abs(np.corrcoef(y[:-1], y[1:])[0, 1]) < 0.03


def test_shot_noise_fires_less_in_bright_light():
    """Relative noise falls as 1/L while the bandwidth grows only until the second pole takes over."""
    circuit = PLAIN.with_(shot_density=0.01)
    counts = [len(simulate(circuit, shapes.constant(level, 0.1), width=6, height=6).events) for level in (100.0, 1e4)]
    assert counts[0] > 200
    assert counts[1] < 0.4 * counts[0]


def test_extra_pole_and_follower_delay_a_ramp():
    """Under a ramp of ln L every stage lags by one over its cutoff; an ideal photoreceptor has no other lag."""
    circuit = IDEAL.with_(follower=500.0)
    lag = simulate(circuit.with_(extra_pole=200.0), ramp(2.0), synchronous=True).events
    free = simulate(circuit, ramp(2.0), synchronous=True).events
    assert lag.t[2] - free.t[2] == pytest.approx(1e9 / 200.0, rel=1e-6)


def test_lower_cutoff_forgets_slow_ramps():
    """The high-pass output of a ramp r saturates at r/ω: no event below the threshold, a first one above."""
    circuit = IDEAL.with_(follower=1e4, lower_cutoff=5.0)
    assert len(simulate(circuit, ramp(0.9), synchronous=True).events) == 0
    events = simulate(circuit, ramp(1.5), synchronous=True).events
    assert len(events) == 1
    assert events.t[0] * 1e-9 == pytest.approx(-np.log(1 - 0.2 * 5 / 1.5) / 5.0 + 1e-4, abs=1e-5)


@pytest.mark.parametrize("shape", ["full_field", "video"])
def test_slew_limit_spaces_the_events_of_a_step(shape):
    circuit = PLAIN.with_(differencing=np.inf, slew_rise=400.0, slew_fall=250.0)
    t, radiance = np.array([0.0, 0.01, 0.0101, 0.03, 0.0301, 0.05]), np.array([500.0, 500, 4000, 4000, 500, 500])
    light = Stimulus.from_arrays(t, radiance if shape == "full_field" else radiance[:, None, None])
    events = simulate(circuit, light, synchronous=True).events
    up, down = events.t[events.p == 1] * 1e-9, events.t[events.p == 0] * 1e-9
    assert len(up) >= 8
    np.testing.assert_allclose(np.diff(up)[1:6], 0.2 / 400.0, rtol=1e-3)
    np.testing.assert_allclose(np.diff(down)[1:5], 0.25 / 250.0, rtol=1e-3)
    gentle = ramp(1.0, 0.5)
    limited, free = (simulate(c, gentle, synchronous=True).events for c in (circuit, PLAIN.with_(differencing=np.inf)))
    np.testing.assert_allclose(limited.t, free.t, atol=20)


def test_hot_pixels_fire_as_a_poisson_process():
    events = simulate(PLAIN.with_(hot_count=5, hot_hz=200.0), shapes.constant(50.0, 4.0), width=20, height=10).events
    assert (events.p == 1).all()
    counts = np.bincount(events.pixel, minlength=200)
    assert (counts > 0).sum() == 5
    assert abs(counts.sum() - 4000) < 4 * np.sqrt(4000)
    dt = intervals(events)[0]
    assert abs(dt.std() / dt.mean() - 1) < 0.06


def test_delay_moves_the_clock_of_the_events():
    light = shapes.chirp(50.0, duration_s=0.1)
    plain = simulate(PLAIN, light, synchronous=True).events
    late = simulate(PLAIN.with_(delay=1.5e-3), light, synchronous=True).events
    early = simulate(PLAIN.with_(delay=-0.05), light, synchronous=True).events
    np.testing.assert_array_equal(late.t, plain.t + 1_500_000)
    np.testing.assert_array_equal(early.t, plain.t[plain.t >= 50_000_000] - 50_000_000)


def test_readout_of_a_whole_sensor():
    """A full-field step on a synchronous sensor: one burst, spread by the queue, in the order of the pixels."""
    circuit = IDEAL.with_(service=1e-6)
    light = Stimulus.from_arrays([0.0, 0.01, 0.02], [1.0, 1.3, 1.3], interpolation="previous")
    events = simulate(circuit, light, width=30, height=10, synchronous=True).events
    np.testing.assert_array_equal(events.t, 10_000_000 + 1000 * np.arange(1, 301))
    np.testing.assert_array_equal(events.pixel, np.arange(300))
    grid = simulate(circuit.with_(tick=5e-5), light, width=30, height=10, synchronous=True).events
    assert set(np.unique(grid.t % 50_000)) == {0}
    assert grid.tick_ns == 50_000


@pytest.mark.parametrize("kind", ["second_order", "one_pole"])
@pytest.mark.parametrize("shape", ["full_field", "video"])
def test_a_bandwidth_floor_speeds_up_the_response_and_leaves_contrast_alone(kind, shape):
    """Low light above a floor: with rates of L + floor written into α, β, γ of a linear pixel, the same events."""
    level, floor = 5.0, 45.0
    t = np.linspace(0.0, 0.2, 2001)
    light = Stimulus.from_arrays(t, level * np.exp(1e-3 * np.sin(2 * np.pi * 20 * t)))
    if shape == "video":
        light = Stimulus.from_arrays(t, np.broadcast_to(light.radiance[:, None, None], (len(t), 1, 2)))
    sensitive = {"on_threshold": 1e-4, "off_threshold": 1e-4, "photoreceptor": kind, "corner": 33.0}
    share = (level + floor) / level
    floored = PLAIN.with_(**sensitive, bandwidth_floor=floor)
    faster = PLAIN.with_(**sensitive).with_(alpha=PLAIN.alpha * share, gamma=PLAIN.gamma * share, corner=33.0 * share)
    found, wanted, plain = (
        simulate(c, light, synchronous=True).events for c in (floored, faster, PLAIN.with_(**sensitive))
    )
    assert len(found) == len(wanted) > 40
    np.testing.assert_allclose(found.t, wanted.t, atol=3e4)  # ns; α, γ L differ from α, γ (L + floor) by the contrast
    assert abs(found.t[:40] - plain.t[:40]).max() > 5e5


def test_a_bandwidth_floor_needs_a_bandwidth():
    with pytest.raises(InputError, match="bandwidth_floor"):
        find_model("ideal").with_effect("bandwidth_floor").circuit()
