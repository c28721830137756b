"""Pixels that fire on their own, as renewal processes seen through a window: pace and regularity from binned intervals.

A pixel whose intervals are independent with density f (Gamma with mean m and coefficient of variation c), in the
steady state, shows n + 1 events with intervals x₁ … xₙ in a window of T seconds with density

    (1/m) f(x₁) … f(xₙ) J(T − Σx),      J(R) = ∫₀ᴿ S(t) S(R − t) dt,      S = 1 − F

(first event after t, none after the last: both waits are equilibrium ones; Cox, Renewal Theory, 1962, ch. 2 and 3).
Without J, slow pixels look fast: a long interval rarely fits into the window.  c = 1 is a Poisson process; noise that
crosses a threshold is near it or above, a leak whose threshold is noisy is far below.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit, gammainc, gammaln

CVS = np.geomspace(0.03, 2.5, 45)
MAX_SLOW = 5  # intervals of a pixel that still counts as slow
TIME_STEPS = 1024  # of time in a window
PERIODS = 128
DAMPING = 9.0  # time constants in a window
MAX_MEAN_WINDOWS = 30.0  # windows: mean intervals beyond are silence


def share(edges_s: np.ndarray, mean_s: np.ndarray, cv: np.ndarray) -> np.ndarray:
    """Share of Gamma intervals in each bin: (..., bins) for `mean_s`, `cv` (...) and bin edges (bins + 1,)."""
    shape = 1.0 / cv[..., None] ** 2
    return np.diff(gammainc(shape, shape * edges_s / mean_s[..., None]), axis=-1)


@dataclass(frozen=True)
class Paces:
    """Pixels with Gamma intervals of their own means and one cv.

    cv: of all;  mean_s: of each pixel at that cv
    profile: (cvs, pixels) log-likelihood at each of `CVS`, each pixel's mean free
    """

    cv: float
    mean_s: np.ndarray
    profile: np.ndarray

    def cv_of(self, pixels: np.ndarray) -> float:
        """The cv that these pixels alone would give (for a bootstrap)."""
        return _best_cv(self.profile[:, pixels].sum(axis=1))


def paces(counts: np.ndarray, edges_s: np.ndarray) -> Paces:
    """Means and common cv of best likelihood for counts (pixels, bins).

    Made for pixels with ten intervals or more, all short against the window.  The cv is common to the pixels because
    one pixel's bins may be too coarse for it: with two of them filled any small cv does.
    """
    used = counts.any(axis=0)
    middle = np.sqrt(edges_s[1:] * edges_s[:-1])
    rough = counts @ middle / counts.sum(axis=1)
    means = np.geomspace(0.4 * rough.min(), 2.5 * rough.max(), 24 * int(np.log2(rough.max() / rough.min()) + 4))
    best, mean = np.empty((len(CVS), len(counts))), np.empty((len(CVS), len(counts)))
    rows = np.arange(len(counts))
    for k, c in enumerate(CVS):
        log_share = np.log(np.maximum(share(edges_s, means, np.full_like(means, c))[:, used], 1e-300))
        value = counts[:, used] @ log_share.T
        at = np.clip(value.argmax(axis=1), 1, len(means) - 2)
        step, best[k] = _parabola_maximum(value[rows, at - 1], value[rows, at], value[rows, at + 1])
        mean[k] = means[at] * (means[1] / means[0]) ** step
    cv = _best_cv(best.sum(axis=1))
    return Paces(cv, mean[int(np.argmin(np.abs(np.log(CVS / cv))))], best)


def _best_cv(profile: np.ndarray) -> float:
    at = int(np.clip(profile.argmax(), 1, len(CVS) - 2))
    step, _ = _parabola_maximum(*profile[at - 1 : at + 2, None])
    return float(CVS[at] * (CVS[1] / CVS[0]) ** step[0])


def _parabola_maximum(left: np.ndarray, top: np.ndarray, right: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where, in steps from the middle, a parabola through three values is highest, and how high."""
    bend = left - 2 * top + right
    step = np.where(bend < 0, np.clip(0.5 * (left - right) / np.where(bend < 0, bend, -1.0), -1, 1), 0.0)
    return step, top + 0.25 * (right - left) * step


@dataclass(frozen=True)
class Slow:
    """Pixels with few intervals in the window.

    Most are regular: their rates are log-normal over pixels, with one cv.  A share `irregular` is Poisson, at any rate.
    rate_hz: of the median pixel;  spread: standard deviation over pixels of ln rate;  cv: of a pixel's intervals
    log_likelihood: at the best cv, and `poisson` where all are Poisson
    """

    rate_hz: float
    spread: float
    cv: float
    irregular: float
    log_likelihood: float
    poisson: float


