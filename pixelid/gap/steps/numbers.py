"""Numbers of a state that its confirmation needs: the free-run gap, and intervals of parameters."""

from __future__ import annotations

import numpy as np

from pixelid.gap.confirm.free_run import FreeRun, free_run
from pixelid.gap.confirm.intervals import in_units, interval_95
from pixelid.gap.imputation.impute import SIGMA
from pixelid.gap.options import Context
from pixelid.gap.state import Hypothesis, State
from pixelid.recordings.own_light import with_fine_light
from pixelid.statistics import Z95


def free_run_of(state: State, context: Context) -> FreeRun:
    """The gap before and after, on the pixels that nothing has looked at."""
    hypothesis, split = state.hypothesis, state.split
    between = hypothesis.evidence.between
    as_came, undone = (
        [with_fine_light(r, between) for r in some] for some in (state.recordings, hypothesis.recordings)
    )
    pixels = state.confirming_pixels
    hot = np.isin(pixels, state.hot.pixels) if state.hot is not None else None
    everyone = np.union1d(split.train, split.confirm)
    return free_run(
        as_came, undone, pixels, everyone, len(split.train), state.base.model, state.grown_model,
        context.options.criteria, context.options.seed, hot, context.work,
    )  # fmt: skip


def intervals_of(hypothesis: Hypothesis) -> dict[str, tuple[float, float]]:
    """95 % intervals of the free parameters, and of the jitter."""
    plain = interval_95(hypothesis.evidence.training, hypothesis.fit, hypothesis.scatter)
    if hypothesis.jitter is not None:
        sigma, error = hypothesis.jitter
        plain[SIGMA] = (sigma * (1.0 - Z95 * error), sigma * (1.0 + Z95 * error))
    if hypothesis.corrected is None:
        return plain
    moved, fit, corrected = {}, hypothesis.fit, hypothesis.corrected
    rows = zip(fit.coordinates.parameters, fit.x, corrected.shift, corrected.widened, strict=True)
    for i, (p, at, shift, factor) in enumerate(rows):
        low, high = (shift + at + factor * (p.to_coordinate(edge) - at) for edge in plain[p.name])
        moved[p.name] = in_units(fit.coordinates, i, low, high)
    return moved
