"""Fit a table of values: Student-t regression of logarithms, so that one mistyped cell cannot steer the answer.

A table without errors says nothing about its own precision: the relative scatter is estimated from the residuals,

    ln(measured + d) = ln(predicted + d) + s t₄,   s² = σ² + (d / √12 / (measured + d))² + stated errors²

with d the last digit written (so "no events" is a measurement: less than d) and t₄ Student's t with 4 degrees of
freedom, fitted by EM (Lange, Little & Taylor 1989, JASA 84).  Maximum likelihood forgets that residuals were fitted:
σ² is raised by n / (n − k) in every step, k the number of parameters that the rows rather than the priors determine, or
a small table would be fitted to a fraction of its scatter, against its priors.  Rows beyond `SUSPECT_SCALES` are named,
and stay in the fit.  Priors of parameters are Gaussian in their fitting coordinates and count as further residuals.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pixelid.parameters.parameter import OPEN_SD, Parameter, precision_in_words
from pixelid.statistics import Z95
from pixelid.status import Status
from pixelid.tables.model import TableModel, predicted_rows

FREEDOM = 4.0  # of Student's t: heavy enough for a slipped decimal point, 83 % efficient for normal errors
SUSPECT_SCALES = 4.0  # scales; 1.6 % of clean rows of t₄ lie beyond
MOST_SUSPECT = 0.25  # of a table's rows; more are not outliers
AT_BOUND = 1e-3  # of a log coordinate
# Rates and latencies repeat within some per cent (3 % and 5 % in the two public tables); the same table read in a unit
# that is wrong by 10³ scatters by 42 % and 116 %
MAX_SCATTER = 0.2
MAX_EM_STEPS = 80
LEAST_SPARE = 0.05  # of a row: what one says of scatter that only its own parameters follow is nothing
REST = 1e-4  # nats
STEP = 1e-5  # of a coordinate, for slopes: a one-sided difference errs by about as much, relatively
# By the column that only rows of a kind of table have: what to do where a fit did not come to rest, and whose units to
# look at where it is far off; then the same of any other table
UNSETTLED = {
    "column": "drop columns with few cells",
    "condition": "drop conditions with few cells",
    "statistic": "drop settings with few cells",
    "polarity": "start from a --model nearer to the sensor, or leave out lights with hardly an event",
    "": "leave out rows that say little",
}
UNITS = {
    "column": "its rates and of its frequencies",
    "condition": "its events and of its frequencies",
    "statistic": "its latencies and of its irradiances",
    "polarity": "its rates and of its light",
    "": "its values",
}


@dataclass(frozen=True)
class Tie:
    """A Gaussian prior on the mean of fitting coordinates: their places (k,), its mean and standard deviation."""

    places: tuple[int, ...]
    mean: float
    sd: float


@dataclass(frozen=True)
class TableFit:
    """A finished fit.

    Attributes:
        model: what was fitted, with the table.
        x: (parameters,) fitting coordinates;  sd: their standard errors, inf where open.
        limit: one-sided 95 % limits of those on a bound, in their unit, else NaN.
        scale: σ, the relative scatter.
        predicted, residual, weight: (rows,) prediction, residual in scales, and weight 0…1 given to the row.
        log_likelihood: at the maximum;  converged: whether EM came to rest.
        ties: priors in addition to the parameters' own.
        wider: (m, parameters) further deviations, of all parameters together each: of `profile.follow_profile` and
            `profile.with_rivals`, or a step that a search could not win.
    """

    model: TableModel
    x: np.ndarray
    sd: np.ndarray
    limit: np.ndarray
    scale: float
    predicted: np.ndarray
    residual: np.ndarray
    weight: np.ndarray
    log_likelihood: float
    converged: bool
    ties: tuple[Tie, ...] = ()
    wider: np.ndarray | None = None

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """What was fitted, at its starting values."""
        return self.model.parameters

    @property
    def suspect(self) -> np.ndarray:
        """(rows,) which rows the fit down-weights."""
        return np.abs(self.residual) > SUSPECT_SCALES

    def at_bound(self) -> list[str]:
        """Names of the parameters on a bound that does not just say that an effect is absent."""
        names = []
        for p, x in zip(self.parameters, self.x, strict=True):
            for side, bound in zip(("lower", "upper"), p.coordinate_bounds(), strict=True):
                neutral = any(p.name.startswith(name) and side == end for name, end in self.model.neutral_bounds)
                if abs(x - bound) < AT_BOUND and not neutral and p.name not in self.model.nuisances:
                    names.append(p.name)
        return names

    def judge(self) -> tuple[Status, str]:
        """(status, advice): the worst that is to be stated, and what to do about it."""
        verdicts = {}
        if not self.converged:
            verdicts[Status.not_converged] = f"The regression did not come to rest: {self._of_kind(UNSETTLED)}."
        if not self.scale < MAX_SCATTER:
            verdicts[Status.misfit] = (
                f"The rows scatter by {100 * self.scale:.0f} % about the best fit: check the unit of the table, of "
                f"{self._of_kind(UNITS)}, before anything else."
            )
        elif np.mean(self.suspect) > MOST_SUSPECT:
            verdicts[Status.misfit] = (
                f"{np.mean(self.suspect):.0%} of the rows lie far off the fit: the table is not one of this model."
            )
        elif strange := self._strange_columns():
            verdicts[Status.misfit] = (
                f"Most of what is off lies in {', '.join(strange)}: look at them, or leave them out."
            )
        if bounds := self.at_bound():
            verdicts[Status.at_bound] = f"{', '.join(bounds)}: on a bound; check the unit of the table."
        wanted = [sd for p, sd in zip(self.parameters, self.sd, strict=True) if p.name not in self.model.nuisances]
        if not (np.array(wanted) < OPEN_SD).any():
            verdicts[Status.not_identified] = "The table fixes none of the parameters."
        status = Status.worst(verdicts)
        return status, verdicts.get(status, "")

    def _of_kind(self, words: Mapping[str, str]) -> str:
        """Which of the words are for this kind of table."""
        return words[next((column for column in words if column in self.model.rows.columns), "")]

    def _strange_columns(self) -> list[str]:
        """Columns of a table with several of which too many rows lie far off."""
        column = np.array(self.model.rows.columns.get("column", []))
        return [str(name) for name in dict.fromkeys(column) if np.mean(self.suspect[column == name]) > MOST_SUSPECT]

    def as_dict(self) -> dict[str, dict[str, Any]]:
        """Entries of the result's JSON, by parameter name; none is identified where the regression did not rest."""
        entries = {}
        for p, x, sd, limit in zip(self.parameters, self.x, self.sd, self.limit, strict=True):
            known = bool(self.converged and np.isfinite(sd) and sd < OPEN_SD)
            low, high = p.lower, p.upper
            if np.isfinite(sd):
                low, high = np.exp(x - Z95 * sd), np.exp(min(x + Z95 * sd, 300.0))
            elif np.isfinite(limit):
                low, high = min(limit, np.exp(x)), max(limit, np.exp(x))
            entries[p.name] = {
                "value": float(np.exp(x)),
                "unit": p.unit,
                "std": float(np.exp(x) * sd) if known else None,
                "interval_95": [max(float(low), p.lower), min(float(high), p.upper)],
                "identified": known,
            }
        return entries

    def precision(self) -> dict[str, str]:
        """How well each parameter is known, in words, by its name."""
        parameters, entries = {p.name: p for p in self.parameters}, self.as_dict()
        return {
            name: precision_in_words(tuple(entry["interval_95"]), parameters[name]) for name, entry in entries.items()
        }

    def as_rows(self) -> list[dict[str, Any]]:
        """The table's rows with measured, predicted and standardised residual."""
        return predicted_rows(self.model, self.predicted, self.residual)


