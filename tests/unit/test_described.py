"""Described effects: simulator and likelihood against events written out one by one, files, and words."""

import json
from dataclasses import asdict

import numpy as np
import pytest

from pixelid.cli.main import main
from pixelid.errors import InputError
from pixelid.fit.coordinates import Coordinates
from pixelid.fit.event_times import EventTimesObjective
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.files import from_document, load_model, save_model, to_document
from pixelid.model.shipped import find_model
from pixelid.recordings.events import Events
from pixelid.recordings.own_light import with_fine_light
from pixelid.recordings.recording import Recording
from pixelid.simulate import simulate
from pixelid.stages.described import all_cells, cell, equation
from pixelid.stages.described_words import in_words
from pixelid.stimuli.stimulus import Stimulus
from tests.oracles.described_events import events

ON, OFF, DEAD = 0.2, 0.25, 1e-3
T = np.linspace(0.0, 1.0, 401)
LOGS = np.log(60.0) + 0.9 * np.sin(2 * np.pi * 3.0 * T) + 0.4 * np.sin(2 * np.pi * 7.3 * T + 1.0)
LIGHT = Stimulus.from_arrays(T, np.exp(LOGS))
IDEAL = (
    find_model("ideal")
    .with_effect("refractory_period", {"refractory_s": DEAD})
    .set({"on_threshold": ON, "off_threshold": OFF})
)
REFERENCE = 50.0
# values of each form, and g by covariate: of the event before and the time since then
SHAPES = {
    "constant": {},
    "linear": {},
    "power": {"exponent": 0.7, "reference": REFERENCE},
    "relaxation": {"scale": 40.0},
    "step": {"edge": 50.0},
}
V = {
    "none": lambda before: 1.0,
    "previous_polarity": lambda before: before.polarity,
    "time_in_recording": lambda before: before.time,
    "radiance": lambda before: before.radiance,
    "speed": lambda before: before.speed,
}
FORM = {
    "constant": lambda v, scale: v,
    "linear": lambda v, scale: v,
    "power": lambda v, scale: (v / REFERENCE) ** 0.7,
    "relaxation": lambda v, scale: np.exp(-v / scale),
    "step": lambda v, scale: float(v > scale),
}


def values_of(own, strength):
    """Parameter values of a cell that make a difference under `LIGHT`, and the scale of its form."""
    shape = dict(SHAPES[own.form])
    for key in ("scale", "edge"):
        if key in shape:
            shape[key] = {"s": 0.4, "1/s": 12.0, "radiance": 50.0}[own.parameters[1].unit]
            if own.covariate == "time_since_event":
                shape[key] = 0.02
    return {"strength": strength, **shape}, shape.get("scale", shape.get("edge", 1.0))


def strength_of(own):
    """A strength that makes a difference, and leaves dead times positive."""
    if own.quantity == "dead_time":
        return {"power": 2e-4, "constant": 8e-4}.get(own.form, 4e-3)
    if own.quantity == "leak":
        return 0.02 if own.form == "linear" else 1.0
    if own.quantity in TWINS:
        return TWINS[own.quantity][2]
    return 0.2 if own.form == "linear" else -0.15


def written_out(own, strength, scale):
    """(times, signs) of a cell's events by the oracle."""

    def g(before):
        if before.polarity == 0.0:
            return 0.0
        return strength * FORM[own.form](V[own.covariate](before), scale)

    def threshold(mean, mine, sign):
        def of(before, since):
            if own.quantity not in (mine, "threshold"):
                return mean
            if own.covariate == "time_since_event":
                return mean * (1.0 + (strength * np.exp(-since / scale) if before.polarity else 0.0))
            flip = sign if own.quantity == "threshold" and own.covariate == "previous_polarity" else 1.0
            return mean * (1.0 + flip * g(before))

        return of

    more = {}
    if own.quantity in ("light", "response"):

        def response(x, when):
            v = np.exp(x) if own.covariate == "radiance" else when
            return x + np.log(1.0 + strength * FORM[own.form](v, scale))

        more["response"] = response
    if own.quantity == "leak":
        more["leak"] = lambda x, when: ON * strength * (np.exp(x) if own.covariate == "radiance" else 1.0)
    dead = (lambda before: DEAD + g(before)) if own.quantity == "dead_time" else lambda before: DEAD
    return events(T, LOGS, threshold(ON, "on_threshold", 1.0), threshold(OFF, "off_threshold", -1.0), dead, **more)


