"""Covariances of levels, alone and if a mean over pixels were known."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np


@dataclass(frozen=True)
class Joint:
    """The camera's parameters θ and the levels u of p pixels as jointly normal: u given θ independent over pixels.

    covariance: (d, d) of θ;  block: (p, k, k) inverse covariance of u_i given θ;  follows: (p, k, d) du/dθ
    """

    covariance: np.ndarray
    block: np.ndarray
    follows: np.ndarray

    @cached_property
    def own(self) -> np.ndarray:
        """(p, k, k) covariance of u_i given θ."""
        return np.linalg.inv(self.block)

    @property
    def level_variances(self) -> np.ndarray:
        """(p, k)."""
        carried = np.einsum("pki,ij,pkj->pk", self.follows, self.covariance, self.follows)
        return np.diagonal(self.own, axis1=1, axis2=2) + carried

    def given_mean(self, kind: int) -> tuple[np.ndarray, np.ndarray]:
        """(covariance of θ (d, d), variances of u (p, k)) if the mean over pixels of levels of a kind were known."""
        mean = self.follows[:, kind].mean(axis=0)
        towards = self.covariance @ mean
        variance = self.own[:, kind, kind].mean() / len(self.own) + mean @ towards
        with_mean = self.own[:, :, kind] / len(self.own) + self.follows @ towards
        return self.covariance - np.outer(towards, towards) / variance, self.level_variances - with_mean**2 / variance