def misses(log_ratio: np.ndarray, standardised: np.ndarray) -> str:
    """How a prediction misses a table, in a few words; "" where it describes it.

    A few rows may be off, whatever the reason: it is judged by the typical row, and by how many are far off both in
    scales and in size.

    Args:
        log_ratio: (rows,) ln(predicted / measured).
        standardised: (rows,) residuals in scales.
    """
    size = np.abs(log_ratio)
    off = float(np.mean((size > MAX_SCATTER) & (np.abs(standardised) > SUSPECT_SCALES))) if len(size) else 0.0
    if len(size) and not np.median(size) <= MAX_SCATTER:
        return f"by a factor of {np.exp(np.median(size)):.3g} (typical)"
    return f"in {off:.0%} of the rows" if off > MOST_SUSPECT else ""


def fit_table(
    model: TableModel, start: Sequence[float] | None = None, ties: Sequence[Tie] = (), *, rest: float = REST,
    scatter: float | None = None,
) -> TableFit:  # fmt: skip
    """Fit a table of values.  All parameters are logarithmic.

    Args:
        model: rows, parameters and prediction.
        start: values to begin at, in the order of the parameters; their own by default.
        ties: priors on means of fitting coordinates, in addition to the parameters' own.
        rest: nats by which a step of EM may still gain when it has come to rest.
        scatter: σ where it is known; fitted where None.
    """
    from scipy.optimize import least_squares

    parameters = model.parameters
    lower, upper = np.array([p.coordinate_bounds() for p in parameters]).T
    first = [p.value for p in parameters] if start is None else start
    x = np.clip(
        [p.to_coordinate(value) for p, value in zip(parameters, first, strict=True)], lower + 1e-9, upper - 1e-9
    )
    prior_rows, prior_target = _priors(model, ties)
    known = _residuals(model, x)[1]

    def residuals(x: np.ndarray) -> np.ndarray:
        return _residuals(model, x)[0]

    latest: list[np.ndarray] = []  # where slopes were last taken, and they

    # Slopes are taken anew where a coordinate has moved so far; else they err by about as much, relatively.  Fits of
    # the Gen 3.1's latencies end within 0.02 nats of where they do with slopes always taken anew.
    same_slopes = 1e-4

    def jacobian(x: np.ndarray) -> np.ndarray:
        if not (latest and np.abs(latest[0] - x).max() < same_slopes):
            latest[:] = x.copy(), -slopes(model, x)
        return latest[1]

    def prior_residuals(x: np.ndarray) -> np.ndarray:
        return prior_rows @ x - prior_target

    r = residuals(x)
    sigma = max(1.48 * float(np.median(np.abs(r))), 0.02) if scatter is None else scatter
    last, converged = -np.inf, False
    for _ in range(MAX_EM_STEPS):
        s = np.sqrt(sigma**2 + known)
        root = np.sqrt((FREEDOM + 1.0) / (FREEDOM + (r / s) ** 2)) / s
        optimum = least_squares(
            lambda z, root=root: np.append(root * residuals(z), prior_residuals(z)),
            x,
            jac=lambda z, root=root: np.vstack([root[:, None] * jacobian(z), prior_rows]),  # pyright: ignore[reportArgumentType]
            bounds=(lower, upper),
            max_nfev=8,
        )
        x = optimum.x
        r = residuals(x)
        if scatter is None:
            spare = np.maximum(1.0 - _leverages(optimum.jac, len(r)), LEAST_SPARE)
            sigma = _maximise_scatter(r / np.sqrt(spare), known, sigma)
        value = _log_likelihood(r, np.sqrt(sigma**2 + known)) - 0.5 * float((prior_residuals(x) ** 2).sum())
        if abs(value - last) < rest:
            converged = True
            break
        last = value
    return fit_at(model, x, float(sigma), converged, ties)


