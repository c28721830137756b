"""Bricks of a field that were given up, or never held, and that events ask for.

Density that is not there has no gradient.  So some of the missing bricks are filled with haze of density σ and radiance
c₀ in a copy of the field, through which batches of chains are rendered.  With step h, T of the ray in front, R what it
collects behind and g = ∂ℓ/∂L, the gradients by a brick's logs are

    ∂ℓ/∂ln σ = Σ hσ g (T c₀ − R) = S        ∂ℓ/∂ln c = Σ hσ g T c₀ = V

and show what the loss would do with haze of any other radiance c there: Σ hσ g (T c − R) = S + (c/c₀ − 1) V, least at
the darkest or the brightest that there may be, by the sign of V.  As the best of two it would be negative for a brick
that nobody asks for, too; so c is chosen on some batches and judged on another, and only bricks that all of `PARTS`
ask for come back.  Chance does as well in 2^−PARTS of them: those clear again, and are given up when bricks follow
next.
"""

from __future__ import annotations

import copy
import dataclasses
import math
from typing import NamedTuple

import numpy as np
import torch

from pixelid.nerf import parallel
from pixelid.nerf.bricks import ROWS
from pixelid.nerf.predict import compared, draw, light
from pixelid.nerf.recipe import Recipe
from pixelid.nerf.render_kernels import CLEAR
from pixelid.nerf.state import Problem, State

HAZE = 2 * CLEAR  # opacity of a step: not passed over, and hardly hiding what is behind
PARTS = 4  # of a batch
MOST_SHARE = 0.02  # of the bricks that are held, that may come back at a time
EXTREMES = 0.01, 0.5, 0.99  # quantiles of the radiance that a scene shows: dark, haze, bright
BEYOND = np.array([-math.log(2.0), 0.0, math.log(2.0)])  # what is missing may be darker or brighter than all the rest


class Asked(NamedTuple):
    """where: (b, b, b) bool, bricks to come back;  log_radiance: (k, C) of them, in the order of their places."""

    where: np.ndarray
    log_radiance: np.ndarray


def asked_for(problem: Problem, recipe: Recipe, state: State, rng: np.random.Generator) -> Asked | None:
    """Missing bricks that a batch asks for, of a random part of them: as many as are held, at most.

    Args:
        problem: what is reconstructed from.
        recipe: with the batch.
        state: whose field lacks bricks; it is left as it is.
        rng: the same in all processes.

    Returns:
        The bricks, None where there are none.
    """
    field = state.field
    missing, held = np.argwhere(field.bricks.index == 0), field.bricks.number
    if len(missing) == 0 or held == 0:
        return None
    looked_at = np.zeros(field.bricks.index.shape, bool)
    looked_at[tuple(missing[rng.permutation(len(missing))[:held]].T)] = True
    dark, middle, bright = _shown(state)
    probe = copy.deepcopy(field)
    number = int(looked_at.sum())
    probe.rearrange(
        looked_at | (field.bricks.index > 0), np.full(number, math.log(HAZE / field.step)),
        np.broadcast_to(middle, (number, len(middle))),
    )  # fmt: skip
    seen = looked_at[tuple(slice(k) for k in probe.occupied.shape)]
    probe.occupied[seen] = 1
    slopes = _slopes(problem, recipe, dataclasses.replace(state, field=probe), probe.bricks.index[looked_at], rng)
    by_density, by_radiance = slopes[..., 0], slopes[..., 1:]  # (PARTS, k), (PARTS, k, C)
    factors = np.where(by_radiance.sum(axis=0) - by_radiance > 0, np.exp(dark - middle), np.exp(bright - middle))
    by_each = by_density + ((factors - 1.0) * by_radiance).sum(axis=-1)
    score = np.where((by_each < 0).all(axis=0), by_each.sum(axis=0), 0.0)
    best = np.argsort(score, kind="stable")[: max(int(MOST_SHARE * held), 1)]
    best = np.sort(best[score[best] < 0])
    if len(best) == 0:
        return None
    where = np.zeros_like(looked_at)
    where[tuple(np.argwhere(looked_at)[best].T)] = True
    return Asked(where, np.where(by_radiance.sum(axis=0)[best] > 0, dark, bright))


def _shown(state: State) -> tuple[np.ndarray, ...]:
    """(C,) log radiance, dark, middle and bright, of what has the density to show; of all where nothing has."""
    grid = state.field.grid.detach().cpu().numpy()[ROWS:]
    dense = grid[:, 0] > math.log(10 * CLEAR / state.field.step)
    shown = np.quantile(grid[dense if dense.any() else slice(None), 1:], EXTREMES, axis=0)
    return tuple(shown + BEYOND[:, None])


def _slopes(
    problem: Problem, recipe: Recipe, state: State, numbers: np.ndarray, rng: np.random.Generator
) -> np.ndarray:  # fmt: skip
    """(PARTS, k, 1 + C) gradient of the losses of events by the logs of bricks of these numbers (k,), part by part."""
    found, grid = [], state.field.grid
    for part in range(PARTS):
        own = np.random.default_rng([int(rng.integers(2**31)), parallel.rank(), part])
        batch = draw(problem, state, problem.training, max(recipe.batch // (PARTS * parallel.world()), 1), own)
        u, _ = light(problem, state, batch, own, recipe.engine)
        loss = compared(problem, recipe.weights, state, batch, u, recipe.engine)[0]
        grid.grad = torch.autograd.grad(loss, grid)[0]
        parallel.average_gradients([grid])
        of_bricks = grid.grad.reshape(-1, ROWS, grid.shape[1]).sum(dim=1).cpu().numpy()
        found.append(of_bricks[numbers])
    return np.stack(found).astype(float)
