"""The log posterior of a circuit under the pooled-rate likelihood, and what its estimates scatter by."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy

import numpy as np

from pixelid.fit.coordinates import Coordinates
from pixelid.fit.objective import Local, Objective
from pixelid.likelihood.pooled_rate import PooledRate
from pixelid.model.model import Model
from pixelid.simulate.simulator import simulate
from pixelid.stimuli.stimulus import Stimulus

STEP = 1e-3  # of a difference in fitting coordinates: counts are smooth over it, and their rounding drowns in it
# Of the standard error that the curvature promises with all else known: bursts narrower than a bin make it ten times
# smaller than STEP, and counts bend over more of it.
FINE_STEP = 0.3
DELAY_STEP_S = 1e-6
REPLICATE_EVENTS = 2_000_000  # simulated for the scatter of the score
LEAST_PIXELS, MOST_PIXELS = 64, 1024  # errors to 1/√(2n): 9 % and 2 %


class PooledRateObjective(Objective):
    """Quasi log posterior; information Σ ∂λ ∂λᵀ / v.  Gradient by differences of the expected counts.

    Those of rough steps bring a search near its optimum; only `fine` ones take it there.
    """

    def __init__(self, likelihood: PooledRate, coordinates: Coordinates) -> None:
        self.likelihood = likelihood
        self.coordinates = coordinates
        self._fine = False
        self._known: tuple[np.ndarray, np.ndarray] | None = None  # where derivatives were computed last, and these

    def near(self, x: np.ndarray, scatter: bool = True, blur: float = 0.0) -> PooledRateObjective:
        """The same with the steps of the model at x, its variances of counts or Poisson's, and thresholds blurred."""
        near = copy(self)
        near.likelihood = self.likelihood.near(self.coordinates.circuit(x), self.coordinates.values(x), scatter, blur)
        near._known = self._known if self._fine and blur == 0 else None  # counts' derivatives do not know variances
        return near

    def fine(self) -> PooledRateObjective:
        """The same with derivatives of its own steps and kinds of pixel, which vanish where the value peaks."""
        fine = PooledRateObjective(self.likelihood, self.coordinates)
        fine._fine = True
        return fine

    def expected(self, x: np.ndarray) -> np.ndarray:
        """(bins,) expected counts at x."""
        return self.likelihood.expected(self.coordinates.circuit(x), self.coordinates.values(x))

    def value(self, x: np.ndarray) -> float:
        return self.likelihood.log_likelihood(self.expected(x)) + self.coordinates.log_prior(x)

    def local(self, x: np.ndarray) -> Local:
        at_x = self.expected(x)
        kept, weight = self.likelihood.kept, 1.0 / self.likelihood.ratio
        J = self.jacobian(x, at_x)[kept]
        mean, weight = at_x[kept], weight[kept]
        gradient, curvature = self.coordinates.prior_gradient_and_curvature(x)
        return Local(
            self.likelihood.log_likelihood(at_x) + self.coordinates.log_prior(x),
            J.T @ (weight * (self.likelihood.observed[kept] / mean - 1.0)) + gradient,
            (J * (weight / mean)[:, None]).T @ J + np.diag(curvature),
        )

    def score(self, x: np.ndarray, at: np.ndarray) -> np.ndarray:
        """(d,) Σ J (n − λ)/v at x with J and v of the point `at`, and the prior's gradient at x."""
        at_it, kept = self.expected(at), self.likelihood.kept
        weight = kept / (self.likelihood.ratio * at_it)
        off = weight * (self.likelihood.observed - self.expected(x))
        return self.jacobian(at, at_it).T @ off + self.coordinates.prior_gradient_and_curvature(x)[0]

    def jacobian(self, x: np.ndarray, at_x: np.ndarray) -> np.ndarray:
        """(bins, d) derivatives of the expected counts, which are `at_x` at x, by differences.

        Taken roughly where there is a rough likelihood: Σ J (n − λ)/v is 0 at the true λ whatever J is, so errors of J
        cost precision by their square and bias nothing.
        """
        if self._known is not None and np.array_equal(self._known[0], x):
            return self._known[1]
        rough = self.likelihood.rough
        if rough is None:
            columns = self._differences(x, at_x, at_x, self, np.full(len(x), STEP))
        else:
            simple = PooledRateObjective(rough, self.coordinates)
            columns = self._differences(x, at_x, simple.expected(x), simple, np.full(len(x), STEP))
        if self._fine:
            norm = np.sqrt(np.sum(columns**2 / (self.likelihood.ratio * at_x)[:, None], axis=0))
            steps = np.minimum(FINE_STEP / np.maximum(norm, 1e-300), STEP)
            columns = self._differences(x, at_x, at_x, self, steps)
        self._known = x.copy(), columns
        return columns

    def _differences(
        self, x: np.ndarray, at_x: np.ndarray, begin: np.ndarray, of: PooledRateObjective, steps: np.ndarray
    ) -> np.ndarray:
        """(bins, d) differences over `steps` (d,) of the expected counts of another objective, which are `begin` at x.

        What is linear is taken from `at_x`, the expected counts of this one.
        """
        values, (_, upper) = self.coordinates.values(x), self.coordinates.bounds()
        linear = self.likelihood.linear_parts(at_x, values)
        queued = values.get("readout_latency.service_s", 0.0) > 0
        columns = []
        for i, parameter in enumerate(self.coordinates.parameters):
            if parameter.name in linear and parameter.transform == "log" and not queued:
                columns.append(linear[parameter.name])
                continue
            step = (
                min(DELAY_STEP_S, steps[i]) if parameter.transform == "linear" and parameter.unit == "s" else steps[i]
            )
            moved = x.copy()
            moved[i] += -step if x[i] + step > upper[i] else step
            columns.append((of.expected(moved) - begin) / (moved[i] - x[i]))
        return np.stack(columns, axis=1)

    def scatter(self, x: np.ndarray, local: Local, seed: int) -> tuple[np.ndarray, np.ndarray]:
        """What pixels simulated from the model at x, one by one, show of the score.

        Counts of neighbouring bins are not independent, as a pixel that has fired does not fire again, and thresholds
        stay with their pixels.  So the errors of estimates come from the scatter of the score over simulated pixels
        (Godambe 1960, Annals of Mathematical Statistics 31, 1208).  Its mean is not quite 0: a dozen kinds of pixel
        stand for the pool, and the forward pass has steps.  What it is moves estimates by several standard errors
        where bursts are narrow, and is subtracted (simulated scores: Gouriéroux, Monfort & Renault 1993, Journal of
        Applied Econometrics 8, S85).

        Where cycles of a readout are given, counts are expected from all that came before, and what is unexpected is
        independent: the score scatters as its curvature says.

        Returns:
            (d, d) inverse of the covariance of estimates, A B⁻¹ A of the score's curvature A and its variance B, and
            (d,) mean of the score; 0 where one arbiter queues the events of pixels, which are simulated without.
        """
        if any(cycles is not None for cycles in self.likelihood.cycles):
            return local.information, np.zeros(len(x))
        at_x = self.expected(x)
        kept = self.likelihood.kept
        weight = 1.0 / (self.likelihood.ratio * at_x)
        per_count = (self.jacobian(x, at_x) * weight[:, None] * kept[:, None]).T  # (d, bins)
        values = self.coordinates.values(x)
        variance, mean = np.zeros((len(x), len(x))), np.zeros(len(x))
        model, first = self.coordinates.model_at(x), 0
        for i, counts in enumerate(self.likelihood.counts):
            n = 2 * len(counts.on)
            mine, background = per_count[:, first : first + n], self.likelihood.background(i, values)
            scores = _scores(self.likelihood, i, model, values, mine, seed + i)
            pixels = values["pooled.pixels"]
            variance += pixels * (1.0 + pixels / scores.shape[1]) * np.cov(scores) + (mine * background) @ mine.T
            mean += pixels * scores.mean(axis=1) - mine @ (at_x[first : first + n] - background)
            first += n
        curvature = self.coordinates.prior_gradient_and_curvature(x)[1]
        A, B = local.information, variance + np.diag(curvature)
        scale = 1.0 / np.sqrt(np.maximum(np.diag(B), 1e-300))
        inverse = np.linalg.pinv(B * np.outer(scale, scale), rcond=1e-10, hermitian=True) * np.outer(scale, scale)
        return A @ inverse @ A, np.zeros(len(x)) if model.has("readout_latency") else mean


