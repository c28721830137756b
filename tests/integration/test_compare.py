"""Model comparison finds the order that made the data."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from pixelid.compare import compare
from pixelid.compare.compare import Comparison, Contender, _about_loo, _sentence
from pixelid.errors import InputError
from pixelid.model.shipped import find_model
from pixelid.recordings.events import Events
from pixelid.recordings.recording import Recording
from pixelid.report.fits import summarise_compare
from pixelid.simulate import simulate
from pixelid.status import Status
from pixelid.stimuli.shapes import chirp


@pytest.fixture(scope="module")
def outcome():
    truth = find_model("dvs128").without_effect("threshold_mismatch")
    recording = simulate(truth, chirp(24.0, duration_s=0.4, dt=2e-4), width=4, height=1, seed=3)
    held = ("refractory_s", "diff_cutoff_hz")
    second = truth.fix(dict.fromkeys(held))
    first = find_model("dvs128_low_light").without_effect("threshold_mismatch").fix(dict.fromkeys(held))
    return compare([recording], [first, second], between="linear")


def test_second_order_data_support_the_second_order_model(outcome):
    assert outcome.best == "dvs128"
    assert outcome.sentence.startswith("the data support dvs128")
    table = outcome.as_dict()["models"]
    assert table["dvs128"]["bic"] < table["dvs128_low_light"]["bic"]
    assert table["dvs128_low_light"]["behind_best_nats"] < -10


def test_every_pixel_is_predicted_once(outcome):
    for contender in outcome.contenders.values():
        assert contender.held_out.shape == (4,)
        assert np.isfinite(contender.held_out).all()


def test_a_comparison_comes_back(outcome, tmp_path):
    outcome.save(tmp_path / "out")
    again = Comparison.load(tmp_path / "out")
    assert again.as_dict() == outcome.as_dict()
    assert again.summary() == outcome.summary()
    assert list(again.to_dataframe().index) == list(outcome.contenders)
    (tmp_path / "out" / "held_out.npz").write_bytes(b"PK nothing")
    with pytest.raises(InputError, match=r"held_out\.npz"):
        Comparison.load(tmp_path / "out")


@pytest.mark.slow
def test_leave_one_pixel_out_agrees_with_held_out_pixels():
    truth = find_model("dvs128").without_effect("threshold_mismatch")
    recording = simulate(truth, chirp(24.0, duration_s=0.2, dt=2e-4), width=20, height=1, seed=3)
    held = dict.fromkeys(("refractory_s", "diff_cutoff_hz", "sf_cutoff_hz"))
    second = truth.fix(held)
    first = find_model("dvs128_low_light").without_effect("threshold_mismatch").fix(held)
    contenders = compare([recording], [first, second], between="linear", posteriors=True).contenders
    for contender in contenders.values():
        assert contender.loo is not None
        assert contender.loo["se"] > 0
    assert contenders["dvs128"].loo["worst_k_hat"] < 0.7  # else the importance weights of a pixel cannot be relied on
    gain = contenders["dvs128"].loo["elpd"] - contenders["dvs128_low_light"].loo["elpd"]
    held_out = contenders["dvs128"].held_out.sum() - contenders["dvs128_low_light"].held_out.sum()
    assert gain > 10
    assert gain == pytest.approx(held_out, rel=0.5)


def test_comparisons_that_make_no_sense():
    with pytest.raises(InputError, match="two or more models"):
        compare([], [find_model("dvs128")])
    with pytest.raises(InputError, match="threshold_noise"):
        compare([], [find_model("dvs128"), find_model("ideal")])
    pooled = Recording(Events.empty(1, 1), source=Path("diode.h5"), pooled=True)
    with pytest.raises(InputError, match="diode is pooled"):
        compare([pooled], [find_model("dvs128"), find_model("photoreceptor")])


def contender(parameters: int, held_out) -> Contender:
    return Contender(SimpleNamespace(coordinates=[0] * parameters), 0.0, np.asarray(held_out, float))


def test_every_model_that_is_not_surely_worse_is_named():
    """Not only the one that comes nearest: another may be farther behind and less certain."""
    rng = np.random.default_rng(0)
    best = np.full(20, 10.0)
    near = best - 0.5 - 0.001 * rng.normal(size=20)
    scattered = best - 0.7 - 3.0 * rng.permutation(np.linspace(-2, 2, 20))
    said = _sentence({"a": contender(9, best), "b": contender(7, near), "c": contender(5, scattered)}, "a")
    assert "do not decide between a and c" in said
    assert said.endswith("take the simplest, c")
    assert "support a" in _sentence({"a": contender(9, best), "b": contender(7, near)}, "a")


def test_two_pixels_decide_little():
    said = _sentence({"a": contender(9, [1.0, 1.6]), "b": contender(7, [0.0, 0.0])}, "a")
    assert "do not decide" in said
    assert "2 pixels are few" in said


def with_loo(k_hat: float, status: Status) -> Contender:
    loo = {"elpd": 100.0, "se": 2.0, "worst_k_hat": k_hat, "status": status}
    return Contender(SimpleNamespace(status=Status.converged), 0.0, np.zeros(2), loo)


def test_leave_one_out_is_said_and_what_cannot_be_relied_on_is_named():
    """Draws for a k̂ that nobody reads: of four pixels it was 0.72 and 0.77, and stood in the JSON alone."""
    good, bad = with_loo(0.3, Status.converged), with_loo(0.77, Status.converged)
    late = with_loo(0.3, Status.not_converged)
    assert _about_loo({"a": contender(1, [0.0, 0.0])}) == ""
    assert _about_loo({"a": good}) == ". PSIS-LOO over pixels, in nats: a 100.0 ± 2"
    said = _about_loo({"a": good, "b": bad, "c": late})
    assert said.endswith("not to be relied on for b (k̂ 0.77), c (not converged): go by the held-out pixels")
    assert Comparison({"a": good, "b": late}, "a", "").status == Status.not_converged


def ended(status: Status, held_out, advice="") -> Contender:
    return Contender(SimpleNamespace(status=status, advice=advice), 0.0, np.asarray(held_out, float))


def test_advice_names_the_model_that_is_not_to_be_trusted():
    """One of two misfitted, and both were under "The model does not describe the data"."""
    rng = np.random.default_rng(0)
    best = ended(Status.converged, np.full(20, 10.0))
    loser = ended(Status.misfit, 5.0 + 0.1 * rng.normal(size=20), "the scatter of ON events is not what the model says")
    near = ended(Status.misfit, 10.0 + rng.normal(size=20) - 0.1)
    said = Comparison({"a": best, "b": loser}, "a", "").advice
    assert said.startswith("b, misfit: the scatter of ON events is not what the model says. Only a clear loser is not")
    for others in ({"b": near}, {"b": loser, "c": near}):
        outcome = Comparison({"a": best, **others}, "a", "")
        assert outcome.status == Status.misfit
        assert f"{[*others][-1]}, misfit: The model does not describe the data" in outcome.advice
        assert "loser" not in outcome.advice
    assert "loser" not in Comparison({"a": best, "b": ended(Status.misfit, np.full(20, 20.0))}, "b", "").advice
    assert Comparison({"a": best}, "a", "").advice == ""
    advice = Comparison({"a": with_loo(0.3, Status.not_converged)}, "a", "").advice
    assert advice.startswith("a, posterior: The optimiser")


@pytest.mark.parametrize("status", ["at_bound", "converged"])
def test_the_page_of_a_comparison_has_its_status(status, outcome, tmp_path):
    said = outcome.as_dict() | {"status": status}
    said["models"] = {name: row | {"status": status} for name, row in said["models"].items()}
    assert summarise_compare(said, tmp_path).status == status
