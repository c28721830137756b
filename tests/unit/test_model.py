"""Models: files without loss, effects added and removed, and refusals that say what is known."""

import math
from dataclasses import FrozenInstanceError, replace

import pytest

from pixelid import stages
from pixelid.errors import InputError
from pixelid.model.files import from_document, load_model, save_model, to_document
from pixelid.model.model import Model
from pixelid.model.shipped import find_model, shipped_models
from pixelid.parameters.parameter import Prior
from pixelid.stages import LIBRARY, Circuit

SHIPPED = sorted(shipped_models())
ADDABLE = [name for name in LIBRARY if name != "second_order_photoreceptor"]


@pytest.fixture
def dvs128() -> Model:
    return find_model("dvs128")


def same_file(model: Model, tmp_path) -> Model:
    save_model(model, tmp_path / "model.toml")
    return load_model(tmp_path / "model.toml")


# --- files ------------------------------------------------------------------------------------------------------


def test_the_shipped_circuits():
    assert SHIPPED == ["dvs128", "dvs128_low_light", "gen31", "ideal", "imx636", "photoreceptor"]
    assert [find_model(name).name for name in SHIPPED] == SHIPPED


@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_model_survives_its_file(name, tmp_path):
    assert same_file(find_model(name), tmp_path) == find_model(name)


@pytest.mark.parametrize("base", SHIPPED)
@pytest.mark.parametrize("effect", ADDABLE)
def test_a_model_with_any_effect_survives_its_file(base, effect, tmp_path):
    model = find_model(base).with_effect(effect)
    assert same_file(model, tmp_path) == model


def test_a_model_with_every_effect_survives_its_file(dvs128, tmp_path):
    model = dvs128
    for name in ADDABLE:
        model = model.with_effect(name)
    assert model.effects == tuple(ADDABLE)  # signal order, whatever the order of adding
    assert same_file(model, tmp_path) == model


def test_priors_bounds_and_fixing_survive(dvs128, tmp_path):
    parameters = dict(dvs128.parameters)
    parameters["alpha"] = replace(parameters["alpha"], prior=Prior(11.0, 0.25), lower=1e3, upper=1e7)
    model = replace(dvs128, parameters=parameters).fix({"sf_cutoff_hz": 2500.0, "gamma": None})
    back = same_file(model, tmp_path)
    assert back == model
    assert back.parameters["alpha"].prior == Prior(11.0, 0.25)
    assert back.parameters["gamma"].free is False
    assert back.parameters["sf_cutoff_hz"].value == 2500.0
    assert back.gauge.ratios == {"A_loop": (0.7, "A_amp")}
    assert back.with_effect("leak").without_effect("leak") == back


def test_a_fit_folder_and_a_file_are_models_too(dvs128, tmp_path):
    save_model(dvs128, tmp_path / "model.toml")
    assert find_model(tmp_path) == find_model(tmp_path / "model.toml") == dvs128
    with pytest.raises(InputError, match=r"no model 'dvs129': .*" + ", ".join(SHIPPED)):
        find_model("dvs129")


def corrupted(**changes) -> dict:
    document = to_document(find_model("dvs128"))
    for path, value in changes.items():
        table, key = path.split("__")
        document.setdefault(table, {})[key] = value
    return document


