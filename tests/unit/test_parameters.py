"""Parameters: coordinates, bounds, priors, and the invariants of the photoreceptor."""

import math
from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm

from pixelid import stages
from pixelid.errors import InputError
from pixelid.fit.coordinates import Coordinates
from pixelid.model.shipped import find_model, shipped_models
from pixelid.parameters.invariants import PHYSICAL_NAMES, Physical, log_jacobian
from pixelid.parameters.parameter import Parameter, Prior
from pixelid.stages.photoreceptor import NOMINAL

LIBRARY_PARAMETERS = [p for effect in stages.LIBRARY.values() for p in effect.parameters]
POSITIVE = st.floats(1e-3, 1e3)


def cutoff(**changes) -> Parameter:
    return Parameter(
        **{"name": "f", "value": 10.0, "unit": "Hz", "lower": 1.0, "upper": 100.0, "transform": "log"} | changes
    )


@given(st.floats(1e-300, 1e300))
def test_log_coordinate_there_and_back(value):
    p = Parameter("a", 1.0, lower=1e-308, transform="log")
    assert p.from_coordinate(p.to_coordinate(value)) == pytest.approx(value, rel=1e-12)


def test_linear_coordinate_is_the_value():
    p = Parameter("delay_s", -0.5, lower=-1, upper=1)
    assert p.to_coordinate(-0.5) == -0.5
    assert p.from_coordinate(-0.5) == -0.5
    assert p.coordinate_bounds() == (-1, 1)


@pytest.mark.parametrize("transform", ["log", "linear"])
def test_a_complex_step_differentiates_the_coordinate(transform):
    p = cutoff(transform=transform)
    slope = p.from_coordinate(complex(0.7, 1e-30)).imag / 1e-30
    assert slope == pytest.approx(math.exp(0.7) if transform == "log" else 1.0, rel=1e-14)


def test_coordinate_bounds():
    assert cutoff().coordinate_bounds() == pytest.approx((0.0, math.log(100.0)))
    assert cutoff(upper=math.inf).coordinate_bounds()[1] == math.inf


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"value": 0.5}, r"f: 0\.5 lies outside its bounds 1\.\.100"),
        ({"value": 101.0}, "outside its bounds"),
        ({"value": math.nan}, "must be finite"),
        ({"value": math.inf, "upper": math.inf}, "must be finite"),
        ({"lower": 0.0}, "lower bound above 0"),
        ({"lower": -1.0}, "lower bound above 0"),
        ({"lower": math.nan}, "lower bound above 0"),
        ({"lower": 20.0, "upper": 5.0}, "outside its bounds"),
        ({"transform": "logit"}, "transform must be 'log' or 'linear', found 'logit'"),
    ],
)
def test_nonsense_is_refused_by_name(changes, says):
    with pytest.raises(InputError, match=says):
        cutoff(**changes)


@pytest.mark.parametrize(("mean", "sd"), [(0, 0), (0, -1), (math.nan, 1), (math.inf, 1), (0, math.nan)])
def test_an_improper_prior_is_refused(mean, sd):
    with pytest.raises(InputError, match="prior"):
        Prior(mean, sd)


def test_a_prior_is_normal_in_the_fitting_coordinate():
    """Against SciPy's density, and its slope and curvature against differences."""
    model = find_model("dvs128")
    alpha = replace(model.parameters["alpha"], prior=Prior(11.0, 0.25))
    coordinates = Coordinates.of(replace(model, parameters=model.parameters | {"alpha": alpha}))
    k, x = coordinates.names.index("alpha"), coordinates.start
    values = [10.2, 11.0, 11.7]
    points = [np.where(np.arange(len(x)) == k, value, x) for value in values]
    expected = norm.logpdf(values, 11.0, 0.25) - norm.logpdf(11.0, 11.0, 0.25)
    np.testing.assert_allclose([coordinates.log_prior(point) for point in points], expected, rtol=1e-12)
    gradient, curvature = coordinates.prior_gradient_and_curvature(points[0])
    sides = norm.logpdf([10.2 + 1e-4, 10.2 - 1e-4], 11.0, 0.25)
    assert gradient[k] == pytest.approx((sides[0] - sides[1]) / 2e-4)
    assert curvature[k] == pytest.approx(1.0 / 0.25**2)
    assert not np.delete(gradient, k).any()


