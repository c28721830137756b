"""Low light: poles, radii and responses against independent numbers; bandwidth and step time read from events."""

import json

import numpy as np
import pytest

from pixelid.cli.main import main
from pixelid.errors import InputError
from pixelid.lowlight import analyse, curves, poles, radii, response
from pixelid.lowlight.analysis import sentences
from pixelid.lowlight.measured import measure
from pixelid.lowlight.stimulus import Steps, Sweep, read_stimulus
from pixelid.model.shipped import find_model
from pixelid.recordings import write_recording
from pixelid.recordings.events import Events
from pixelid.recordings.recording import Recording
from pixelid.simulate import simulate
from pixelid.stimuli.shapes import chirp, constant, sine, slow, steps
from pixelid.stimuli.stimulus import Stimulus

MODEL = find_model("dvs128")
CIRCUIT = MODEL.circuit()
DARK = CIRCUIT.with_(dark=4.0)


@pytest.mark.parametrize("circuit", [CIRCUIT, DARK], ids=["no dark", "dark 4 fA"])
@pytest.mark.parametrize("radiance", [0.01, 3.0, 14.0, 24.0, 400.0, 1e4, 5e5])
def test_poles_are_the_roots_of_the_polynomial(circuit, radiance):
    effective = radiance + circuit.dark
    roots = -np.roots([1.0, circuit.beta + circuit.gamma * effective, circuit.alpha * effective])
    pair = poles.pair(circuit, radiance)
    assert np.sort(np.abs(pair)) == pytest.approx(np.sort(np.abs(roots)), rel=1e-9)
    assert pair.sum() == pytest.approx(roots.sum(), rel=1e-9)


def test_the_tangent_in_the_dark_touches_the_slow_pole():
    h = 1e-4
    slope = (poles.dominant(DARK, h) - poles.dominant(DARK, -h)) / (2 * h)
    tangent = poles.corner(DARK, np.array([0.0, 1.0]), "at_dark")
    assert tangent[0] == pytest.approx(poles.dominant(DARK, 0.0), rel=1e-12)
    assert tangent[1] - tangent[0] == pytest.approx(slope, rel=1e-6)
    assert poles.corner(CIRCUIT, 7.0, "at_dark") == poles.corner(CIRCUIT, 7.0, "one_pole")


@pytest.mark.parametrize("approximation", poles.APPROXIMATIONS)
def test_radii_against_brute_force(approximation):
    error = radii.error_function(DARK, approximation, "dominant_pole", "photoreceptor")
    crossings = radii.crossings(error, 1e-3, 1e4, 4001)
    L = np.geomspace(1e-3, 1e4, 1_000_001)
    b, a = DARK.beta + DARK.gamma * (L + 4.0), DARK.alpha * (L + 4.0)
    roots = np.sqrt((b * b - 4 * a).astype(complex))
    exact = np.minimum(np.abs((b - roots) / 2), np.abs((b + roots) / 2))
    error = poles.corner(DARK, L, approximation) / exact - 1
    for level in radii.LEVELS:
        entry = crossings["levels"][f"{100 * level:g}%"]
        beyond = np.abs(error) > level
        brute = L[np.flatnonzero(beyond[1:] != beyond[:-1])]
        inside = [c["radiance"] for c in entry["crossings"] if 1e-3 < c["radiance"] < 1e4]
        assert inside == pytest.approx(brute, rel=1e-4)
        assert entry["first"] == pytest.approx(0.0 if beyond[0] else brute[0], rel=1e-4)


def test_radii_of_the_nominal_circuit_are_the_expansion_in_small_light():
    """To first order ωc / p₁ = 1 − (α/β² − γ/β) L."""
    error = radii.error_function(CIRCUIT, "one_pole", "dominant_pole", "photoreceptor")
    first = radii.crossings(error, 1e-3, 1e4, 401)["levels"]["1%"]["first"]
    slope = CIRCUIT.alpha / CIRCUIT.beta**2 - CIRCUIT.gamma / CIRCUIT.beta
    assert first == pytest.approx(0.01 / slope, rel=0.02)
    assert first == pytest.approx(0.5727, rel=1e-3)


def test_critical_damping_and_the_regime_of_24_fa():
    map_ = radii.regimes(CIRCUIT)
    roots = np.roots([CIRCUIT.gamma**2, 2 * CIRCUIT.beta * CIRCUIT.gamma - 4 * CIRCUIT.alpha, CIRCUIT.beta**2])
    assert map_["critical"] == pytest.approx(sorted(roots), rel=1e-6)
    assert map_["epsilon_one"] == pytest.approx(55.9, abs=0.05)
    assert abs(poles.pair(CIRCUIT, 24.0)[0].imag) > 0
    for border, inside in zip(map_["critical"], (1.001, 0.999), strict=True):
        assert abs(poles.pair(CIRCUIT, border * inside)[0].imag) > 0
        assert abs(poles.pair(CIRCUIT, border / inside)[0].imag) == 0
    assert radii.regimes(CIRCUIT.with_(gamma=2 * CIRCUIT.alpha / CIRCUIT.beta))["critical"] is None


