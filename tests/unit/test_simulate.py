"""Event times against the oracle, against brute force, and against themselves."""

import numpy as np
import pytest
from oracles.trajectories import oracle_case
from scipy.integrate import solve_ivp

from pixelid.errors import InputError
from pixelid.model.shipped import find_model
from pixelid.simulate import simulate, simulate_stream
from pixelid.stages.circuit import Circuit
from pixelid.stimuli import shapes
from pixelid.stimuli.stimulus import Stimulus

PLAIN = Circuit(
    alpha=61287.0, beta=1851.0, gamma=1.1236, follower=2 * np.pi * 3122, differencing=2 * np.pi * 16000,
    on_threshold=0.2, off_threshold=0.25, refractory=1e-4,
)  # fmt: skip


@pytest.mark.parametrize("case", range(6))
def test_event_times_of_the_oracle(shared, case):
    circuit, light, times, polarities = oracle_case(np.load(shared / "oracle" / "pixel_trajectories.npz"), case)
    events = simulate(circuit, light(40001), synchronous=True).events
    np.testing.assert_array_equal(2.0 * events.p - 1, polarities)
    np.testing.assert_allclose(events.t * 1e-9, times, rtol=0, atol=5e-8)


def test_second_order_in_the_stimulus_step(shared):
    circuit, light, times, _ = oracle_case(np.load(shared / "oracle" / "pixel_trajectories.npz"), 4)
    errors = [
        np.abs(simulate(circuit, light(n), synchronous=True).events.t * 1e-9 - times).max()
        for n in (5001, 10001, 20001)
    ]
    assert 3.5 < errors[0] / errors[1] < 4.5
    assert 3.5 < errors[1] / errors[2] < 4.5


def test_no_frame_locked_timestamps():
    """Coarse frames leave no trace in the sub-frame phase of the events."""
    stimulus = shapes.sine(100.0, 0.6, 7.3, duration_s=1.0, dt=1e-3)
    events = simulate(PLAIN.with_(noise=0.03, mismatch=0.03), stimulus, width=20, height=20, seed=5).events
    phase = events.t % 1_000_000 / 1e6
    counts = np.histogram(phase, 20, (0, 1))[0]
    assert counts.min() > 0.8 * counts.mean()
    assert counts.max() < 1.25 * counts.mean()
    assert (events.t % 1_000_000 == 0).sum() < 3


def brute_force(circuit, t, radiance, end):
    """Events of one synchronous pixel by an ODE solver and fine marching; nothing shared with the simulator.

    Per step the photoreceptor is linearised at the midpoint, as the simulator does.
    """
    u = np.log(radiance)
    state, knots, pieces = np.array([0.0, u[0], u[0], u[0], u[0] * (circuit.lower_cutoff > 0)]), [], []
    if circuit.lower_cutoff > 0:
        state[3] = 0.0
    for k in range(len(t) - 1):
        if t[k + 1] == t[k]:
            continue
        L = np.sqrt(radiance[k] * radiance[k + 1])
        a, b2 = circuit.alpha * L, circuit.beta + circuit.gamma * L
        slope = (u[k + 1] - u[k]) / (t[k + 1] - t[k])

        def rate(time, x, k=k, a=a, b2=b2, slope=slope):
            v, y, s, d, z = x
            h = s - z if circuit.lower_cutoff > 0 else s
            return [
                a * (u[k] + slope * (time - t[k]) - y) - b2 * v,
                v,
                circuit.follower * (y - s),
                circuit.differencing * (h - d),
                circuit.lower_cutoff * (s - z),
            ]

        run = solve_ivp(
            rate, (t[k], t[k + 1]), state, "DOP853", rtol=1e-12, atol=1e-13, max_step=1e-4, dense_output=True
        )
        state = run.y[:, -1]
        knots.append(t[k])
        pieces.append(run.sol)
    knots = np.array(knots)

    def at(time):
        x = pieces[max(np.searchsorted(knots, time, side="right") - 1, 0)](time)
        return x[3], x[2] - (x[4] if circuit.lower_cutoff > 0 else 0.0)

    found, tr = [], t[0]
    d, level = at(tr)
    offset = d - level
    time, step = tr, 2e-6

    def change(when):
        c = at(when)[0] - level - offset * np.exp(-circuit.differencing * (when - tr))
        return c + circuit.leak_hz * circuit.on_threshold * (when - tr)

    while time < end:
        after = min(time + step, end)
        c = change(after)
        scale = 1 + circuit.threshold_drift * after
        sign = 1 if c >= circuit.on_threshold * scale else -1 if c <= -circuit.off_threshold * scale else 0
        if sign:
            low, high = time, after
            threshold = circuit.on_threshold if sign > 0 else circuit.off_threshold
            for _ in range(50):
                middle = 0.5 * (low + high)
                beyond = sign * change(middle) >= threshold * (1 + circuit.threshold_drift * middle)
                low, high = (low, middle) if beyond else (middle, high)
            found.append((high, sign))
            tr = high + circuit.refractory
            if tr >= end:
                break
            d, level = at(tr)
            offset = d - level
            after = tr
        time = after
    return np.array([f[0] for f in found]), np.array([f[1] for f in found])


