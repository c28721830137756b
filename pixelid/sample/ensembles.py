"""Independent emcee ensembles that survive being killed.

Every ensemble has its own random state (emcee ensembles left unseeded share NumPy's).  An ensemble's whole state —
positions, log posterior, pieces and random numbers — goes to an HDF5 file after every step; the file that others see
is a copy of it made while it is closed and put in place by renaming, so a kill at any moment leaves a whole file, and
a resumed run gives the same chain as one that was never stopped.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from pixelid.sample.proposal import Proposal

CHUNK = 10  # steps between looks at convergence
SAVE_S = 2.0  # seconds between snapshots


def moves(proposal: Proposal, trust: float):
    """Mixed moves: the independence proposal with probability `trust`, local moves of the ensemble for the rest."""
    from emcee import moves as emcee_moves

    rest = 1.0 - trust
    return [
        (emcee_moves.MHMove(proposal.suggest), trust),
        (emcee_moves.DEMove(), 0.6 * rest),
        (emcee_moves.DESnookerMove(), 0.1 * rest),
        (emcee_moves.StretchMove(), 0.3 * rest),
    ]


class Ensembles:
    """`count` ensembles of `walkers` on one target, stepped together.

    chain_file: where the snapshot lives;  an existing one of the same `identity` is continued, any other replaced.
    """

    def __init__(
        self,
        target: Callable[[np.ndarray], tuple[float, np.ndarray]],
        starts: np.ndarray,
        proposal: Proposal,
        trust: float,
        seed: int,
        chain_file: Path,
        identity: dict,
    ) -> None:
        import emcee

        self.path = Path(chain_file)
        self._live = self.path.with_name(f".{self.path.name}.live")
        count, walkers, d = starts.shape
        key = hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()
        self.resumed = self._recover(key)
        self.samplers = []
        for k in range(count):
            backend = emcee.backends.HDFBackend(str(self._live), name=f"ensemble_{k}")
            sampler = emcee.EnsembleSampler(walkers, d, target, backend=backend, moves=moves(proposal, trust))
            if _steps(sampler) == 0:
                sampler.random_state = np.random.RandomState([seed, k, 20240711]).get_state()
            self.samplers.append(sampler)
        self._starts = starts
        if not self.resumed:
            self._label(key)
        self._saved = time.monotonic()

    def _recover(self, key: str) -> bool:
        """Take up the snapshot if it is ours; otherwise start afresh."""
        import h5py

        self._live.unlink(missing_ok=True)
        if not self.path.exists():
            return False
        try:
            with h5py.File(self.path, "r") as file:
                ours = file.attrs.get("identity") == key
        except OSError:
            ours = False
        if ours:
            shutil.copyfile(self.path, self._live)
        return ours

    def _label(self, key: str) -> None:
        import h5py

        with h5py.File(self._live, "a") as file:
            file.attrs["identity"] = key

    @property
    def steps(self) -> int:
        """Steps that every ensemble has made."""
        return min(_steps(sampler) for sampler in self.samplers)

    def advance(self, until: int) -> None:
        """Step every ensemble to `until` steps, and save now and then."""
        for k, sampler in enumerate(self.samplers):
            while (done := _steps(sampler)) < until:
                start = self._starts[k] if done == 0 else sampler.get_last_sample()
                sampler.run_mcmc(start, min(until - done, CHUNK), skip_initial_state_check=True)
                if time.monotonic() - self._saved > SAVE_S:
                    self.save()

    def save(self) -> None:
        """Put a copy of the closed file in place, whole or not at all."""
        temporary = self.path.with_name(f".{self.path.name}.new")
        shutil.copyfile(self._live, temporary)
        with open(temporary, "rb") as file:
            os.fsync(file.fileno())
        temporary.replace(self.path)
        self._saved = time.monotonic()

    def finish(self) -> None:
        """The last snapshot; the working copy goes."""
        self.save()
        self._live.unlink(missing_ok=True)

    def chain(self, discard: int = 0) -> np.ndarray:
        """(ensembles, steps, walkers, d)."""
        return np.stack([s.get_chain(discard=discard) for s in self.samplers])

    def log_prob(self, discard: int = 0) -> np.ndarray:
        """(ensembles, steps, walkers) log posterior."""
        return np.stack([s.get_log_prob(discard=discard) for s in self.samplers])

    def pieces(self, discard: int = 0) -> np.ndarray:
        """(ensembles, steps, walkers, pieces), see `target.Target`."""
        return np.stack([np.asarray(s.get_blobs(discard=discard)) for s in self.samplers])

    def acceptance(self) -> float:
        """Fraction of accepted moves."""
        return float(np.mean([s.acceptance_fraction.mean() for s in self.samplers]))


def _steps(sampler) -> int:
    return int(sampler.backend.iteration)
