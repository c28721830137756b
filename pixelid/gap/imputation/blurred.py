"""True times behind a jitter or a coarse tick: whole paths drawn, and the model stepped towards the stamps, in turns.

First with few pixels, until steps are small beside what the stamps tell, then with all.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from pixelid.fit.coordinates import Coordinates
from pixelid.gap.imputation.imputed import JITTER, Imputation, draw_again
from pixelid.gap.imputation.marginal import MAX_LOG_MOVE, MarginalStep, marginal_step
from pixelid.model.model import Model

MOST_ROUNDS, LEAST_ROUNDS = 24, 4  # of draws and steps with few pixels

Report = Callable[[str], None]


def follow(whole: Imputation, model: Model, seed: int, report: Report) -> tuple[Imputation, Model]:
    """The imputation with its times drawn, and the model so found, from a start that need not be near."""
    return _follow(whole, model, MOST_ROUNDS, seed, report)


def follow_again(whole: Imputation, model: Model, report: Report) -> tuple[Imputation, Model]:
    """The same for a model that has gained an effect."""
    rounds_again = 10  # at most, after the model has gained an effect
    return _follow(whole, model, rounds_again, 0, report)


def draw_once_more(whole: Imputation, model: Model) -> Imputation:
    """Other times from the same model: paths owe nothing to the draw before."""
    return draw_again(whole, model, estimate=False)


def _follow(whole: Imputation, model: Model, rounds: int, seed: int, report: Report) -> tuple[Imputation, Model]:
    model = whole.with_filter_priors(model)
    few_events = 5_000  # filters to a percent or a few, in half a second a draw
    part = whole.few(few_events, np.random.default_rng(seed))
    small = 0
    settled_sd = 2.0  # a step is small by, in standard errors of each coordinate: draws alone move it by one
    for turn in range(rounds):
        report("true times")
        before = Coordinates.of(model).start
        part, model, step = _step(part, model)
        moved = np.abs(step.x - before) <= settled_sd * np.maximum(step.sd, 1e-3)
        small = small + 1 if moved.all() else 0
        if small >= 2 and turn + 1 >= LEAST_ROUNDS:
            break
    if whole.effect == JITTER:
        whole = whole.with_spread(part.sigma_s)
    ends, logs = [], []
    rounds_with_all = 2  # averaged
    for _ in range(rounds_with_all):
        report("true times")
        drawn_with = whole.windows
        whole, model, step = _step(whole, model)
        if whole.effect == JITTER:
            other = likeliest_spread(whole, 1e-9 * drawn_with[0].sd, step.sigma_error)
            logs.append(np.log([step.sigma_s, other]))
            whole = whole.with_spread(float(np.exp(logs[-1].mean())))
        ends.append(step)
    model = Coordinates.of(model).model_at(np.mean([end.x for end in ends], axis=0))
    if logs:  # one is to first order, the other hangs on how well draws mix: what they differ by is uncertain
        by_step, by_draw = np.mean(logs, axis=0)
        error = float(np.hypot(whole.error, 0.5 * (by_draw - by_step)))
        whole = replace(whole.with_spread(float(np.exp(0.5 * (by_step + by_draw)))), error=error)
    return whole, model


def likeliest_spread(drawn: Imputation, sigma_s: float, error: float) -> float:
    """The jitter's standard deviation, from how far stamps are off times drawn with `sigma_s`, s.

    A step of EM, lengthened by what is missing of the information: n stamps known with their times would tell it to
    1/√(2n), and they tell it to `error`.  Where it rests, nothing is to first order only.
    """
    off = np.concatenate([w.centre - t for w, t in zip(drawn.windows, drawn.times, strict=True)])
    growth = 0.5 * np.log(np.mean((1e-9 * off / sigma_s) ** 2))
    max_lengthening = 5.0  # of a step of EM: four fifths of the information missing
    lengthened = float(np.clip(2.0 * len(off) * error**2, 1.0, max_lengthening))
    return sigma_s * float(np.exp(np.clip(lengthened * growth, -MAX_LOG_MOVE, MAX_LOG_MOVE)))


def _step(imputation: Imputation, model: Model) -> tuple[Imputation, Model, MarginalStep]:
    """Times drawn, and the model a step on."""
    imputation = draw_again(imputation, model, estimate=False)
    jitters = imputation.effect == JITTER
    stamps = [
        1e-9 * w.centre[np.argsort(t, kind="stable")] for w, t in zip(imputation.windows, imputation.times, strict=True)
    ]
    sigma_s = next((w.spread_s for w in imputation.windows if len(w.lo)), 0.0)
    step = marginal_step(imputation.likelihood, stamps, model, sigma_s, jitters)
    coordinates = Coordinates.of(model)
    scatter = dict(zip(coordinates.names, step.missing_sd.tolist(), strict=True))
    imputation = replace(imputation, error=step.sigma_error, scatter=scatter)
    return imputation.with_spread(step.sigma_s) if jitters else imputation, coordinates.model_at(step.x), step