def test_changes_make_a_new_parameter():
    p = cutoff(prior=Prior(2.0, 0.5))
    assert (p.at(20).value, p.value) == (20.0, 10.0)
    assert p.at(20).prior == Prior(2.0, 0.5)
    assert (p.fixed().free, p.fixed().freed().free, p.free) == (False, True, True)
    with pytest.raises(FrozenInstanceError):
        p.value = 3.0  # type: ignore[misc]
    with pytest.raises(InputError, match="outside"):
        p.at(1000)


@pytest.mark.parametrize("p", LIBRARY_PARAMETERS, ids=lambda p: p.name)
def test_every_effect_documents_its_parameters(p):
    assert p.unit
    assert p.lower < p.value < p.upper
    assert math.isfinite(p.lower)
    assert math.isfinite(p.upper)


# --- invariants -------------------------------------------------------------------------------------------------


def physical(values) -> Physical:
    return Physical(**dict(zip(PHYSICAL_NAMES, values, strict=True)))


def test_dvs128_invariants_by_hand():
    alpha, beta, gamma = NOMINAL.invariants()
    assert alpha == pytest.approx(99 / (0.89 * 1815e-6), rel=1e-14)
    assert beta == pytest.approx((0.875 + 141 * 0.015) / (0.89 * 1815e-6), rel=1e-14)
    assert gamma == pytest.approx(1 / 0.89, rel=1e-14)
    assert beta**2 / alpha == pytest.approx(56.0, rel=5e-3)  # fA; complex poles from a quarter of it on


@given(st.lists(POSITIVE, min_size=6, max_size=6), POSITIVE)
def test_invariants_are_the_photoreceptor_at_every_radiance(values, recorded):
    p = physical(values)
    alpha, beta, gamma = p.invariants()
    light = p.radiance_scale * recorded
    tau_in, tau_mil = p.q_in / light, p.q_mil / light
    product = (tau_in + tau_mil) * p.tau_out
    assert alpha * recorded == pytest.approx((p.A_loop + 1) / product, rel=1e-12)
    damping = (tau_in + p.tau_out + (p.A_amp + 1) * tau_mil) / product
    assert beta + gamma * recorded == pytest.approx(damping, rel=1e-12)


@given(st.lists(POSITIVE, min_size=6, max_size=6))
def test_log_jacobian_against_finite_differences(values):
    logs, h = np.log(values), 1e-5

    def invariants(x):
        return np.log(physical(np.exp(x)).invariants())

    numeric = np.stack([(invariants(logs + h * e) - invariants(logs - h * e)) / (2 * h) for e in np.eye(6)], axis=1)
    np.testing.assert_allclose(log_jacobian(physical(values)), numeric, atol=1e-8)


def test_three_equations_for_six_values():
    assert np.linalg.matrix_rank(log_jacobian(NOMINAL)) == 3


NOMINAL_MODELS = [name for name in sorted(shipped_models()) if find_model(name).radiance_unit != "W/m2"]  # not fitted


@pytest.mark.parametrize("name", NOMINAL_MODELS)
def test_shipped_invariants_equal_their_physical_values(name):
    model = find_model(name)
    source = model.physical or NOMINAL
    for key, value in zip(("alpha", "beta", "gamma"), source.invariants(), strict=True):
        if key in model.parameters:
            assert model.values[key] == pytest.approx(value, rel=1e-12)
    if "alpha_over_beta" in model.parameters:
        alpha, beta, _ = source.invariants()
        assert model.values["alpha_over_beta"] == pytest.approx(alpha / beta, rel=1e-12)
