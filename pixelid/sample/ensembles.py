"""Independent emcee ensembles that survive being killed.

Every ensemble has its own random state (emcee ensembles left unseeded share NumPy's).  The whole state of all of them —
positions, log posterior, pieces and random numbers — lies in memory and goes to one file now and then, whole or not at
all, so a resumed run gives the same chain as one that was never stopped.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from pixelid import __version__
from pixelid.arrays import load_arrays
from pixelid.errors import InputError
from pixelid.outputs import set_aside, whole_file
from pixelid.sample.proposal import Proposal

CHUNK = 10  # steps between looks at convergence
SAVE_S = 2.0  # seconds between snapshots
COLUMNS = ("chain", "log_prob", "blobs")  # of an ensemble's memory, one entry per step


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

    chain_file: where the snapshot lives (.npz);  an existing one of the same `identity` is continued, any other is set
    aside, and said.
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
        count, walkers, d = starts.shape
        labelled = json.dumps({"version": __version__, **identity}, sort_keys=True)
        self._key = hashlib.sha256(labelled.encode()).hexdigest()
        backends = self._recovered(starts.shape)
        self.resumed = backends is not None
        self.samplers = []
        for k in range(count):
            backend = emcee.backends.Backend() if backends is None else backends[k]
            sampler = emcee.EnsembleSampler(walkers, d, target, backend=backend, moves=moves(proposal, trust))
            sampler.log_prob_fn = target  # pyright: ignore  (emcee's own wrapper prints a traceback for an interrupt)
            if _steps(sampler) == 0:
                sampler.random_state = np.random.RandomState([seed, k, 20240711]).get_state()
            self.samplers.append(sampler)
        self._starts = starts
        self._saved = time.monotonic()

    def _recovered(self, shape: tuple[int, int, int]) -> list[Any] | None:
        """What the snapshot holds, where there is one of ours."""
        if not self.path.exists():
            return None
        try:
            arrays = load_arrays(self.path)
            if str(arrays["identity"]) != self._key:
                set_aside(self.path, "belongs to another run", "other")
                return None
            return [_backend(arrays, k, shape) for k in range(shape[0])]
        except (InputError, LookupError, ValueError, TypeError):
            set_aside(self.path, "is damaged", "damaged")
            return None

    @property
    def steps(self) -> int:
        """Steps that some ensemble has made: a snapshot is taken while one after the other is advanced."""
        return max(_steps(sampler) for sampler in self.samplers)

    def advance(self, until: int) -> None:
        """Step every ensemble to `until` steps, and save now and then."""
        for k, sampler in enumerate(self.samplers):
            while (done := _steps(sampler)) < until:
                start = self._starts[k] if done == 0 else sampler.get_last_sample()
                sampler.run_mcmc(start, min(until - done, CHUNK), skip_initial_state_check=True)
                if time.monotonic() - self._saved > SAVE_S:
                    self.save()

    def save(self) -> None:
        """Put the state of all ensembles in place, whole or not at all."""
        arrays: dict[str, Any] = {"identity": np.array(self._key)}
        for k, sampler in enumerate(self.samplers):
            backend = sampler.backend
            if not backend.iteration:
                continue
            for name in COLUMNS:
                arrays[f"{name}_{k}"] = getattr(backend, name)[: backend.iteration]
            kind, numbers, *rest = backend.random_state
            arrays |= {f"accepted_{k}": backend.accepted, f"random_{k}": numbers, f"random_rest_{k}": np.array(rest)}
            assert kind == "MT19937"
        with whole_file(self.path, overwrite=True) as temporary, temporary.open("wb") as file:
            np.savez(file, allow_pickle=False, **arrays)
        self._saved = time.monotonic()

    def finish(self) -> None:
        """The last snapshot."""
        self.save()

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


def _backend(arrays: dict[str, np.ndarray], k: int, shape: tuple[int, int, int]) -> Any:
    """The state of ensemble k as `save` wrote it.  Raises LookupError or ValueError when it is another."""
    import emcee

    _, walkers, d = shape
    backend = emcee.backends.Backend()
    backend.reset(walkers, d)
    if f"chain_{k}" not in arrays:  # it had not begun
        return backend
    columns = {name: arrays[f"{name}_{k}"] for name in COLUMNS}
    accepted, numbers, rest = (arrays[f"{name}_{k}"] for name in ("accepted", "random", "random_rest"))
    steps = len(columns["chain"])
    wanted = {"chain": (steps, walkers, d), "log_prob": (steps, walkers), "blobs": (steps, walkers)}
    for name, column in columns.items():
        whole = column.shape[: len(wanted[name])] == wanted[name]
        if not whole or column.dtype != np.float64 or np.isnan(columns["chain"]).any():
            raise ValueError(f"{name}: {column.dtype} of shape {column.shape}")
    if accepted.shape != (walkers,) or numbers.shape != (624,) or rest.shape != (3,):
        raise ValueError("random state or acceptance")
    for name, column in columns.items():
        setattr(backend, name, column)
    backend.accepted, backend.iteration = accepted, steps
    backend.random_state = ("MT19937", numbers.astype(np.uint32), int(rest[0]), int(rest[1]), float(rest[2]))
    return backend
