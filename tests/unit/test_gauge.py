"""Gauges: three statements make the circuit unique; fewer leave flat directions, more contradict or repeat."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pixelid.errors import InputError
from pixelid.model.shipped import find_model, shipped_models
from pixelid.parameters.gauge import Gauge
from pixelid.parameters.invariants import PHYSICAL_NAMES, Physical
from pixelid.stages.photoreceptor import NOMINAL

COMPLETE = [
    {"q_in": 0.875, "A_loop": "0.7 A_amp", "q_mil": 0.015},
    {"q_in": 0.875, "A_loop": "0.7 A_amp", "radiance_scale": 1.0},
    {"A_amp": 140, "tau_out": 1815e-6, "radiance_scale": 1.0},
    {"A_amp": 140, "A_loop": 98, "q_in": 0.875},
    {"q_in": "58.33333333333333 q_mil", "A_amp": 140, "radiance_scale": 1},
]


def logs(physical: Physical) -> np.ndarray:
    return np.log([physical.as_dict()[name] for name in PHYSICAL_NAMES])


def powers(sentence: str) -> np.ndarray:
    """The direction a sentence names: 'scaling tau_out × k together with q_in × k^-1 …' → one exponent per value."""
    direction = np.zeros(len(PHYSICAL_NAMES))
    terms = sentence.removeprefix("scaling ").removesuffix(" changes no event").replace(" together with ", ", ")
    for term in terms.split(", "):
        name, power = term.split(" × k")
        direction[PHYSICAL_NAMES.index(name)] = float(power.removeprefix("^") or 1)
    return direction


@pytest.mark.parametrize("statements", COMPLETE, ids=lambda s: " ".join(s))
def test_a_complete_gauge_gives_the_circuit_back(statements):
    start = Physical(*(np.exp(logs(NOMINAL)) * [1.5, 0.6, 1.4, 0.7, 1.3, 0.8]))
    physical = Gauge.parse(statements).physical(*NOMINAL.invariants(), around=start)
    np.testing.assert_allclose(logs(physical), logs(NOMINAL), atol=1e-7)


@given(st.lists(st.floats(0.2, 5.0), min_size=6, max_size=6))
@settings(deadline=None, max_examples=40)
def test_round_trip_of_any_circuit(factors):
    truth = Physical(*(np.exp(logs(NOMINAL)) * factors))
    gauge = Gauge(
        fixed={"q_in": truth.q_in, "q_mil": truth.q_mil}, ratios={"A_loop": (truth.A_loop / truth.A_amp, "A_amp")}
    )
    physical = gauge.physical(*truth.invariants(), around=NOMINAL)
    np.testing.assert_allclose(logs(physical), logs(truth), atol=1e-6)


def test_the_choice_of_the_paper_leaves_exactly_two_flat_directions():
    flat = Gauge.parse({"q_in": 0.875}).flat_directions(NOMINAL)
    assert len(flat) == 2
    assert np.linalg.matrix_rank([powers(sentence) for sentence in flat]) == 2
    assert len(Gauge().flat_directions(NOMINAL)) == 3


@pytest.mark.parametrize("statements", [{}, {"q_in": 0.875}, {"A_loop": "0.7 A_amp"}, {"q_in": 0.875, "A_amp": 140}])
def test_moving_along_a_flat_direction_changes_no_invariant(statements):
    gauge = Gauge.parse(statements)
    flat = gauge.flat_directions(NOMINAL)
    assert len(flat) == 3 - len(statements)
    for sentence in flat:
        direction, step = powers(sentence), 1e-4
        moved = [Physical(*np.exp(logs(NOMINAL) + sign * step * direction)) for sign in (1, -1)]
        change = np.log(moved[0].invariants()) - np.log(moved[1].invariants())
        assert np.abs(direction).max() >= 1
        # the sentence rounds its exponents to three digits
        np.testing.assert_allclose(change / (2 * step), 0, atol=5e-3 * np.abs(direction).sum())
        for name, value in gauge.fixed.items():
            assert moved[0].as_dict()[name] == pytest.approx(value)
        for name, (factor, other) in gauge.ratios.items():
            values = moved[0].as_dict()
            assert values[name] / values[other] == pytest.approx(factor, rel=1e-6)


def test_a_whole_orbit_shares_its_invariants():
    gauge = Gauge.parse(COMPLETE[0])
    for q_mil in (0.001, 0.015, 0.02):
        other = Gauge({**gauge.fixed, "q_mil": q_mil}, gauge.ratios)
        physical = other.physical(*NOMINAL.invariants(), around=NOMINAL)
        np.testing.assert_allclose(physical.invariants(), NOMINAL.invariants(), rtol=1e-8)
        assert physical.q_mil == pytest.approx(q_mil)
        assert physical.A_loop == pytest.approx(0.7 * physical.A_amp)


@pytest.mark.parametrize(("statements", "count"), [({}, 3), ({"q_in": 0.875}, 2), ({"q_in": 0.875, "A_amp": 140}, 1)])
def test_an_incomplete_gauge_is_refused_with_its_flat_directions(statements, count):
    with pytest.raises(InputError, match="gauge: incomplete") as refusal:
        Gauge.parse(statements).check(NOMINAL)
    message = str(refusal.value)
    assert f"{count} direction" in message
    assert message.count("changes no event") == count
    assert "\n" not in message


@pytest.mark.parametrize(
    "statements",
    [
        {"q_in": 0.875, "A_loop": "0.7 A_amp", "q_mil": 0.015, "A_amp": 140},
        {"q_in": 0.875, "q_mil": 0.015, "radiance_scale": 1.0},  # γ fixes the scale once q is known
        {"q_in": 0.875, "q_mil": 0.015, "radiance_scale": 1.0, "A_amp": 140},
        {"A_loop": "0.7 A_amp", "A_amp": "1.4285714 A_loop", "q_in": 0.875},
        {"A_loop": 98, "tau_out": 1815e-6, "q_in": 0.875},  # α / γ ties A_loop to τ_out
    ],
)
def test_an_over_determined_gauge_is_refused(statements):
    with pytest.raises(InputError, match="gauge: over-determined by 1") as refusal:
        Gauge.parse(statements).check(NOMINAL)
    for name in statements:
        assert name in str(refusal.value)


def test_ratio_relations_are_read_and_written():
    gauge = Gauge.parse({"A_loop": "0.7 A_amp", "q_in": "2e1*q_mil"})
    assert gauge.ratios == {"A_loop": (0.7, "A_amp"), "q_in": (20.0, "q_mil")}
    assert Gauge.parse(gauge.statements()) == gauge


@pytest.mark.parametrize(
    ("statements", "says"),
    [
        ({"q_out": 1.0}, "unknown name 'q_out'; known: A_amp"),
        ({"q_in": "big"}, "neither a number nor a ratio"),
        ({"q_in": "0.7 q_in"}, "neither a number nor a ratio"),
        ({"q_in": "0.7 gain"}, "neither a number nor a ratio"),
        ({"q_in": "1.2.3 q_mil"}, "neither a number nor a ratio"),
        ({"q_in": "e q_mil"}, "neither a number nor a ratio"),
        ({"q_in": [1, 2]}, "neither a number nor a ratio"),
        ({"q_in": True}, "neither a number nor a ratio"),
        ({"q_in": -0.875}, "positive and finite"),
        ({"q_in": 0}, "positive and finite"),
        ({"q_in": "nan"}, "positive and finite"),
        ({"q_in": "inf"}, "positive and finite"),
        ({"A_loop": "-0.7 A_amp"}, "positive and finite"),
    ],
)
def test_nonsense_is_refused_in_one_line(statements, says):
    with pytest.raises(InputError, match=says) as refusal:
        Gauge.parse(statements)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    "statements",
    [
        # (q_in + (A_amp + 1) q_mil) / q > 1 while β = that / τ_out: τ_out > 1/β = 540 µs
        {"tau_out": 1e-5, "q_in": 0.875, "A_amp": 140},
        # A_amp = q (1 − βγ/α) / (0.7 βγ q/α − q_mil) turns negative near q_mil = 0.021
        {"q_in": 0.875, "A_loop": "0.7 A_amp", "q_mil": 0.2},
    ],
)
def test_a_gauge_without_a_positive_solution_is_refused(statements):
    with pytest.raises(InputError, match="no positive circuit values"):
        Gauge.parse(statements).physical(*NOMINAL.invariants(), around=NOMINAL)


@pytest.mark.parametrize("name", sorted(shipped_models()))
def test_shipped_gauges_are_complete(name):
    model = find_model(name)
    if model.gauge.statements():
        model.gauge.check(model.physical or NOMINAL)
