"""What a scene says of pixels that training did not see: the terms of the loss, events and silence alike."""

from __future__ import annotations

import numpy as np
import torch

from pixelid.nerf.losses import quiet_change, terms
from pixelid.nerf.predict import draw, draw_quiet, light, response
from pixelid.nerf.state import Problem, State

RUNS, PAIRS = 1024, 8192  # chains, and pairs of times in which nothing fired; the same ones every time


def held_out_losses(problem: Problem, state: State, engine: str = "auto") -> dict[str, float]:
    """The terms of the loss on events and silence of held-out pixels.

    Args:
        problem: whose held-out pixels are asked.
        state: of the training; it stays as it is.
        engine: of `render` and `respond`.

    Returns:
        Means of "diff", "tv", "chain" and "quiet", without weights; those that no pixel tells of are not there.
    """
    if len(problem.held_out.starts) == 0:
        return {}
    rng = np.random.default_rng(2)
    with torch.no_grad():
        batch = draw(problem, state, problem.held_out, RUNS, rng)
        pairs = draw_quiet(problem, state, problem.quiet_held_out, PAIRS, rng)
        u, in_quiet = light(problem, state, batch, rng, engine, pairs)
        change, level = response(problem, state, batch, u, engine)
        parts = terms(change, level, batch, *state.pixel.thresholds_at(batch.pixel))
        if pairs is not None:
            parts = parts | {"quiet": quiet_change(in_quiet, *state.pixel.thresholds)}
    return {name: float(value) for name, value in parts.items()}