# quantity → (the effect with the same equation, its values, strength)
TWINS = {
    "low_pass": ("extra_pole", {"extra_pole.cutoff_hz": 1500.0}, 1.0 / (2.0 * np.pi * 1500.0)),
    "high_pass": ("lower_cutoff", {"lower_cutoff.cutoff_hz": 0.5}, 0.5),
}
EXACT = [own for own in all_cells() if own.quantity != "rate" and own.quantity not in TWINS]


@pytest.mark.parametrize("quantity", TWINS)
def test_a_filter_described_is_the_effect_of_that_equation(quantity):
    effect, values, strength = TWINS[quantity]
    own = cell(quantity, "none", "constant")
    model = find_model("dvs128")
    described = model.with_effect(own.name, {"strength": strength})
    twin = model.with_effect(effect, values)
    found, expected = (asdict(one.circuit()) for one in (described, twin))
    assert found.pop("extra_pole") == pytest.approx(expected.pop("extra_pole"), rel=1e-12)
    assert found == expected
    assert model.with_effect(own.name, {"strength": 0.0}).circuit() == model.circuit()
    with pytest.raises(InputError, match="which is the same"):
        twin.with_effect(own.name, {"strength": strength}).circuit()


@pytest.mark.parametrize("own", EXACT, ids=lambda own: own.name)
def test_simulated_events_are_those_written_out(own):
    strength = strength_of(own)
    values, scale = values_of(own, strength)
    model = IDEAL.with_effect(own.name, values)
    found = simulate(model, LIGHT, synchronous=True, as_sampled=True).events
    plain = simulate(IDEAL, LIGHT, synchronous=True, as_sampled=True).events
    times, signs = written_out(own, strength, scale)
    assert len(times) > 15
    assert len(found) == len(times)
    np.testing.assert_array_equal(np.where(found.p == 1, 1.0, -1.0), signs)
    # between samples the oracle's response bends where the package's is linear in log radiance
    tolerance = 2e-4 if own.quantity in ("light", "response", "leak") else 2e-6
    np.testing.assert_allclose(found.t * 1e-9, times, atol=tolerance)
    assert len(plain) != len(times) or np.abs(plain.t * 1e-9 - times).max() > 20 * tolerance


@pytest.mark.parametrize(
    "own", [cell("light", "time_in_recording", form) for form in ("linear", "relaxation")], ids=lambda own: own.form
)
def test_constant_light_of_two_samples_changes_with_time(own):
    """A light that is constant is recorded as its two ends, and what changes with time bends between them."""
    strength = 0.8 if own.form == "linear" else -0.7
    values, scale = values_of(own, strength)
    constant = Stimulus(np.array([0.0, 1.5]), np.array([40.0, 40.0]))
    model = IDEAL.with_effect(own.name, values)
    found = simulate(model, constant, synchronous=True).events

    def response(x, when):
        return x + np.log(1.0 + strength * FORM[own.form](when, scale))

    times, signs = events(
        np.linspace(0.0, 1.5, 20), np.full(20, np.log(40.0)), lambda b, s: ON, lambda b, s: OFF, lambda b: DEAD,
        response=response,
    )  # fmt: skip
    assert len(times) > 2
    assert len(found) == len(times)
    np.testing.assert_array_equal(np.where(found.p == 1, 1.0, -1.0), signs)
    np.testing.assert_allclose(found.t * 1e-9, times, atol=2e-5)  # a step of the light is 7e-4
    recording = with_fine_light(Recording(found, constant), "smooth")
    noisy = model.with_effect("threshold_noise", {"threshold_sigma": 0.02})
    terms = EventTimes([recording]).terms(noisy.circuit())
    np.testing.assert_allclose(terms.z, np.where(signs[1:] > 0, ON, OFF), atol=1e-5)
    assert not terms.background.any()


@pytest.mark.parametrize("own", EXACT, ids=lambda own: own.name)
def test_levels_of_events_written_out_are_the_thresholds(own):
    strength = strength_of(own)
    values, scale = values_of(own, strength)
    times, signs = written_out(own, strength, scale)
    stamps = np.round(times * 1e9).astype(np.int64)
    zeros = np.zeros(len(times), np.uint16)
    recording = Recording(Events(stamps, zeros, zeros, (signs > 0).astype(np.uint8), 1, 1, 1), LIGHT)
    likelihood = EventTimes([recording])
    base = IDEAL.with_effect("threshold_noise", {"threshold_sigma": 0.02})
    terms = likelihood.terms(base.with_effect(own.name, values).circuit())
    expected = np.where(signs[1:] > 0, ON, OFF)
    tolerance = 3e-3 if own.quantity in ("light", "response", "leak") else 2e-5
    np.testing.assert_allclose(terms.z, expected, atol=tolerance)
    assert not terms.background.any()
    without = likelihood.terms(base.circuit())
    assert np.abs(without.z - expected).max() > 3 * tolerance
    assert terms.total > without.total


