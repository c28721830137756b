"""Sample the posterior of a fit: one function from a fit to converged draws, or a plain statement that they are not."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from pixelid.errors import InputError
from pixelid.fit.data import event_times_of
from pixelid.fit.event_times import EventTimesObjective
from pixelid.fit.pooled_rate import PooledRateObjective
from pixelid.fit.result import FitResult, Stopwatch
from pixelid.fit.uncertainty.small_sample import MISMATCH, mismatch_shares
from pixelid.likelihood.pooled_rate import PooledRate
from pixelid.provenance import versions
from pixelid.recordings.recording import Recording
from pixelid.sample.convergence import ENOUGH_TAU, Convergence, convergence
from pixelid.sample.ensembles import CHUNK, Ensembles, moves
from pixelid.sample.posterior import Posterior
from pixelid.sample.proposal import Proposal, shaped
from pixelid.status import Status


class Target:
    """Log posterior in fitting coordinates (logs where the parameter says so).

    Priors: the model's Gaussian ones, else flat in the fitting coordinate within the bounds.  Per-pixel thresholds are
    integrated out in closed form (likelihood/event_times.py).  Pooled counts: the log-likelihood is divided by the
    measured dispersion, as the fit's errors are.

    pieces: (r + 1 + p,) log-likelihood of the r recordings given the thresholds, of the thresholds themselves, and of
    the p pixels (or units of several pixels), which add up to the same total.
    """

    def __init__(self, result: FitResult, recordings: Sequence[Recording]) -> None:
        self.coordinates = result.coordinates
        self.lower, self.upper = self.coordinates.bounds()
        self.recordings = tuple(recordings)
        self.pooled = result.observation == "pooled_rate"
        self._dispersion = float(result.details.get("dispersion", 1.0))
        most_units = 512  # pixels whose log-likelihoods are kept apart; more share units
        if self.pooled:
            self._counts = PooledRate(recordings)
            self._pooled = PooledRateObjective(self._counts, self.coordinates)
            self.units = 0
        else:
            self._density = event_times_of(result, recordings)
            self.units = min(self._density.likelihood.pixels, most_units)
        self.evaluations = 0

    @property
    def objective(self) -> EventTimesObjective | PooledRateObjective:
        """The same density as an optimiser sees it."""
        return self._pooled if self.pooled else self._density

    def inside(self, x: np.ndarray) -> bool:
        """Whether x respects the bounds."""
        return bool(((x >= self.lower) & (x <= self.upper)).all())

    def value(self, x: np.ndarray) -> float:
        """The log posterior, −∞ outside the bounds."""
        return self(x)[0]

    def __call__(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        """(log posterior, pieces)."""
        size = len(self.recordings) + 1 + self.units
        if not self.inside(x):
            return -np.inf, np.full(size, np.nan)
        self.evaluations += 1
        prior = self.coordinates.log_prior(x)
        if self.pooled:
            pieces = np.append(self._pooled_pieces(x) / self._dispersion, 0.0)
            total = pieces.sum()
        else:
            terms = self._density.terms(x)
            total = terms.total
            units = np.bincount(np.arange(len(terms.per_pixel)) % self.units, terms.per_pixel, self.units)
            pieces = np.concatenate([terms.per_recording, [total - terms.per_recording.sum()], units])
        if not np.isfinite(total):
            return -np.inf, np.full(size, np.nan)
        return total + prior, pieces

    def _pooled_pieces(self, x: np.ndarray) -> np.ndarray:
        """(r,) Poisson log-likelihoods of the recordings, without the constant of the counts."""
        return self._counts.per_recording(self._pooled.expected(x))


GOOD = 0.6  # efficiency of importance weights from which the Laplace shape is kept
WANTED = 1000  # effective samples per parameter


def sample(
    result: FitResult,
    recordings: Sequence[Recording],
    *,
    seed: int = 0,
    wanted: int = WANTED,
    ensembles: int = 2,
    max_steps: int = 4000,
    chain_file: Path | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Posterior:
    """Draws of the exact posterior of a fit's free parameters.

    result, recordings: a fit and what it was fitted to;  wanted: effective samples per parameter;
    chain_file: .npz file of the chains; an unfinished one of the same fit and seed is continued.
    It stops when N > 50 τ, the nested R̂ < 1.01 and `wanted` effective samples are there for every parameter, or at
    `max_steps`: then `status` says that it did not converge.

    Raises InputError for fewer than two ensembles, and for a fit with levels of pixels.
    """
    if ensembles < 2:
        raise InputError(f"sample: expected at least 2 independent ensembles, found {ensembles}")
    if result.pixel_levels is not None:
        raise InputError("sample: not of a fit with pixel_levels, whose levels would be held at their estimates")
    watch = Stopwatch()
    report = progress or (lambda what, fraction: None)
    target = Target(result, recordings)
    coordinates = result.coordinates
    d = len(coordinates)
    report("shaping the proposal", 0.0)
    names = list(coordinates.names)
    proposal = shaped(
        target.value,
        result.x,
        result.covariance,
        target.lower,
        target.upper,
        coordinates.longest_moves(),
        mismatch_shares(names, result.x, np.sqrt(np.diag(result.covariance)), result.pixels),
        names.index(MISMATCH) if MISMATCH in names else 0,
        lambda x: target.objective.local(x).gradient,
    )
    walkers = max(2 * d, 8)
    starts, trust, pilot = _pilot(target, proposal, ensembles, walkers, seed)
    if pilot["proposal_efficiency"] < GOOD:
        report("refitting the proposal", 0.0)
        proposal = proposal.refitted(_explored(target, proposal, starts.reshape(-1, d), seed))
        starts, trust, pilot = _pilot(target, proposal, ensembles, walkers, seed + 1)
        pilot["proposal_refitted"] = True
    identity = {
        "x": np.round(result.x, 5).tolist(),
        "names": coordinates.names,
        "inputs": dict(result.inputs_sha256),
        "seed": seed,
        "shape": [ensembles, walkers, d],
        "events": result.events,
    }
    with tempfile.TemporaryDirectory() as folder:
        path = Path(chain_file) if chain_file is not None else Path(folder) / "chain.npz"
        run = Ensembles(target, starts, proposal, trust, seed, path, identity)
        burn, reached = _until_converged(run, wanted, max_steps, report)
        chain, log_prob, pieces = run.chain(burn), run.log_prob(burn), run.pieces(burn)
        acceptance, resumed = run.acceptance(), run.resumed
        run.finish()
    enough = reached.done and reached.effective.min() >= wanted
    return Posterior(
        status=Status.converged if enough else Status.not_converged,
        advice="" if enough else _advice(reached, coordinates.names, wanted),
        coordinates=coordinates,
        chain=chain,
        log_prob=log_prob,
        pieces=pieces,
        convergence=reached,
        details={
            "ensembles": ensembles,
            "walkers": walkers,
            "burn_in": burn,
            "steps": reached.steps,
            "acceptance": acceptance,
            "exact_evaluations": target.evaluations,
            "resumed": resumed,
            "seed": seed,
            "seconds": watch.seconds(),
            **pilot,
        },
        recordings=result.recordings,
        versions=versions(),
        inputs_sha256=result.inputs_sha256,
    )


def _pilot(target: Target, proposal: Proposal, ensembles: int, walkers: int, seed: int):
    """(starts (ensembles, walkers, d), trust in the proposal, what the pilot found).

    The starts are draws of the proposal, wider than the posterior; their importance ratios show how good it is.
    """
    rng = np.random.RandomState([seed, 20240711])
    need = ensembles * walkers
    points, values = [], []
    pilot = 60  # exact evaluations that judge the proposal
    for _ in range(200):
        for x in proposal.draw(need, rng):
            value = target.value(x)
            if np.isfinite(value):
                points.append(x)
                values.append(value)
        if len(points) >= max(need, pilot):
            break
    if len(points) < need:
        raise InputError("sample: the posterior is finite almost nowhere around the fit; fit again before sampling")
    x, logp = np.array(points), np.array(values)
    ratio = logp - proposal.log_density(x)
    weight = np.exp(ratio - ratio.max())
    efficiency = float(weight.sum() ** 2 / (weight**2).sum() / len(weight))
    trust = 0.9 if efficiency > GOOD else 0.7 if efficiency > 0.15 else 0.3
    starts = x[:need].reshape(ensembles, walkers, -1)
    return starts, trust, {"proposal_efficiency": efficiency, "proposal_k_hat": k_hat(ratio), "proposal_share": trust}


def _explored(target: Target, proposal: Proposal, starts: np.ndarray, seed: int) -> np.ndarray:
    """(n, d) draws of a short exact run from `starts`, good enough to shape a proposal and thrown away after."""
    import emcee

    sampler = emcee.EnsembleSampler(starts.shape[0], starts.shape[1], target.value, moves=moves(proposal, 0.3))
    sampler.random_state = np.random.RandomState([seed, 7]).get_state()
    explore = 120  # steps that shape a better one
    sampler.run_mcmc(starts, explore, skip_initial_state_check=True)
    return np.asarray(sampler.get_chain(discard=explore // 2, flat=True))


def k_hat(log_ratio: np.ndarray) -> float:
    """Pareto shape of importance ratios (Vehtari et al. 2024, JMLR 25, PSIS): below 0.7 they can be relied on."""
    from arviz_stats.base.array import array_stats

    _, k = array_stats.psislw(-np.asarray(log_ratio, dtype=float))  # it takes log-likelihoods: weights' logs negated
    return float(k)


def _until_converged(run: Ensembles, wanted: int, max_steps: int, report) -> tuple[int, Convergence]:
    """(burn-in, convergence after it)."""
    until = CHUNK
    while until < run.steps:  # a resumed run looks where the first would have: what is behind it did not suffice
        until = _next_look(until, max_steps)
    while True:
        run.advance(until)
        chain = run.chain()
        reached = convergence(chain[:, until // 10 :])
        burn = int(min(max(np.ceil(3.0 * np.nan_to_num(reached.tau.max(), posinf=until)), 5), until // 2))
        reached = convergence(chain[:, burn:])
        share = min(reached.steps / (ENOUGH_TAU * reached.tau.max()), reached.effective.min() / wanted, 1.0)
        report("sampling", share)
        if (reached.done and reached.effective.min() >= wanted) or until >= max_steps:
            return burn, reached
        until = _next_look(until, max_steps)


def _next_look(until: int, max_steps: int) -> int:
    return min(max(until + CHUNK, CHUNK * int(1.1 * until // CHUNK)), max_steps)


def _advice(reached: Convergence, names: tuple[str, ...], wanted: int) -> str:
    slow, apart = int(reached.tau.argmax()), int(reached.r_hat.argmax())
    return (
        f"the posterior did not converge: {names[slow]} has τ = {reached.tau[slow]:.3g} steps of {reached.steps} "
        f"(needs {ENOUGH_TAU:g} τ) and {reached.effective.min():.0f} of {wanted} effective samples, the ensembles "
        f"differ most in {names[apart]} (nested R̂ {reached.r_hat[apart]:.3f}): "
        "fix what the data leave open, or record richer light"
    )
