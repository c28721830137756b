"""Designs: information that scales, criteria of known matrices, predictions that simulated fits bear out."""

import json
from dataclasses import replace

import numpy as np
import pytest

from pixelid.cli.main import main
from pixelid.design import criteria, default_menu, read_menu, recommend
from pixelid.design.design import known_from
from pixelid.design.information import PIXELS, information, simulated
from pixelid.design.menu import candidate
from pixelid.errors import InputError
from pixelid.fit.coordinates import Coordinates
from pixelid.fit.event_times import EventTimesObjective
from pixelid.fit.newton import maximise
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.shipped import find_model
from pixelid.recordings import Events, Recording, write_recording
from pixelid.simulate import simulate
from pixelid.stimuli.resample import resampled

MODEL = find_model("dvs128")
COORDINATES = Coordinates.of(MODEL)
CHIRP_24 = candidate("chirp_24", "chirp", level=24.0, stop_hz=200.0)
CHIRP_390 = candidate("chirp_390", "chirp", level=390.0, stop_hz=800.0)
STEPS_24 = candidate("steps_24", "steps", level=24.0, seed=1)
MENU = [CHIRP_24, CHIRP_390, STEPS_24]


def camera(stimuli, pixels: int, seed: int) -> list[Recording]:
    """Recordings of the same pixels: their own thresholds once and for all, fresh noise in every recording.

    The light is resampled as a fit does it, so that simulation and fit linearise alike.
    """
    circuit, rng = MODEL.circuit(), np.random.default_rng(seed)
    on, off = (C * (1 + circuit.mismatch * rng.standard_normal(pixels)) for C in (0.25, 0.25))
    recordings = []
    for k, stimulus in enumerate(map(resampled, stimuli)):
        parts = []
        for i in range(pixels):
            own = circuit.with_(on_threshold=on[i], off_threshold=off[i], mismatch=0.0)
            events = simulate(own, stimulus, width=1, height=1, seed=10_000 * seed + 100 * k + i).events
            parts.append((events.t, np.full(len(events), i), events.p))
        t, x, p = (np.concatenate(column) for column in zip(*parts, strict=True))
        order = np.argsort(t, kind="stable")
        events = Events.from_columns(t[order], x[order], 0 * x, p[order], pixels, 1)
        recordings.append(Recording(events, stimulus, condition=f"part {k}", sensor="camera"))
    return recordings


@pytest.fixture(scope="module")
def one_level():
    return camera([CHIRP_24.stimulus], 9, seed=1)


@pytest.fixture(scope="module")
def advice(one_level):
    return recommend(MODEL, MENU, recordings=one_level, seed=1)


# --- criteria ---------------------------------------------------------------------------------------------------


def test_criteria_of_diagonal_information():
    names = ("a", "b")
    before, after = np.diag([1.0, 4.0]), np.diag([4.0, 4.0])
    assert criteria.score("D", names, before, after) == pytest.approx(np.log(2))
    assert criteria.score("A", names, before, after) == pytest.approx(0.5 * np.log(1.25 / 0.5))
    assert criteria.score("a", names, before, after) == pytest.approx(np.log(2))
    assert criteria.score("b", names, before, after) == pytest.approx(0.0)
    direction, factor = criteria.most_improved(before, after)
    assert np.abs(direction) == pytest.approx([1.0, 0.0], abs=1e-12)
    assert factor == pytest.approx(2.0)


def test_more_information_never_scores_less():
    rng = np.random.default_rng(0)
    for _ in range(20):
        J, K = rng.normal(size=(2, 6, 4))
        before = J.T @ J + 0.1 * np.eye(4)
        for criterion in ("D", "A", "w", "z"):
            assert criteria.score(criterion, ("w", "x", "y", "z"), before, before + K.T @ K) > 0


# --- information ------------------------------------------------------------------------------------------------