@pytest.mark.parametrize(
    ("changes", "interpolation"),
    [
        ({}, "linear"),
        ({}, "previous"),
        ({"refractory": 0.0}, "linear"),
        ({"refractory": 3.3e-3, "leak_hz": 20.0}, "linear"),
        ({"lower_cutoff": 2 * np.pi * 20}, "linear"),
        ({"threshold_drift": -3.0, "leak_hz": 5.0}, "previous"),
        ({"beta": 300.0, "gamma": 0.5}, "previous"),  # rings: humps inside long steps
    ],
)
def test_brute_force_finds_the_same_events(changes, interpolation):
    circuit = PLAIN.with_(**changes)
    t = np.cumsum(np.concatenate([[0.0], np.random.default_rng(3).uniform(2e-4, 8e-3, 24)]))
    radiance = np.exp(np.random.default_rng(4).normal(3.5, 0.35, len(t)))
    stimulus = Stimulus.from_arrays(t, radiance, interpolation=interpolation)
    events = simulate(circuit, stimulus, synchronous=True, as_sampled=True).events
    if interpolation == "previous":
        t, radiance = np.repeat(t, 2)[1:], np.repeat(radiance, 2)[:-1]
    times, signs = brute_force(circuit, t, radiance, t[-1])
    assert len(times) > 10
    np.testing.assert_array_equal(2.0 * events.p - 1, signs)
    np.testing.assert_allclose(events.t * 1e-9, times, rtol=0, atol=2e-8)


@pytest.mark.parametrize(
    "changes", [{}, {"refractory": 0.0}, {"beta": 300.0, "gamma": 0.5}, {"refractory": 3e-4, "on_threshold": 0.05}]
)
def test_brute_force_finds_the_same_events_of_a_video(changes):
    circuit, rng = PLAIN.with_(**changes), np.random.default_rng(6)
    t = np.cumsum(np.concatenate([[0.0], rng.uniform(2e-4, 4e-3, 12)]))
    log_light = np.log([[5.0, 60.0, 3000.0]]) + rng.normal(0.0, 0.35, (len(t), 1, 3))
    events = simulate(circuit, Stimulus.from_arrays(t, np.exp(log_light)), synchronous=True).events
    for pixel in range(3):
        times, signs = brute_force(circuit, t, np.exp(log_light[:, 0, pixel]), t[-1])
        own = events.x == pixel
        np.testing.assert_array_equal(2.0 * events.p[own] - 1, signs)
        np.testing.assert_allclose(events.t[own] * 1e-9, times, rtol=0, atol=2e-8)
    assert len(events) > 20


@pytest.mark.parametrize(
    ("level", "dt", "changes"),
    [
        (100.0, 1e-4, {}),
        (5.0, 1e-3, {"noise": 0.2, "refractory": 5e-4}),
        (2000.0, 1e-3, {"refractory": 0.0}),
        (300.0, 3e-4, {"refractory": 2e-5, "on_threshold": 0.05, "off_threshold": 0.03}),
        (50.0, 1e-2, {"beta": 300.0, "gamma": 0.5}),
    ],
)
def test_pixels_searched_together_fire_as_those_searched_one_by_one(level, dt, changes):
    circuit = PLAIN.with_(**{"noise": 0.04, "mismatch": 0.03, **changes})
    video = shapes.grating(width=40, height=30, level=level, modulation=0.9, duration_s=40 * dt, dt=dt)
    together = simulate(circuit, video).events
    alone = simulate(circuit.with_(threshold_drift=1e-300), video).events  # any drift is searched for one by one
    assert len(together) == len(alone) > 1000
    np.testing.assert_allclose(np.sort(together.t), np.sort(alone.t), atol=1)
    orders = [np.lexsort((e.t, e.x, e.y)) for e in (together, alone)]
    for name in "xyp":
        np.testing.assert_array_equal(getattr(together, name)[orders[0]], getattr(alone, name)[orders[1]])


