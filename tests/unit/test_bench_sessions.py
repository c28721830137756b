"""The independent bench sessions: crossing times, what its files say, what a seed and a fault change."""

import json
from dataclasses import replace

import numpy as np
import pytest

from pixelid.recordings import open_recording
from pixelid.stimuli.sampled import read_light
from tests.oracles import whole_pixel
from tests.oracles.bench_lights import make_light, sample
from tests.oracles.bench_pixel import Circuit, grid, thresholds, trajectory, walk
from tests.oracles.bench_sessions import FAULTS, NOMINAL, STEP_S, UNITS, draw, events, make_session
from tests.oracles.trajectories import oracle_light

CIRCUIT = Circuit(**NOMINAL, on_threshold=0.2, off_threshold=0.18, refractory_s=1.5e-4)
SHORT = {"levels": (24,), "durations": (("steps", 0.3), ("chirp", 0.3), ("constant", 0.1))}
CLEAN = SHORT | {"trace_noise": 0.0, "trace_bits": 0, "effects": {}, "gain_sd": 0.0, "unit": "radiance_fA"}


@pytest.mark.parametrize("case", range(6))
def test_crossings_are_those_of_an_adaptive_integrator(shared, case):
    file = np.load(shared / "oracle" / "pixel_trajectories.npz")
    a_amp, a_loop, tau_out, q_in, q_mil, *rest = file[f"case{case}/params"]
    q = q_in + q_mil
    circuit = Circuit((a_loop + 1) / (q * tau_out), (q_in + (a_amp + 1) * q_mil) / (q * tau_out), 1 / q, *rest)
    stimulus, kind = file[f"case{case}/stimulus"], str(file[f"case{case}/kind"])
    steps = grid(lambda t: oracle_light(kind, t, *stimulus), [], stimulus[3], 1e-5)
    own = np.array([circuit.on_threshold, circuit.off_threshold])
    t, p = walk(circuit, steps, trajectory(circuit, steps), own, np.ones((1000, 2)), None)
    np.testing.assert_allclose(t, file[f"case{case}/event_t_s"], rtol=0, atol=1e-8)
    np.testing.assert_array_equal(p > 0, file[f"case{case}/event_p"] > 0)


@pytest.mark.parametrize("kind", ["chirp", "steps", "slow"])
def test_crossings_are_those_of_the_whole_pixel(kind):
    circuit = replace(CIRCUIT, leak_hz=3.0, dark_fa=2.0)
    light = make_light(kind, 24, 0.4, np.random.default_rng(5), 1.0, "corners")
    steps = grid(light.of, light.corners, 0.4, STEP_S[kind])
    own = np.array([0.21, 0.17])
    draws = 1 + 0.04 * np.random.default_rng(1).standard_normal((4000, 2))
    t, p = walk(circuit, steps, trajectory(circuit, steps, 1.1), own, draws, 0.3)
    rates = circuit.rates
    other = whole_pixel.Pixel(*rates, circuit.on_threshold, circuit.off_threshold, circuit.refractory_s)
    odd = whole_pixel.Oddity(leak_hz=lambda t, radiance, speed: np.full(len(t), 3.0))
    seen = whole_pixel.signals(other, lambda t: 1.1 * light.of(t) + 2.0, 0.4, odd)
    other_t, other_p = whole_pixel.walk(other, own, seen, draws, 0.3, odd)
    assert len(t) > 10
    np.testing.assert_array_equal(p, other_p)
    np.testing.assert_allclose(t, other_t, rtol=0, atol=1e-7)


def test_shot_noise_has_the_variance_of_the_filters():
    """S α/(4β) before the follower, where γL is small and the follower fast: the noise bandwidth is ωn²/(4·2ζωn)."""
    circuit = replace(CIRCUIT, gamma=1e-9, sf_cutoff_hz=60_000.0, shot_density=2e-5)
    light = make_light("constant", 24, 8.0, np.random.default_rng(0), 1.0, "")
    path = trajectory(circuit, grid(light.of, [], 8.0, 1e-5), rng=np.random.default_rng(2))
    assert np.var(path.follower) == pytest.approx(2e-5 * circuit.alpha / (4 * circuit.beta), rel=0.1)