def test_information_grows_with_duration_and_pixels():
    def of(duration_s, seed):
        light = candidate("steps", "steps", level=24.0, duration_s=duration_s, seed=3).stimulus
        return information([simulated(MODEL, light, seed)], COORDINATES, COORDINATES.start)

    place = [COORDINATES.names.index(name) for name in ("alpha", "beta", "threshold_sigma")]
    short, long = (np.diag(of(duration, 1))[place] for duration in (0.8, 3.2))
    assert long / short == pytest.approx(4.0, rel=0.35)  # other random steps
    twice = replace(simulated(MODEL, CHIRP_24.stimulus, 2), sensor="another")
    both = information([simulated(MODEL, CHIRP_24.stimulus, 1), twice], COORDINATES, COORDINATES.start)
    one = information([simulated(MODEL, CHIRP_24.stimulus, 1)], COORDINATES, COORDINATES.start)
    assert np.diag(both) / np.diag(one) == pytest.approx(2.0, rel=0.2)


def test_constant_light_says_nothing_to_a_silent_pixel():
    dark = candidate("constant", "constant", level=24.0)
    assert not information([simulated(MODEL, dark.stimulus, 1)], COORDINATES, COORDINATES.start).any()


def test_simulated_pixels_are_those_recorded(one_level):
    recording = simulated(MODEL, CHIRP_24.stimulus, 4, one_level)
    assert set(np.unique(recording.events.pixel)) == set(np.unique(one_level[0].events.pixel))
    assert recording.sensor == "camera"


# --- recommendations --------------------------------------------------------------------------------------------


def test_data_at_one_level_call_for_another_level(advice):
    assert advice["recommended"]["name"] == "chirp_390"
    assert advice["pixels"] == 9
    assert "source follower's cutoff" in advice["why"]
    assert [entry["score"] for entry in advice["ranking"]] == sorted(
        (entry["score"] for entry in advice["ranking"]), reverse=True
    )
    for name, before in advice["widths_before"].items():
        assert advice["widths_after"][name]["std_coordinate"] <= before["std_coordinate"] * 1.001


def test_a_longer_stimulus_scores_more():
    menu = [candidate(f"{T}", "steps", level=24.0, duration_s=T, seed=1) for T in (0.4, 0.8, 1.6)]
    scores = {entry["name"]: entry["score"] for entry in recommend(MODEL, menu, seed=1)["ranking"]}
    assert scores["0.4"] < scores["0.8"] < scores["1.6"]


def test_predicted_errors_are_those_of_a_fit(one_level, advice):
    """The standard errors an actual fit reports after adding the recommended stimulus: within 20 %.

    Those of the thresholds follow the mismatch that the fit finds among nine pixels, which is scaled out; that of the
    noise may be 20 % smaller in the Hessian than in the information matrix.
    """
    recordings = camera([CHIRP_24.stimulus, CHIRP_390.stimulus], 9, seed=1)
    objective = EventTimesObjective(EventTimes(recordings), COORDINATES)
    optimum = maximise(objective, COORDINATES.start, max_steps=30, tolerance=1e-3)
    assert optimum.converged
    reported = np.sqrt(np.diag(np.linalg.inv(-objective.hessian(optimum.x, optimum.local))))
    predicted = [advice["widths_after"][name]["std_coordinate"] for name in COORDINATES.names]
    names = list(COORDINATES.names)
    mismatch = np.exp((optimum.x - COORDINATES.start)[names.index("threshold_mismatch.sigma")])
    for name, ours, theirs in zip(names, predicted, reported, strict=True):
        scale = mismatch if name in ("on_threshold", "off_threshold") else 1.0
        assert theirs == pytest.approx(ours * scale, rel=0.3 if name == "threshold_sigma" else 0.2), name
    pulls = (optimum.x - COORDINATES.start) / predicted
    assert np.sqrt((pulls**2).mean()) < 1.7  # ten of them, one fit