@pytest.mark.parametrize(
    ("document", "says"),
    [
        ({}, r"\[model\] table with a name"),
        ({"model": []}, r"\[model\] table with a name"),
        (corrupted(model__photoreceptor="third_order"), "photoreceptor must be .* found 'third_order'"),
        (corrupted(model__linearisation="older"), "linearisation must be 'midpoint' or 'newer', found 'older'"),
        (corrupted(model__effects=["glow"]), "unknown effect 'glow'; known: dark_current"),
        (corrupted(model__effects=["second_order_photoreceptor"]), "photoreceptor kind"),
        ({"model": {"name": "m", "effects": ["leak", "leak"]}}, "effects listed twice: leak"),
        (corrupted(model__effects="leak"), "effects"),
        (corrupted(model__effects=7), "effects"),
        (corrupted(parameters__alpha="large"), "alpha: expected a number or a table, found 'large'"),
        (corrupted(parameters__alpha={"value": "large"}), r"alpha\.value: expected a number"),
        (corrupted(parameters__alpha={"value": True}), r"alpha\.value: expected a number"),
        (corrupted(parameters__alpha=-1.0), "outside its bounds"),
        (corrupted(parameters__alpha=math.nan), "must be finite"),
        (corrupted(parameters__alpha={"valeu": 1.0}), "unknown keys valeu"),
        (corrupted(parameters__alpha={"prior": {"mean": 1.0}}), "prior must be"),
        (corrupted(parameters__alpha={"prior": {"mean": 1.0, "sd": -1.0}}), "sd > 0"),
        (corrupted(parameters__alpha={"free": "yes"}), "free"),
        (corrupted(parameters__mu=1.0), "'mu' belongs to no effect"),
        (corrupted(**{"parameters__leak.rate_hz": 0.1}), r"'leak\.rate_hz' belongs to no effect"),
        ({**corrupted(), "parameters": 3}, "parameters"),
        (corrupted(physical__C_mil=1.0), "unknown names C_mil"),
        (corrupted(physical__q_in="small"), "needs the numbers"),
        ({**corrupted(), "physical": {"q_in": 1.0}}, "needs the numbers"),
        ({**corrupted(), "physical": 3}, "physical"),
        (corrupted(gauge__q_out=1.0), "unknown name 'q_out'"),
        ({**corrupted(), "gauge": 3}, "gauge"),
    ],
)
def test_a_broken_document_is_refused_in_one_line(document, says):
    with pytest.raises(InputError, match=says) as refusal:
        from_document(document)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("content", [b"", b"[model", b"\xff\xfe\x00", b"name = 1"])
def test_a_broken_file_is_refused_by_name(content, tmp_path):
    (tmp_path / "m.toml").write_bytes(content)
    with pytest.raises(InputError, match=r"m\.toml: ") as refusal:
        load_model(tmp_path / "m.toml")
    assert "\n" not in str(refusal.value)
    with pytest.raises(InputError, match=r"absent\.toml: cannot be read"):
        load_model(tmp_path / "absent.toml")


# --- effects ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", LIBRARY)
def test_every_effect_is_described(name):
    effect = LIBRARY[name]
    assert effect.name == name
    assert effect.sentence.endswith(".")
    assert effect.equation
    assert effect.source
    assert effect.stage in {stage.__name__.rpartition(".")[2] for stage in stages.STAGES}
    assert effect.parameters


@pytest.mark.parametrize("name", LIBRARY)
def test_an_effect_changes_the_circuit_and_comes_off_without_a_trace(name, dvs128):
    bare = dvs128.without_effect(name)
    assert not bare.has(name)
    assert bare.without_effect(name) is bare
    full = bare.with_effect(name)
    assert full.has(name)
    assert full.circuit() != bare.circuit()
    assert full.without_effect(name).circuit() == bare.circuit()
    assert full.without_effect(name) == bare
    assert set(full.values) - set(bare.values) <= {p.name for p in LIBRARY[name].parameters}
    assert not {p.name for p in LIBRARY[name].parameters} & set(bare.values)


@pytest.mark.parametrize("name", LIBRARY)
def test_an_effect_takes_values_by_full_and_by_short_name(name, dvs128):
    p = LIBRARY[name].parameters[0]
    value = min(1.1 * p.value, p.upper)
    long = dvs128.with_effect(name, {p.name: value})
    assert long.values[p.name] == value
    if "." in p.name:
        assert dvs128.with_effect(name, {p.name.partition(".")[2]: value}) == long
    assert long.with_effect(name, {p.name: p.value}).values[p.name] == p.value
    with pytest.raises(InputError, match=f"effect {name} has no parameter 'sauce'; it has"):
        dvs128.with_effect(name, {"sauce": 1.0})


@pytest.mark.parametrize("method", ["with_effect", "without_effect", "has"])
def test_an_unknown_effect_lists_the_known_ones(method, dvs128):
    with pytest.raises(InputError, match="unknown effect 'leek'") as refusal:
        getattr(dvs128, method)("leek")
    for name in LIBRARY:
        assert name in str(refusal.value)


def test_going_to_low_light_keeps_the_pole(dvs128):
    low = dvs128.without_effect("second_order_photoreceptor")
    assert low.photoreceptor == "one_pole"
    assert low.values["alpha_over_beta"] == pytest.approx(find_model("dvs128_low_light").values["alpha_over_beta"])
    assert low.effects == dvs128.effects


