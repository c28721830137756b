"""Judging a finished fit: does the model describe the data, does a bound decide, and how well is each value known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from pixelid.fit.advice import likely_causes
from pixelid.fit.event_times import EventTimesObjective
from pixelid.fit.newton import Optimum
from pixelid.fit.objective import Objective
from pixelid.fit.result import Estimate
from pixelid.fit.uncertainty.profiles import at_fixed
from pixelid.parameters.parameter import Parameter, precision_in_words
from pixelid.statistics import DROP_NATS
from pixelid.status import STOPPED, Status

# Events that fit the model not at all.  Under a true model they are one in 10⁵ (`likelihood/event_times.py`), so one
# in 10³ is an effect; below 5 a single accident could decide.
LARGEST_BACKGROUND_FRACTION, MIN_BACKGROUND_EVENTS = 1e-3, 5
# Pooled counts about a true model have dispersion 1; pools of real pixels reach 2 to 3 by sharing light fluctuations,
# for which errors are widened.  Beyond, what is left of the counts has structure.
LARGEST_DISPERSION = 3.0


@dataclass(frozen=True)
class ResidualTest:
    """One test for structure in the residuals.

    covariate: against what, in words;  p_value: of no structure;  share: of the residuals' variance that the structure
    explains;  expected: such a share of a true model, where the likelihood is approximate
    """

    covariate: str
    p_value: float
    share: float
    expected: float = 0.0

    def as_dict(self) -> dict:
        """The entry in fit.json."""
        return {"covariate": self.covariate, "p_value": self.p_value, "share": self.share, "expected": self.expected}


def residual_tests(objective: EventTimesObjective, x: np.ndarray) -> list[ResidualTest]:
    """Whether event residuals depend on anything that they must not depend on.

    Under a true model the levels at the events, about their pixel's threshold in units of their noise, are independent
    standard normal whatever happened before.  They are sorted by a covariate and cut into K blocks; Σ n m² over the
    blocks' means m is χ² with K degrees of freedom (with fewer, as parameters were fitted: the test is conservative),
    and so is Σ n (v − 1)²/2 over their mean squares v, scaled to an overall mean square of 1.

    A covariate must not know the residual: an event that comes late has a long interval.  So times are those at which
    the event was expected, to first order: the residual over the speed of the change earlier.

    Args:
        objective: the event-time log posterior.
        x: (p,) its optimum.

    Returns:
        One test per covariate and moment.
    """
    likelihood = objective.likelihood
    terms = objective.terms(x)
    kept = np.flatnonzero(~terms.background & ~terms.at_once)  # what came at once does not tell its level
    # Residuals against a covariate: events per block, and most blocks.
    block_events, most_blocks = 50, 40
    if len(kept) < 2 * block_events:
        return []
    group = likelihood.group[kept]
    e = (terms.z[kept] - terms.weighted_mean[group]) / terms.scale[kept]
    e /= max(float(np.sqrt((e**2).mean())), 1e-300)
    late_s = (terms.z[kept] - terms.weighted_mean[group]) * np.exp(-terms.log_rate[kept])
    expected_s = likelihood.time_s[kept] - late_s
    previous_s = np.concatenate([intervals.previous_s for intervals in likelihood.intervals])[kept]
    covariates = {
        "time": likelihood.recording_of_event[kept] * 1e9 + expected_s,
        "the time since the pixel's previous event": expected_s - previous_s,
    }
    tests = []
    for name, covariate in covariates.items():
        for polarity, sign in (("ON", 1.0), ("OFF", -1.0)):
            some = np.flatnonzero(likelihood.sign[kept] == sign)
            if len(some) < 2 * block_events:
                continue
            ordered = e[some[np.argsort(covariate[some], kind="stable")]]
            blocks = np.array_split(ordered, min(len(some) // block_events, most_blocks))
            mean = sum(len(b) * b.mean() ** 2 for b in blocks)
            square = sum(0.5 * len(b) * ((b**2).mean() - 1.0) ** 2 for b in blocks)
            for moment, statistic in (("level", mean), ("scatter", square)):
                share = float(max(statistic - len(blocks), 0.0) / len(some))
                p = float(chi2.sf(statistic, len(blocks)))
                tests.append(ResidualTest(f"the {moment} of {polarity} events against {name}", p, share))
    return tests


def significant(tests: Sequence[ResidualTest]) -> list[ResidualTest]:
    """The tests that raise an alarm, most significant first."""
    # All tests of one fit together raise a false alarm in 0.2 % of true models by the χ² law; docs/methods/fitting.md
    # has what simulated null fits measured.
    false_alarms = 0.002
    level = false_alarms / max(len(tests), 1)
    # A significant structure also has to matter: at 1 % of the residuals' variance, events are moved by a tenth of
    # their own noise.  Sampled stimuli leave up to 0.1 % (interpolation between samples), which large recordings make
    # significant.
    smallest_share = 0.01
    alarms = [test for test in tests if test.p_value < level and test.share - test.expected > smallest_share]
    return sorted(alarms, key=lambda test: (test.p_value, -test.share))


def deciding_bounds(objective: Objective, optimum: Optimum, dispersion: float = 1.0) -> list[str]:
    """Names of free parameters that sit on a bound which decides the fit.

    A parameter on a bound is moved a factor e inwards, with all else maximised again.  Where the log posterior then
    falls by less than 1.92 nats (times the dispersion of pooled counts) the data do not ask for the bound, they are
    merely open there.
    """
    x, lower, upper = optimum.x, *objective.coordinates.bounds()
    moves = objective.coordinates.longest_moves()
    names = []
    for i in map(int, np.flatnonzero(optimum.on_bound)):
        moved = x.copy()
        moved[i] = np.clip(x[i] + (moves[i] if x[i] <= lower[i] else -moves[i]), lower[i], upper[i])
        enough = optimum.local.value - DROP_NATS * dispersion
        if len(x) == 1 or at_fixed(objective, moved, i, enough)[0] <= enough:
            names.append(objective.coordinates.names[i])
    return names


def has_arrived(objective: Objective, optimum: Optimum) -> bool:
    """Whether a search ended at its maximum, or so close that nothing it could report would change.

    An open parameter drifts along a plateau, where the promise of a step drowns in rounding and no optimiser meets its
    own tolerance.  What counts is what a Newton step of at most a longest move (a factor e) still promises.
    """
    if optimum.converged:
        return True
    free = ~optimum.on_bound
    gradient = optimum.local.gradient[free]
    information = optimum.local.information[np.ix_(free, free)]
    move = np.linalg.lstsq(information, gradient, rcond=1e-14)[0]
    move /= max(1.0, float(np.abs(move / objective.coordinates.longest_moves()[free]).max(initial=0.0)))
    # A log posterior this close to its maximum is 0.14 standard errors away.
    negligible_nats = 0.01
    return bool(gradient @ move - 0.5 * move @ information @ move < negligible_nats)


def status_of(
    objective: Objective, optimum: Optimum, estimates: Mapping[str, Estimate], details: Mapping
) -> tuple[Status, str]:
    """How a fit ended, and what to do about it in words.

    Args:
        objective: what was maximised, for the test of bounds.
        optimum: where.
        estimates: by parameter.
        details: "dispersion" of pooled fits; "background_events", "background_fraction", "residual_tests" of event
            times.

    Returns:
        The most serious status and all advice, joined.
    """
    advice, statuses = [], []
    if not np.isfinite(optimum.local.value) or not np.isfinite(optimum.x).all():
        return Status.diverged, Status.diverged.advice
    if not has_arrived(objective, optimum):
        advice.append("the optimiser did not converge, so no interval can be trusted")
        statuses.append(Status.not_converged)
    background, share = details.get("background_events", 0), details.get("background_fraction", 0.0)
    if share > LARGEST_BACKGROUND_FRACTION and background >= MIN_BACKGROUND_EVENTS:
        advice.append(f"{background} events ({100 * share:.2g} %) have no cause in the model: it lacks an effect")
        statuses.append(Status.misfit)
    dispersion = details.get("dispersion", 1.0)
    if dispersion > LARGEST_DISPERSION:
        advice.append(
            f"counts vary {dispersion:.1f} times more about the model than Poisson counts would: "
            "errors are scaled for it, but the model lacks an effect"
        )
        statuses.append(Status.misfit)
    alarms = significant([ResidualTest(**test) for test in details.get("residual_tests", ())])
    if alarms:
        worst = alarms[0]
        advice.append(
            f"residuals depart from the model in {worst.covariate} ({100 * worst.share:.2g} % of their variance, "
            f"p = {worst.p_value:.1g}): an effect is missing, find it with `pixelid gap`"
        )
        statuses.append(Status.misfit)
    if statuses and isinstance(objective, EventTimesObjective):
        causes = likely_causes(objective, optimum.x)
        advice += causes
        if not causes and Status.misfit not in statuses:
            advice.append("most likely an effect is missing: look for it with `pixelid gap`")
    held = deciding_bounds(objective, optimum, dispersion)
    if held:
        advice.append(f"{', '.join(held)} on the bound: fix there, remove the effect, or widen the bound")
        statuses.append(Status.at_bound)
    free = [estimate for estimate in estimates.values() if not estimate.fixed]
    if free and not any(estimate.identified for estimate in free):
        advice.append(Status.not_identified.advice)
        statuses.append(Status.not_identified)
    return Status.worst(statuses), "; ".join(advice)


def open_sides(
    estimates: Mapping[str, Estimate], parameters: Sequence[Parameter]
) -> tuple[dict[str, Estimate], list[str]]:
    """Estimates whose intervals end where the data end them: a side at the parameter's bound becomes None.

    Args:
        estimates: by name, with intervals clipped to the bounds.
        parameters: the free ones, with their bounds.

    Returns:
        The estimates, open ones not identified; and a sentence for each open parameter.
    """
    changed, sentences = dict(estimates), []
    for parameter in parameters:
        estimate = estimates[parameter.name]
        low, high = estimate.interval_95 or (None, None)
        if low is None or high is None:
            continue
        wide = parameter.upper - parameter.lower
        below = low - parameter.lower <= 1e-9 * (abs(low) if parameter.transform == "log" else wide)
        above = parameter.upper - high <= 1e-9 * (abs(high) if parameter.transform == "log" else wide)
        if not below and not above:
            continue
        changed[parameter.name] = replace(
            estimate, interval_95=(None if below else low, None if above else high), identified=False
        )
        if below and above:
            if parameter.transform == "log":
                sentences.append(f"{parameter.name} is not identified over {np.log10(high / low):.0f} decades")
            else:
                sentences.append(f"{parameter.name} is not identified: any value between its bounds fits")
        elif below:
            sentences.append(f"{parameter.name}: only an upper limit, {high:.3g} {parameter.unit}")
        else:
            sentences.append(f"{parameter.name}: only a lower limit, {low:.3g} {parameter.unit}")
    return changed, sentences


def at_rest_only(estimates: Mapping[str, Estimate], status: Status) -> tuple[dict[str, Estimate], list[str]]:
    """Estimates without intervals where the search did not come to rest, and a sentence that says so."""
    if status.at_rest:
        return dict(estimates), []
    unknown = {
        name: e if e.fixed else replace(e, std=None, interval_95=None, identified=False)
        for name, e in estimates.items()
    }
    return unknown, [STOPPED]


def precision(estimate: Estimate, parameter: Parameter, status: Status = Status.converged) -> str:
    """How well a value is known, in words: "known within 3 %", "known to a factor of 3", "only a lower limit"."""
    if estimate.fixed:
        return "fixed"
    if not status.at_rest:
        return "not reliable: the optimiser stopped early"
    return precision_in_words(estimate.interval_95 or (None, None), parameter)