@pytest.mark.slow
def test_predicted_errors_are_those_of_many_fits_and_the_recommended_stimulus_wins(one_level, advice):
    """Errors against the truth over 24 simulated experiments: within 20 % of the prediction, all parameters pooled."""
    errors = {}
    for extra in (CHIRP_390, STEPS_24):
        widths = recommend(MODEL, [extra], recordings=one_level, seed=1)["widths_after"]
        predicted = np.array([widths[name]["std_coordinate"] for name in COORDINATES.names])
        rows = []
        for seed in range(200, 224):
            recordings = camera([CHIRP_24.stimulus, extra.stimulus], 9, seed)
            objective = EventTimesObjective(EventTimes(recordings), COORDINATES)
            rows.append(maximise(objective, COORDINATES.start, max_steps=30, tolerance=1e-3).x - COORDINATES.start)
        errors[extra.name] = np.sqrt((np.array(rows) ** 2).mean(axis=0))
        if extra is CHIRP_390:
            assert np.sqrt(((np.array(rows) / predicted) ** 2).mean()) == pytest.approx(1.0, abs=0.2)
    for name in ("alpha", "gamma", "sf_cutoff_hz", "refractory_s"):
        i = COORDINATES.names.index(name)
        assert errors["chirp_390"][i] < 0.5 * errors["steps_24"][i]


def test_a_fit_is_what_is_known_before():
    names = COORDINATES.names
    covariance = np.diag(np.linspace(0.01, 0.1, len(names)) ** 2)
    known = known_from(names, covariance)
    recommended = recommend(MODEL, [STEPS_24], known=known, pixels=PIXELS, criterion="A", seed=1)
    assert recommended["before"] == "fit"
    assert "--recorded" in recommended["advice"]
    before = [recommended["widths_before"][name]["std_coordinate"] for name in names]
    assert before == pytest.approx(np.linspace(0.01, 0.1, len(names)), rel=0.01)
    on_bound = covariance.copy()
    on_bound[2] = on_bound[:, 2] = 0.0
    assert known_from(names, on_bound).names == (*names[:2], *names[3:])


# --- menus and the command --------------------------------------------------------------------------------------


def test_the_default_menu_holds_every_kind_at_three_levels():
    menu = default_menu(MODEL)
    assert {c.kind for c in menu} == {"chirp", "steps", "slow", "constant"}
    assert len({c.parameters["level"] for c in menu}) == 3
    assert len({c.stimulus.duration_s for c in menu}) == 2


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "expected [[stimulus]] tables"),
        ("[[stimulus]]\nlevel = 3.0\n", "with a kind"),
        ('[[stimulus]]\nkind = "steps"\nname = "a"\n[[stimulus]]\nkind = "slow"\nname = "a"\n', "name of its own"),
        ('[[stimulus]]\nkind = "grating"\nwidth = 4\nheight = 4\n', "full-field"),
        ('[[stimulus]]\nkind = "steps"\nlevl = 4\n', "levl"),
    ],
)
def test_a_wrong_menu_is_named(text, says, tmp_path):
    path = tmp_path / "menu.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=says.replace("[", r"\[")):
        read_menu(path)


def test_the_command_end_to_end(tmp_path, one_level, capsys):
    write_recording(one_level[0], tmp_path / "chirp.h5")
    menu = tmp_path / "menu.toml"
    menu.write_text(
        '[[stimulus]]\nname = "near"\nkind = "steps"\nlevel = 24.0\n'
        '[[stimulus]]\nname = "far"\nkind = "chirp"\nlevel = 390.0\nstop_hz = 800.0\n'
    )
    out = tmp_path / "out"
    words = ["design", "dvs128", "--recorded", str(tmp_path / "chirp.h5"), "--menu", str(menu), "--out", str(out)]
    assert main([*words, "--criterion", "gamma"]) == 0
    written = json.loads((out / "design.json").read_text())
    assert {"status", "recommended", "why", "ranking", "widths_before", "widths_after", "seed", "versions"} <= set(
        written
    )
    assert written["recommended"]["name"] == "far"
    assert set(written["inputs_sha256"]) == {"menu.toml", "chirp.h5"}
    assert "<svg" in (out / "report.html").read_text()
    assert "next: far, for dvs128 by gamma" in capsys.readouterr().out
    assert main(["simulate", "dvs128", "--stimulus", str(out / "next.toml"), "--out", str(tmp_path / "n.h5")]) == 0
