"""Fit every form of law to a table, and weigh them.

Forms are compared by the Bayesian information criterion (Schwarz 1978, Ann. Statist. 6, 461), whose differences give
weights exp(−ΔBIC / 2); predictions mix the forms by weight.  Settings left out and predicted from the others say how
far a law can be trusted.  Neighbouring rows of a table of one code miss its law together where the form is not exact,
or where cells are rounded: the covariance is raised by (1 + ρ) / (1 − ρ), ρ the correlation of neighbours' residuals
(Bayley & Hammersley 1946, J. R. Statist. Soc. Suppl. 8, 184).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from pixelid.biases.laws import FORMS, Form, Law
from pixelid.biases.saved import DRAWS
from pixelid.errors import InputError
from pixelid.parameters.parameter import Parameter
from pixelid.tables.biases.reading import BiasTable
from pixelid.tables.fit import TableFit, covariance_at, fit_table
from pixelid.tables.model import Rows

HEADROOMS = (0.02, 0.1, 0.5, 2.0)  # codes of no current at which searches begin, in half-ranges below the range
BLOCKS = 5  # of neighbouring codes, left out in turn
OPEN = 1e100  # limits of intervals that are open


@dataclass(frozen=True)
class LawModel:
    """A form fitted to rows, as `tables.model.TableModel`."""

    table: BiasTable
    law: Law
    nuisances: frozenset[str] = field(default_factory=frozenset)

    @property
    def rows(self) -> Rows:
        """The measured rows."""
        t = self.table
        return Rows(t.measured, t.last_digit, t.relative_error, dict(zip(t.codes, t.code.T, strict=True)))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The coordinates, scaled: those of magnitudes as logarithms."""
        form = self.law.form
        return tuple(
            Parameter(name, float(np.exp(x)) if kind == "log" else x, "1", *_bounds(kind, k, self.table), kind)
            for k, (name, kind, x) in enumerate(zip(form.parameters, form.kinds, self.law.x.tolist(), strict=True))
        )

    @property
    def neutral_bounds(self) -> tuple[tuple[str, str], ...]:
        """Floors may be 0, ceilings and codes of no current far away."""
        return tuple((p.name, side) for p in self.parameters[1:] if p.transform == "log" for side in ("lower", "upper"))

    def predict(self, x: np.ndarray) -> np.ndarray:
        """(rows,) the law; nearly nothing beyond its end."""
        return np.exp(
            np.nan_to_num(self.law.log_value(self.table.code, x), nan=np.log(self.table.measured.min()) - 9.0)
        )

    def dependence(self) -> list[np.ndarray]:
        """Every row depends on every coordinate."""
        return [np.full(len(self.table.measured), k) for k in range(len(self.law.x))]


def _bounds(kind: str, k: int, table: BiasTable) -> tuple[float, float]:
    if kind == "linear":
        return -30.0, 30.0  # e-folds, or values at the reference, per half-range
    if k == 0:
        return 1e-6 * float(table.measured.min()), 1e6 * float(table.measured.max())
    return 1e-9, 1e9


@dataclass(frozen=True)
class FittedLaw:
    """A form at its optimum.  bic: its criterion;  heldout: (rows,) ln predicted over measured of settings left out."""

    law: Law
    regression: TableFit
    bic: float
    heldout: np.ndarray | None = None

    @property
    def usable(self) -> bool:
        """Whether the search came to rest and the rows fix every coordinate; else a form with fewer says the same."""
        # Standard error of a coordinate: a factor 7 either way; wider, its interval is no longer normal
        least_known = 1.0
        return self.regression.converged and bool((self.regression.sd < least_known).all())


