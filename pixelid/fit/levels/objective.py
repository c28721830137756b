"""The log posterior of a circuit whose pixels have levels of their own, at the best levels for each circuit.

With θ the camera's coordinates, u_i the levels of pixel i as `Scales.levels` reads them and l_i its log-likelihood,

    value(θ) = Σ_i max over u_i of [l_i(θ, u_i) − |u_i|²/2] + log prior of θ.

Levels act in their own pixel's terms alone, so one evaluation with every pixel's light changed gives all scores
∂l_i/∂u_i, and the curvatures B_i = −∂²l_i/∂u_i² + 1 are blocks as small as there are kinds of levels, however many
pixels there are.  At the best levels the gradient of the value is that of θ alone, and its second derivatives are the
Schur complement

    H = H_θθ + Σ_i H_θi B_i⁻¹ H_iθ,        du_i/dθ = B_i⁻¹ H_iθ,

whose negated inverse is the covariance of θ with the levels integrated out (Laplace's approximation).  What is left of
that, −Σ ½ ln det B_i, moves slowly with θ: its slope is a tilt of the value, estimated where the search last ended
(`scales.py`).  Without it levels would take up scatter that is noise's and mismatch's, as a mean does in a
variance.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pixelid.fit.coordinates import Coordinates
from pixelid.fit.event_times import EventTimesObjective, along
from pixelid.fit.levels.pixel_levels import FAR, Scales, seen_by
from pixelid.fit.objective import Local
from pixelid.likelihood.density import NUMBERS, Terms
from pixelid.likelihood.event_times import EventTimes
from pixelid.likelihood.information import Information, Tangent

STEP = 1e-6  # of a level in its standard deviations, for the slope of changes: as `event_times.STEP`
WIDER = 10.0  # steps of the Hessian, in those of a difference of gradients
TOLERANCE = 1e-7  # nats: below what the last steps of θ are judged by
MOST_STEPS = 40
ROUGH = 1e-3, 8  # tolerance and most steps over other coordinates, where 1.92 nats are asked about


@dataclass(frozen=True)
class At:
    """Every pixel's terms at levels u (p, k).

    objective: with these levels held;  value: (p,) log posterior by pixel;  score: (p, k) and block: (p, k, k) of it
    tangents: of the changes, by kind of level
    """

    u: np.ndarray
    objective: EventTimesObjective
    value: np.ndarray
    score: np.ndarray
    block: np.ndarray
    tangents: tuple[Tangent, ...]


class LevelledObjective(EventTimesObjective):
    """The log posterior at each circuit's best levels.

    Args:
        likelihood: of recordings with a light for each pixel (`with_own_lights`).
        coordinates: of the camera.
        scales: how far levels spread.
        start: (p, k) levels to begin at; None: 0.
        tilt: by parameter, (slope, coordinate where it was estimated).
        tolerance, most_steps: nats that all levels together may still promise; steps after which they are left there.
    """

    def __init__(
        self, likelihood: EventTimes, coordinates: Coordinates, scales: Scales, start: np.ndarray | None = None,
        tilt: Mapping[str, tuple[float, float]] | None = None, tolerance: float = TOLERANCE,
        most_steps: int = MOST_STEPS,
    ) -> None:  # fmt: skip
        super().__init__(likelihood, coordinates)
        self.scales, self.tilt, self.tolerance, self.most_steps = scales, dict(tilt or {}), tolerance, most_steps
        self._start = np.zeros((likelihood.pixels, len(scales.kinds))) if start is None else start
        self._of_lights = _pixel_of_lights(likelihood)
        self._found: tuple[bytes, At] | None = None
        self._follows: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None  # θ, u, du/dθ of the latest `local`

    def on(self, coordinates: Coordinates) -> LevelledObjective:
        start = self._start if self._found is None else self._found[1].u
        return LevelledObjective(self.likelihood, coordinates, self.scales, start, self.tilt, *ROUGH)

    def weighed(self, x: np.ndarray) -> LevelledObjective:
        """The same with timestamp noise counted as at x (`EventTimes.weighed`)."""
        weighed = self.at(x).weighed(self.coordinates.circuit(x))
        likelihood = self.likelihood.with_stamps(weighed.carried, weighed.clock_share, weighed.placed)
        return LevelledObjective(likelihood, self.coordinates, self.scales, self.best(x).u, self.tilt)

    def best(self, x: np.ndarray) -> At:
        """The best levels at x: damped Newton steps, each pixel's for itself."""
        key = np.asarray(x, dtype=float).tobytes()
        if self._found is not None and self._found[0] == key:
            return self._found[1]
        here = self._around(x, self._guess(x))
        damping, mixed = np.zeros(len(here.u)), False
        for _ in range(self.most_steps):
            B = here.block + damping[:, None, None] * _diagonals(here.block)
            step = np.linalg.solve(B, here.score[:, :, None])[:, :, 0]
            step /= np.maximum(1.0, np.abs(step).max(axis=1, keepdims=True))
            step = np.clip(here.u + step, -FAR, FAR) - here.u
            promised = (here.score * step).sum(1) - 0.5 * np.einsum("pi,pij,pj->p", step, here.block, step)
            if not np.isfinite(here.value).all() or promised.sum() < self.tolerance:
                break
            there = self._around(x, here.u + step)
            better = there.value > here.value - 1e-10 * np.abs(here.value)  # NaN is not
            damping = np.where(better, np.where(damping > 1e-3, damping / 5.0, 0.0), np.maximum(4.0 * damping, 0.1))
            mixed = not better.all()
            here = _merged(better, there, here) if mixed else there
        if mixed:
            here = self._around(x, here.u)
        self._found = key, here
        return here

    def held(self, x: np.ndarray) -> EventTimesObjective:
        """The log posterior with the levels held that are best at x."""
        return self.best(x).objective

    def at(self, x: np.ndarray) -> EventTimes:
        return self.held(x).at(x)

    def terms(self, x: np.ndarray) -> Terms:
        return self.held(x).terms(x)

    def value(self, x: np.ndarray) -> float:
        return float(self.best(x).value.sum()) + self.coordinates.log_prior(x) + self._tilted(x)[0]

    def gradient(self, x: np.ndarray) -> np.ndarray:
        return self.held(x).gradient(x) + self._tilted(x)[1]

    def local(self, x: np.ndarray) -> Local:
        best, d = self.best(x), len(x)
        information, gradient = self._information(x, best)
        kinds = range(best.u.shape[1])
        cross = np.array([[_by_pixel(information, i, d + k) for k in kinds] for i in range(d)]).transpose(2, 1, 0)
        follows = -np.linalg.solve(best.block, cross)
        self._follows = np.array(x), best.u, follows
        prior = self.coordinates.prior_gradient_and_curvature(x)
        matrix = information.matrix()[:d, :d] + np.einsum("pki,pkj->ij", cross, follows) + np.diag(prior[1])
        return Local(self.value(x), gradient + prior[0] + self._tilted(x)[1], 0.5 * (matrix + matrix.T))

    def hessian(self, x: np.ndarray, here: Local | None = None) -> np.ndarray:
        """The Schur complement, by differences of exact gradients along θ_i with the levels following.

        With R = du/dθ it is [1 Rᵀ] H [1; R], where an error of R counts squared.  Were H_θθ and the rest taken apart,
        what a common gain undoes would be left as the difference of two numbers a thousand times as large.

        Events that move across samples of the light make the gradient rough: one short step left 5 % of the variance of
        α, steps `WIDER` times as long to both sides leave 0.2 % (four pixels, 331 events, against differences of all
        parameters).
        """
        best, steps = self.best(x), WIDER * self.difference_steps()
        block, cross = self.curvature(x)
        follows = np.linalg.solve(block, cross)
        H = np.empty((len(x), len(x)))
        for i, step in enumerate(steps):
            sides = []
            for side in (step, -step):
                moved, u = np.array(x), best.u + side * follows[:, :, i]
                moved[i] += side
                there = EventTimesObjective(self._under(u), self.coordinates)
                scored = _scores_of(there.terms(moved), self._tangents(moved, u, there)) - u
                sides.append(there.gradient(moved) + np.einsum("pk,pkj->j", scored, follows))
            H[i] = (sides[0] - sides[1]) / (2.0 * step)
        return 0.5 * (H + H.T)

    def curvature(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(B (p, k, k), H_iθ (p, k, d)) at the best levels for x: differences of exact scores.

        Where B is not positive definite it is Gauss and Newton's.
        """
        best, base = self.best(x), self._scores(x, self.best(x).u)
        block, cross = np.empty_like(best.block), np.empty((*best.u.shape, len(x)))
        curvature_step = 1e-4  # for the slope of scores, which are exact: as `Objective.difference_steps`
        for k in range(best.u.shape[1]):
            moved = best.u + curvature_step * np.eye(best.u.shape[1])[k]
            block[:, :, k] = (base - self._scores(x, moved)) / curvature_step
        block = 0.5 * (block + block.transpose(0, 2, 1)) + np.eye(best.u.shape[1])
        bad = ~(np.linalg.eigvalsh(block)[:, 0] > 0.1 * np.linalg.eigvalsh(best.block)[:, 0])
        block[bad] = best.block[bad]
        for i, step in enumerate(self.difference_steps()):
            moved = np.array(x)
            moved[i] += step
            cross[:, :, i] = (self._scores(moved, best.u) - base) / step
        return block, cross

    def evidence(self, x: np.ndarray) -> float:
        """The log posterior of θ with the levels integrated out."""
        best = self.best(x)
        return float(best.value.sum()) + self.coordinates.log_prior(x) + self.log_volume(x, best.u)

    def log_volume(self, x: np.ndarray, u: np.ndarray) -> float:
        """−Σ ½ ln det B_i at levels u."""
        return -0.5 * float(np.linalg.slogdet(self._around(x, u).block)[1].sum())

    def follows(self, x: np.ndarray) -> np.ndarray:
        """du/dθ (p, k, d) at x, where `local` has been asked for."""
        assert self._follows is not None
        assert np.array_equal(self._follows[0], x)
        return self._follows[2]

    def _guess(self, x: np.ndarray) -> np.ndarray:
        """Where to look for the best levels: from the latest, moved as θ has moved."""
        if self._follows is not None:
            at, u, follows = self._follows
            return np.clip(u + np.clip(follows @ (x - at), -1.0, 1.0), -FAR, FAR)
        return self._start if self._found is None else self._found[1].u

    def _tilted(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        """(value, gradient) of the tilt."""
        if not self.tilt:
            return 0.0, np.zeros(len(x))
        values, known = self.coordinates.values(x), self.coordinates
        everything = {**known.model.parameters, **known.nuisances, **{p.name: p for p in known.parameters}}
        value = sum(s * (everything[n].to_coordinate(values[n]) - at) for n, (s, at) in self.tilt.items())
        return float(value), np.array([self.tilt[name][0] if name in self.tilt else 0.0 for name in known.names])

    def _under(self, u: np.ndarray) -> EventTimes:
        """The likelihood with the pixels' light at levels u."""
        gain, background = self.scales.levels(u)
        lights = [
            [
                seen_by(light, float(gain[p]), float(background[p]))
                for light, p in zip(e.section.lights, pixels, strict=True)
            ]
            for e, pixels in zip(self.likelihood.evaluators, self._of_lights, strict=True)
        ]
        return self.likelihood.with_lights(lights)

    def _tangents(self, x: np.ndarray, u: np.ndarray, here: EventTimesObjective) -> tuple[Tangent, ...]:
        """How all changes move with the levels of all pixels at once, by kind."""
        circuit, changes, out = self.coordinates.circuit(x), here.terms(x).changes, []
        for k in range(u.shape[1]):
            moved = self._under(u + STEP * np.eye(u.shape[1])[k])
            difference = moved.changes(circuit, changes)
            with np.errstate(over="ignore", invalid="ignore"):
                difference.vector[:] = (difference.vector - changes.vector) / STEP
            np.nan_to_num(difference.vector, copy=False, posinf=0.0, neginf=0.0)
            out.append(Tangent(difference, np.zeros(len(NUMBERS))))
        return tuple(out)

    def _scores(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """(p, k) ∂l_i/∂u_i, of the likelihood alone."""
        here = EventTimesObjective(self._under(u), self.coordinates)
        return _scores_of(here.terms(x), self._tangents(x, u, here))

    def _around(self, x: np.ndarray, u: np.ndarray) -> At:
        here = EventTimesObjective(self._under(u), self.coordinates)
        terms, tangents = here.terms(x), self._tangents(x, u, here)
        information, k = Information(terms, u.shape[1]), range(u.shape[1])
        for i, tangent in enumerate(tangents):
            information.add(i, tangent)
        block = np.array([[_by_pixel(information, i, j) for j in k] for i in k]).transpose(2, 0, 1)
        value = terms.per_pixel - 0.5 * (u**2).sum(axis=1)
        return At(u, here, value, _scores_of(terms, tangents) - u, block + np.eye(u.shape[1]), tangents)

    def _information(self, x: np.ndarray, best: At) -> tuple[Information, np.ndarray]:
        """Of θ and then the levels of all pixels at once, and the gradient of the likelihood in θ."""
        terms, d = best.objective.terms(x), len(x)
        here, information, gradient = terms.gradient(), Information(terms, d + len(best.tangents)), np.empty(d)
        for i in range(d):
            tangent = best.objective.tangent(x, i)
            gradient[i] = along(here, tangent)
            information.add(i, tangent)
        for k, tangent in enumerate(best.tangents):
            information.add(d + k, tangent)
        return information, gradient


def _pixel_of_lights(likelihood: EventTimes) -> list[np.ndarray]:
    """By section, whose light each of its lights is."""
    out = []
    for evaluator, pixels in zip(
        likelihood.evaluators, np.split(likelihood.layout.last_pixel, likelihood.layout.end_ends), strict=True
    ):
        assert len(evaluator.section.lights) == len(pixels)  # one light, one pixel, one unfinished interval
        of_light = np.empty(len(pixels), np.int64)
        of_light[evaluator.section.last_light] = pixels
        out.append(of_light)
    return out


def _scores_of(terms: Terms, tangents: tuple[Tangent, ...]) -> np.ndarray:
    at, here, out = terms.layout, terms.gradient().by_changes, []
    for tangent in tangents:
        assert tangent.changes is not None
        events = sum(a * b for a, b in zip(here.events, tangent.changes.events, strict=True))
        ends = sum(a * b for a, b in zip(here.ends, tangent.changes.ends, strict=True))
        out.append(np.bincount(at.pixel, events, at.pixels) + np.bincount(at.last_pixel, ends, at.pixels))
    return np.array(out).T


def _by_pixel(information: Information, i: int, j: int) -> np.ndarray:
    """(p,) the parts of an entry of the information by pixel."""
    at = information.terms.layout
    events, groups, released = information.events, information.groups, information.at_release
    out = np.bincount(at.pixel[information.kept], (events[i] * events[j]).sum(axis=0), at.pixels)
    out = out + (groups[i] * groups[j]).sum(axis=0).reshape(-1, 2).sum(axis=1)
    return out + np.bincount(at.pixel[information.release.k], (released[i] * released[j]).sum(axis=0), at.pixels)


def _diagonals(block: np.ndarray) -> np.ndarray:
    return block * np.eye(block.shape[1])


def _merged(mine: np.ndarray, a: At, b: At) -> At:
    """Of each pixel a where `mine` (p,), else b; the objective is neither's."""

    def chosen(name: str) -> np.ndarray:
        first, second = getattr(a, name), getattr(b, name)
        return np.where(mine.reshape(-1, *(1,) * (first.ndim - 1)), first, second)

    return At(chosen("u"), b.objective, chosen("value"), chosen("score"), chosen("block"), b.tangents)
