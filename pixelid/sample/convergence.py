"""Has it converged?  Autocorrelation time, effective samples, and R̂ between independent ensembles.

Walkers of one ensemble move each other, so chain-wise R̂ means little for them.  The nested R̂ (Margossian, Hoffman,
Sountsov, Riou-Durand, Vehtari & Gelman 2024, Bayesian Analysis, "Nested R̂: assessing the convergence of Markov chain
Monte Carlo when running many short chains", arXiv 2110.13017, eqs. 6 to 9) compares superchains: here one superchain
is one ensemble with its own random numbers, and its walkers are the chains within it.  ArviZ has no nested R̂.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri
from scipy.stats import rankdata

ENOUGH_TAU = 50.0  # steps per autocorrelation time (emcee's advice)


def nested_r_hat(draws: np.ndarray) -> float:
    """Nested R̂ of draws (superchains K, chains M, draws N)."""
    K, M, N = draws.shape
    chain_means = draws.mean(axis=2)
    super_means = chain_means.mean(axis=1)
    between = super_means.var(ddof=1) if K > 1 else 0.0
    within = draws.var(axis=2, ddof=1).mean(axis=1) if N > 1 else np.zeros(K)
    if M > 1:
        within = within + chain_means.var(axis=1, ddof=1)
    W = float(within.mean())
    return float(np.sqrt(1.0 + between / W)) if W > 0 else 1.0


def ranked_nested_r_hat(draws: np.ndarray) -> float:
    """The larger of the nested R̂ of rank-normalised and of folded draws, which also sees scale and tails
    (Vehtari et al. 2021, Bayesian Analysis 16, section 4)."""
    folded = np.abs(draws - np.median(draws))
    return max(nested_r_hat(_rank_normalised(draws)), nested_r_hat(_rank_normalised(folded)))


def _rank_normalised(draws: np.ndarray) -> np.ndarray:
    ranks = rankdata(draws.ravel(), method="average").reshape(draws.shape)
    return ndtri((ranks - 0.375) / (draws.size + 0.25))


@dataclass(frozen=True)
class Convergence:
    """Per coordinate (d,): tau in steps, effective samples of all ensembles, nested R̂;  steps kept per walker."""

    tau: np.ndarray
    effective: np.ndarray
    r_hat: np.ndarray
    steps: int

    @property
    def done(self) -> bool:
        """N > 50 τ and nested R̂ < 1.01, for every coordinate."""
        largest_r_hat = 1.01
        return bool(self.steps > ENOUGH_TAU * self.tau.max() and self.r_hat.max() < largest_r_hat)


def autocorrelation_time(draws: np.ndarray) -> float:
    """Integrated autocorrelation time [steps] of draws (steps, walkers), at least 1.

    Sokal's window of 5 τ, as in emcee, but about the mean of the whole ensemble: a walker that is stuck away from the
    others then lengthens τ, where per-walker means would hide it (or divide by zero).
    """
    steps, walkers = draws.shape
    centred = draws - draws.mean()
    power = np.abs(np.fft.rfft(centred, 2 * steps, axis=0)) ** 2
    covariance = np.fft.irfft(power, axis=0)[:steps].sum(axis=1) / walkers / np.arange(steps, 0, -1)
    if not covariance[0] > 0:
        return float(steps)
    taus = 2.0 * np.cumsum(covariance / covariance[0]) - 1.0
    outside = np.arange(steps) >= 5.0 * taus
    window = int(outside.argmax()) if outside.any() else steps - 1
    return float(max(taus[window], 1.0))


def convergence(chain: np.ndarray) -> Convergence:
    """Of a chain (ensembles, steps, walkers, d), burn-in removed."""
    _, steps, walkers, d = chain.shape
    if steps < 4:
        return Convergence(np.full(d, np.inf), np.zeros(d), np.full(d, np.inf), steps)
    tau = np.array([[autocorrelation_time(one[..., i]) for i in range(d)] for one in chain])
    effective = (steps * walkers / tau).sum(axis=0)
    r_hat = np.array([ranked_nested_r_hat(chain[..., i].transpose(0, 2, 1)) for i in range(d)])
    return Convergence(tau.max(axis=0), effective, r_hat, steps)