def test_hump_inside_a_single_step_is_found():
    """The photoreceptor rings over after a jump: the threshold lies between the final value and the peak."""
    circuit = PLAIN.with_(beta=100.0, gamma=0.1, off_threshold=5.0)
    stimulus = Stimulus.from_arrays([0.0, 0.01, 0.5], [30.0, 60.0, 60.0], interpolation="previous")
    events = simulate(circuit.with_(on_threshold=np.log(2) * 1.2), stimulus, synchronous=True).events
    assert len(events) == 1
    assert 0.01 < events.t[0] * 1e-9 < 0.015


def columns(events):
    return np.stack([events.t, events.x, events.y, events.p])


def full_field_and_video(stimulus, width=20, height=13):
    frames = np.repeat(stimulus.radiance[:, None], width * height, axis=1).reshape(-1, height, width)
    return stimulus, Stimulus.from_arrays(stimulus.t, frames, interpolation=stimulus.interpolation)


@pytest.mark.parametrize("held", [False, True])
@pytest.mark.parametrize("name", ["dvs128", "ideal", "photoreceptor", "dvs128_low_light", "everything"])
def test_video_of_uniform_light_equals_full_field(name, held):
    """One shared trajectory, pixel by pixel, and one trajectory per pixel, step by step, are two programs."""
    model = find_model("dvs128" if name == "everything" else name)
    if name == "everything":
        for effect in ("dark_current", "mains_flicker", "extra_pole", "lower_cutoff", "leak", "parasitic_photocurrent",
                       "threshold_drift"):  # fmt: skip
            model = model.with_effect(effect)
    stimulus = shapes.chirp(50.0, duration_s=0.1, dt=1e-4)
    if held:
        stimulus = Stimulus.from_arrays(stimulus.t[::20], stimulus.radiance[::20], interpolation="previous")
    light, video = full_field_and_video(stimulus)
    shared = simulate(model, light, width=20, height=13, seed=3, as_sampled=True).events
    own = simulate(model, video, seed=3).events
    assert len(shared) > 1000
    assert len(own) == len(shared)
    np.testing.assert_array_equal(columns(own)[1:], columns(shared)[1:])
    assert np.abs(own.t - shared.t).max() <= 1


BUSY = ("leak", "shot_noise", "hot_pixels", "readout_latency", "timestamp_jitter", "timestamp_quantisation")


def busy_model():
    model = find_model("dvs128")
    for name in BUSY:
        model = model.with_effect(name)
    return model.set({"timestamp_quantisation.tick_s": 1e-5, "hot_pixels.rate_hz": 2000.0})


def test_seed_decides():
    light = shapes.chirp(30.0, duration_s=0.05)
    first = simulate(busy_model(), light, width=9, height=7, seed=1).events
    again = simulate(busy_model(), light, width=9, height=7, seed=1).events
    other = simulate(busy_model(), light, width=9, height=7, seed=2).events
    np.testing.assert_array_equal(columns(first), columns(again))
    assert len(first) != len(other) or (columns(first) != columns(other)).any()


@pytest.mark.parametrize("kind", ["full_field", "noisy", "video"])
def test_threads_and_chunks_change_nothing(kind, monkeypatch):
    model = find_model("dvs128").with_effect("readout_latency").with_effect("timestamp_jitter")
    light = shapes.chirp(30.0, duration_s=0.05)
    if kind == "noisy":
        model = busy_model()
    if kind == "video":
        light = shapes.grating(width=40, height=11, duration_s=0.02)
    size = {} if kind == "video" else {"width": 40, "height": 11}
    whole = simulate(model, light, seed=4, threads=1, **size).events
    parallel = simulate(model, light, seed=4, threads=2, **size).events
    monkeypatch.setattr("pixelid.simulate.light.WORK", 440 * 7)
    monkeypatch.setattr("pixelid.simulate.full_field.WORK", 440 * 7)
    chunks = list(simulate_stream(model, light, seed=4, threads=1, **size))
    assert len(chunks) > 5
    np.testing.assert_array_equal(columns(whole), columns(parallel))
    np.testing.assert_array_equal(columns(whole), np.concatenate([columns(chunk) for chunk in chunks], axis=1))
    assert (np.diff(whole.t) >= 0).all()