def session(model, seed=1):
    return simulate(model, LIGHT, width=3, height=3, seed=seed, as_sampled=True)


@pytest.mark.parametrize("own", all_cells(), ids=lambda own: own.name)
def test_gradient_is_the_derivative_of_the_log_likelihood(own):
    base = find_model("dvs128").with_effect("refractory_period", {"refractory_s": 1e-3})
    values, _ = values_of(own, 1e-4 if own.quantity == "dead_time" else 0.01)
    model = base.with_effect(own.name, values)
    objective = EventTimesObjective(EventTimes([session(base)]), Coordinates.of(model))
    x = objective.coordinates.start
    gradient = objective.gradient(x)
    for i, name in enumerate(objective.coordinates.names):
        if not name.startswith("described.") and "threshold" not in name:
            continue
        h = 1e-5 * objective.coordinates.longest_moves()[i]
        up, down = x.copy(), x.copy()
        up[i] += h
        down[i] -= h
        numeric = (objective.value(up) - objective.value(down)) / (2 * h)
        assert gradient[i] == pytest.approx(numeric, rel=2e-3, abs=2e-3 * max(1.0, np.abs(gradient).max() * 1e-3)), name


def test_relaxing_thresholds_hold_for_the_polarity_that_does_not_fire():
    """The extreme of the other polarity, less its shift, by looking at every sample of every interval."""
    base = find_model("dvs128")
    name = "described.threshold.time_since_event.relaxation"
    model = base.with_effect(name, {"strength": -0.5, "scale": 0.03})
    recording = session(base)
    likelihood = EventTimes([recording])
    evaluator = likelihood.evaluators[0]
    circuit = model.circuit()
    changes = evaluator(circuit)
    iv, trajectory = evaluator.intervals, evaluator.trajectory(circuit)
    output, wd = trajectory.states[:, 5], circuit.differencing
    mean = {1.0: circuit.on_threshold, -1.0: circuit.off_threshold}
    for i in range(0, len(iv), 7):
        release = iv.previous_s[i] + circuit.refractory
        level, out = (trajectory.at([release])[0][j] for j in (2, 5))
        inside = (trajectory.t > release) & (trajectory.t <= iv.time_s[i])
        t = trajectory.t[inside]
        change = output[inside] - level - (out - level) * np.exp(-wd * (t - release))
        shift = -0.5 * mean[-iv.sign[i]] * np.exp(-(t - iv.previous_s[i]) / 0.03)
        best = np.max(-iv.sign[i] * change - shift, initial=-np.inf)
        if best > 0:
            assert changes.opposite[i] == pytest.approx(best, abs=1e-9)
        else:
            assert changes.opposite[i] <= 0.5 * mean[-iv.sign[i]]


@pytest.mark.parametrize("own", all_cells(), ids=lambda own: own.name)
def test_model_files_keep_described_effects(own, tmp_path):
    values, _ = values_of(own, 0.01)
    model = find_model("dvs128").with_effect(own.name, values).with_effect("leak")
    save_model(model, tmp_path / "model.toml")
    again = load_model(tmp_path / "model.toml")
    assert again.effects == model.effects
    assert again.parameters == model.parameters
    assert again.circuit() == model.circuit()
    entry = to_document(model)["described"][0]
    assert [entry[key] for key in ("stage", "quantity", "covariate", "form")] == [
        own.stage, own.quantity, own.covariate, own.form,
    ]  # fmt: skip
    assert own.name not in to_document(model)["model"]["effects"]
    assert model.without_effect(own.name) == find_model("dvs128").with_effect("leak")


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ({"quantity": "colour", "covariate": "none", "form": "constant"}, "unknown quantity 'colour'; known: light"),
        ({"quantity": "leak", "covariate": "speed", "form": "power"}, "unknown covariate of leak 'speed'; known: none"),
        ({"quantity": "leak", "covariate": "none", "form": "power"}, "unknown form of leak by none 'power'"),
        (
            {"stage": "readout", "quantity": "leak", "covariate": "none", "form": "constant"},
            "belongs to 'differencing'",
        ),
        ({"quantity": "leak", "covariate": "none", "form": "constant", "why": 1}, "unknown keys why"),
        ({"quantity": "leak", "covariate": "none", "form": "constant", "parameters": {"rate": 1.0}}, "no effect"),
    ],
)
def test_a_wrong_described_table_is_refused_in_plain_words(entry, words):
    with pytest.raises(InputError, match=words):
        from_document({"model": {"name": "x"}, "described": [entry]})