class SlowPixels:
    """The likelihood of the pixels with up to `MAX_SLOW` intervals in a window of `window_s`, tabulated once.

    Which pixels are slow depends on the data, so the likelihood is that of a pixel given that it is slow.
    """

    def __init__(self, counts: np.ndarray, edges_s: np.ndarray, window_s: float, cvs: np.ndarray = CVS) -> None:
        """counts: (pixels, bins) of all pixels;  edges_s: rising interval edges (bins + 1,)"""
        self.slow = np.flatnonzero(counts.sum(axis=1) <= MAX_SLOW)
        self.patterns, index = np.unique(counts[self.slow].astype(int), axis=0, return_inverse=True)
        self.index = index.ravel()
        self.means = np.geomspace(window_s / 40.0, MAX_MEAN_WINDOWS * window_s, PERIODS)
        self.cvs = np.append(cvs, 1.0)  # the last one is Poisson
        tables = [_tables(self.patterns, edges_s, window_s, self.means, c) for c in self.cvs]
        self.table = np.stack([t[0] for t in tables])  # (cvs, patterns, means)
        self.number = np.stack([t[1] for t in tables])  # (cvs, MAX_SLOW + 1, means): chance of 0, 1, … intervals
        self.allowed = self.number.sum(axis=1)  # (cvs, means)
        fast = self.means < 0.5 * window_s
        self.of_irregular = (
            self.table[-1][:, fast].mean(axis=1) / self.allowed[-1][fast].mean()
        )  # of an irregular pixel

    def fit(self, pixels: np.ndarray | None = None) -> Slow:
        """The best Slow; `pixels` (indices among the slow) for a bootstrap."""
        index = self.index if pixels is None else self.index[pixels]
        weight = np.bincount(index, minlength=len(self.patterns)).astype(float)
        x = np.log(self.means)

        def cost(at: np.ndarray, k: int) -> float:
            # not narrower than the grid of periods, not outside it
            fence = 1e3 * (
                max(0.0, -2.3 - at[1]) + max(0.0, at[1] - 1.5) + max(0.0, abs(at[0] - x.mean()) - np.ptp(x) / 2)
            )
            mixture = np.exp(-0.5 * ((x - at[0]) / np.exp(np.clip(at[1], -2.5, 2.0))) ** 2)
            mixture = mixture / max(mixture.sum(), 1e-300)
            seen = (self.table[k] @ mixture) / max(self.allowed[k] @ mixture, 1e-300)
            odd = float(expit(at[2]))
            return fence - float(weight @ np.log(np.maximum((1 - odd) * seen + odd * self.of_irregular, 1e-300)))

        start = np.array([np.log(self.means[0] * 20.0), np.log(0.5), -4.0])
        minima: dict[int, Any] = {}
        last = len(self.cvs) - 1

        def at(k: int) -> float:
            if k not in minima:
                near = min((j for j in minima if j != last), key=lambda j: abs(j - k), default=None)
                first = start if near is None or k == last else minima[near].x
                minima[k] = minimize(cost, first, (k,), "Nelder-Mead", options={"xatol": 1e-3, "fatol": 1e-3})
            return minima[k].fun

        low, high = 0, last - 1
        while high - low > 2:  # one valley over cv
            a, b = low + (high - low) // 3, high - (high - low) // 3
            low, high = (low, b) if at(a) <= at(b) else (a, high)
        k = min((*range(low, high + 1), last), key=at)
        best = minima[k]
        return Slow(
            rate_hz=float(np.exp(-best.x[0])),
            spread=float(np.exp(best.x[1])),
            cv=float(self.cvs[k]),
            irregular=float(expit(best.x[2])),
            log_likelihood=-float(best.fun),
            poisson=-float(minima[last].fun),
        )


def _tables(patterns: np.ndarray, edges_s: np.ndarray, window_s: float, means: np.ndarray, cv: float):
    """(patterns, means): chance of each pattern of intervals, (MAX_SLOW + 1, means): chance of each number of them.

    Sums of intervals are convolutions, done on a grid of time by FFT: a pattern is the product of its bins' transforms
    and that of J, read at the window's end.  Everything is damped by exp(-t/τ) first and restored at the end, so that
    sums beyond twice the window, which come round, weigh exp(-2 · `DAMPING`) of what they would.
    """
    dt = window_s / TIME_STEPS
    size = 2 * TIME_STEPS
    t = dt * np.arange(TIME_STEPS + 1)
    shape = 1.0 / cv**2
    cumulative = gammainc(shape, shape * t / means[:, None])  # (means, times)
    mass = np.diff(cumulative, axis=1)  # of intervals between two grid points, put at the later
    survival = 1.0 - 0.5 * (cumulative[:, 1:] + cumulative[:, :-1])
    damp = np.exp(-DAMPING * t[:-1] / window_s)
    waits = np.fft.rfft(survival * damp, size) ** 2 * dt / means[:, None]  # (1/m) J, per time step
    into = np.clip(np.searchsorted(edges_s, t[:-1] + 0.5 * dt, side="right") - 1, -1, len(edges_s) - 1)
    transforms = {}
    for j in np.flatnonzero(patterns.any(axis=0)):
        transforms[j] = np.fft.rfft(np.where(into == j, mass * damp, 0.0), size)
    turn = np.exp(2j * np.pi * np.arange(TIME_STEPS + 1) * (TIME_STEPS - 1) / size)
    turn[1:-1] *= 2.0  # the other half of a real signal's spectrum

    def read(spectrum: np.ndarray) -> np.ndarray:
        return np.maximum(np.real(spectrum * turn).sum(axis=-1) / size / damp[-1], 0.0)

    # no event at all: the equilibrium density S/m beyond T
    nothing, single = np.maximum(1.0 - (survival * dt).sum(axis=1) / means, 0.0), read(waits)
    table = np.empty((len(patterns), len(means)))
    for row, pattern in enumerate(patterns):
        spectrum = waits
        for j in np.flatnonzero(pattern):
            spectrum = spectrum * transforms[j] ** int(pattern[j])
        table[row] = read(spectrum) * _orders(pattern) + (nothing if not pattern.any() else 0.0)
    number, spectrum, every = [nothing + single], waits, np.fft.rfft(mass * damp, size)
    for _ in range(MAX_SLOW):
        spectrum = spectrum * every
        number.append(read(spectrum))
    return table, np.maximum(number, 1e-300)


def _orders(pattern: np.ndarray) -> float:
    """In how many orders these intervals can come (it is the same for all parameters)."""
    return float(np.exp(gammaln(pattern.sum() + 1) - gammaln(pattern + 1).sum()))
