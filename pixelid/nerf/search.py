"""The gap in the scene itself: what the pixel lacks, found in what a scene leaves unexplained of held-out events.

A scene is trained coarsely under the pixel as it is told.  Every candidate is then added, at a strength that the
residuals suggest, and trained on together with the scene for some steps; so is the pixel without it.  A scene bends to
what its pixel lacks (a leak becomes light that brightens on and on), so residuals of one scene under two pixels would
hide most of it; two scenes, each trained under its own pixel, do not.  What explains events of held-out pixels best is
kept, if chance would not do as well, and the search goes on beside it.  Views are never asked.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch

from pixelid.nerf.additions import ADDITIONS
from pixelid.nerf.calibration import Calibration
from pixelid.nerf.limits import ALPHA, LEAST_SHARE
from pixelid.nerf.pixel import FILTER, Bandwidth, Pixel, filter_parameters
from pixelid.nerf.pixel_maps import MISMATCH
from pixelid.nerf.predict import draw, predict
from pixelid.nerf.recipe import Recipe
from pixelid.nerf.residuals import Gain, compare, residual_map, rows_of
from pixelid.nerf.state import Problem, State, start
from pixelid.nerf.train import train

EFFECTS = {"refractory": "refractory_period"}  # where the library has another name than training
BANDWIDTH, MISMATCHED = "bandwidth", "threshold_mismatch"
# Polarity memory is not: events of one polarity follow each other within edges, where a coarse scene lacks contrast,
# and it was named in a camera that has none.
SEARCHED = ("refractory", "leak", "parasitic_photocurrent", "threshold_drift")
HELD_OUT = 0.1  # share of the pixels that judge; the final training holds out less
WARM, TRIAL = 1 / 3, 1 / 12  # shares of the recipe's steps: of the first scene, and of every candidate
MOST_ROUNDS = 3
# Times that the strengths of what was kept are renewed before the next round: a scene gives back what it has taken of
# an effect by and by, and neighbours of the effect would be named for the rest
SETTLING = 2
SCREENED = 512  # chains that suggest strengths
# A dead time cannot be longer than any interval, and one that matters is hardly shorter; so close to it that what went
# on meanwhile can still be told from the time that was left to look.
WITHIN = 0.8
TIE = 0.01  # of the loss: of candidates that explain as much, the first in the list is taken

Make = Callable[[Calibration, tuple[str, ...]], Problem]


@dataclass(frozen=True)
class Trial:
    """A candidate in one round: name in the effect library, what it was trained from and to, what it explained."""

    name: str
    start: Mapping[str, float]
    values: Mapping[str, float]
    gain: Gain

    def as_dict(self) -> dict[str, Any]:
        """An entry of "gap" in reconstruction.json."""
        return {
            "name": self.name, "start": dict(self.start), "values": dict(self.values),
            "heldout_gain": self.gain.share, "p_value": self.gain.p_value, "rows": self.gain.rows,
        }  # fmt: skip


@dataclass(frozen=True)
class Found:
    """What a search found.

    calibration: with the effects at the strengths found;  trained: names of `Bandwidth.trained` to train on;  kept:
    the trials that were kept, in order;  rounds: all trials of every round;  gain: of all that was kept together, over
    the same scene trained as long without;  psnr: of a validation view of those two scenes, dB;  residuals: of
    `residual_map`
    """

    calibration: Calibration
    trained: tuple[str, ...]
    kept: tuple[Trial, ...]
    rounds: tuple[tuple[Trial, ...], ...]
    gain: Gain | None = None
    psnr: tuple[float, float] | None = None
    residuals: Mapping[str, Any] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """The entry "gap" of reconstruction.json."""
        return {
            "effects": [trial.as_dict() for trial in self.kept],
            "heldout_gain": self.gain.share if self.gain else 0.0,
            "coarse_psnr": {"before": self.psnr[0], "after": self.psnr[1]} if self.psnr else None,
            "residuals": dict(self.residuals),
            "rounds": [[trial.as_dict() for trial in trials] for trials in self.rounds],
            "alpha": ALPHA,
        }


def search(
    calibration: Calibration, bandwidth: Bandwidth, recipe: Recipe, make: Make, *, mapped: bool = False,
    score: Callable[[State], float] = lambda state: math.nan, device: str = "cpu",
    progress: Callable[[str, float], None] = lambda what, share: None,
) -> Found:  # fmt: skip
    """Find effects that the pixel of a dataset lacks.

    Args:
        calibration: of the camera and its pixel.
        bandwidth: how the pixel enters.
        recipe: of the training that follows; its first grid and a share of its steps are used here.
        make: the problem under a calibration, with what training is to move.
        mapped: whether thresholds of single pixels are known from a map.
        score: PSNR of a scene, for the record: nothing is decided by it.
        device: "cpu" or "cuda".
        progress: called with what is done and the fraction.

    Returns:
        The pixel with what was found.
    """
    coarse = replace(recipe, vertices=recipe.vertices[:1])
    warm, steps = max(round(WARM * recipe.iterations), 1), max(round(TRIAL * recipe.iterations), 1)
    names = _candidates(calibration, bandwidth, mapped)
    # as if the search kept one effect; it may keep none, or more
    total, done = float(warm + 2 * (len(names) + 1) * steps), 0.0

    def report(now: State, measured: dict[str, float]) -> None:
        nonlocal done
        done += 1.0
        progress(f"searching for effects, loss {measured['loss']:.3f}", min(done / total, 1.0))

    unit = 0.5 * float(calibration.circuit.on_threshold + calibration.circuit.off_threshold)
    problem = make(calibration, bandwidth.moving)
    state = train(problem, coarse, start(problem, coarse, bandwidth, device), until=warm, report=report)
    calibration = settled(calibration, state.pixel, problem)
    problem = make(calibration, bandwidth.moving)
    told = problem, calibration, state  # what goes on under the pixel as told, for comparison at the end
    trained: tuple[str, ...] = ()
    kept: list[Trial] = []
    rounds: list[tuple[Trial, ...]] = []

    def grown(state: State, calibration: Calibration, trained: tuple[str, ...]) -> tuple[State, Calibration]:
        """Scene and pixel after as many steps as a trial takes, from strengths that the residuals suggest."""
        using = replace(bandwidth, trained=(*bandwidth.trained, *trained))
        every = make(calibration, (*using.moving, *ADDITIONS))
        suggested = suggestions(every, state)
        for name in trained:
            calibration = _begun(name, calibration, suggested, every)
        problem = make(calibration, using.moving)
        state = _go_on(problem, state, coarse, using, steps, device, report)
        return state, settled(calibration, state.pixel, problem)

    while len(rounds) < MOST_ROUNDS and names and not state.diverged:
        using = replace(bandwidth, trained=(*bandwidth.trained, *trained))
        every = make(calibration, (*using.moving, *ADDITIONS))
        suggested = suggestions(every, state)
        problem = make(calibration, using.moving)
        plain = _go_on(problem, state, coarse, using, steps, device, report)
        reference = rows_of(problem, plain, problem.held_out, unit)
        trials, states = [], []
        for name in names:
            begun = _begun(name, calibration, suggested, every)
            moved = replace(using, trained=tuple(dict.fromkeys((*using.trained, *_trained_by(name, calibration)))))
            its_problem = make(begun, moved.moving)
            after = _go_on(its_problem, state, coarse, moved, steps, device, report)
            gain = compare(reference, rows_of(its_problem, after, its_problem.held_out, unit))
            trials.append(Trial(EFFECTS.get(name, name), _told(name, begun), _values(name, after.pixel), gain))
            states.append((after, settled(begun, after.pixel, its_problem), moved))
        rounds.append(tuple(trials))
        most = max(trial.gain.share for trial in trials)
        best = next(k for k, trial in enumerate(trials) if trial.gain.share > most - TIE)
        if trials[best].gain.p_value * len(names) > ALPHA or trials[best].gain.share < LEAST_SHARE:
            state, calibration = plain, settled(calibration, plain.pixel, problem)
            break
        state, calibration, moved = states[best]
        trained = tuple(name for name in moved.trained if name not in bandwidth.trained)
        for _ in range(SETTLING):
            state, calibration = grown(state, calibration, trained)
        kept.append(trials[best])
        names = tuple(name for k, name in enumerate(names) if k != best)
        total = max(total, done + (len(names) + 2) * steps)
    if not kept:
        return Found(told[1], (), (), tuple(rounds))
    problem, alone = told[0], told[2]
    alone = _go_on(problem, alone, coarse, bandwidth, state.iteration - alone.iteration, device, report)
    before = rows_of(problem, alone, problem.held_out, unit)
    problem = make(calibration, (*bandwidth.moving, *trained))
    state = _moved_to(problem, state, coarse, replace(bandwidth, trained=(*bandwidth.trained, *trained)), device)
    after = rows_of(problem, state, problem.held_out, unit)
    return Found(
        calibration, trained, tuple(kept), tuple(rounds), compare(before, after), (score(alone), score(state)),
        residual_map(before, after),
    )  # fmt: skip


def suggestions(problem: Problem, state: State) -> dict[str, float]:
    """By how much each of `ADDITIONS` would best move to explain residuals of training chains, the scene held.

    One step of Gauss and Newton under Huber's weights, beside a factor of all thresholds: the contrast that a scene
    still lacks must not pass for an effect.  The scene has taken a part of every effect upon itself, so the strengths
    are too small.

    problem: with the tilts of all, under what the state's pixel has been trained to
    """
    bandwidth = replace(state.pixel.bandwidth, trained=tuple(ADDITIONS))
    pixel = Pixel(problem.circuit, bandwidth, state.pixel.maps).to(state.pixel.nominal.device)
    with torch.no_grad():
        pixel.departures.copy_(state.pixel.departures)
    probe = replace(state, pixel=pixel)
    batch = draw(problem, probe, problem.training, SCREENED, np.random.default_rng(7))

    def change() -> np.ndarray:
        with torch.no_grad():
            return predict(problem, probe, batch, np.random.default_rng(8))[0].cpu().numpy()

    on, off = (float(x) for x in pixel.thresholds)
    at = change()
    said = batch.rise * on - batch.fall * off
    rest = said - at
    deviation = 0.5 * (on + off) * np.sqrt(1.0 + batch.variance)
    weight = batch.weight / deviation**2 * np.minimum(1.0, deviation / np.maximum(np.abs(rest), 1e-12))
    found = {}
    for k, name in enumerate(ADDITIONS):
        with torch.no_grad():
            pixel.added[k] = 1.0
            slope = change() - at
            pixel.added[k] = 0.0
        slope = slope - said * (weight * said * slope).sum() / (weight * said**2).sum()
        curvature = float((weight * slope**2).sum())
        step = float(pixel.steps[k])
        found[name] = step * float((weight * slope * rest).sum()) / curvature if curvature > 0 else 0.0
    return found


def settled(calibration: Calibration, pixel: Pixel, problem: Problem) -> Calibration:
    """The calibration with what training has moved in place of what it began with.

    problem: that it was trained in
    """
    changed = {a.field: float(pixel.strength(name).detach()) for name, a in ADDITIONS.items() if pixel.adds_to(name)}
    numbers: dict[str, float] = dict(zip(FILTER, pixel.dynamics.detach().tolist(), strict=False))
    moving = [name for name, moves in zip(FILTER, pixel.moves.tolist(), strict=False) if moves]
    changed |= {name: float(numbers[name]) for name in moving}
    added = {name: float(pixel.addition(name).detach()) for name in problem.tilts}
    factor = math.prod(tilt.threshold_factor(added[name]) for name, tilt in problem.tilts.items())
    on, off = (factor * float(x.detach()) for x in pixel.thresholds)
    changed |= {"on_threshold": on, "off_threshold": off}
    return replace(calibration, circuit=calibration.circuit.with_(**changed))


def _candidates(calibration: Calibration, bandwidth: Bandwidth, mapped: bool) -> tuple[str, ...]:
    """Names of what is tried: `ADDITIONS`, mismatch, and a filter slower or faster than told."""
    circuit = calibration.circuit
    names = [name for name in SEARCHED if name not in bandwidth.moving]
    if not mapped and circuit.mismatch < MISMATCH:
        names.append(MISMATCHED)
    if bandwidth.mode == "on" and circuit.photoreceptor == "second_order":
        names.append(BANDWIDTH)
    return tuple(names)


def _trained_by(name: str, calibration: Calibration) -> tuple[str, ...]:
    """What of the pixel a candidate trains; a dead time is held, since training knows it to first order only."""
    if name == BANDWIDTH:
        return tuple(part for part in ("alpha", "follower") if part in filter_parameters(calibration.circuit))
    return (name,) if name in ADDITIONS and name != "refractory" else ()


def _begun(name: str, calibration: Calibration, suggested: Mapping[str, float], problem: Problem) -> Calibration:
    """The calibration that a candidate begins with."""
    circuit = calibration.circuit
    if name == MISMATCHED:
        return replace(calibration, circuit=circuit.with_(mismatch=MISMATCH))
    if name not in ADDITIONS:
        return calibration
    addition = ADDITIONS[name]
    value = max(getattr(circuit, addition.field) + suggested[name], addition.least)
    if name == "refractory":
        value = WITHIN * problem.shortest
    added = value - getattr(circuit, addition.field)
    factor = problem.tilts[name].threshold_factor(added) if name in problem.tilts else 1.0
    on, off = factor * circuit.on_threshold, factor * circuit.off_threshold
    return replace(
        calibration, circuit=circuit.with_(**{addition.field: value, "on_threshold": on, "off_threshold": off})
    )


def _told(name: str, calibration: Calibration) -> dict[str, float]:
    """Parameters of a candidate where it begins, by their names in the library."""
    circuit = calibration.circuit
    if name == MISMATCHED:
        return {"threshold_mismatch.sigma": circuit.mismatch}
    if name == BANDWIDTH:
        return {"alpha": circuit.alpha, "follower": circuit.follower}
    return {ADDITIONS[name].parameter: getattr(circuit, ADDITIONS[name].field)}


def _values(name: str, pixel: Pixel) -> dict[str, float]:
    """The same after training; of the mismatch, the spread that thresholds of single pixels have come to."""
    if name == MISMATCHED:
        return {"threshold_mismatch.sigma": float(np.hypot(*pixel.threshold_spread()) / np.sqrt(2.0))}
    values = pixel.values()
    if name == BANDWIDTH:
        return {part: values[part] for part in ("alpha", "follower")}
    return {ADDITIONS[name].parameter: values[ADDITIONS[name].parameter]}


def _go_on(
    problem: Problem, state: State, recipe: Recipe, bandwidth: Bandwidth, steps: int, device: str,
    report: Callable[[State, dict[str, float]], None],
) -> State:  # fmt: skip
    """A copy of the state, trained on for some steps under another problem and pixel."""
    copy = _moved_to(problem, state, recipe, bandwidth, device)
    return train(problem, recipe, copy, until=copy.iteration + steps, report=report)


def _moved_to(problem: Problem, state: State, recipe: Recipe, bandwidth: Bandwidth, device: str) -> State:
    """The scene of a state under another problem and pixel; what a pixel's thresholds were trained to stays."""
    copy = start(problem, recipe, bandwidth, device)
    with torch.no_grad():
        copy.field.grid.copy_(state.field.grid)
        copy.field.log_background.copy_(state.field.log_background)
        if copy.pixel.departures.requires_grad and state.pixel.departures.requires_grad:
            copy.pixel.departures.copy_(state.pixel.departures)
    copy.field.occupied = state.field.occupied.copy()
    copy.iteration, copy.rays = state.iteration, state.rays
    return copy