def test_one_quantity_at_most_depends_on_the_time_since_the_last_event():
    model = IDEAL.with_effect(cell("on_threshold", "time_since_event", "relaxation").name)
    with pytest.raises(InputError, match="only one quantity"):
        model.with_effect(cell("off_threshold", "time_since_event", "relaxation").name).circuit()


@pytest.mark.parametrize(
    ("own", "values", "words"),
    [
        (("on_threshold", "previous_polarity", "constant"), {"strength": -0.04},
         "threshold of ON events 4 % lower after an ON event, 4 % higher after an OFF event"),
        (("threshold", "time_in_recording", "linear"), {"strength": 0.05},
         "thresholds of both polarities 5 % higher with every second of a recording"),
        (("dead_time", "none", "constant"), {"strength": 1.5e-4}, "dead time 150 µs longer than the model's"),
        (("off_threshold", "time_since_event", "relaxation"), {"strength": 0.2, "scale": 0.012},
         "threshold of OFF events 20 % higher just after an event, the difference fading within 12 ms (to 1/e)"),
        (("leak", "none", "constant"), {"strength": 0.5},
         "the change drifts upwards: ON events in constant light at 0.5 Hz"),
        (("on_threshold", "radiance", "power"), {"strength": 0.1, "exponent": 0.5, "reference": 80.0},
         "threshold of ON events 10 % higher at a radiance of 80 at the event before, as its power 0.5 elsewhere"),
        (("rate", "radiance", "relaxation"), {"strength": -0.1, "scale": 30.0},
         "bandwidth of the photoreceptor 10 % lower in the dark, fading with radiance, to 1/e at 30"),
        (("dead_time", "speed", "step"), {"strength": 1e-4, "edge": 20.0},
         "dead time 100 µs longer where speed |d ln L/dt| at the event before exceeds 20 per second"),
        # nearly logarithms: (1 + 0.722 · 10^0.03145) / (1 + 0.722 · 10^-0.03145), and 200 µs · (10^-0.062 - 10^0.062)
        (("threshold", "radiance", "power"), {"strength": 0.722, "exponent": 0.0629, "reference": 79.0},
         "thresholds of both polarities 6.26 % higher with every tenfold radiance at the event before"),
        (("dead_time", "radiance", "power"), {"strength": 2e-4, "exponent": -0.124, "reference": 89.8},
         "dead time 57.3 µs shorter with every tenfold radiance at the event before"),
    ],
)  # fmt: skip
def test_descriptions_say_themselves_in_words(own, values, words):
    assert in_words(cell(*own), values) == words


def test_every_cell_has_words_and_an_equation_with_its_numbers():
    for own in all_cells():
        values = {p.name.rsplit(".", 1)[1]: 0.123 for p in own.parameters}
        assert "0.123" in equation(own.quantity, own.covariate, own.form, values)
        assert in_words(own, values)


def test_the_command_line_simulates_and_fits_a_described_effect(tmp_path):
    effect = "described.threshold.previous_polarity.constant"
    session = tmp_path / "session.h5"
    truth = ["--with", f"{effect}:strength=0.08", "--seed", "3"]
    assert run(["simulate", "dvs128", "--stimulus", "chirp", "--pixels", "9", "--out", str(session), *truth]) == 0
    out = tmp_path / "fit"
    assert run(["fit", str(session), "--model", "dvs128", "--with", effect, "--out", str(out), "--quiet"]) in (0, 1)
    fitted = load_model(out / "model.toml").values[f"{effect}.strength"]
    assert fitted == pytest.approx(0.08, abs=0.01)
    again = load_model(out / "model.toml")
    assert simulate(again, LIGHT, width=2, height=2).events is not None
    assert json.loads((out / "fit.json").read_text())["parameters"][f"{effect}.strength"]["identified"]


def run(arguments):
    """Exit code of the command line."""
    try:
        main(arguments)
    except SystemExit as done:
        return int(done.code or 0)
    return 0
