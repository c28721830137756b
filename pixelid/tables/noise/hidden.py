"""The states of the stages that an event's output and slope do not identify, and that the next event depends on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pixelid.tables.noise.process import NoiseProcess

LOST = 1e-13  # determinant of a correlation matrix that is rounding; `crossings` takes the density there as 0


@dataclass(frozen=True)
class Hidden:
    """Hidden states h between the start and the end of a lag, at both of which output and slope y are known.

    At any crossing h is a standard normal draw.  At first passages it is not, and its law is carried as the first
    terms of its Hermite series: density · (1 + μ·h), μ its mean.  All are linear Gaussian, so with δ the deviation of
    y at the end from its mean

        E[h_start | y_end] = its mean + start_gain δ,   E[h_end | y_end] = end_mean y_start + end_spread o + end_gain δ
        E[h_end h_startᵀ | y_end] = E[h_end | y_end] E[h_start | y_end]ᵀ + cross

    Attributes:
        start_gain, end_gain, end_mean: (n, 2, lags).
        cross: (n, n, lags).
        end_spread: (n, lags) per standard deviation o of the reference that was stored in between; 0 without a reset.
    """

    start_gain: np.ndarray
    end_gain: np.ndarray
    cross: np.ndarray
    end_mean: np.ndarray
    end_spread: np.ndarray

    @classmethod
    def of(
        cls, p: NoiseProcess, reading: np.ndarray, mean: np.ndarray, spread: np.ndarray, carried: np.ndarray,
        covariance: np.ndarray,
    ) -> Hidden:  # fmt: skip
        """From the law of all states at the end.

        reading: (n, states), see `NoiseProcess.hidden`;  mean: (lags, states, 2) per y at the start;
        spread: (lags, states) per standard deviation of the reference;
        carried: (lags, states, n) per h at the start;  covariance: (lags, states, states), h at the start unknown.
        """
        V = p.seen @ covariance @ p.seen.T
        known = np.linalg.det(V) > LOST * V[:, 0, 0] * V[:, 1, 1]
        V[~known] = np.eye(2)
        inverse = np.linalg.inv(V) * known[:, None, None]
        together = np.swapaxes(p.seen @ carried, 1, 2)
        start_gain, end_gain = together @ inverse, reading @ covariance @ p.seen.T @ inverse
        cross = reading @ carried - end_gain @ np.swapaxes(together, 1, 2)
        arrays = start_gain, end_gain, cross, reading @ mean, spread @ reading.T
        return cls(*map(lags_last, arrays))

    @property
    def moments(self) -> int:
        """1 and the mean of each hidden state."""
        return len(self.start_gain) + 1

    @property
    def arrays(self) -> tuple[np.ndarray, ...]:
        """As `crossings` takes them."""
        return self.start_gain, self.end_gain, self.cross, self.end_mean, self.end_spread


def normal_laws(covariances: np.ndarray) -> np.ndarray:
    """(5, lags) of output and slope with covariances (lags, 2, 2): the variance of the output, the entries 00, 01, 11
    of the inverse, and the density at the mean, 0 where the covariance is lost in rounding.
    """
    v00, v01, v11 = covariances[:, 0, 0], covariances[:, 0, 1], covariances[:, 1, 1]
    det = v00 * v11 - v01 * v01
    known = det > LOST * v00 * v11
    det = np.where(known, det, 1.0)
    return np.stack([v00, v11 / det, -v01 / det, v00 / det, known / (2.0 * np.pi * np.sqrt(det))])


def lags_last(array: np.ndarray) -> np.ndarray:
    """(lags, …) as (…, lags), which `crossings` wants."""
    return np.ascontiguousarray(np.moveaxis(array, 0, -1))