@pytest.mark.parametrize("scope", poles.SCOPES)
@pytest.mark.parametrize("radiance", [0.05, 3.0, 14.218212339, 24.0, 400.0, 2e4, 5e5])
def test_bandwidth_and_step_time_against_brute_force(radiance, scope):
    chain = poles.exact(CIRCUIT, radiance, scope)
    corner_hz = response.bandwidth_hz(chain)
    assert abs(response.gain(chain, corner_hz)) == pytest.approx(np.sqrt(0.5), rel=1e-9)
    beyond = corner_hz * np.geomspace(1.0001, 1e3, 5000)
    assert (np.abs(response.gain(chain, beyond)) < np.sqrt(0.5)).all()
    t63 = response.step_time_s(chain)
    # the step response by integrating the chain's state equations with a fine trapezoidal rule
    t = np.linspace(0, t63, 4001)
    numeric = _trapezoidal(chain, t)
    assert response.step_response(chain, t[1000::1000]) == pytest.approx(numeric[1000::1000], abs=2e-4)
    assert numeric[-1] == pytest.approx(response.LEVEL, abs=2e-4)
    assert (numeric[:-1] < response.LEVEL + 2e-4).all()


def _trapezoidal(chain, t):
    n = len(chain)
    A = np.diag(-chain) + np.diag(chain[1:], -1)
    drive = np.zeros(n, complex)
    drive[0] = chain[0]
    h = t[1] - t[0]
    step = np.linalg.solve(np.eye(n) - h / 2 * A, np.eye(n) + h / 2 * A)
    push = np.linalg.solve(np.eye(n) - h / 2 * A, h * drive)
    x, out = np.zeros(n, complex), [0.0]
    for _ in t[1:]:
        x = step @ x + push
        out.append(x[-1].real)
    return np.array(out)


def test_one_pole_has_the_known_bandwidth_and_step_time():
    chain = np.array([50.0 + 0j])
    assert response.bandwidth_hz(chain) == pytest.approx(50 / (2 * np.pi), rel=1e-12)
    assert response.step_time_s(chain) == pytest.approx(1 / 50, rel=1e-9)


def test_a_one_pole_model_has_no_error_and_an_unlimited_one_no_analysis():
    model = MODEL.without_effect("second_order_photoreceptor")
    crossings = radii.crossings(radii.error_function(model.circuit(), "one_pole", "bandwidth", "pixel"), 1e-3, 1e3, 51)
    assert all(entry["first"] is None for entry in crossings["levels"].values())
    with pytest.raises(InputError, match="no bandwidth limit"):
        analyse(find_model("ideal"))


# --- from events ------------------------------------------------------------------------------------------------


def test_lights_are_told_apart():
    assert isinstance(read_stimulus(chirp(24.0)), Sweep)
    assert isinstance(read_stimulus(chirp(400.0, start_hz=1.0, stop_hz=4000.0)), Sweep)
    shape = read_stimulus(steps(24.0))
    assert isinstance(shape, Steps)
    assert shape.middle_s == pytest.approx(0.02 * np.arange(1, len(shape.middle_s) + 1), abs=0.4)
    for light in (constant(3.0), slow(24.0), sine(24.0)):
        assert isinstance(read_stimulus(light), str)


@pytest.mark.parametrize("radiance", [3.0, 24.0])
def test_small_steps_give_the_small_signal_step_time(radiance):
    """Steps of at most ± 0.3 in ln L, thresholds of 0.02: the measured time is that of the linear pixel."""
    model = MODEL.set({"on_threshold": 0.02, "off_threshold": 0.02, "refractory_s": 1e-6})
    light = steps(radiance, modulation=0.3, hold_s=0.08, edge_s=2e-5, duration_s=2.4)
    circuit = model.circuit()
    recording = simulate(model, light, width=5, height=5, seed=2)
    measured = measure(recording.events, read_stimulus(light), 0.02, 0.02, 1e-6 + 1 / circuit.differencing)
    expected = response.step_time_s(poles.exact(circuit, radiance, "pixel"))
    assert measured.interval_95 is not None
    assert measured.value == pytest.approx(expected, rel=0.08)


@pytest.mark.parametrize("radiance", [3.0, 24.0])
def test_small_chirps_give_the_small_signal_bandwidth(radiance):
    model = MODEL.set({"on_threshold": 0.02, "off_threshold": 0.02, "refractory_s": 1e-6})
    light = chirp(radiance, modulation=0.2, start_hz=1.0, stop_hz=120.0 * radiance**0.5, duration_s=2.0)
    recording = simulate(model, light, width=5, height=5, seed=2)
    measured = measure(recording.events, read_stimulus(light), 0.02, 0.02, 1e-6 + 1 / CIRCUIT.differencing)
    expected = response.bandwidth_hz(poles.exact(model.circuit(), radiance, "pixel"))
    assert measured.value == pytest.approx(expected, rel=0.1)