def fit_at(
    model: TableModel, x: np.ndarray, scale: float, converged: bool = True, ties: Sequence[Tie] = ()
) -> TableFit:
    """Errors, limits and residuals of a table at coordinates that another search has found.

    Args:
        model: rows, parameters and prediction.
        x: (parameters,) fitting coordinates.
        scale: relative scatter σ.
        converged: whether the search came to rest.
        ties: priors in addition to the parameters' own.
    """
    lower, upper = np.array([p.coordinate_bounds() for p in model.parameters]).T
    r, known = _residuals(model, x)
    s = np.sqrt(scale**2 + known)
    low, high = x < lower + AT_BOUND, x > upper - AT_BOUND
    # a parameter on a bound counts in its own unit (at its lower bound) or inverted (at its upper), where its effect
    # is linear: the others' errors then include it, and it gets a one-sided limit
    unit = np.where(low, np.exp(-x), np.where(high, np.exp(x), 1.0))
    J = np.vstack([
        slopes(model, x) / s[:, None] * np.sqrt((FREEDOM + 1.0) / (FREEDOM + 3.0)), _priors(model, ties)[0]
    ]) * unit  # fmt: skip
    sd = standard_errors(J.T @ J)
    limit = np.where(low, np.exp(x) + Z95 * sd, np.where(high, 1.0 / (np.exp(-x) + Z95 * sd), np.nan))
    sd = np.where(low | high, np.inf, sd)
    weight = (FREEDOM + 1.0) / (FREEDOM + (r / s) ** 2) / ((FREEDOM + 1.0) / FREEDOM)
    value = _log_likelihood(r, s)
    rows, predicted = model.rows, model.predict(x)
    own = rows.log_ratio(predicted) / np.sqrt(scale**2 + rows.known_variance)
    return TableFit(model, x, sd, limit, scale, predicted, own, weight, value, converged, tuple(ties))


