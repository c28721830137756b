"""Candidates judged by pixels: fits of the event-time likelihood on pools of pixels."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from pixelid import stages
from pixelid.cluster import Work
from pixelid.fit.cache import FitCache, map_fits
from pixelid.fit.maximise import Maximum, maximise
from pixelid.gap.attribute.attribute import MIN_SCREENED_NATS, Report
from pixelid.gap.attribute.candidates import SLEW, Tried, remove_effect, start_in_each, strongest_start, tried
from pixelid.gap.attribute.significance import log_chance_of_gain, own_values
from pixelid.gap.detect.pixels import PixelEvidence, per_pixel
from pixelid.gap.imputation.windows import DELAY
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.model import Model

# Optimiser steps of a screening fit; effects that trade places with what the model has take longer.
SCREEN_STEPS, SCREEN_STEPS_TRADING = 6, 15
SCREEN_STEPS_OWN = 15  # of an effect with values of each recording's own: phases start up to 45° off
# Chance of what an effect gains with values of each recording's own, from which a fit to all pixels is for those and
# not for shared ones.  Only steers: what is named is judged by a p-value that counts them.
WORTH_P = 0.01
LEADING_STEPS, FIT_STEPS = 30, 10  # of the leading effect, and of the others: they start where screening left them
WITHOUT_STEPS = 10


@dataclass(frozen=True)
class PixelCandidates:
    """The `Evidence` of pixels.

    Attributes:
        evidence: The pools, weighed by the circuit of the model under test.
        base_screened, base: That model on the pixels to screen on, and on the fit pixels.
        restart: The model at its shipped values, to screen from as well; None where the fitted ones are to be trusted.
        cache: Fits already made.
        work: Who fits.
        delay_found: Whether a free delay of the stamps is near where it belongs, so that it can be held at first.
    """

    evidence: PixelEvidence
    base_screened: Maximum
    base: Maximum
    restart: Model | None
    cache: FitCache | None
    work: Work = field(default_factory=Work)
    delay_found: bool = False

    def screen(self, effects: Sequence[str], report: Report) -> list[tuple[Maximum, float] | None]:
        """For each effect (it fitted to a few pixels, nats gained there), from the best of the strengths tried."""
        screen = _Screen(self.evidence.screening, self.base_screened, self.restart, self.delay_found)
        return map_fits(self.work, screen, effects, self.cache, report)

    def fit(self, starts: Sequence[tuple[str, Maximum]], report: Report) -> list[Maximum]:
        """Screened candidates on the fit pixels; the first one, which leads, to the end."""
        jobs = [(name, end.model, FIT_STEPS if i else LEADING_STEPS) for i, (name, end) in enumerate(starts)]
        fit = _Fit(self.evidence.fitting)
        return map_fits(self.work, fit, jobs, self.cache, lambda job: report(job[0]))

    def fit_without(self, effect: str, end: Maximum) -> Maximum:
        """The model without an effect, from the values that it has with it."""
        less = remove_effect(end.model, effect, self.base.model)
        return maximise(self.evidence.fitting, less, tolerance=0.1, max_steps=WITHOUT_STEPS, cache=self.cache)

    def held_out_gain(self, better: Maximum, worse: Maximum) -> np.ndarray:
        """(select pixels,) nats that one model gains on another."""
        pool = self.evidence.judging
        return per_pixel(pool, better.model) - per_pixel(pool, worse.model)


@dataclass(frozen=True)
class _Fit:
    """A candidate (name, model to start from, steps) fitted to the fit pixels."""

    pool: EventTimes

    def __call__(self, job: tuple[str, Model, int], cache: FitCache | None) -> Maximum:
        _, start, steps = job
        return maximise(self.pool, start, tolerance=0.02, max_steps=steps, cache=cache)


@dataclass(frozen=True)
class _Screen:
    """An effect fitted to a few pixels.

    Attributes:
        pool: These pixels.
        base: The model under test there.
        restart, delay_found: As of `PixelCandidates`.
    """

    pool: EventTimes
    base: Maximum
    restart: Model | None
    delay_found: bool

    def __call__(self, effect: str, cache: FitCache | None) -> tuple[Maximum, float] | None:
        """(the effect fitted, nats gained); None where no strength of it can be evaluated."""
        best: Maximum | None = None
        steps = SCREEN_STEPS_TRADING if stages.effect(effect).trades_places else SCREEN_STEPS
        origins = [origin for origin in (self.base.model, self.restart) if origin is not None]
        trials = [None if effect == SLEW else tried(self.pool, origin, effect) for origin in origins]
        for origin, some in zip(origins, trials, strict=True):
            end = strongest_fit(
                self.pool, origin, effect, self.base.value, lambda s: self._screened(s, steps, cache), some
            )
            if end is not None and (best is None or end.value > best.value):
                best = end
        if best is None:
            return None
        own = self._in_each(effect, best.value, origins, trials, cache)
        best = best if own is None else own
        return best, best.value - self.base.value

    def _screened(self, start: Model, steps: int, cache: FitCache | None) -> Maximum:
        """A start fitted to a few pixels; where the delay of the stamps is free, also with it held at first.

        Far from the optimum a delay runs to its bound in the place of what is missing, and holds the fit there.
        """
        pool = self.pool
        if DELAY not in start.free:
            return maximise(pool, start, tolerance=0.3, max_steps=steps, cache=cache)
        end = None if self.delay_found else maximise(pool, start, tolerance=0.3, max_steps=steps, cache=cache)
        held = maximise(pool, start.fix({DELAY: None}), tolerance=0.3, max_steps=steps, cache=cache).model
        freed = replace(held, parameters={**held.parameters, DELAY: start.parameter(DELAY)})
        again = maximise(pool, freed, tolerance=0.3, max_steps=steps, cache=cache)
        return again if end is None or again.value > end.value else end

    def _in_each(
        self, effect: str, shared: float, origins: Sequence[Model], trials: Sequence[list[Tried] | None],
        cache: FitCache | None,
    ) -> Maximum | None:  # fmt: skip
        """The effect with what starts anew free in each recording; None where that is not surely worth it.

        shared: log-likelihood with it shared by all;  origins, trials: models begun at, and what was tried beside each
        """
        starts = [start_in_each(self.pool, m, effect, some) for m, some in zip(origins, trials, strict=True)]
        start = max((s for s in starts if s is not None), key=lambda s: s[1], default=None)
        if start is None or start[1] < self.base.value + MIN_SCREENED_NATS:
            return None
        end = maximise(self.pool, start[0], tolerance=0.3, max_steps=SCREEN_STEPS_OWN, cache=cache)
        of_own = log_chance_of_gain(effect, end.value - self.base.value, 1, own_values(end.model, effect))
        of_shared = log_chance_of_gain(effect, shared - self.base.value, 1)
        return end if of_own < min(math.log(WORTH_P), of_shared) else None


def strongest_fit(
    pool: EventTimes,
    origin: Model,
    effect: str,
    least: float,
    fit: Callable[[Model], Maximum],
    trials: Sequence[Tried] | None = None,
) -> Maximum | None:
    """An effect fitted from its `strongest_start` beside a model; None where there is none.  trials: as of that.

    A limit of a slew at which nothing slews has no slope, so that a fit leaves it there: it is looked for again where
    the fit has led the other parameters.
    """
    start = strongest_start(pool, origin, effect, least, trials)
    if start is None:
        return None
    end = fit(start)
    if effect != SLEW or end.value < least + MIN_SCREENED_NATS:
        return end
    return slewing_both_ways(pool, end, fit)


def slewing_both_ways(pool: EventTimes, end: Maximum, fit: Callable[[Model], Maximum]) -> Maximum:
    """The end, or a better one from where the limits of a slew were looked for again, each side by itself."""
    start = strongest_start(pool, end.model, SLEW, end.value)
    again = None if start is None else fit(start)
    return end if again is None or again.value <= end.value else again


def candidates_of(
    evidence: PixelEvidence,
    model: Model,
    restart: Model | None,
    cache: FitCache | None,
    work: Work,
    delay_found: bool = False,
) -> PixelCandidates:
    """Evidence for candidates beside a model, from its fitted values.

    Args:
        evidence: Weighed by the model's circuit.
        model: At its fitted values.
        restart: The model at shipped values, where what is missing may have led the fitted ones astray.
        cache: Fits already made.
        work: Who fits.
        delay_found: Whether a free delay of the stamps is near where it belongs.
    """
    base = maximise(evidence.fitting, model, tolerance=0.05, max_steps=25, cache=cache)
    screened = base
    if evidence.screening is not evidence.fitting:
        screened = maximise(evidence.screening, model, tolerance=0.1, max_steps=25, cache=cache)
    return PixelCandidates(evidence, screened, base, restart, cache, work, delay_found)
