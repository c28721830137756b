"""What fitted models say of themselves: the fit behind each value, circuit values that follow, nothing of the start."""

from dataclasses import replace

import numpy as np
import pytest

import pixelid as px
from pixelid.errors import InputError
from pixelid.fit.result import FitResult
from pixelid.gap.result import GapReport
from pixelid.model.files import load_model, save_model
from pixelid.model.fitted import implied_physical
from pixelid.stimuli.shapes import chirp


@pytest.fixture(scope="module")
def fitted():
    camera = px.find_model("dvs128").set({"on_threshold": 0.3})
    recording = px.simulate(camera, chirp(24.0, duration_s=0.3, stop_hz=200.0), pixels=4, seed=1)
    held = {"off_threshold": 0.25, "refractory_s": 1.2e-4, "sf_cutoff_hz": 3122.0, "diff_cutoff_hz": 16e3, "gamma": 1.1}
    return px.fit(recording, "dvs128", starts=0, fixed=held)


def test_fitted_values_carry_their_fit_and_interval(fitted, tmp_path):
    fitted.save(tmp_path / "fit")
    model = load_model(tmp_path / "fit" / "model.toml")
    for name, estimate in fitted.estimates.items():
        source = model.parameters[name].source if name in model.parameters else None
        if source is None:
            continue
        if estimate.fixed:
            assert not source.startswith("fitted")
        else:
            assert source.startswith(f"fitted: {fitted.hash}, {fitted.date}")
            low, high = estimate.interval_95
            assert ("not identified" in source) == (not estimate.identified)
            assert low is None or f"{low:.4g}.." in source
            assert high is None or f"..{high:.4g}" in source
    shipped = px.find_model("dvs128").parameters
    assert model.parameters["off_threshold"].source == shipped["off_threshold"].source  # held where it was
    assert model.parameters["refractory_s"].source == ""  # held elsewhere
    assert "nominal" not in model.summary
    assert "fitted to" in model.summary
    assert fitted.hash in model.summary


def test_a_fit_comes_back_with_the_same_hash_and_model(fitted, tmp_path):
    fitted.save(tmp_path / "fit")
    back = FitResult.load(tmp_path / "fit")
    assert (back.hash, back.date) == (fitted.hash, fitted.date)
    assert back.model == fitted.model
    other = replace(fitted, seed=fitted.seed + 1)
    assert other.hash != fitted.hash
    assert other.hash in other.model.parameters["alpha"].source


def test_circuit_values_are_those_that_the_fit_implies(fitted, tmp_path):
    save_model(fitted.model, tmp_path / "model.toml")
    model = load_model(tmp_path / "model.toml")
    if fitted.physical is None:
        pytest.fail(fitted.physical_why)
    assert model.physical.as_dict() == fitted.physical
    invariants = [model.values[name] for name in ("alpha", "beta", "gamma")]
    np.testing.assert_allclose(model.physical.invariants(), invariants, rtol=1e-6)
    assert model.physical.A_amp != pytest.approx(140.0, rel=1e-3)
    assert model.physical.q_in == pytest.approx(0.875)
    without = replace(fitted, physical=None, physical_why="gauge: incomplete", seed=7).model
    assert without.physical is None
    assert "No [physical] values: gauge: incomplete" in without.summary


def test_a_value_that_is_set_has_no_source_of_another():
    model = px.find_model("dvs128")
    assert model.set({"on_threshold": 0.3}).parameters["on_threshold"].source == ""
    same = model.set({"on_threshold": model.values["on_threshold"]}).parameters["on_threshold"]
    assert same == model.parameters["on_threshold"]


def test_the_models_of_a_search_say_that_they_are_fitted():
    from pixelid.gap.result import Named

    base = px.find_model("dvs128").set({"alpha": 9e4})
    grown = replace(base.with_effect("leak", {"rate_hz": 1.9}), name="dvs128_grown")
    leak = Named("leak", 1e-9, 20.0, None, None, 0.1, "gamma", {"leak.rate_hz": (1.9, (1.8, 2.1))}, "")
    report = GapReport(
        verdict="named", sentence="", remainder=False, global_p=1e-9, alpha=0.01, effects=(leak,), free_run=None,
        rounds=(), base=base, model=grown, term=None, recommended_next={}, seconds=1.0, seed=0,
    )  # fmt: skip
    sources = {name: p.source for name, p in report.model.parameters.items()}
    assert sources["leak.rate_hz"].endswith("95 % interval 1.8..2.1")
    assert sources["on_threshold"].startswith("fitted: ")
    assert report.base.parameters["on_threshold"].source != sources["on_threshold"]
    assert report.model.physical == implied_physical(grown)[0] != base.physical
    assert replace(report, advice="other").model == report.model


def test_no_result_replaces_another_unless_asked(fitted, tmp_path):
    folder = tmp_path / "fit"
    fitted.save(folder)
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    other = px.lowlight("dvs128")
    with pytest.raises(InputError, match=r"fit: holds model\.toml already"):
        other.save(folder)
    with pytest.raises(InputError, match=r"holds fit\.json already"):
        fitted.save(folder)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    assert [path.name for path in tmp_path.iterdir()] == ["fit"]
    other.save(folder, overwrite=True)
    assert not (folder / "fit.json").exists()
    assert (folder / "lowlight.json").exists()


def test_a_folder_of_other_files_is_written_into(fitted, tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    fitted.save(tmp_path)
    assert (tmp_path / "notes.txt").read_text() == "mine"
    assert FitResult.load(tmp_path).hash == fitted.hash
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "model.toml").write_text("mine")
    for overwrite in (False, True):
        with pytest.raises(InputError, match=r"model\.toml already; choose another \S+$"):
            fitted.save(tmp_path / "thesis", overwrite=overwrite)
    assert (tmp_path / "thesis" / "model.toml").read_text() == "mine"


def test_a_fit_is_asked_for_one_parameter(fitted):
    assert fitted["on_threshold"] is fitted.estimates["on_threshold"]
    with pytest.raises(InputError, match=r"no parameter 'on_treshold'.*did you mean 'on_threshold'"):
        fitted["on_treshold"]