def fit_laws(table: BiasTable, report: Callable[[float], None] = lambda done: None) -> list[FittedLaw]:
    """All forms that the table can distinguish, best first, with weights, the first three with settings left out.

    Raises:
        InputError: fewer than 3 settings.
    """
    settings = len(np.unique(table.code, axis=0))
    forms = [form for form in FORMS if form.codes == len(table.codes) and len(form.kinds) < settings]
    if not forms:
        raise InputError(f"{table.name}: expected 3 or more settings of {', '.join(table.codes)}, found {settings}")
    fitted = []
    for k, form in enumerate(forms):
        fitted.append(fit_form(table, form))
        report((k + 1) / (len(forms) + 3))
    fitted.sort(key=lambda one: (not one.usable, one.bic))
    usable = np.array([one.usable for one in fitted])
    weight = np.exp(-0.5 * np.maximum([one.bic - fitted[0].bic for one in fitted], 0.0)) * usable
    weight = weight if usable.any() else np.eye(len(fitted))[0]
    least_weight = 0.005  # of the draws of a prediction: 20 of 4000
    weight = np.where(weight / weight.sum() < least_weight, 0.0, weight)
    weight /= weight.sum()
    values = []
    for k, (one, w) in enumerate(zip(fitted, weight, strict=True)):
        heldout = leave_out(table, one.law) if k < 3 else None
        values.append(replace(one, law=replace(one.law, weight=float(w)), heldout=heldout))
        report(min((len(forms) + k + 1) / (len(forms) + 3), 1.0))
    return values


def fit_form(table: BiasTable, form: Form) -> FittedLaw:
    """The likeliest law of a form."""
    low, high = table.code.min(0), table.code.max(0)
    width = len(form.parameters)
    empty = [
        Law(form, table.codes, low, high, sign, np.zeros(width), np.eye(width)) for sign in (1, -1)[: 1 + form.signed]
    ]
    starts = [replace(law, x=x) for law in empty for x in _starts(table, law)]
    return _fit_from(table, min(starts, key=lambda law: _misses(table, law)))


def _fit_from(table: BiasTable, start: Law) -> FittedLaw:
    """The optimum that is reached from a law."""
    best = fit_table(LawModel(table, start))
    covariance = covariance_at(best) * _correlation(table, best.residual)
    # of errors that are stated nothing is estimated from the spare rows (Satterthwaite 1946, Biometrics Bull. 2, 110)
    share = float((best.scale**2 / (best.scale**2 + best.model.rows.known_variance)).mean())
    most_freedom = 1e6  # as good as normal
    freedom = min(max(len(best.residual) - len(best.x) - 1.0, 1.0) / share**2, most_freedom)
    law = replace(
        start, x=best.x, covariance=0.5 * (covariance + covariance.T), scatter=best.scale, freedom=freedom
    )  # fmt: skip
    bic = (len(best.x) + 1) * np.log(len(best.residual)) - 2.0 * best.log_likelihood
    sd = np.where(np.isfinite(best.sd), np.sqrt(np.diag(law.covariance)), np.inf)
    return FittedLaw(law, replace(best, sd=sd), float(bic))


def _misses(table: BiasTable, law: Law) -> float:
    """Median |ln| by which a law misses: what outliers do not move."""
    return float(np.median(np.nan_to_num(np.abs(law.log_value(table.code) - np.log(table.measured)), nan=50.0)))


def _starts(table: BiasTable, law: Law) -> list[np.ndarray]:
    """Coordinates at which a search may begin: linear fits, given what is not linear."""
    v, q, form = (table.code - law.centre) / law.half, table.measured, law.form
    one, count = np.ones(len(q)), len(form.parameters)
    least = 1e-3 * float(np.median(q))
    if not form.signed:
        v = v[:, :1] - v[:, 1:] if form.name == "difference of codes" else v
        X = np.column_stack([one, v])
        if "log_slope.x" in form.parameters:
            shares = (0.0, 0.5, 0.9) if "floor" in form.parameters else (0.0,)  # of the smallest, that is floor
            lines = [_absolute_fit(X, np.log(q - share * q.min())) for share in shares]
            return [np.append(x, [np.log(max(s * q.min(), least))] * (count - len(x)))
                    for x, s in zip(lines, shares, strict=True)]  # fmt: skip
        line = _absolute_fit(X, q, 1.0 / q)
        value = max(line[0], least)
        rest = [1.0 if name == "exponent" else 0.0 for name in form.parameters[len(line) :]]
        return [np.array([np.log(value), *(line[1:] / value), *rest])]
    starts = []
    for m in HEADROOMS:
        w = (1.0 + m + law.sign * v[:, 0]) / (1.0 + m)
        if form.power is None:
            level, power = _absolute_fit(np.column_stack([one, np.log(w)]), np.log(q))
            starts.append(np.array([level, np.log(m), power]))
            continue
        y = q**-form.power  # a time
        a, c = _absolute_fit(np.column_stack([1.0 / w, one]), y, 1.0 / y) if count > 2 else (np.median(y * w), 0.0)
        a, c = np.maximum([a, c], 1e-3 * np.median(y))
        starts.append(np.array([-form.power * np.log(a), np.log(m), -form.power * np.log(c)])[:count])
    return starts


