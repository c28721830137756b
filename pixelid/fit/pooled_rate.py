"""The log posterior of a circuit under the pooled-rate likelihood, and what its estimates scatter by."""

from __future__ import annotations

import numpy as np

from pixelid.fit.coordinates import Coordinates
from pixelid.fit.objective import Local, Objective
from pixelid.likelihood.pooled_rate import PooledRate
from pixelid.model.model import Model
from pixelid.recordings.recording import Recording
from pixelid.simulate.simulator import simulate
from pixelid.stages.circuit import Circuit
from pixelid.stimuli.stimulus import Stimulus

STEP = 1e-3  # of a difference in fitting coordinates: counts are smooth over it, and their rounding drowns in it
DELAY_STEP_S = 1e-6
REPLICATE_EVENTS = 1_000_000  # simulated for the scatter of the score
LEAST_PIXELS, MOST_PIXELS = 64, 512  # errors to 1/√(2n): 9 % and 3 %


class PooledRateObjective(Objective):
    """Quasi log posterior; information Σ ∂λ ∂λᵀ / v.  Gradient by differences of the expected counts."""

    def __init__(self, likelihood: PooledRate, coordinates: Coordinates) -> None:
        self.likelihood = likelihood
        self.coordinates = coordinates
        self._central = False  # differences from both sides
        self._taken: tuple[np.ndarray, np.ndarray] | None = None  # where derivatives were taken last, and these

    def near(self, x: np.ndarray, scatter: bool = True, blur: float = 0.0) -> PooledRateObjective:
        """The same with the steps of the model at x, its variances of counts or Poisson's, and thresholds blurred."""
        likelihood = self.likelihood.near(self.coordinates.circuit(x), self.coordinates.values(x), scatter, blur)
        return PooledRateObjective(likelihood, self.coordinates)

    def fine(self) -> PooledRateObjective:
        """The same with derivatives of its own steps and kinds of pixel, which vanish where the value peaks."""
        fine = PooledRateObjective(self.likelihood.without_rough(), self.coordinates)
        fine._central = True
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

    def jacobian(self, x: np.ndarray, at_x: np.ndarray) -> np.ndarray:
        """(bins, d) derivatives of the expected counts, which are `at_x` at x, by differences.

        Taken roughly where there is a rough likelihood: Σ J (n − λ)/v is 0 at the true λ whatever J is, so errors of J
        cost precision by their square and bias nothing.
        """
        if self._taken is not None and np.array_equal(self._taken[0], x):
            return self._taken[1]
        rough = self.likelihood.rough
        taken = self if rough is None else PooledRateObjective(rough, self.coordinates)
        begin = at_x if rough is None else taken.expected(x)
        values, (lower, upper) = self.coordinates.values(x), self.coordinates.bounds()
        linear = self.likelihood.linear_parts(at_x, values)
        queued = values.get("readout_latency.service_s", 0.0) > 0
        columns = []
        for i, parameter in enumerate(self.coordinates.parameters):
            if parameter.name in linear and parameter.transform == "log" and not queued:
                columns.append(linear[parameter.name])
                continue
            step = DELAY_STEP_S if parameter.transform == "linear" and parameter.unit == "s" else STEP
            step = -step if x[i] + step > upper[i] else step
            # Where few counts are left to chance a step is many standard errors, over which counts bend: a delay
            # has even the wrong sign from one side.
            both = self._central and lower[i] <= x[i] - step <= upper[i]
            moved, back = x.copy(), x.copy()
            moved[i] += step
            back[i] -= step
            other = taken.expected(back) if both else begin
            columns.append((taken.expected(moved) - other) / (step * (1 + both)))
        self._taken = x.copy(), np.stack(columns, axis=1)
        return self._taken[1]

    def information(self, x: np.ndarray, local: Local, seed: int) -> np.ndarray:
        """(d, d) inverse of the covariance of estimates: A B⁻¹ A of the score's curvature A and its variance B.

        Counts of neighbouring bins are not independent, as a pixel that has fired does not fire again, and thresholds
        stay with their pixels.  So B is the scatter of the score over pixels simulated from the model
        (Godambe 1960, Annals of Mathematical Statistics 31, 1208).
        """
        at_x = self.expected(x)
        kept = self.likelihood.kept
        weight = 1.0 / (self.likelihood.ratio * at_x)
        per_count = (self.jacobian(x, at_x) * weight[:, None] * kept[:, None]).T  # (d, bins)
        values = self.coordinates.values(x)
        scatter = np.zeros((len(x), len(x)))
        model, first = self.coordinates.model_at(x), 0
        for i, counts in enumerate(self.likelihood.counts):
            n = 2 * len(counts.on)
            scores = _scores(self.likelihood, i, model, values, per_count[:, first : first + n], seed + i)
            scatter += values["pooled.pixels"] * np.cov(scores)
            background = self.likelihood.background(i, values)
            scatter += (per_count[:, first : first + n] * background) @ per_count[:, first : first + n].T
            first += n
        curvature = self.coordinates.prior_gradient_and_curvature(x)[1]
        A, B = local.information, scatter + np.diag(curvature)
        scale = 1.0 / np.sqrt(np.maximum(np.diag(B), 1e-300))
        inverse = np.linalg.pinv(B * np.outer(scale, scale), rcond=1e-10, hermitian=True) * np.outer(scale, scale)
        return A @ inverse @ A


def _scores(likelihood: PooledRate, i: int, model: Model, values: dict, per_count: np.ndarray, seed: int) -> np.ndarray:
    """(d, pixels) what each simulated pixel adds to the score through recording i."""
    counts, recording = likelihood.counts[i], likelihood.recordings[i]
    stimulus = recording.stimulus
    assert isinstance(stimulus, Stimulus)
    if stimulus.unit == "shape":
        light = values["stimulus.offset"] + values["stimulus.gain"] * stimulus.radiance
        stimulus = Stimulus(stimulus.t, light, "relative", stimulus.interpolation)
    stimulus = stimulus.until(min(float(counts.edges[-1]), stimulus.end_s))
    events = (counts.on.sum() + counts.off.sum()) / values["pooled.pixels"]
    pixels = int(np.clip(REPLICATE_EVENTS / max(events, 1.0), LEAST_PIXELS, MOST_PIXELS))
    model = model.without_effect("readout_latency") if model.has("readout_latency") else model
    run = simulate(model, stimulus, width=pixels, height=1, seed=seed)
    return _of_pixels(run, likelihood, i, values, per_count, pixels, model.circuit())


def _of_pixels(
    run: Recording, likelihood: PooledRate, i: int, values: dict, per_count: np.ndarray, pixels: int, circuit: Circuit
) -> np.ndarray:
    edges = likelihood.counts[i].edges
    n = len(edges) - 1
    t = likelihood.on_recording(i, run.events.t * 1e-9, values, circuit)
    index = np.floor((t - edges[0]) / (edges[1] - edges[0])).astype(np.int64)
    inside = (index >= 0) & (index < n)
    bins = index[inside] + np.where(run.events.p[inside] == 1, 0, n)
    which = run.events.x[inside]
    return np.stack([np.bincount(which, row[bins], pixels) for row in per_count])