def test_a_simulated_camera_lies_where_the_model_says_and_silence_is_not_measurable():
    recordings = [
        simulate(MODEL, light, width=5, height=4, seed=7)
        for light in (chirp(400.0, stop_hz=3000.0), steps(24.0), constant(3.0))
    ]
    measured = analyse(MODEL, recordings, seed=11)["measured"]
    assert [entry["kind"] for entry in measured] == ["sweep", "steps", "none"]
    for entry in measured[:2]:
        low, high = entry["interval_95"]
        own_low, own_high = entry["model"]["same_light_interval_95"]
        assert max(low, own_low) < min(high, own_high)
        assert not low < entry["model"]["same_light_one_pole"] < high
    assert measured[2]["value"] is None
    assert "hardly changes" in measured[2]["why"]


def _noise(stimulus, seed=0, pixels=48, rate_hz=5.0):
    """Events that follow no light."""
    rng = np.random.default_rng(seed)
    n = rng.poisson(rate_hz * stimulus.duration_s * pixels)
    t = np.sort(rng.integers(0, int(stimulus.duration_s * 1e9), n))
    events = Events.from_columns(t, rng.integers(0, pixels, n), np.zeros(n, int), rng.integers(0, 2, n), pixels, 1)
    return Recording(events, stimulus)


@pytest.mark.parametrize(
    "light",
    [steps(100.0, hold_s=0.3, duration_s=3.6), chirp(100.0, start_hz=2.0, stop_hz=50.0, duration_s=4.0)],
    ids=["steps", "chirp"],
)
def test_events_that_follow_no_light_are_no_measurement(light):
    """A step time of minus 50 us once, and the fall of counts per cycle as the bandwidth."""
    for seed in range(5):
        entry = analyse(MODEL, [_noise(light, seed)])["measured"][0]
        assert entry["value"] is None
        assert "no events follow" in entry["why"]


def test_light_that_goes_to_zero_is_not_read():
    t = np.arange(0.0, 3.0, 0.1)
    assert "zero" in read_stimulus(Stimulus(t, np.where(np.arange(len(t)) % 2, 0.0, 100.0)))


def test_a_dark_current_within_the_complex_range_leaves_no_limit_of_one_pole():
    plain = radii.regimes(CIRCUIT)
    low, high = plain["critical"]
    for dark in (2.0 * low, 0.5 * (plain["epsilon_one"] + high), 2.0 * high):
        model = MODEL.with_effect("dark_current", {"radiance": dark})
        content = analyse(model, [])
        map_ = content["regimes"]
        assert all(border is None or border > 0 for border in (map_["epsilon_one"], map_["gamma_one"]))
        assert map_["critical"] == (None if dark > high else pytest.approx([0.0, high - dark]))
        said = " ".join(sentences({**content, "radiance_unit": "fA"}))
        assert "-" not in said.replace("one-pole", "").split("ωc")[0]
        assert "no light is dim enough" in said


def test_bands_contain_the_exact_curves():
    rng = np.random.default_rng(0)
    draws = [
        CIRCUIT.with_(alpha=CIRCUIT.alpha * f, beta=CIRCUIT.beta * g)
        for f, g in np.exp(0.05 * rng.normal(size=(20, 2)))
    ]
    bands = curves.bands(CIRCUIT, draws)
    exact = curves.exact_curves(CIRCUIT, bands["radiance"])
    low, high = bands["curves"]["slow_pole"]
    assert ((low < exact["slow_pole"]) & (exact["slow_pole"] < high)).all()
    low, high = bands["epsilon_one"]
    assert low < CIRCUIT.beta**2 / CIRCUIT.alpha < high


# --- the command ------------------------------------------------------------------------------------------------


def test_the_command_end_to_end(tmp_path, capsys):
    recording = tmp_path / "steps.h5"
    write_recording(simulate(MODEL, steps(24.0), width=4, height=2, seed=1), recording)
    out = tmp_path / "out"
    words = [
        "lowlight",
        "dvs128",
        str(recording),
        "--with",
        "dark_current:radiance=4",
        "--out",
        str(out),
        "--seed",
        "3",
    ]
    assert main(words) == 0
    written = json.loads((out / "lowlight.json").read_text())
    assert {"status", "advice", "errors", "regimes", "curves", "measured", "seed", "versions", "inputs_sha256"} <= set(
        written
    )
    assert written["dark_radiance"] == 4.0
    assert "steps.h5" in written["inputs_sha256"]
    assert {path.name for path in out.glob("*.svg")} == {
        "poles.svg", "errors.svg", "bode.svg", "steps.svg", "measured.svg"
    }  # fmt: skip
    assert "<svg" in (out / "report.html").read_text()
    assert "complex pair" in capsys.readouterr().out
    (out / "report.html").unlink()
    assert main(["report", str(out)]) == 0
    assert (out / "report.html").is_file()