def _absolute_fit(X: np.ndarray, y: np.ndarray, weight: np.ndarray | float = 1.0) -> np.ndarray:
    """Coefficients of least absolute deviations, by reweighting: single rows do not move them."""
    w = np.broadcast_to(np.asarray(weight, float), y.shape).copy()
    own, values = w.copy(), np.zeros(X.shape[1])
    for _ in range(12):
        values = np.linalg.lstsq(X * w[:, None], y * w, rcond=None)[0]
        rest = own * np.abs(y - X @ values)
        w = own / np.sqrt(np.maximum(rest, 1e-6 + 1e-3 * rest.max()))
    return values


def _correlation(table: BiasTable, residual: np.ndarray) -> float:
    """By how much errors are larger where neighbours in code miss together; 1 for tables of two codes."""
    if len(table.codes) != 1 or len(residual) < 2 * BLOCKS:
        return 1.0
    r = np.clip(residual[np.argsort(table.code[:, 0], kind="stable")], -3.0, 3.0)
    rho = float((r[1:] * r[:-1]).mean() / max((r * r).mean(), 1e-12))
    two_sided = 1.96  # standard errors 1/√n of a correlation that is none
    return (1.0 + min(rho, 0.95)) / (1.0 - min(rho, 0.95)) if rho > two_sided / np.sqrt(len(r)) else 1.0


def folds(table: BiasTable) -> list[np.ndarray]:
    """(rows,) masks of settings to leave out in turn: blocks of codes, or every level of the last code."""
    code = table.code[:, -1]
    levels = np.unique(code)
    if len(levels) < 3:
        code = table.code[:, 0]
        levels = np.unique(code)
    most_levels = 12  # of a code, left out in turn one by one
    groups = [[x] for x in levels] if len(levels) <= most_levels else np.array_split(levels, BLOCKS)
    return [np.isin(code, group) for group in groups]


def leave_out(table: BiasTable, law: Law) -> np.ndarray:
    """(rows,) ln predicted over measured, each by the law's form from rows of other settings; NaN where too few."""
    values = np.full(len(table.measured), np.nan)
    for out in folds(table):
        rest = table.select(~out)
        if len(np.unique(rest.code, axis=0)) > len(law.x) and (np.ptp(rest.code, axis=0) > 0).all():
            values[out] = _fit_from(rest, law).law.log_value(table.code[out]) - np.log(table.measured[out])
    return values


def departure_variance(table: BiasTable, fitted: FittedLaw) -> float:
    """Variance of ln q per half-range away from measured settings (`biases.saved`), from those left out; by medians."""
    if fitted.heldout is None:
        return 0.0
    known = fitted.law.scatter**2 + fitted.regression.model.rows.known_variance
    distance = np.full(len(table.measured), np.nan)
    for out in folds(table):
        distance[out] = fitted.law.distances(table.code[out], table.code[~out])
    square = (fitted.heldout**2 - known) / distance
    square = square[np.isfinite(square)]
    median_square = 0.455  # of a standard normal
    return max(float(np.median(square)), 0.0) / median_square if len(square) else 0.0


def natural_values(law: Law, seed: int) -> dict[str, tuple[float, float, list[float]]]:
    """Parameter of the equation → (value, standard deviation, 95 % interval), from draws of the coordinates."""
    with np.errstate(over="ignore", invalid="ignore"):
        drawn = law.natural(law.draw(DRAWS, np.random.default_rng(seed))[0])
    values = {}
    for name, value in law.natural(law.x).items():
        finite = np.nan_to_num(drawn[name], posinf=OPEN, neginf=-OPEN)
        low, below, above, high = np.percentile(np.clip(finite, -OPEN, OPEN), [2.5, 15.87, 84.13, 97.5])
        values[name] = (float(value), 0.5 * float(above - below), [float(low), float(high)])
    return values
