"""The ArviZ groups that a posterior's draws fill by themselves."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import numpy as np

from pixelid.likelihood.clocks import numbered
from pixelid.sample.figures import Draws
from pixelid.status import Status


class Sampled(Draws, Protocol):
    """What groups need of a posterior."""

    @property
    def status(self) -> Status: ...
    @property
    def log_prob(self) -> np.ndarray: ...
    @property
    def pieces(self) -> np.ndarray: ...
    @property
    def recordings(self) -> tuple[str, ...]: ...
    @property
    def details(self) -> Mapping: ...


def sampled_groups(posterior: Sampled, beside: dict | None = None, dims_beside: dict | None = None):
    """A DataTree of the draws alone (posterior, sample_stats, log_likelihood), and of groups `beside`."""
    from arviz_base import from_dict

    ensembles, steps, walkers, _ = posterior.chain.shape
    chains = ensembles * walkers

    def by_chain(a: np.ndarray) -> np.ndarray:
        return np.swapaxes(a, 1, 2).reshape(chains, steps, *a.shape[3:])

    pieces = by_chain(posterior.pieces)
    r = len(posterior.recordings)
    likelihood = {"recording": pieces[..., :r]}
    dims = {"recording": ["recording_name"], "pixel": ["pixel_unit"], **(dims_beside or {})}
    coords: dict = {"recording_name": numbered(list(posterior.recordings))}
    if pieces.shape[-1] > r + 1:
        likelihood["pixel"] = pieces[..., r + 1 :]
        coords["pixel_unit"] = np.arange(pieces.shape[-1] - r - 1)
    groups = {
        "posterior": posterior.values(),
        "sample_stats": {
            "lp": by_chain(posterior.log_prob),
            "ensemble": np.repeat(np.arange(ensembles), walkers)[:, None].repeat(steps, axis=1),
        },
        "log_likelihood": likelihood,
        **(beside or {}),
    }
    model, seed = posterior.coordinates.model.name, int(posterior.details.get("seed", 0))
    attributes = {"status": str(posterior.status), "model": model, "seed": seed}
    return from_dict(groups, coords=coords, dims=dims, attrs={"/": attributes})
