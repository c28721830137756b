"""Candidates judged by stretches of time: fits of the pooled rate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pixelid.errors import InputError
from pixelid.fit.pooled import READOUT, read_out
from pixelid.gap.attribute.attribute import Report
from pixelid.gap.attribute.candidates import missing, remove_effect, variants
from pixelid.gap.pooled_counts.stretches import Fitted, Stretches
from pixelid.model.model import Model
from pixelid.recordings.bursts import bursts_of

# Of the optimiser: neighbouring models start near each other, and the first steps show which of them lead.
STEPS, FIRST_STEPS = 12, 4
FIT, SELECT = 0, 1  # roles of stretches
LIGHT_SPREAD = "light_spread"  # which only pooled counts have
# Counts in bins of 50 µs blur what moves single events, and an event lost is a pixel fewer or a higher threshold.
NOT_IN_COUNTS = {"timestamp_jitter", "lost_events"}
ONLY_IN_COUNTS = (LIGHT_SPREAD, "readout_latency")


@dataclass(frozen=True)
class PooledCandidates:
    """The `Evidence` of stretches of time.

    Attributes:
        stretches: The counts.
        base: The model under test, on the stretches to fit.
    """

    stretches: Stretches
    base: Fitted

    def screen(self, effects: Sequence[str], report: Report) -> list[tuple[Fitted, float] | None]:
        """For each effect (it fitted to the stretches to fit, quasi nats gained), from the best of the strengths."""
        screened = []
        for effect in effects:
            report(effect)
            screened.append(self._screen(effect))
        return screened

    def _screen(self, effect: str) -> tuple[Fitted, float] | None:
        part, base = self.stretches.part(FIT), self.base
        best: tuple[float, Model] | None = None
        trials = variants(base.model, effect)
        if effect == READOUT:
            trials = [read_out(base.model.with_effect(READOUT), map(bursts_of, self.stretches.whole.recordings))]
        for trial in trials:
            try:
                value = part.log_likelihood(part.expected(trial.circuit(), {**base.nuisances, **trial.values}))
            except (InputError, FloatingPointError):
                continue
            if np.isfinite(value) and (best is None or value > best[0]):
                best = value, trial
        if best is None:
            return None
        end = self.stretches.fit(best[1], base.nuisances, part, FIRST_STEPS)
        return end, end.value - base.value

    def fit(self, starts: Sequence[tuple[str, Fitted]], report: Report) -> list[Fitted]:
        """The candidates from where screening left them."""
        return [self.stretches.fit(end.model, end.nuisances, self.stretches.part(FIT), STEPS) for _, end in starts]

    def fit_without(self, effect: str, end: Fitted) -> Fitted:
        """The model without an effect, from the values that it has with it."""
        less = remove_effect(end.model, effect, self.base.model)
        return self.stretches.fit(less, end.nuisances, self.stretches.part(FIT), STEPS)

    def held_out_gain(self, better: Fitted, worse: Fitted) -> np.ndarray:
        """(select stretches,) quasi nats that one model gains on another."""
        return self.stretches.by_stretch(SELECT, better, worse)


def pooled_candidates(stretches: Stretches, model: Fitted) -> PooledCandidates:
    """Evidence for candidates beside a model fitted to the training stretches."""
    return PooledCandidates(stretches, stretches.fit(model.model, model.nuisances, stretches.part(FIT), STEPS))


def effects_to_try(stretches: Stretches, model: Model, leave_out: Sequence[str]) -> list[str]:
    """Effects that a model lacks and pooled counts can show.

    A shared readout alone, where bursts show one: as long as pixels are taken not to wait, others stand in for it.
    """
    if READOUT not in leave_out and not model.has(READOUT) and any(stretches.whole.cycles):
        return [READOUT]
    shaped = any(r.stimulus is not None and r.stimulus.unit == "shape" for r in stretches.whole.recordings)
    # where the light is known up to an offset, dark current is that offset
    skip = {*leave_out, *NOT_IN_COUNTS, *(("dark_current",) if shaped else ())}
    there = [*missing(model), *(effect for effect in ONLY_IN_COUNTS if not model.has(effect))]
    return [effect for effect in there if effect not in skip]
