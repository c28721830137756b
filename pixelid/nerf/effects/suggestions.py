"""Strengths of effects that residuals suggest, the scene held: where a search for what the pixel lacks begins."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.optimize import lsq_linear

from pixelid.nerf.effects.additions import ADDITIONS
from pixelid.nerf.pixel.model import Pixel
from pixelid.nerf.training.predict import draw, predict
from pixelid.nerf.training.state import Problem, State


@dataclass(frozen=True)
class Suggested:
    """What residuals of training chains say of strengths, the scene held.

    slopes: (rows,) of each of `ADDITIONS`, in standard deviations per unit of its strength, with a factor of all
    thresholds;  rest: (rows,) what is left unexplained, in standard deviations
    """

    slopes: Mapping[str, np.ndarray]
    rest: np.ndarray

    def of(self, least: Mapping[str, float]) -> dict[str, float]:
        """By how much strengths would best move together, each by its `least` (negative) or more."""
        found = dict.fromkeys(least, 0.0)
        told = [name for name in least if self.slopes[name].any()]
        if told:
            size = [float(np.linalg.norm(self.slopes[name])) for name in told]
            columns = np.column_stack([self.slopes[name] / n for name, n in zip(told, size, strict=True)])
            low = np.minimum([least[name] * n for name, n in zip(told, size, strict=True)], -1e-12)
            moved = lsq_linear(columns, self.rest, (low, np.inf)).x
            found |= {name: float(x / n) for name, x, n in zip(told, moved, size, strict=True)}
        return found


def suggestions(problem: Problem, state: State) -> Suggested:
    """How `ADDITIONS` would best move to explain residuals of training chains, the scene held.

    One step of Gauss and Newton under Huber's weights, with a factor of all thresholds: the contrast that a scene
    still lacks must not pass for an effect.  The scene has taken a part of every effect upon itself, so the strengths
    are too small.

    problem: with the tilts of all, under what the state's pixel has been trained to
    """
    bandwidth = replace(state.pixel.bandwidth, trained=tuple(ADDITIONS))
    pixel = Pixel(problem.circuit, bandwidth, state.pixel.maps).to(state.pixel.nominal.device)
    with torch.no_grad():
        pixel.departures.copy_(state.pixel.departures)
    probe = replace(state, pixel=pixel)
    screened = 512  # chains that suggest strengths
    batch = draw(problem, probe, problem.training, screened, np.random.default_rng(7))

    def change() -> np.ndarray:
        with torch.no_grad():
            return predict(problem, probe, batch, np.random.default_rng(8))[0].cpu().numpy()

    with torch.no_grad():
        on, off = (x.cpu().numpy() for x in pixel.thresholds_at(batch.pixel))
    at = change()
    said = batch.rise * on - batch.fall * off
    rest = said - at
    deviation = 0.5 * (on + off) * np.sqrt(1.0 + batch.variance)
    weight = batch.weight / deviation**2 * np.minimum(1.0, deviation / np.maximum(np.abs(rest), 1e-12))
    slopes = {}
    for k, name in enumerate(ADDITIONS):
        with torch.no_grad():
            pixel.added[k] = 1.0
            slope = change() - at
            pixel.added[k] = 0.0
        slope = slope - said * (weight * said * slope).sum() / (weight * said**2).sum()
        slopes[name] = (np.sqrt(weight) * slope).ravel() / float(pixel.steps[k])
    return Suggested(slopes, (np.sqrt(weight) * rest).ravel())