@pytest.mark.parametrize("form", ["csv", "raw", "npz", "txt"])
def test_files_hold_the_events(tmp_path, form):
    truth = make_session(tmp_path, 3, form=form, fault="", **CLEAN)
    files = {name: open_recording(tmp_path / f"{name}.{form}") for name in ("steps_24", "chirp_24")}
    for name, recording in files.items():
        written = truth["recordings"][name]
        assert len(recording.events.t) == written["events"] > 100
        seconds = (recording.events.t / 1e3 - written["camera_at_light_zero_us"]) * 1e-6
        assert -1e-6 <= seconds[0] < seconds[-1] <= written["light_s"] * (1 + 1e-4)
        assert set(recording.events.x) == set(truth["address"][0] + np.arange(5))
        assert set(recording.events.y) == set(truth["address"][1] + np.arange(5))
        light = read_light(tmp_path / f"{name}_light.csv")
        assert light.t[0] == 3.2
        assert light.unit == "fA"
        assert light.t[-1] - light.t[0] == pytest.approx(written["light_s"])
    assert json.loads((tmp_path / "truth.json").read_text())["events"] == truth["events"]


def test_triggers_stand_at_the_ends_of_the_light_by_the_cameras_clock(tmp_path):
    truth = make_session(tmp_path, 3, form="raw", fault="", clock_ppm=50.0, **CLEAN)
    for name, written in truth["recordings"].items():
        triggers = open_recording(tmp_path / f"{name}.raw").triggers
        rises = triggers.t[triggers.rising] / 1e3
        assert rises[0] == np.floor(written["camera_at_light_zero_us"])
        assert rises[1] - rises[0] == pytest.approx(written["light_s"] * 1e6 * (1 + 50e-6), abs=1.0)


@pytest.mark.parametrize("unit", [unit for unit in UNITS if unit != "radiance_fA"])
def test_units_multiply_the_light_alone(tmp_path, unit):
    truth = make_session(tmp_path / "unit", 4, form="csv", fault="", **(CLEAN | {"unit": unit}))
    make_session(tmp_path / "fA", 4, form="csv", fault="", **CLEAN)
    light, true = (np.loadtxt(tmp_path / f / "chirp_24_light.csv", delimiter=",", skiprows=1) for f in ("unit", "fA"))
    np.testing.assert_allclose(light[:, 1], true[:, 1] * truth["unit_factor"], rtol=1e-6)
    assert (tmp_path / "unit" / "chirp_24.csv").read_bytes() == (tmp_path / "fA" / "chirp_24.csv").read_bytes()


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_changes_one_statement_alone(tmp_path, fault):
    options = CLEAN | {"form": "raw"}
    truth = make_session(tmp_path / "wrong", 6, fault=fault, **options)
    make_session(tmp_path / "right", 6, fault="", **options)
    changed = {
        path.name for path in (tmp_path / "right").iterdir()
        if path.read_bytes() != (tmp_path / "wrong" / path.name).read_bytes()
    } - {"truth.json"}  # fmt: skip
    names = truth["fault_recordings"]
    if fault in ("level", "light"):
        assert changed == {f"{name}_light.csv" for name in names}
        assert len(names) == {"level": 1, "light": 2}[fault]
    else:
        assert changed == {f"{name}.raw" for name in names if truth["recordings"][name]["events"] or fault == "edge"}
    if fault == "level":
        wrong, right = (
            np.loadtxt(tmp_path / f / f"{names[0]}_light.csv", delimiter=",", skiprows=1) for f in ("wrong", "right")
        )
        assert 1.29 < max(truth["fault_size"], 1 / truth["fault_size"]) < 1.81
        np.testing.assert_allclose(wrong[:, 1], right[:, 1] * truth["fault_size"], rtol=1e-6)
    if fault == "polarity":
        wrong, right = (open_recording(tmp_path / f / "chirp_24.raw").events for f in ("wrong", "right"))
        np.testing.assert_array_equal(wrong.t, right.t)
        np.testing.assert_array_equal(wrong.p, 1 - right.p)
    if fault == "edge":
        wrong, right = (open_recording(tmp_path / f / f"{names[0]}.raw").triggers for f in ("wrong", "right"))
        late = (wrong.t - right.t)[wrong.rising] / 1e3
        assert sorted(late) == [0, round(truth["fault_size"])]
        assert 30 <= truth["fault_size"] <= 80


