"""How a sampled light runs between its samples: cubic splines from kink to kink.

A spline rings around a corner that lies between two samples, and a straight line cuts it.  Where the second
differences of log radiance stand out on the two samples around an interval, against the ones next to them, the course
has a corner inside that interval; both sides are continued to where they meet (subcell resolution: Harten 1989,
J. Comput. Phys. 83, 148).  Sides that do not meet inside are joined by a straight line: the light jumped.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq


@dataclass(frozen=True)
class Course:
    """Log radiance at any time.

    starts: (k,) s, where each piece begins, ascending;  pieces: (k,) splines
    """

    starts: np.ndarray
    pieces: tuple[CubicSpline, ...]

    @property
    def corners(self) -> np.ndarray:
        """(k − 1,) times at which one piece meets the next."""
        return self.starts[1:]

    def __call__(self, t: np.ndarray, order: int = 0) -> np.ndarray:
        """Log radiance, or a derivative of it, at times t (n,)."""
        t = np.asarray(t, dtype=float)
        which = np.clip(np.searchsorted(self.starts, t, side="right") - 1, 0, len(self.pieces) - 1)
        if len(self.pieces) == 1:
            return self.pieces[0](t, order)
        values = np.empty(len(t))
        edges = np.flatnonzero(np.diff(which)) + 1
        if len(t) and (np.diff(t) >= 0).all():
            for begin, end in zip([0, *edges], [*edges, len(t)], strict=True):
                values[begin:end] = self.pieces[which[begin]](t[begin:end], order)
            return values
        for piece in np.unique(which):
            here = which == piece
            values[here] = self.pieces[piece](t[here], order)
        return values


def course(t: np.ndarray, u: np.ndarray) -> Course:
    """The course through samples u (n,) of log radiance at ascending times t (n,), n ≥ 4."""
    broken = _broken_intervals(u)
    starts, pieces = [float(t[0])], []
    first = 0
    for k in [*broken, len(t) - 1]:
        last = k if k < len(t) - 1 else len(t) - 1
        pieces.append(_spline(t[first : last + 1], u[first : last + 1]))
        first = k + 1
        if k == len(t) - 1:
            break
        after = min([b for b in broken if b > k], default=len(t) - 1)
        meeting = _meeting(pieces[-1], _spline(t[first : after + 1], u[first : after + 1]), t[k], t[first])
        if meeting is None:
            starts += [float(t[k]), float(t[first])]
            pieces.append(_spline(t[k : first + 1], u[k : first + 1]))
        else:
            starts.append(meeting)
    return Course(np.array(starts), tuple(pieces))


def _broken_intervals(u: np.ndarray) -> list[int]:
    """Intervals k … k+1 that hold a corner, at least two samples apart."""
    bend = np.zeros(len(u) + 2)  # |second difference| at samples −1 … n
    bend[2:-2] = np.abs(np.diff(u, 2))
    inside = bend[1:-2] + bend[2:-1]  # of the samples k and k + 1
    beside = bend[:-3] + bend[3:]
    stands_out = 10.0  # times the second differences beside it
    smallest_bend = 1e-4  # second difference of log radiance that may be a corner
    corner = (inside > stands_out * beside) & (inside > smallest_bend)
    found: list[int] = []
    for k in np.flatnonzero(corner):
        if 1 <= k <= len(u) - 3 and (not found or k - found[-1] >= 2):
            found.append(int(k))
    return found


def _spline(t: np.ndarray, u: np.ndarray) -> CubicSpline:
    if len(t) == 1:
        return CubicSpline(np.array([t[0], t[0] + 1.0]), np.array([u[0], u[0]]))
    return CubicSpline(t, u)


def _meeting(left: CubicSpline, right: CubicSpline, begin: float, end: float) -> float | None:
    """When two pieces continued into begin … end meet; None when they do not, or meet only at a grazing angle."""

    def apart(when: float) -> float:
        return float(left(when) - right(when))

    a, b = apart(begin), apart(end)
    if a == 0.0 or b == 0.0:
        return begin if a == 0.0 else end
    if a * b > 0:
        return None
    return float(np.asarray(brentq(apart, begin, end, xtol=1e-12)))
