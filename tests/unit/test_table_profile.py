"""Fits of small tables: scatter that counts what was fitted, and errors that follow a skewed profile."""

from dataclasses import dataclass

import numpy as np
import pytest

from pixelid.parameters.parameter import Parameter, Prior
from pixelid.tables.fit import covariance_at, fit_table, log_posterior_at
from pixelid.tables.model import Rows
from pixelid.tables.profile import FALL, follow_profile


@dataclass(frozen=True)
class Charging:
    """measured = swing (1 − exp(−t / time)) at t well below the time: swing over time shows, each alone hardly."""

    rows: Rows
    prior: Prior | None = None
    nuisances: frozenset[str] = frozenset()
    neutral_bounds: tuple[tuple[str, str], ...] = ()

    @property
    def parameters(self):
        return (
            Parameter("swing", 2.0, "1", 1e-2, 1e3, "log", prior=self.prior),
            Parameter("time", 2.0, "s", 1e-2, 1e3, "log"),
        )

    def dependence(self):
        return [np.full(len(self.rows.measured), k) for k in range(2)]

    def predict(self, x):
        return np.exp(x[0]) * -np.expm1(-np.array(self.rows.columns["t"]) / np.exp(x[1]))


def table(seed: int, longest: float = 0.4, scatter: float = 0.04) -> Charging:
    """Errors of the fit's own law, Student's t with 4 degrees of freedom."""
    t = np.linspace(0.05, longest, 24)
    measured = 1.5 * -np.expm1(-t) * np.exp(scatter * np.random.default_rng(seed).standard_t(4, len(t)))
    return Charging(Rows(measured, 1e-9, columns={"t": t.tolist()}), Prior(np.log(3.0), 1.0))


def test_rounding_is_the_error_of_what_a_table_writes():
    """Of values rounded to hundredths, and one of which nothing is left."""
    true = np.random.default_rng(0).uniform(2.0, 2.2, 100_000)
    rows = Rows(np.round(true, 2), 0.01, relative_error=0.03)
    assert np.std(rows.log_ratio(true)) == pytest.approx(float(rows.rounding.mean()), rel=0.01)
    np.testing.assert_allclose(rows.known_variance, rows.rounding**2 + 0.03**2)
    assert Rows(np.zeros(1), 0.01).log_ratio(np.array([0.01])) == pytest.approx(-np.log(2.0))


def test_an_error_reaches_as_far_as_the_profile():
    """Against a scan of the profile, every place with a fit of its own by another routine."""
    from scipy.optimize import minimize_scalar

    model = table(1)
    fit = fit_table(model)
    wide = follow_profile(fit, "swing")
    assert wide.sd[0] > 1.1 * fit.sd[0]
    top = log_posterior_at(fit, fit.x)

    def fallen(swing: float) -> float:
        best = minimize_scalar(
            lambda time: -log_posterior_at(fit, np.array([swing, time])), bounds=(-4.0, 6.0), method="bounded",
            options={"xatol": 1e-9},
        )  # fmt: skip
        return top + float(best.fun)

    scan = [next(d for d in np.linspace(0.0, 5.0, 2001) if fallen(fit.x[0] + s * d) > FALL) for s in (-1, 1)]
    assert wide.sd[0] * 1.96 == pytest.approx(max(scan), rel=0.06)
    np.testing.assert_allclose(np.sqrt(np.diag(covariance_at(wide))), wide.sd, rtol=1e-6)
    # the other goes with it: their ratio is known as before
    ratio = np.array([1.0, -1.0])
    assert ratio @ covariance_at(wide) @ ratio < 1.5 * (ratio @ covariance_at(fit) @ ratio) + 0.3 * wide.sd[0] ** 2


def test_a_known_parameter_keeps_its_error():
    fit = fit_table(table(2, longest=5.0, scatter=0.01))
    assert fit.sd[0] < 0.1
    assert follow_profile(fit, "swing") is fit


def test_scatter_counts_what_was_fitted():
    """Four rows and two parameters: half of the scatter is fitted away, and given back."""
    found = []
    for seed in range(200):
        t = np.array([0.3, 1.0, 2.0, 4.0])
        rng = np.random.default_rng(seed)
        measured = 1.5 * -np.expm1(-t) * np.exp(0.05 * rng.standard_normal(4))
        found.append(fit_table(Charging(Rows(measured, 1e-9, columns={"t": t.tolist()}))).scale)
    # Student's scale of normal errors is some 0.85 of their deviation; without the correction it is 0.6
    assert 0.035 < np.sqrt(np.mean(np.square(found))) < 0.06


def test_intervals_of_a_skewed_parameter_cover():
    covered = []
    for seed in range(100):
        wide = follow_profile(fit_table(table(seed)), "swing")
        low, high = wide.as_dict()["swing"]["interval_95"]
        covered.append(low < 1.5 < high)
    assert np.mean(covered) >= 0.93