def test_a_seed_is_a_session(tmp_path):
    for folder, seed in (("a", 8), ("b", 8), ("c", 9)):
        make_session(tmp_path / folder, seed, form="csv", **SHORT)
    a, b, c = ({p.name: p.read_bytes() for p in (tmp_path / folder).iterdir()} for folder in "abc")
    assert a == b
    assert a.keys() == c.keys()
    assert all(a[name] != c[name] for name in a if name not in ("constant_24.csv",))


def test_what_is_stated_leaves_the_rest_as_drawn():
    for seed in range(20):
        plan, stated = draw(seed, effects={}), draw(seed, effects={}, clock_ppm=0.0, circuit={"on_threshold": 0.3})
        assert stated == replace(plan, clock_ppm=0.0, circuit=replace(plan.circuit, on_threshold=0.3))


def test_faults_and_effects_are_drawn_as_often_as_stated():
    plans = [draw(seed) for seed in range(400)]
    assert 160 < sum(bool(plan.fault) for plan in plans) < 240
    assert {plan.fault for plan in plans} == {"", *FAULTS}
    assert all(plan.form == "raw" for plan in plans if plan.fault == "edge")
    assert 110 < sum(not plan.effects for plan in plans) < 170
    assert max(abs(plan.clock_ppm) for plan in plans) <= 60


@pytest.mark.parametrize("kind", ["chirp", "slow"])
def test_counts_of_a_practice_session(shared, kind):
    """b01, whose circuit is known: its counts lie within 4 standard deviations of ours."""
    folder = shared / "bench" / "b01"
    truth = json.loads((folder / "truth.json").read_text())
    known = {name: truth[name] for name in (*NOMINAL, "on_threshold", "off_threshold", "refractory_s")}
    circuit = Circuit(**known, threshold_mismatch=0.03, threshold_sigma=0.04)
    light = make_light(kind, 400, 0.8, np.random.default_rng(0), 1.0, "")
    t, trace = np.loadtxt(folder / f"{kind}_400_light.csv", delimiter=",", skiprows=1).T
    if kind == "slow":
        phase = np.arctan2(*[np.mean(np.log(trace / 400) * f(4 * np.pi * (t - 3.2))) for f in (np.cos, np.sin)])
        light = replace(light, of=lambda t: 400 * np.exp(0.9 * np.sin(4 * np.pi * t + phase)))
    light = replace(light, duration_s=float(t[-1] - 3.2))
    np.testing.assert_allclose(sample(light, t - 3.2, 0.0, 0, np.random.default_rng(0)), trace, rtol=1e-5)
    counts = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        own = thresholds(circuit, 25, rng)
        _, _, p = events(circuit, own, np.ones(25), light, STEP_S[kind], "reset", rng)
        counts.append([np.sum(p > 0), np.sum(p < 0)])
    p = np.loadtxt(folder / f"{kind}_400.csv", delimiter=",", skiprows=1)[:, 3]
    mean, scatter = np.mean(counts, axis=0), np.std(counts, axis=0, ddof=1)
    assert np.all(np.abs([np.sum(p == 1), np.sum(p == 0)] - mean) < 4 * scatter)