def _scores(likelihood: PooledRate, i: int, model: Model, values: dict, per_count: np.ndarray, seed: int) -> np.ndarray:
    """(d, pixels) what each simulated pixel adds to the score through recording i."""
    counts = likelihood.counts[i]
    events = (counts.on.sum() + counts.off.sum()) / values["pooled.pixels"]
    pixels = int(np.clip(REPLICATE_EVENTS / max(events, 1.0), LEAST_PIXELS, MOST_PIXELS))
    model = model.without_effect("readout_latency") if model.has("readout_latency") else model
    bins, which = simulated(likelihood, i, model, values, pixels, seed)
    return np.stack([np.bincount(which, row[bins], pixels) for row in per_count])


def simulated(
    likelihood: PooledRate, i: int, model: Model, values: Mapping[str, float], pixels: int, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """(bin, pixel) of each event of pixels simulated under the light of recording i; ON bins, then OFF."""
    edges, stimulus = likelihood.counts[i].edges, likelihood.recordings[i].stimulus
    assert isinstance(stimulus, Stimulus)
    if stimulus.unit == "shape":
        light = values["stimulus.offset"] + values["stimulus.gain"] * stimulus.radiance
        stimulus = Stimulus(stimulus.t, light, "relative", stimulus.interpolation)
    stimulus = stimulus.until(min(float(edges[-1]), stimulus.end_s))
    run = simulate(model.set({"delay_s": 0.0}), stimulus, width=pixels, height=1, seed=seed)  # `on_recording` has it
    n = len(edges) - 1
    t = likelihood.on_recording(i, run.events.t * 1e-9, values, model.circuit())
    index = np.floor((t - edges[0]) / (edges[1] - edges[0])).astype(np.int64)
    inside = (index >= 0) & (index < n)
    return index[inside] + np.where(run.events.p[inside] == 1, 0, n), run.events.x[inside]
