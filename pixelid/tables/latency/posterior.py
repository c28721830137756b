"""The posterior of a latency fit: emcee on the same Student-t likelihood and priors, with the scatter sampled too.

Two ensembles, each with its own random state, start at draws of the Gaussian about the maximum and move by mixed
proposals (`sample.ensembles.moves`); they are compared by nested R̂ (`sample.convergence`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from pixelid.parameters.parameter import log_prior
from pixelid.status import Status
from pixelid.tables.fit import FREEDOM, covariance_at
from pixelid.tables.latency.fit import CameraFit, LatencyFit

if TYPE_CHECKING:
    from pixelid.sample.convergence import Convergence
    from pixelid.sample.proposal import Proposal

STEPS = 1500
ENSEMBLES = 2


def log_posterior(fit: CameraFit, z: np.ndarray) -> float:
    """Of z = (x, ln σ), σ the relative scatter; flat in ln σ."""
    model = fit.model
    x, scatter = z[:-1], np.exp(z[-1])
    bounds = np.array([p.coordinate_bounds() for p in model.parameters])
    most_scatter = 1.0  # relative: a model that misses delays by their size describes none of them
    if (x < bounds[:, 0]).any() or (x > bounds[:, 1]).any() or not 1e-4 < scatter < most_scatter:
        return -np.inf
    rows = model.rows
    s = np.sqrt(scatter**2 + rows.rounding**2 + np.asarray(rows.relative_error) ** 2)
    r = rows.log_ratio(model.predict(x)) / s
    prior = log_prior(model.parameters, x)
    return float((-np.log(s) - 0.5 * (FREEDOM + 1.0) * np.log1p(r**2 / FREEDOM)).sum() + prior)


def sample_camera(
    fit: CameraFit, seed: int, steps: int = STEPS, progress: Callable[[float], None] | None = None
) -> tuple[np.ndarray, Convergence]:
    """(chain (ensembles, steps, walkers, d), convergence) after a burn-in of a third; the last coordinate is ln σ.

    Where poles can be exchanged, walkers start at either end.

    progress: called with the fraction done
    """
    import emcee

    from pixelid.sample.convergence import convergence
    from pixelid.sample.ensembles import moves

    proposal = _gaussian(fit)
    d = len(proposal.centre)
    walkers = 2 * d + 2
    ends = [proposal.centre, *(np.append(one.x, np.log(one.scale)) for one in fit.rivals)]
    chains = []

    def target(z: np.ndarray) -> float:
        return log_posterior(fit, z)

    trust = 0.5  # share of independence proposals
    for k in range(ENSEMBLES):
        rng = np.random.RandomState([seed, k, 15])
        starts = np.empty((walkers, d))
        for j in range(walkers):
            width = 1.0
            while True:
                starts[j] = ends[j % len(ends)] + width * (proposal.draw(1, rng)[0] - proposal.centre)
                if np.isfinite(log_posterior(fit, starts[j])):
                    break
                width *= 0.7
        sampler = emcee.EnsembleSampler(walkers, d, target, moves=moves(proposal, trust))
        sampler.log_prob_fn = target  # pyright: ignore  (emcee's own wrapper prints a traceback for an interrupt)
        sampler.random_state = np.random.RandomState([seed, k, 20240711]).get_state()
        for done, _ in enumerate(sampler.sample(starts, iterations=steps, skip_initial_state_check=True), 1):
            if progress is not None:
                progress((k + done / steps) / ENSEMBLES)
        chains.append(sampler.get_chain(discard=steps // 3))
    chain = np.stack(chains)
    return chain, convergence(chain)


def sample_fit(
    fit: LatencyFit, seed: int, steps: int = STEPS, progress: Callable[[float], None] | None = None
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Sample every camera: intervals and convergence of each, and its chains.

    Nothing is drawn for a camera whose delays the fit misses by about their size: its status is `misfit`.
    """
    report = progress or (lambda done: None)
    said, arrays, count = {}, {}, len(fit.fits)
    for place, one in enumerate(fit.fits):
        if not np.isfinite(log_posterior(one, np.append(one.regression.x, np.log(one.regression.scale)))):
            said[one.name] = {"status": Status.misfit, "draws": 0, "effective": 0.0, "largest_r_hat": None,
                              "parameters": {}}  # fmt: skip
            continue
        chain, reached = sample_camera(one, seed, steps, lambda done, place=place: report((place + done) / count))
        names = [*(p.name for p in one.model.parameters), "relative_scatter"]
        flat = np.exp(chain.reshape(-1, chain.shape[-1]))
        low, middle, high = np.quantile(flat, [0.025, 0.5, 0.975], axis=0)
        said[one.name] = {
            "status": Status.converged if reached.done else Status.not_converged,
            "draws": len(flat),
            "effective": float(reached.effective.min()),
            "largest_r_hat": float(reached.r_hat.max()),
            "parameters": {
                name: {"median": float(middle[k]), "interval_95": [float(low[k]), float(high[k])]}
                for k, name in enumerate(names)
            },
        }
        arrays[one.name] = chain.astype(np.float32)
    return said, arrays


def _gaussian(fit: CameraFit) -> Proposal:
    """The Gaussian about the maximum, ln σ with x."""
    from pixelid.sample.proposal import Proposal

    regression = fit.regression
    x, rows = regression.x, fit.model.rows
    covariance = covariance_at(regression)
    sd = np.sqrt(np.diag(covariance))
    most_sd = 1.0  # of a start along any coordinate: what the table leaves open starts no wider
    covariance *= np.outer(np.minimum(1.0, most_sd / sd), np.minimum(1.0, most_sd / sd))
    size = len(x) + 1
    axes = np.zeros((size, size))
    axes[:-1, :-1] = np.linalg.cholesky(covariance + 1e-12 * np.eye(len(x)))
    axes[-1, -1] = 1.0 / np.sqrt(2.0 * len(rows.measured) / 3.0)
    ones = np.ones(size)
    return Proposal(np.append(x, np.log(regression.scale)), axes, ones, ones, np.zeros(size), 0)
