"""What an optimiser needs: value, gradient and curvature of a log posterior at a coordinate vector."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, Self

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
    likelihood: Any

    def on(self, coordinates: Coordinates) -> Self:
        """The same log posterior over other coordinates."""
        return type(self)(self.likelihood, coordinates)  # pyright: ignore[reportCallIssue]

    @abstractmethod
    def value(self, x: np.ndarray) -> float:
        """Log posterior at x."""

    @abstractmethod
    def local(self, x: np.ndarray) -> Local:
        """Value, gradient and information at x."""

    def near(self, x: np.ndarray) -> Self:
        """The same with what it holds near an optimum taken again at x; itself where it holds nothing."""
        return self

    def following(self, x: np.ndarray) -> Self:
        """As `near`, where values of what is held at one place and at another can be compared; else itself."""
        return self

    def gradient(self, x: np.ndarray) -> np.ndarray:
        """The gradient at x."""
        return self.local(x).gradient

    def hessian(self, x: np.ndarray, here: Local | None = None) -> np.ndarray:
        """Second derivatives of the log posterior at x: differences of the exact gradient, symmetrised.

        One-sided (relative error ~1e-4, plenty for standard errors); `here` is `local(x)` when it is known.
        """
        base, steps = self.gradient(x) if here is None else here.gradient, self.difference_steps()
        rows = []
        for i, h in enumerate(steps):
            moved = x.copy()
            moved[i] += h
            rows.append((self.gradient(moved) - base) / h)
        H = np.array(rows)
        return 0.5 * (H + H.T)

    def difference_steps(self) -> np.ndarray:
        """(d,) how far each coordinate is moved for a difference of gradients."""
        return 1e-4 * self.coordinates.longest_moves()