def test_neutral_strength_is_the_base_circuit():
    circuit = find_model("ideal").circuit()
    assert circuit == Circuit(photoreceptor="unlimited", on_threshold=0.25, off_threshold=0.25)


# --- values -----------------------------------------------------------------------------------------------------


def test_a_model_never_changes(dvs128):
    before = dvs128.values
    dvs128.set({"alpha": 1e5})
    dvs128.with_effect("leak")
    dvs128.without_effect("refractory_period")
    dvs128.fix({"beta": 1000.0})
    assert dvs128.values == before
    with pytest.raises(FrozenInstanceError):
        dvs128.name = "other"  # type: ignore[misc]


def test_set_fix_release(dvs128):
    model = dvs128.set({"alpha": 7e4}).fix({"beta": 2000.0, "gamma": None})
    assert (model.values["alpha"], model.values["beta"]) == (7e4, 2000.0)
    assert set(dvs128.free) - set(model.free) == {"beta", "gamma"}
    assert model.release(["beta", "gamma"]).free == dvs128.free
    with pytest.raises(InputError, match=r"has no parameter 'leak\.rate_hz'; it has alpha"):
        dvs128.set({"leak.rate_hz": 1.0})
    with pytest.raises(InputError, match="outside its bounds"):
        dvs128.set({"on_threshold": -0.1})


def test_numbers_in_another_unit_of_light(dvs128):
    """The numbers stay; what was learned per fA is no prior of a number per lux."""
    dark = dvs128.with_effect("dark_current").set({"dark_current.radiance": 2.0})
    told = {name: replace(p, prior=Prior(0.0, 1.0)) for name, p in dark.parameters.items()}
    model = replace(dark, parameters=told).with_radiance_in("lux")
    assert model.radiance_unit == "lux"
    assert model.values == dark.values
    assert [model.parameter(name).unit for name in ("alpha", "gamma")] == ["1/s²/lux", "1/s/lux"]
    lost = {name for name, p in model.parameters.items() if p.prior is None}
    assert lost == {"alpha", "gamma", "dark_current.radiance"}
    assert replace(model, radiance_unit="W/m²").with_radiance_in("W/m2").parameters == model.parameters
    unsaid = replace(model, radiance_unit="radiance").with_radiance_in("lux")
    assert unsaid.parameters == model.parameters
    assert unsaid.radiance_unit == "lux"


def test_parameters_and_effects_must_match(dvs128):
    surplus = {**dvs128.parameters, "leak.rate_hz": LIBRARY["leak"].parameters[0]}
    with pytest.raises(InputError, match=r"parameters without their effect: leak\.rate_hz"):
        replace(dvs128, parameters=surplus)
    missing = {name: p for name, p in dvs128.parameters.items() if name != "refractory_s"}
    with pytest.raises(InputError, match="missing parameters refractory_s"):
        replace(dvs128, parameters=missing)


def test_complex_values_reach_the_circuit(dvs128):
    circuit = dvs128.circuit({"alpha": complex(6e4, 1e-20), "diff_cutoff_hz": complex(16e3, 1e-20)})
    assert circuit.alpha.imag == 1e-20
    assert circuit.differencing.imag == pytest.approx(2 * math.pi * 1e-20)


def test_a_model_in_one_recording_keeps_how_far_its_clock_may_be_off():
    """An alignment known to tens of milliseconds widens the bounds of a delay beyond the usual ones."""
    from dataclasses import replace

    from pixelid.model.model import CLOCK_DELAY

    wide = replace(CLOCK_DELAY, name="alignment.delay_s[slow]", lower=-0.1, upper=0.1, value=-0.03)
    model = replace(find_model("dvs128"), nuisances={wide.name: wide})
    assert model.in_recording("slow").circuit().delay == pytest.approx(-0.03)


def test_a_model_is_saved_whole_and_never_over_another(tmp_path):
    model = find_model("dvs128").with_effect("leak", rate_hz=2.0)
    path = model.save(tmp_path / "mine.toml")
    assert find_model(path) == model
    with pytest.raises(InputError, match="exists already"):
        model.without_effect("leak").save(path)
    assert find_model(path) == model
