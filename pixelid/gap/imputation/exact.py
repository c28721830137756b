"""What intervals of exactly known times say of lost events, behind a queue.

While a readout is busy, times are drawn, and an event drawn into the wrong place leaves an interval that nothing
explains but a lost event.  Events get lost by chance, whatever the readout does: then intervals that begin and end
while it was idle, whose times are known, lack as large a share.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import poisson

from pixelid.gap.imputation.imputed import QUEUE, Imputation
from pixelid.model.model import Model

LOST, FRACTION = "lost_events", "lost_events.fraction"
# Of the fitted fraction: beside true losses, some of what is unexplained among drawn times is misplaced.
MIN_SHARE = 0.5


def loses_where_times_are_exact(imputation: Imputation, fitted: Model, without: Model, alpha: float) -> bool:
    """Whether intervals of exact times may lack as many events as a fit says; true where times are no queue's.

    Args:
        imputation: with the times drawn last.
        fitted: with lost events.
        without: the same without them, fitted.
        alpha: chance of finding too few of half as many.

    Returns:
        False where they are too few.
    """
    if imputation.effect != QUEUE or not imputation.windows:
        return True
    likelihood = imputation.likelihood
    exact = np.concatenate([
        (window.lo == window.hi)[intervals.event] & (window.lo == window.hi)[intervals.previous_event]
        for window, intervals in zip(imputation.windows, likelihood.intervals, strict=True)
    ])  # fmt: skip
    unexplained = float(likelihood.terms(without.circuit()).unexplained[exact].sum())
    expected = MIN_SHARE * fitted.values[FRACTION] * np.count_nonzero(exact)
    return bool(poisson.cdf(unexplained, expected) >= alpha)
