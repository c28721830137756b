"""Training: batches of chains, rendered, filtered by the pixel, compared with the events.

State is explicit: `start → step → step …`; a state written to disk and read back continues with the same numbers.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import torch

from pixelid.nerf.field.radiance import WHOLE
from pixelid.nerf.field.render import Rays
from pixelid.nerf.field.smoothness import mean_log_density, mean_square, variation
from pixelid.nerf.training import parallel
from pixelid.nerf.training.losses import quiet_change, terms, total, unexplained, variance_left
from pixelid.nerf.training.predict import EPSILON, draw, draw_quiet, light, predict, response
from pixelid.nerf.training.recipe import Recipe
from pixelid.nerf.training.state import Problem, State, follow, optimiser_of

# Steps, not a share of them, before which clear space cannot be told from a scene that has not grown yet: Adam moves a
# log density by its rate at most, a tenth a step.
FIRST_LOOK = 64
FOLLOW = 64  # steps after which the bricks of a fine field follow the scene, by one at a time
LEVEL_RAYS = 512  # of the reference views in a step, whose mean light is compared
JUDGED = 512  # held-out chains, the same ones every time
PAIRS = 3  # of times in which nothing fired, per chain: a twentieth of the rays of a step


def step(problem: Problem, recipe: Recipe, state: State) -> dict[str, float]:
    """One step of training, in place; what it measured.  A loss that is no number changes nothing but `diverged`."""
    wanted = recipe.vertices_at(state.iteration)
    if wanted != state.field.vertices and (wanted <= WHOLE or state.iteration >= FIRST_LOOK):
        state.field.refine(wanted)
        state.optimiser = optimiser_of(state.field, state.pixel, state.poses, recipe)
    for group in state.optimiser.param_groups:
        group["lr"] = recipe.rate_at(state.iteration) * group["share"]
    rng = np.random.default_rng([recipe.seed, parallel.rank(), state.iteration])  # nothing to carry between steps
    batch = draw(problem, state, problem.training, max(recipe.batch // parallel.world(), 1), rng)
    pairs = draw_quiet(problem, state, PAIRS * len(batch.pixel) if recipe.quiet > 0 else 0, rng)
    u, in_quiet = light(problem, state, batch, rng, pairs)
    change, level = response(problem, state, batch, u)
    thresholds, growth = state.pixel.thresholds_at(batch.pixel), state.pixel.growth
    parts = terms(change, level, batch, *thresholds, growth)
    loss = total(parts, recipe.weights)
    if recipe.roughness > 0:
        varies = variation(state.field.grid, state.field.bricks)
        loss = loss + state.regularisation.factor * (recipe.roughness * varies / growth)
    if recipe.emptiness > 0:
        loss = loss + recipe.emptiness * mean_log_density(state.field.grid, state.field.bricks)
    if recipe.stiffness > 0 and state.field.coefficients.requires_grad:
        loss = loss + recipe.stiffness * mean_square(state.field.coefficients, state.field.bricks) / growth**2
    if pairs is not None:
        loss = loss + recipe.quiet * quiet_change(in_quiet, *state.pixel.thresholds)
    if problem.gauge.kind == "level":
        loss = loss + recipe.level * _off_level(problem, state, rng)
    if any(values.requires_grad for values in state.pixel.parameters()):
        left = variance_left(change, batch, *thresholds)
        loss = loss + state.pixel.penalty(left) / max(len(problem.training.starts), 1)
    if state.poses.trained:
        loss = loss + state.poses.penalty() / max(len(problem.training.starts), 1)
    measured = {"loss": float(loss.detach()), **{name: float(value.detach()) for name, value in parts.items()}}
    if not math.isfinite(parallel.average(measured["loss"])):
        state.diverged = True
        return measured
    state.optimiser.zero_grad(set_to_none=True)
    loss.backward()
    parallel.average_gradients(p for group in state.optimiser.param_groups for p in group["params"])
    state.optimiser.step()
    state.pixel.keep_within_bounds()
    state.iteration += 1
    state.rays += len(batch.t)
    if state.iteration % 16 == 0 and state.iteration >= FIRST_LOOK:
        state.field.look_for_empty_blocks()
        if state.iteration % FOLLOW == 0:
            follow(state)
    return measured


def _off_level(problem: Problem, state: State, rng: np.random.Generator) -> torch.Tensor:
    """Squared distance of the mean log light over random rays from that of the reference views, mean over colours.

    Dark current is part of the light: below it the events say nothing, and a mean of logs would be full of it.
    """
    views = problem.gauge.reference
    assert views is not None  # a gauge of this kind has them
    which = rng.integers(0, len(views), LEVEL_RAYS)
    x, y = rng.integers(0, views.camera.width, LEVEL_RAYS), rng.integers(0, views.camera.height, LEVEL_RAYS)
    channel = rng.integers(0, len(problem.dark), LEVEL_RAYS)
    inside = views.camera.directions(np.column_stack([x, y]))
    directions = np.einsum("nij,nj->ni", views.rotation[which], inside).astype(np.float32)
    rays = Rays(views.position[which].astype(np.float32), directions, channel, rng.random(LEVEL_RAYS, dtype=np.float32))
    radiance, _ = state.field(rays)
    floor = np.maximum(problem.dark, EPSILON)[channel]
    target = torch.as_tensor(
        np.log(views.images[which, y, x, channel] / views.exposure[which] + floor), device=radiance.device
    )
    off = torch.log(radiance.double() + torch.as_tensor(floor, device=radiance.device)) - target
    of_colour = (torch.mean(off[torch.as_tensor(channel == c)]) ** 2 for c in np.unique(channel))
    return torch.stack(list(of_colour)).mean()


def held_out_residual(problem: Problem, state: State) -> float:
    """What is left unexplained of held-out chains (see `unexplained`).

    Args:
        problem: whose held-out pixels are asked.
        state: of the training.

    Returns:
        Root mean square of what is left, as a share of what the events say; 1 would be no scene.
    """
    if len(problem.held_out.starts) == 0:
        return math.nan
    rng = np.random.default_rng(1)
    with torch.no_grad():
        batch = draw(problem, state, problem.held_out, JUDGED, rng)
        change, _, _ = predict(problem, state, batch, rng)
        thresholds = (x.cpu().numpy() for x in state.pixel.thresholds_at(batch.pixel))
    return unexplained(change.cpu().numpy(), batch, *thresholds)


def train(
    problem: Problem, recipe: Recipe, state: State, until: int | None = None,
    report: Callable[[State, dict[str, float]], None] = lambda state, measured: None,
) -> State:  # fmt: skip
    """Train until the recipe is done, or a step diverges.

    Args:
        problem: what is reconstructed from.
        recipe: how.
        state: where to begin; it is changed in place.
        until: stop at this step; by default the recipe's last.
        report: called after each step with the state and what the step measured.

    Returns:
        The state given.
    """
    while state.iteration < (recipe.iterations if until is None else until) and not state.diverged:
        report(state, step(problem, recipe, state))
    return state
