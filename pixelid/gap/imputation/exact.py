"""What may be lost where times are drawn, and what intervals of exactly known times say, behind a queue.

While a readout is busy, times are drawn, and an event drawn into the wrong place leaves an interval that nothing
explains but a lost event.  Events get lost by chance, whatever the readout does: then intervals that begin and end
while it was idle, whose times are known, lack as large a share.  What they leave unexplained, drawn times do, too.
Behind a jitter or a coarse tick no time is known, and only a share counts that drawing does not leave by itself.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import poisson

from pixelid.gap.detect.diagnostics import chance_of_background
from pixelid.gap.imputation.imputed import QUEUE, Imputation
from pixelid.gap.options import Options
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.model import Model

LOST, FRACTION = "lost_events", "lost_events.fraction"
# Intervals of a recording whose times are exact, by which the model is judged there: five simulated sessions, their
# models right or nearly so, left 0 to 3e-4 of them unexplained; the few of a busy readout would tell less.
MIN_EXACT = 100
SPOILED = 2.0  # drawn times that an event which the model lacks makes unexplained: on either side of it


def loses_where_times_are_exact(imputation: Imputation, fitted: Model, without: Model, options: Options) -> bool:
    """Whether intervals of exact times lack events, and may lack as many as fitted; of paths, whether many are lost.

    Args:
        imputation: with the times drawn last.
        fitted: with lost events.
        without: the same without them, fitted.
        options: with the share of the fitted fraction that they must lack, and the chance to find too few of so many.

    Returns:
        False where they are too few.
    """
    if not imputation.windows or not (imputation.by_paths or imputation.effect == QUEUE):
        return True
    if imputation.by_paths:
        return fitted.values[FRACTION] >= options.criteria.min_lost_fraction_at_drawn_times
    likelihood, criteria = imputation.likelihood, options.criteria
    exact = exact_intervals(imputation, likelihood)
    number = np.count_nonzero(exact)
    unexplained = int(likelihood.terms(without.circuit()).unexplained[exact].sum())
    expected = criteria.min_lost_share_at_exact_times * fitted.values[FRACTION] * number
    if chance_of_background(unexplained, criteria.max_unexplained_fraction * number) >= options.alpha_each:
        return False  # no more than a true model leaves
    return bool(poisson.cdf(unexplained, expected) >= options.alpha_each)


def exact_intervals(imputation: Imputation, likelihood: EventTimes) -> np.ndarray:
    """(n,) bool, intervals of the imputation's likelihood whose events did not wait."""
    return np.concatenate([
        (window.lo == window.hi)[intervals.event] & (window.lo == window.hi)[intervals.previous_event]
        for window, intervals in zip(imputation.windows, likelihood.intervals, strict=True)
    ])  # fmt: skip


def keeps_its_times(imputation: Imputation, model: Model, most: float) -> np.ndarray:
    """(recordings,) bool, whether drawn times leave few events of a recording unexplained.

    Few is `most` of them, beyond what the model leaves unexplained where times are exact.  Where exact times of a
    recording leave more than that by themselves, it is the model that lacks something, and no recording is told by it.
    """
    likelihood = imputation.likelihood
    unexplained, of = likelihood.terms(model.circuit()).unexplained, likelihood.recording_of_event
    exact = exact_intervals(imputation, likelihood)

    def shares(some: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        number = np.bincount(of[some], minlength=len(likelihood.recordings))
        return np.bincount(of[some], unexplained[some], len(number)) / np.maximum(number, 1), number

    where_exact, number = shares(exact)
    if (where_exact[number >= MIN_EXACT] > most).any():
        return np.ones(len(number), bool)
    lacking = float(where_exact @ number) / max(int(number.sum()), 1)
    return shares(np.ones_like(exact))[0] <= most + SPOILED * lacking
