"""Noise of stamps, which an event's level shares with the next one of its pixel.

A stamp that is late by j_k raises the level at its own event by r_k j_k, r_k the level's rate, and that at the next by
m_{k+1} j_k: it moves the reference, too.  So levels of neighbours are correlated,

    y_k = z_k − C = ξ_k + r_k j_k + m_k j_{k−1},

and stamps that stand for references are errors in a variable: unless what y_{k−1} says of j_{k−1} is taken from y_k,
short intervals shift poles and dead times by a multiple of their errors.  The innovations of the sequence are
independent (Kalman 1960, J. Basic Eng. 82, 35):

    e_k = y_k − b_k e_{k−1},    b_k = m_k r_{k−1} σ²/S_{k−1},
    S_k = V_k + r_k² σ² + m_k² σ² (1 − r_{k−1}² σ²/S_{k−1})

with V_k the variance of the threshold and σ² that of stamps.

Levels bend within σ where a pixel was let go shortly before.  With H the second derivatives of y by both times, h =
(r, m), D = diag(σ², σ² (1 − r_{k−1}² σ²/S_{k−1})) and g = D h/S, the log density of e is, to first order in H, that of
a normal one and

    c(e) = −e/(2 S) (e² gᵀHg + tr HD − 3 S gᵀHg) − (H g)_1 e/r_k,

the last term the Jacobian's.  Its derivative is that by which a level further off by S c′(e) differs.  All of this is
taken where a circuit puts it and held.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from pixelid.likelihood.layout import StackedChanges, read_only

if TYPE_CHECKING:
    from pixelid.likelihood.density import Terms

FAR = 5.0  # standard deviations: what lies further off says nothing of its stamp
NEGLIGIBLE = 0.01  # of an innovation, that the next level shares, in any event
MOST_BENT = 0.5  # of an innovation's standard deviation, by second derivatives
BENT, FEW = 0.2, 0.01  # of a standard deviation, from which first order errs by a tenth; share of events that may be so
MOST_SHARE = 100.0  # a level that falls ten times as fast by its reset as it rises: the light has all but turned


@dataclass(frozen=True, eq=False)
class Carried:
    """What levels share with those of the events before them.

    order: (n,) rows, each pixel's in a recording after each other in order of time
    after: (n,) whether the event before, in that order, is the pixel's one before and says something of its stamp
    by: (n,) b
    scale: (n,) what levels change by with their changes
    change, level: (n,) both at the circuit that all is taken at, the level about its threshold and of innovations
    sd: (n,) of innovations
    left: (n,) variance of the stamp before, given its own level
    bent: (n,) S c′(e)
    gain: (n,) c(e) less what levels further off by S c′(e) gain: so the density at the circuit is that with the bend
    bend: second derivatives that these are of, or None
    """

    order: np.ndarray
    after: np.ndarray
    by: np.ndarray
    scale: np.ndarray
    change: np.ndarray
    level: np.ndarray
    sd: np.ndarray
    left: np.ndarray
    bent: np.ndarray
    gain: np.ndarray
    bend: Bend | None = None

    @property
    def nearly_straight(self) -> bool:
        """Whether second derivatives are small in nearly all events, so that values of the density can be compared."""
        return bool(np.mean(np.abs(self.bent) > BENT * self.sd) < FEW)

    def with_bend(self, terms: Terms, moved: np.ndarray, stamp: np.ndarray, bend: Bend) -> Carried:
        """The same with what second derivatives add;  arguments otherwise as of `carried_over`."""
        rate, S, e = terms.event.rate, self.sd**2, self.level
        at_event, at_reset = stamp * rate / S, self.left * moved / S
        along = at_event * bend.event + at_reset * bend.both
        twice = at_event * along + at_reset * (at_event * bend.both + at_reset * bend.reset)
        spread = stamp * bend.event + self.left * bend.reset
        bent = -0.5 * (3.0 * e * e * twice + spread - 3.0 * S * twice) - S * along / rate
        c = -0.5 * e / S * (e * e * twice + spread - 3.0 * S * twice) - along * e / rate
        most = MOST_BENT * self.sd
        bent, c = np.clip(np.nan_to_num(bent), -most, most), np.clip(np.nan_to_num(c), -MOST_BENT, MOST_BENT)
        gain = np.where(np.abs(e) < FAR * self.sd, c - bent * (e - 0.5 * bent) / S, 0.0)
        return replace(self, bent=read_only(bent), gain=read_only(gain), bend=bend)

    def apply(self, changes: StackedChanges, among: np.ndarray | None = None) -> None:
        """Take from the changes what events before say of them, at those `among` (n,) only."""
        every = np.ones(len(self.order), np.bool_) if among is None else among
        _take(
            changes.events.change, every, self.order, self.after, self.by, self.scale, self.change, self.level, self.sd,
            self.bent,
        )  # fmt: skip


@dataclass(frozen=True)
class Bend:
    """(n,) second derivatives of levels, by the time of the event, that of the reset, and both; 0 where unknown."""

    event: np.ndarray
    reset: np.ndarray
    both: np.ndarray


def carried_over(
    terms: Terms, moved: np.ndarray, stamp: np.ndarray, scale: np.ndarray, previous_s: np.ndarray,
    added: np.ndarray | None = None,
) -> tuple[Carried | None, np.ndarray]:  # fmt: skip
    """(what levels share with those before, None where that is little; (n,) variance by stamps over r² σ²).

    Args:
        terms: At a circuit, its timestamp noise counted once.
        moved: (n,) m.
        stamp: (n,) σ², of each event's unit and the jitter [s²].
        scale: (n,) what levels change by with their changes.
        previous_s: (n,) times of the pixels' events before.
        added: (n,) variance of levels by other noise; None: there is none.
    """
    at, rate = terms.layout, terms.event.rate
    y = np.where(terms.z != 0.0, terms.z - terms.group_mean[at.group], 0.0)
    usable = ~(terms.background | terms.at_once) & (np.abs(y) < FAR * terms.scale)
    order = np.lexsort((at.time_s, at.pixel * at.recordings + at.recording))
    after = np.zeros(len(y), np.bool_)
    first, second = order[:-1], order[1:]
    same = (at.pixel[first] == at.pixel[second]) & (at.recording[first] == at.recording[second])
    after[second] = same & (at.time_s[first] == previous_s[second]) & usable[first]
    own = rate**2 * stamp
    thresholds = np.maximum(terms.scale**2 - rate**2 * terms.event.clock, 1e-300) + (0.0 if added is None else added)
    left, by, level, S = (np.ones(len(y)) for _ in range(4))
    _innovations(order, after, y, rate, moved, stamp, own, thresholds, left, by, level, S)
    share = 1.0 + np.minimum(moved**2 * left / own, MOST_SHARE - 1.0)
    previous = np.empty(len(y))
    previous[second] = np.sqrt(S[first])
    previous[order[:1]] = 0.0
    if np.max(np.abs(by) * previous / np.sqrt(S), initial=0.0) < NEGLIGIBLE:
        return None, share
    change = terms.changes.events.change.copy()
    of, none = read_only, read_only(np.zeros(len(y)))
    sd = of(np.sqrt(S))
    return Carried(of(order), of(after), of(by), of(scale), of(change), of(level), sd, of(left), none, none), share


@njit(cache=True, nogil=True, error_model="numpy")
def _innovations(order, after, y, rate, moved, stamp, own, thresholds, left, by, level, S):
    """Fill `left` and `by`, the innovations `level` and their variances `S`."""
    last = 0
    for i in range(len(order)):
        k = order[i]
        by[k], left[k] = 0.0, stamp[k]
        if after[k]:
            left[k] = stamp[last] * (1.0 - own[last] / S[last])
            by[k] = moved[k] * rate[last] * stamp[last] / S[last]
            level[k] = y[k] - by[k] * level[last]
        else:
            level[k] = y[k]
        S[k] = thresholds[k] + own[k] + moved[k] * moved[k] * left[k]
        last = k


@njit(cache=True, nogil=True, error_model="numpy")
def _take(row, among, order, after, by, scale, change, level, sd, bent):
    """Innovations in place of changes, where they are not too far off to say anything."""
    last_level = 0.0
    for i in range(len(order)):
        k = order[i]
        if not among[k]:
            continue
        here = level[k] + scale[k] * (row[k] - change[k])
        shared = 0.0
        if after[k]:
            shared = by[k] * last_level
            here += by[k] * level[order[i - 1]] - shared
        row[k] -= (shared + bent[k]) / scale[k]
        last_level = min(max(here, -FAR * sd[k]), FAR * sd[k]) if abs(here) < np.inf else 0.0
