"""Fit a rate table: Student-t regression of log rates, so that one mistyped cell cannot steer the answer.

A table without counting errors says nothing about its own precision: the relative scatter is estimated from the
residuals,

    ln(observed + d) = ln(predicted + d) + s t_4,   s² = σ² + (d / √12 / (observed + d))²

with d the last digit written (so "no events" is a measurement: less than d) and t_4 Student's t with 4 degrees of
freedom,
fitted by EM (Lange, Little & Taylor 1989, JASA 84).  Cells beyond `SUSPECT` scales are named, and stay in the fit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from pixelid.parameters.parameter import Parameter

FREEDOM = 4.0
SUSPECT = 4.0
Z95 = 1.959963984540054
OPEN_SD = 0.5  # a log coordinate known no better than this is not identified (as in `fit.identifiability`)

Predict = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Regression:
    """A finished fit.  x: log parameters;  sd: their standard errors, inf where open;  limit: one-sided 95 % limits
    of those on a bound, in their unit, else NaN;  scale: σ;  predicted, residual,
    weight: (cells,) prediction, residual in scales, and weight 0…1 given to the cell;  log_likelihood;  converged
    """

    parameters: tuple[Parameter, ...]
    x: np.ndarray
    sd: np.ndarray
    limit: np.ndarray
    scale: float
    predicted: np.ndarray
    residual: np.ndarray
    weight: np.ndarray
    log_likelihood: float
    converged: bool

    def as_dict(self) -> dict:
        """Entries of the result's JSON, by parameter name."""
        found = {}
        for p, x, sd, limit in zip(self.parameters, self.x, self.sd, self.limit, strict=True):
            known = bool(np.isfinite(sd) and sd < OPEN_SD)
            low, high = p.lower, p.upper
            if np.isfinite(sd):
                low, high = np.exp(x - Z95 * sd), np.exp(min(x + Z95 * sd, 300.0))
            elif np.isfinite(limit):
                low, high = min(limit, np.exp(x)), max(limit, np.exp(x))
            found[p.name] = {
                "value": float(np.exp(x)),
                "unit": p.unit,
                "std": float(np.exp(x) * sd) if known else None,
                "interval_95": [max(float(low), p.lower), min(float(high), p.upper)],
                "identified": known,
            }
        return found


def regress(
    parameters: tuple[Parameter, ...],
    predict: Predict,
    observed: np.ndarray,
    digit: float,
    slots: Sequence[np.ndarray],
    known_sd: np.ndarray | float = 0.0,
    rounds: int = 80,
) -> Regression:
    """Fit `predict` (log parameters → (cells,)) to `observed` (cells,).

    slots: per kind of parameter, (cells,) which parameter of that kind a cell depends on: all parameters of a
    kind are then differentiated at once;  digit: d above;  known_sd: (cells,) relative errors the table itself gives,
    added to the scatter in quadrature.
    """
    from scipy.optimize import least_squares

    lower, upper = np.array([p.coordinate_bounds() for p in parameters]).T
    x = np.clip([p.to_coordinate(p.value) for p in parameters], lower + 1e-9, upper - 1e-9)
    target = np.log(observed + digit)
    fixed = (digit / np.sqrt(12.0) / (observed + digit)) ** 2 + np.asarray(known_sd) ** 2

    def gap(x: np.ndarray) -> np.ndarray:
        return target - np.log(predict(x) + digit)

    def slopes(x: np.ndarray) -> np.ndarray:
        J = np.zeros((len(target), len(x)))
        for slot in slots:
            step = np.zeros(len(x))
            step[slot] = 1e-5
            J[np.arange(len(target)), slot] += (gap(x + step) - gap(x - step)) / 2e-5
        return J

    r = gap(x)
    sigma, last, converged = max(1.48 * float(np.median(np.abs(r))), 0.02), -np.inf, False
    for _ in range(rounds):
        s = np.sqrt(sigma**2 + fixed)
        root = np.sqrt((FREEDOM + 1.0) / (FREEDOM + (r / s) ** 2)) / s
        found = least_squares(
            lambda z, root=root: root * gap(z),
            x,
            jac=lambda z, root=root: root[:, None] * slopes(z),  # pyright: ignore[reportArgumentType]
            bounds=(lower, upper),
            max_nfev=8,
        )
        x = found.x
        r = gap(x)
        sigma = _scatter(r, fixed, sigma)
        value = _log_likelihood(r, np.sqrt(sigma**2 + fixed))
        if abs(value - last) < 1e-4:
            converged = True
            break
        last = value
    value = _log_likelihood(r, np.sqrt(sigma**2 + fixed))
    sigma *= np.sqrt(len(r) / max(len(r) - len(x), 1))  # maximum likelihood forgets that x was fitted
    s = np.sqrt(sigma**2 + fixed)
    low, high = x < lower + 1e-3, x > upper - 1e-3
    # a parameter on a bound counts in its own unit (at its lower bound) or inverted (at its upper), where its effect
    # is linear: the others' errors then include it, and it gets a one-sided limit
    unit = np.where(low, np.exp(-x), np.where(high, np.exp(x), 1.0))
    J = slopes(x) / s[:, None] * np.sqrt((FREEDOM + 1.0) / (FREEDOM + 3.0)) * unit
    sd = _errors(J)
    limit = np.where(low, np.exp(x) + Z95 * sd, np.where(high, 1.0 / (np.exp(-x) + Z95 * sd), np.nan))
    sd = np.where(low | high, np.inf, sd)
    weight = (FREEDOM + 1.0) / (FREEDOM + (r / s) ** 2) / ((FREEDOM + 1.0) / FREEDOM)
    return Regression(parameters, x, sd, limit, sigma, predict(x), r / s, weight, value, converged)


def _errors(J: np.ndarray) -> np.ndarray:
    """Standard errors from a weighted Jacobian; directions the cells do not see come out as inf."""
    size = np.maximum(np.sqrt((J**2).sum(0)), 1e-300)
    values, vectors = np.linalg.eigh((J / size).T @ (J / size))
    floor = 1e-10 * values.max()
    variance = (vectors**2 / np.maximum(values, floor)).sum(1)
    blind = (vectors**2 * (values < floor)).sum(1) > 1e-6
    return np.where(blind | (size <= 1e-12), np.inf, np.sqrt(variance) / size)


def _scatter(r: np.ndarray, fixed: np.ndarray, sigma: float) -> float:
    """σ that maximises the t likelihood of residuals r, given the known variances."""
    from scipy.optimize import minimize_scalar

    found = minimize_scalar(
        lambda g: -_log_likelihood(r, np.sqrt(np.exp(2.0 * g) + fixed)),
        bounds=(np.log(1e-3), np.log(max(10.0 * sigma, 1.0))),
        method="bounded",
    )
    return float(np.exp(found.x))


def _log_likelihood(r: np.ndarray, s: np.ndarray) -> float:
    from scipy.special import gammaln

    constant = gammaln(0.5 * (FREEDOM + 1)) - gammaln(0.5 * FREEDOM) - 0.5 * np.log(FREEDOM * np.pi)
    return float((constant - np.log(s) - 0.5 * (FREEDOM + 1) * np.log1p((r / s) ** 2 / FREEDOM)).sum())
