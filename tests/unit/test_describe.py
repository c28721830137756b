"""Descriptions of what no effect explains: scores, candidates, and a search that ends in one."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from pixelid.fit.maximise import maximise
from pixelid.gap.describe import describe as describing
from pixelid.gap.describe.cells import beginnings, covariates
from pixelid.gap.describe.screen import screened
from pixelid.gap.gap import gap
from pixelid.gap.options import Context, Options
from pixelid.gap.result import GapReport
from pixelid.gap.state import Hypothesis
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.shipped import find_model
from pixelid.simulate import simulate
from pixelid.stages.described import described
from pixelid.stimuli import shapes

CELL = "described.on_threshold.previous_polarity.constant"


@pytest.fixture(scope="module")
def likelihood():
    truth = find_model("dvs128").with_effect(CELL, {"strength": 0.02})
    light = shapes.chirp(60.0, duration_s=0.4)
    return EventTimes([simulate(truth, light, width=3, height=3, seed=4)])


def test_covariates_are_those_of_the_previous_events(likelihood):
    values = covariates(likelihood)
    (iv,) = likelihood.intervals
    stimulus = likelihood.recordings[0].stimulus
    light = np.exp(np.interp(iv.previous_s, stimulus.t, np.log(stimulus.radiance)))
    np.testing.assert_allclose(values["radiance"], light, rtol=1e-9)
    np.testing.assert_array_equal(values["previous_polarity"], iv.previous_sign)
    np.testing.assert_allclose(values["time_since_event"], iv.time_s - iv.previous_s)
    slope = np.diff(np.log(stimulus.radiance)) / np.diff(stimulus.t)
    k = np.searchsorted(stimulus.t, iv.previous_s, side="right") - 1
    inside = iv.previous_s + 2e-5 < stimulus.t[k + 1]
    np.testing.assert_allclose(values["speed"][inside], np.abs(slope[k])[inside], rtol=1e-3, atol=1e-3)


def test_the_score_promises_what_a_fit_of_a_weak_effect_gains(likelihood):
    base = maximise(likelihood, find_model("dvs128"), tolerance=1e-3, max_steps=40)
    starts = [(own, start) for own, start in beginnings(covariates(likelihood), base.model) if own.name == CELL]
    (one,) = screened(likelihood, base, starts)
    end = maximise(likelihood, one.start, tolerance=1e-3, max_steps=40)
    assert one.gain == pytest.approx(end.value - base.value, rel=0.15)
    assert one.start.values[f"{CELL}.strength"] == pytest.approx(end.values[f"{CELL}.strength"], rel=0.15)
    index = end.coordinates.names.index(f"{CELL}.strength")
    error = np.sqrt(np.linalg.inv(end.information)[index, index])
    assert abs(end.x[index] - 0.02) < 3.0 * error


def test_a_description_is_judged_by_the_share_of_unexplained_events_that_its_model_was(likelihood, monkeypatch):
    """At imputed times some events cannot be explained, whatever describes them."""
    base = maximise(likelihood, find_model("dvs128"), tolerance=0.1, max_steps=10)
    asked = []
    monkeypatch.setattr(describing, "diagnose", lambda *_, background_fraction, **__: asked.append(background_fraction))
    monkeypatch.setattr(describing, "maximise_with_restarts", lambda *_, **__: base)
    accepted = SimpleNamespace(own=described(CELL), end=SimpleNamespace(model=base.model.with_effect(CELL)))
    for allowed in (5e-3, None):
        seen = SimpleNamespace(allowed=allowed)
        before = Hypothesis((), SimpleNamespace(training=likelihood), base, seen, base.model)
        describing._with(before, before.evidence, accepted, Context(Options(), None, print))
    assert asked == [5e-3, None]


def test_a_model_is_not_offered_what_it_has_under_its_own_name(likelihood):
    plain = {own.name for own, _ in beginnings(covariates(likelihood), find_model("dvs128"))}
    leaking = {own.name for own, _ in beginnings(covariates(likelihood), find_model("dvs128").with_effect("leak"))}
    assert plain - leaking == {"described.leak.none.constant"}
    ideal = {own.quantity for own, _ in beginnings(covariates(likelihood), find_model("ideal"))}
    assert "rate" not in ideal
    with_one = find_model("dvs128").with_effect("described.on_threshold.time_since_event.relaxation")
    assert not any(".time_since_event." in own.name for own, _ in beginnings(covariates(likelihood), with_one))


def test_the_edge_of_a_step_is_found_between_those_that_are_screened():
    name, truth = "described.threshold.time_in_recording.step", find_model("dvs128")
    edge = 0.34  # nearly in the middle between two that are screened
    stepping = truth.with_effect(name, {"strength": 0.1, "edge": edge})
    made = EventTimes([simulate(stepping, shapes.chirp(60.0, duration_s=0.4), width=3, height=3, seed=4)])
    seen = covariates(made)
    base = maximise(made, truth, tolerance=0.1, max_steps=20)
    starts = [(own, start) for own, start in beginnings(seen, base.model) if own.name == name]
    one = screened(made, base, starts)[0]
    fitted = describing._Fit(base, None, made, made, seen, 1, 0.0)(one, None)
    assert abs(one.start.values[f"{name}.edge"] - edge) > 0.01
    times = np.sort(seen["time_in_recording"])
    k = np.searchsorted(times, edge)  # known to a few events: thresholds scatter by 4 %, and step by 10
    assert times[k - 4] < fitted.end.values[f"{name}.edge"] < times[k + 3]
    assert fitted.end.values[f"{name}.strength"] == pytest.approx(0.1, abs=0.02)


@pytest.mark.slow
def test_an_effect_left_out_of_the_library_is_described(tmp_path):
    from gap_certification import camera, planted, session

    model, base = planted("polarity_memory", 2.0, camera(6870))  # strong enough to show in counts
    report = gap(session(model, 6870), base, seed=6870, leave_out=("polarity_memory",), recommend=False)
    assert report.verdict == "unknown"
    assert report.remainder
    (found,) = report.described
    entry = found.as_dict()
    assert (entry["stage"], entry["quantity"], entry["covariate"]) == ("comparator", "threshold", "previous_polarity")
    value, (low, high) = found.parameters["strength"]
    assert low < 0.1 < high
    assert value == pytest.approx(0.1, abs=0.005)
    assert found.closed is not None
    assert found.closed > 0.8
    assert found.effect in report.model.effects
    report.save(tmp_path / "gap")
    again = GapReport.load(tmp_path / "gap")
    assert again.described == report.described
    assert again.model.effects == report.model.effects
    written = json.loads((tmp_path / "gap" / "gap.json").read_text())["described"][0]
    assert set(written) == {
        "stage", "quantity", "covariate", "form", "equation", "parameters", "heldout_gain_nats", "closed_fraction",
    }  # fmt: skip


@pytest.mark.slow
def test_a_description_takes_the_place_of_neighbours_that_were_named():
    from gap_certification import camera, planted, session

    model, base = planted("bandwidth_floor", 1.0, camera(6750))
    report = gap(session(model, 6750), base, seed=6750, leave_out=("bandwidth_floor",), recommend=False)
    assert report.verdict == "unknown"
    assert [named.name for named in report.effects] == []
    assert "dark_current" in report.details["withdrawn"]
    (found,) = report.described
    entry = found.as_dict()
    assert (entry["stage"], entry["quantity"], entry["covariate"]) == ("photoreceptor", "rate", "radiance")
    strength, reference, exponent = (found.parameters[key][0] for key in ("strength", "reference", "exponent"))
    assert exponent == pytest.approx(-1.0, abs=0.05)
    assert strength * reference == pytest.approx(model.values["bandwidth_floor.radiance"], rel=0.05)
    assert report.details["remaining_p"] > 0.005
    taken_back = [one["withdrawn"] for one in report.rounds if one.get("withdrawn")]
    assert taken_back == ["a description explains better what it did"] * len(taken_back)


@pytest.mark.parametrize(("strength", "after_on_s", "after_off_s"), [(1.27e-4, 2.07e-4, 0.0), (-1.27e-4, 0.0, 2.07e-4)])
def test_a_dead_time_below_zero_is_taken_back_to_zero(strength, after_on_s, after_off_s):
    name = "described.dead_time.previous_polarity.constant"
    model = find_model("dvs128").set({"refractory_s": 8e-5}).with_effect(name, {"strength": strength})
    end = describing._with_dead_time_at_zero(described(name), model)
    assert end is not None
    dead, longer = end.values["refractory_s"], end.values[f"{name}.strength"]
    assert dead + longer == pytest.approx(after_on_s, abs=3e-7)
    assert dead - longer == pytest.approx(after_off_s, abs=3e-7)
    assert min(dead + longer, dead - longer) > 0  # where a fit can move either way
    assert describing._with_dead_time_at_zero(described(name), end) is None
    assert describing._with_dead_time_at_zero(described("described.dead_time.none.constant"), model) is None


@pytest.mark.parametrize(("scale", "constant"), [(0.3, False), (3.0, True)])
def test_what_no_event_sees_fade_is_a_constant(likelihood, monkeypatch, scale, constant):
    own = described("described.on_threshold.time_since_event.relaxation")
    base = find_model("dvs128")
    end = SimpleNamespace(model=base.with_effect(own.name, {"strength": 0.05, "scale": scale}), value=500.0)
    monkeypatch.setattr(describing, "per_pixel", lambda *_: np.zeros(9))
    worse = SimpleNamespace(model=base, value=0.0)
    monkeypatch.setattr(describing, "maximise", lambda _, model, **__: end if model.has(own.name) else worse)
    fit = describing._Fit(worse, None, likelihood, likelihood, {own.covariate: 1.0}, 100, 4.0)
    p = fit(SimpleNamespace(own=own, start=end.model), None).p
    assert (p == 1.0) == constant
    assert constant or p < 1e-6


def a_candidate(worth, name=CELL):
    """A description that gains so much more than its parameters cost."""
    return SimpleNamespace(own=described(name), worth=worth, held_out=np.array([worth, worth]), p=1e-9, penalty=4.0,
                           judged=np.array([worth]), as_dict=dict)  # fmt: skip


@pytest.mark.parametrize(
    ("worths", "flexible", "left", "found"),
    [
        ([30.0], [20.0], [1.0], 1),  # as much as the flexible term, and nothing is left
        ([30.0, 8.0], [20.0, 5.0], [0.0, 1.0], 2),
        ([30.0, 3.0], [20.0, 5.0], [0.0, 1.0], 1),  # a second one that gains less than the term is not kept
        ([15.0, 8.0], [20.0, 9.0], [0.0, 1.0], 2),  # together more than the term at first
        ([15.0, 4.0], [20.0, 9.0], [0.0, 1.0], 0),
        ([-1.0], [0.0], [0.0], 0),
    ],
)
def test_descriptions_gain_what_a_flexible_term_does_one_by_one_or_both(monkeypatch, worths, flexible, left, found):
    turns = iter(range(2))
    monkeypatch.setattr(describing, "_promises", lambda *_: None)
    monkeypatch.setattr(
        describing, "_candidates",
        lambda *_: describing._Looked([a_candidate(worths[(turn := next(turns))])], {}, np.zeros(1) + turn, 2.0),
    )  # fmt: skip
    terms = iter(flexible)
    monkeypatch.setattr(
        describing, "flexible_alternative", lambda *_: SimpleNamespace(held_out=np.array([next(terms)]))
    )
    after = iter(left)

    def at(p):
        evidence = SimpleNamespace(weighed=lambda circuit: None)
        fit = SimpleNamespace(model=SimpleNamespace(circuit=lambda: None))
        return SimpleNamespace(evidence=evidence, fit=fit, seen=SimpleNamespace(p=p))

    monkeypatch.setattr(describing, "_with", lambda *_: at(next(after)))
    ended = describing.describe(at(0.0), Context(Options()))
    assert len(ended.found) == found
    assert [told["described"] for told in ended.tried].count(CELL) == found
    assert ended.price == 4.0 * found
    assert ended.judged == pytest.approx(worths[found - 1] if found else 0.0)


@pytest.mark.parametrize(("gain", "held_out", "better"), [(5.0, 3.0, True), (5.0, 1e4, False), (1e4, 3.0, False)])
def test_a_description_stands_against_an_effect_by_what_it_gains(gain, held_out, better):
    truth = find_model("dvs128").with_effect(CELL, {"strength": 0.1})
    light = shapes.chirp(60.0, duration_s=0.4)
    fitting, judging = (EventTimes([simulate(truth, light, width=3, height=3, seed=s)]) for s in (5, 6))
    evidence = SimpleNamespace(fitting=fitting, judging=judging)
    base = maximise(fitting, find_model("dvs128"), tolerance=1e-3, max_steps=40)
    rival = SimpleNamespace(gain=gain, heldout_gain=held_out)
    assert describing.describes_better(evidence, base, rival, None, Context(Options())) is better