def _residuals(model: TableModel, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(rows,) ln measured over predicted, turned, and variances that are known."""
    rows = model.rows
    return rows.turned(rows.log_ratio(model.predict(x))), rows.turned_variance


def slopes(model: TableModel, x: np.ndarray) -> np.ndarray:
    """(rows, parameters) derivatives of ln(predicted + d) by the fitting coordinates, turned as residuals are."""
    d = model.rows.last_digit
    J = np.zeros((len(model.rows.measured), len(x)))
    here = np.log(model.predict(x) + d)
    for slot in model.dependence():
        step = np.zeros(len(x))
        step[slot] = STEP
        J[np.arange(len(J)), slot] += (np.log(model.predict(x + step) + d) - here) / STEP
    return model.rows.turned(J)


def information_at(fit: TableFit) -> np.ndarray:
    """(n, n) Fisher information of a fit's coordinates at its maximum, priors included."""
    s = np.sqrt(fit.scale**2 + _residuals(fit.model, fit.x)[1])
    J = slopes(fit.model, fit.x) / s[:, None] * np.sqrt((FREEDOM + 1.0) / (FREEDOM + 3.0))
    prior = _priors(fit.model, fit.ties)[0]
    return J.T @ J + prior.T @ prior


def covariance_at(fit: TableFit) -> np.ndarray:
    """(n, n) covariance of a fit's coordinates, in the normal approximation and what a profile added to it."""
    normal = np.linalg.pinv(information_at(fit))
    return normal if fit.wider is None else normal + fit.wider.T @ fit.wider


def log_posterior_at(fit: TableFit, x: np.ndarray) -> float:
    """Log likelihood and log prior, to a constant, of coordinates x (n,) under the scatter of a fit."""
    r, known = _residuals(fit.model, x)
    prior_rows, prior_target = _priors(fit.model, fit.ties)
    prior = 0.5 * float(((prior_rows @ x - prior_target) ** 2).sum())
    return _log_likelihood(r, np.sqrt(fit.scale**2 + known)) - prior


def _priors(model: TableModel, ties: Sequence[Tie]) -> tuple[np.ndarray, np.ndarray]:
    """(rows (m, n), target (m,)): the priors as further residuals, rows @ x − target."""
    own = [Tie((k,), p.prior.mean, p.prior.sd) for k, p in enumerate(model.parameters) if p.prior is not None]
    every = [*own, *ties]
    rows = np.zeros((len(every), len(model.parameters)))
    for row, tie in zip(rows, every, strict=True):
        row[list(tie.places)] = 1.0 / (len(tie.places) * tie.sd)
    return rows, np.array([tie.mean / tie.sd for tie in every])


def standard_errors(information: np.ndarray) -> np.ndarray:
    """Standard errors from a Fisher information; what the data do not see comes out as inf.

    The matrix is scaled to a unit diagonal first: blind directions are then those whose eigenvalue is 1e-10 of the
    largest, whatever the units.
    """
    size = np.sqrt(np.maximum(np.diag(information), 0.0))
    scaled = information / np.maximum(np.outer(size, size), 1e-300)
    values, vectors = np.linalg.eigh(scaled)
    floor = 1e-10 * max(values.max(), 1e-300)
    variance = (vectors**2 / np.maximum(values, floor)).sum(1)
    blind = (vectors**2 * (values < floor)).sum(1) > 1e-6
    return np.where(blind | (size <= 1e-12), np.inf, np.sqrt(variance) / np.maximum(size, 1e-300))


def _leverages(weighted: np.ndarray, rows: int) -> np.ndarray:
    """(rows,) how much of each row's prediction is the row itself: the diagonal of the hat matrix.

    weighted: (rows and priors, parameters) derivatives over errors
    """
    of_rows = weighted[:rows]
    return np.einsum("rn,nm,rm->r", of_rows, np.linalg.pinv(weighted.T @ weighted), of_rows)


def _maximise_scatter(r: np.ndarray, known: np.ndarray, sigma: float) -> float:
    """σ that maximises the t likelihood of residuals r, given the known variances."""
    from scipy.optimize import minimize_scalar

    optimum = minimize_scalar(
        lambda g: -_log_likelihood(r, np.sqrt(np.exp(2.0 * g) + known)),
        bounds=(np.log(1e-3), np.log(max(10.0 * sigma, 1.0))),
        method="bounded",
    )
    return float(np.exp(optimum.x))


def _log_likelihood(r: np.ndarray, s: np.ndarray) -> float:
    from scipy.special import gammaln

    constant = gammaln(0.5 * (FREEDOM + 1)) - gammaln(0.5 * FREEDOM) - 0.5 * np.log(FREEDOM * np.pi)
    return float((constant - np.log(s) - 0.5 * (FREEDOM + 1) * np.log1p((r / s) ** 2 / FREEDOM)).sum())
