"""Training whose regularisation, length and outcome are chosen by events of pixels that it has not seen.

Those events choose nothing but one factor of the regularisation and one of some states, so what `held_out_residual`
owes to the choice is below what separates two states (`held_out`).
"""

from __future__ import annotations

import copy
from collections.abc import Callable

import numpy as np

from pixelid.nerf.field.bricks import Bricks
from pixelid.nerf.options import AUTO
from pixelid.nerf.training import parallel
from pixelid.nerf.training.held_out import AHEAD, FACTORS, Look, Regularisation, chosen
from pixelid.nerf.training.recipe import Recipe
from pixelid.nerf.training.residuals import loss_of_pixels, rows_of
from pixelid.nerf.training.state import Problem, State, learned, take
from pixelid.nerf.training.train import train


def train_judged(
    problem: Problem, recipe: Recipe, state: State, report: Callable[[State, dict[str, float]], None] = lambda *_: None
) -> State:
    """Train until the recipe is done, held-out events have nothing more to win, or a step diverges.

    What is looked at and chosen follows from the state, so a state that is read back comes to the same end.

    Args:
        problem: what is reconstructed from, with the held-out events.
        recipe: how.
        state: where to begin; it is changed in place.
        report: called after each step with the state and what the step measured.

    Returns:
        The state given, as it is after the last step; `keep_best` brings back what is kept.
    """
    while not state.diverged:
        if _to_choose(problem, recipe, state):
            state.regularisation = _choose(problem, recipe, state)
        due = state.stopping.next
        if due is not None and state.iteration >= due:
            state.stopping.add(_look(problem, state), _copied(state))
            continue
        if state.stopping.stopped or state.iteration >= recipe.iterations:
            break
        until = recipe.last_stage if state.iteration < recipe.last_stage else due
        train(problem, recipe, state, until=until, report=report)
    return state


def keep_best(state: State) -> None:
    """Let a trained state be the one that held-out events speak for, unless it diverged; its optimiser is of no use."""
    stopping = state.stopping
    if not state.finite or not stopping.looks or stopping.kept == len(stopping.looks) - 1:
        return
    scene = stopping.scene
    take(state, Bricks.of_index(int(scene["vertices"]), scene["bricks"].cpu().numpy()), scene)


def _look(problem: Problem, state: State) -> Look:
    most_chains = 2048  # of held-out pixels, that are looked at: a look costs less than five steps of as many chains
    rows = rows_of(problem, state, problem.held_out, state.pixel.mean_threshold, most_chains)
    losses = parallel.agreed(loss_of_pixels(rows))  # on GPUs last digits differ, and with them what is decided
    return Look(state.iteration, losses, len(rows.rest))


def _copied(state: State) -> dict:
    return {name: value if isinstance(value, int) else value.clone() for name, value in learned(state).items()}


def _to_choose(problem: Problem, recipe: Recipe, state: State) -> bool:
    asked = recipe.regularisation == AUTO and recipe.roughness > 0 and len(problem.held_out.starts) > 0
    return asked and state.iteration == recipe.last_stage and not state.regularisation.trials


def _choose(problem: Problem, recipe: Recipe, state: State) -> Regularisation:
    """Go ahead from copies of the state, which itself stays where it is; one that diverges explains nothing."""
    until = min(state.iteration + max(round(AHEAD * recipe.iterations), 1), recipe.iterations)
    looks, losses = [], []
    for factor in (1.0, *FACTORS):
        ahead = copy.deepcopy(state, {id(state.inside): state.inside})
        ahead.regularisation = Regularisation(factor)
        look = _look(problem, train(problem, recipe, ahead, until=until))
        told = not ahead.diverged and np.isfinite(look.losses).all()
        looks.append(look)
        losses.append(look.losses if told else look.losses * np.nan)
    usual, *others = losses
    return chosen(usual, others, looks[0].rows)
