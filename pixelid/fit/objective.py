"""What an optimiser needs: value, gradient and curvature of a log posterior at a coordinate vector."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from pixelid.fit.coordinates import Coordinates


@dataclass(frozen=True)
class Local:
    """A log posterior around one point: value, gradient, and positive semi-definite information matrix."""

    value: float
    gradient: np.ndarray
    information: np.ndarray


class Objective(ABC):
    """A log posterior over the coordinates of a model."""

    coordinates: Coordinates

    @abstractmethod
    def value(self, x: np.ndarray) -> float:
        """Log posterior at x."""

    @abstractmethod
    def local(self, x: np.ndarray) -> Local:
        """Value, gradient and information at x."""

    def hessian(self, x: np.ndarray) -> np.ndarray:
        """Second derivatives of the log posterior at x, by central differences of the exact gradient."""
        n = len(x)
        H = np.empty((n, n))
        for i in range(n):
            h = 1e-4
            up, down = x.copy(), x.copy()
            up[i] += h
            down[i] -= h
            H[i] = (self.local(up).gradient - self.local(down).gradient) / (2 * h)
        return 0.5 * (H + H.T)
