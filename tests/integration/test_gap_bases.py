"""The whole search from every shipped model as base: no structure of a pixel makes it stumble."""

import re
from dataclasses import replace

import pytest

from pixelid.fit.again import can_be_simulated
from pixelid.gap.attribute.candidates import impossible, missing, remove_effect, variants
from pixelid.gap.gap import gap
from pixelid.gap.result import VERDICTS
from pixelid.model.shipped import find_model
from pixelid.simulate import simulate
from pixelid.stages import LIBRARY
from pixelid.stimuli.resample import resampled
from pixelid.stimuli.shapes import chirp, steps

SHIPPED = ("dvs128", "dvs128_low_light", "photoreceptor", "ideal")
ADDED = (
    "",
    "bandwidth_floor",
    "polarity_memory",
    "linear_log",
    "lost_events",
    "dead_time_without_reset",
    "mains_flicker",
)
NOT_TRIED = {
    "light_spread", "shot_noise", "hot_pixels", "readout_latency", "shared_readout", "timestamp_quantisation",
}  # fmt: skip
FAST = [
    ("dvs128", "", ""), ("dvs128_low_light", "bandwidth_floor", ""), ("ideal", "", "leak"),
    ("ideal", "dead_time_without_reset", ""),
]  # fmt: skip
PLANTED = (
    "", "leak", "polarity_memory", "bandwidth_floor", "second_order_photoreceptor", "linear_log", "lost_events",
    "dead_time_without_reset",
)  # fmt: skip

BLURRED = {
    "timestamp_quantisation": {"tick_s": 1e-4}, "timestamp_jitter": {"sigma_s": 1e-4},
    "readout_latency": {"service_s": 1e-4},
}  # fmt: skip


def base_model(name, added=""):
    model = find_model(name)
    if "threshold_noise" not in model.effects:
        model = model.with_effect("threshold_noise")
    return model.with_effect(added) if added else model


def possible(name, effect):
    base = base_model(name)
    return not effect or base.has(effect) or effect in missing(base)


def tiny_session(model):
    """Two short recordings of 2 × 2 pixels."""
    found = []
    for i, light in enumerate((chirp(60.0, stop_hz=60.0, duration_s=0.5), steps(60.0, seed=1, duration_s=0.4))):
        r = simulate(model, resampled(light, "smooth"), width=2, height=2, seed=i, sensor_seed=3)
        found.append(replace(r, stimulus=light, condition=f"part_{i}", attributes={}))
    return found


def search(name, added, planted):
    """The report on sessions of a camera that has one effect more than its base."""
    base = base_model(name, added)
    camera = base if not planted or base.has(planted) else base.with_effect(planted)
    if planted == "leak":
        camera = camera.set({"leak.rate_hz": 20.0})
    return base, gap(tiny_session(camera), base)


def check(base, report):
    assert report.verdict in VERDICTS
    assert report.seconds > 0
    first = next(entry for entry in report.rounds if entry["round"] == 1)
    for name in LIBRARY:
        if name not in NOT_TRIED and not base.has(name):
            told = [first["screened_nats"].get(name), first["skipped"].get(name)]
            assert sum(one is not None for one in told) == 1, f"{name}: tried, or skipped with a reason"
    assert all(reason and not re.search(r"Error|Traceback", reason) for reason in first["skipped"].values())


@pytest.mark.parametrize(("name", "added", "planted"), FAST)
def test_the_search_goes_through(name, added, planted):
    check(*search(name, added, planted))


@pytest.mark.slow
@pytest.mark.parametrize("planted", PLANTED)
@pytest.mark.parametrize("added", ADDED)
@pytest.mark.parametrize("name", SHIPPED)
def test_the_search_goes_through_from_every_base(name, added, planted):
    if not possible(name, added) or not possible(name, planted):
        pytest.skip("this photoreceptor cannot have it")
    check(*search(name, added, planted))


def behind_blurred_times(name, effect):
    """The report on a camera that lacks a leak too."""
    base = base_model(name)
    camera = base.with_effect("leak").set({"leak.rate_hz": 20.0}).with_effect(effect, BLURRED[effect])
    return gap(tiny_session(camera), base)


def test_a_leak_behind_a_tick_is_named_where_the_base_has_no_pole():
    report = behind_blurred_times("ideal", "timestamp_quantisation")
    assert [found.name for found in report.effects] == ["timestamp_quantisation", "leak"]


@pytest.mark.slow
@pytest.mark.parametrize("effect", BLURRED)
@pytest.mark.parametrize("name", SHIPPED)
def test_the_search_goes_through_behind_blurred_times(name, effect):
    report = behind_blurred_times(name, effect)
    assert report.verdict in VERDICTS
    assert {found.name for found in report.effects} <= {effect, "leak"}


@pytest.mark.parametrize("name", SHIPPED)
def test_every_effect_tried_makes_a_model_and_can_be_taken_back(name):
    base = base_model(name)
    for effect in missing(base):
        trials = list(variants(base, effect))
        assert trials
        for trial in trials:
            trial.circuit()
        back = remove_effect(trials[0], effect, base)
        assert (back.photoreceptor, back.effects) == (base.photoreceptor, base.effects)
    assert not set(impossible(base)) & set(missing(base))


def test_shot_noise_is_looked_for_where_a_bandwidth_limits_it():
    recordings = tiny_session(base_model("ideal"))
    for name in SHIPPED:
        assert can_be_simulated(recordings, base_model(name)) == (name != "ideal")
    assert can_be_simulated(recordings, base_model("ideal", "source_follower_pole"))
    ran_away = base_model("dvs128").set({"alpha": 1e15, "beta": 1e9})
    assert not can_be_simulated(recordings, ran_away)


def test_an_impossible_effect_is_skipped_with_its_reason():
    assert "'unlimited'" in impossible(base_model("ideal"))["bandwidth_floor"]
    assert "bandwidth_floor" in missing(base_model("dvs128"))
    assert "second_order_photoreceptor" in missing(base_model("ideal"))