def test_frames_from_an_iterable_equal_the_video():
    video = shapes.grating(width=33, height=5, duration_s=0.01)
    whole = simulate(find_model("dvs128"), video, seed=1).events
    chunks = list(simulate_stream(find_model("dvs128"), zip(video.t, video.radiance, strict=True), seed=1))
    np.testing.assert_array_equal(columns(whole), np.concatenate([columns(chunk) for chunk in chunks], axis=1))


def test_random_start_spreads_the_first_event():
    """A ramp: synchronous pixels fire together, the others evenly over the time to one threshold."""
    t = np.linspace(0, 1, 1001)
    ramp = Stimulus.from_arrays(t, 100 * np.exp(2 * t))
    circuit = PLAIN.with_(off_threshold=0.2)
    together = simulate(circuit, ramp, width=50, height=40, synchronous=True).events
    assert len(np.unique(together.t)) * 2000 == len(together)
    events = simulate(circuit, ramp, width=50, height=40).events
    first = np.full(2000, -1.0)
    first[events.pixel[::-1]] = events.t[::-1] * 1e-9
    # change starts uniform in (−0.2, 0.2) and grows at 2 per second: first event uniform in (0, 0.2) s, plus the lag
    assert abs(np.mean(first) - 0.1) < 0.005
    assert abs(np.std(first) - 0.2 / np.sqrt(12)) < 0.004


def test_ideal_pixel_fires_at_equal_steps_of_log_light():
    t = np.linspace(0, 1, 101)
    ramp = Stimulus.from_arrays(t, np.exp(1.3 * t))
    events = simulate(find_model("ideal"), ramp, synchronous=True).events
    np.testing.assert_allclose(events.t * 1e-9, np.arange(1, 6) * 0.25 / 1.3, atol=1e-9)
    jump = Stimulus.from_arrays([0.0, 0.5, 1.0], [1.0, 2.0, 2.0], interpolation="previous")
    assert simulate(find_model("ideal"), jump, synchronous=True).events.t.tolist() == [500_000_000]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"width": 0}, "sensor"),
        ({"model": PLAIN.with_(on_threshold=0.0)}, "threshold"),
        ({"model": PLAIN.with_(threshold_drift=-2.0)}, "threshold_drift"),
        ({"model": PLAIN.with_(slew_rise=10.0, follower=np.inf)}, "source_follower_pole"),
        ({"model": PLAIN.with_(hot_count=5, hot_hz=3.0)}, "hot_pixels.count"),
        ({"model": Circuit(photoreceptor="unlimited", on_threshold=1.0, off_threshold=1.0, shot_density=1.0)}, "shot"),
        ({"stimulus": Stimulus.from_arrays([0.0, 1.0], [0.0, 1.0], "shape")}, "shape"),
    ],
)
def test_what_cannot_be_simulated_is_said(arguments, says):
    model = arguments.pop("model", PLAIN)
    stimulus = arguments.pop("stimulus", shapes.constant())
    with pytest.raises(InputError, match=says):
        simulate(model, stimulus, **arguments)


def test_bad_frames_of_a_stream_are_named():
    frames = [(0.0, np.ones((2, 2))), (1e-3, np.full((2, 2), np.nan))]
    with pytest.raises(InputError, match="NaN"):
        list(simulate_stream(PLAIN, frames))
    with pytest.raises(InputError, match="one shape"):
        list(simulate_stream(PLAIN, [(0.0, np.ones((2, 2))), (1.0, np.ones((3, 2)))]))
    with pytest.raises(InputError, match="two frames"):
        list(simulate_stream(PLAIN, frames[:1]))


def test_the_sensor_seed_names_the_pixels_and_the_seed_their_luck():
    model = find_model("dvs128").set({"threshold_sigma": 1e-5, "threshold_mismatch.sigma": 0.2})
    light = shapes.chirp(level=100.0, duration_s=0.2, stop_hz=50.0)
    counts = [
        np.bincount(simulate(model, light, width=8, height=8, seed=a, sensor_seed=b).events.pixel, minlength=64)
        for a, b in ((1, 7), (2, 7), (1, 8))
    ]
    assert np.corrcoef(counts[0], counts[1])[0, 1] > 0.9
    assert np.corrcoef(counts[0], counts[2])[0, 1] < 0.5
    with pytest.raises(InputError, match="sensor_seed"):
        simulate(model, light, width=1, height=1, sensor_seed=-1)
