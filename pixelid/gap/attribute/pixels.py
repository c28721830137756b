"""Candidates judged by pixels: fits of the event-time likelihood on pools of pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pixelid.fit.cache import FitCache
from pixelid.fit.maximise import Maximum, maximise
from pixelid.gap.attribute.candidates import remove_effect, strongest_start
from pixelid.gap.detect.pixels import PixelEvidence, per_pixel
from pixelid.model.model import Model

POLES = ("source_follower_pole", "extra_pole", "differencing_pole")
# Optimiser steps of a screening fit.  Poles trade places with those that the model has, which takes longer.
SCREEN_STEPS, SCREEN_STEPS_POLES = 6, 15
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
        pool, steps = self.evidence.screening, SCREEN_STEPS_POLES if effect in POLES else SCREEN_STEPS
        for origin in (self.base_screened.model, self.restart):
            start = None if origin is None else strongest_start(pool, origin, effect, self.base_screened.value)
            if start is None:
                continue
            end = maximise(pool, start, tolerance=0.3, max_steps=steps, cache=self.cache)
            if best is None or end.value > best.value:
                best = end
        return None if best is None else (best, best.value - self.base_screened.value)

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
