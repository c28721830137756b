"""Candidates judged by pixels: fits of the event-time likelihood on pools of pixels."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pixelid.fit.cache import FitCache
from pixelid.fit.maximise import Maximum, maximise
from pixelid.gap.attribute.attribute import MIN_SCREENED_NATS
from pixelid.gap.attribute.candidates import remove_effect, start_in_each, strongest_start
from pixelid.gap.attribute.significance import chance_of_gain, own_values
from pixelid.gap.detect.pixels import PixelEvidence, per_pixel
from pixelid.gap.imputation.windows import DELAY
from pixelid.model.model import Model

# Optimiser steps of a screening fit.  Poles, and a floor of the bandwidth, trade places with the poles that the model
# has, which takes longer.
TRADING_PLACES = ("source_follower_pole", "extra_pole", "differencing_pole", "bandwidth_floor")
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
    """

    evidence: PixelEvidence
    base_screened: Maximum
    base: Maximum
    restart: Model | None
    cache: FitCache | None

    def screen(self, effect: str) -> tuple[Maximum, float] | None:
        """(the effect fitted to a few pixels, nats gained there), from the best of the strengths tried."""
        best: Maximum | None = None
        pool, steps = self.evidence.screening, SCREEN_STEPS_TRADING if effect in TRADING_PLACES else SCREEN_STEPS
        for origin in (self.base_screened.model, self.restart):
            start = None if origin is None else strongest_start(pool, origin, effect, self.base_screened.value)
            if start is None:
                continue
            end = self._screened(start, steps)
            if best is None or end.value > best.value:
                best = end
        if best is None:
            return None
        own = self._screen_in_each(effect, best.value)
        best = best if own is None else own
        return best, best.value - self.base_screened.value

    def _screened(self, start: Model, steps: int) -> Maximum:
        """A start fitted to a few pixels; where the delay of the stamps is free, also with it held at first.

        Far from the optimum a delay runs to its bound in the place of what is missing, and holds the fit there.
        """
        pool, cache = self.evidence.screening, self.cache
        end = maximise(pool, start, tolerance=0.3, max_steps=steps, cache=cache)
        if DELAY not in start.free:
            return end
        held = maximise(pool, start.fix({DELAY: None}), tolerance=0.3, max_steps=steps, cache=cache).model
        freed = replace(held, parameters={**held.parameters, DELAY: start.parameter(DELAY)})
        again = maximise(pool, freed, tolerance=0.3, max_steps=steps, cache=cache)
        return again if again.value > end.value else end

    def _screen_in_each(self, effect: str, shared: float) -> Maximum | None:
        """The effect with what starts anew free in each recording; None where that is not surely worth it.

        shared: log-likelihood with it shared by all
        """
        pool = self.evidence.screening
        starts = [start_in_each(pool, m, effect) for m in (self.base_screened.model, self.restart) if m is not None]
        start = max((s for s in starts if s is not None), key=lambda s: s[1], default=None)
        if start is None or start[1] < self.base_screened.value + MIN_SCREENED_NATS:
            return None
        end = maximise(pool, start[0], tolerance=0.3, max_steps=SCREEN_STEPS_OWN, cache=self.cache)
        of_own = chance_of_gain(effect, end.value - self.base_screened.value, 1, own_values(end.model, effect))
        of_shared = chance_of_gain(effect, shared - self.base_screened.value, 1)
        return end if of_own < min(WORTH_P, of_shared) else None

    def fit(self, start: Maximum, leading: bool) -> Maximum:
        """A screened candidate on the fit pixels."""
        steps = LEADING_STEPS if leading else FIT_STEPS
        return maximise(self.evidence.fitting, start.model, tolerance=0.02, max_steps=steps, cache=self.cache)

    def fit_without(self, effect: str, end: Maximum) -> Maximum:
        """The model without an effect, from the values that it has with it."""
        less = remove_effect(end.model, effect, self.base.model)
        return maximise(self.evidence.fitting, less, tolerance=0.1, max_steps=WITHOUT_STEPS, cache=self.cache)

    def held_out_gain(self, better: Maximum, worse: Maximum) -> np.ndarray:
        """(select pixels,) nats that one model gains on another."""
        pool = self.evidence.judging
        return per_pixel(pool, better.model) - per_pixel(pool, worse.model)


def candidates_of(
    evidence: PixelEvidence, model: Model, restart: Model | None, cache: FitCache | None
) -> PixelCandidates:
    """Evidence for candidates beside a model, from its fitted values.

    Args:
        evidence: Weighed by the model's circuit.
        model: At its fitted values.
        restart: The model at shipped values, where what is missing may have led the fitted ones astray.
        cache: Fits already made.
    """
    screened = maximise(evidence.screening, model, tolerance=0.1, max_steps=25, cache=cache)
    base = maximise(evidence.fitting, model, tolerance=0.05, max_steps=25, cache=cache)
    return PixelCandidates(evidence, screened, base, restart, cache)
