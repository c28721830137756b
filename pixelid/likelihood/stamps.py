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

Levels bend within σ where a pixel was let go shortly before, so all of it is expanded where events most likely happened
(`Placed`): with û_k the most likely j_k, all levels given (Rauch, Tung & Striebel 1965, AIAA J. 3, 1445), r, m and the
level are taken at stamps that are û earlier, and carried on from there to the stamps as measured,

    y_k ≈ y(û_k, û_{k−1}) + r_k û_k + m_k û_{k−1},

until û rests: the Gauss-Newton form of Laplace's approximation of the integral over all j.  What is left of the bend
counts to first order.  With H the second derivatives of y by both times, h = (r, m), D = diag(σ², σ² (1 − r_{k−1}²
σ²/S_{k−1})), g = D h/S and d = e g − (û_k, û_{k−1}), the log density of e is that of a normal one and

    c(e) = −e/(2 S) (dᵀHd + tr HD − S gᵀHg) + gᵀHd − (H d)_1/r_k,

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
RESTS = 0.03  # of a level's standard deviation, by which the last placing of any event moved it
CLOSER = 0.75  # of the time since a pixel's release, by which a turn may place an event closer to it
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

    def with_bend(
        self, terms: Terms, moved: np.ndarray, stamp: np.ndarray, bend: Bend, placed: Placed | None = None
    ) -> Carried:
        """The same with what second derivatives add;  arguments otherwise as of `carried_over`."""
        rate, S, e = terms.event.rate, self.sd**2, self.level
        at_event, at_reset = stamp * rate / S, self.left * moved / S
        d_event, d_reset = e * at_event, e * at_reset
        if placed is not None:
            d_event, d_reset = d_event - placed.earlier, d_reset - placed.reset_earlier
        along_event = at_event * bend.event + at_reset * bend.both
        along_reset = at_event * bend.both + at_reset * bend.reset
        mixed = along_event * d_event + along_reset * d_reset
        twice = at_event * along_event + at_reset * along_reset
        squared = d_event**2 * bend.event + 2.0 * d_event * d_reset * bend.both + d_reset**2 * bend.reset
        spread = stamp * bend.event + self.left * bend.reset - S * twice + squared
        bent = -0.5 * spread - e * mixed + S * twice - S * along_event / rate
        c = -0.5 * e / S * spread + mixed - (d_event * bend.event + d_reset * bend.both) / rate
        most = MOST_BENT * self.sd
        bent, c = np.clip(np.nan_to_num(bent), -most, most), np.clip(np.nan_to_num(c), -MOST_BENT, MOST_BENT)
        gain = np.where(np.abs(e) < FAR * self.sd, c - bent * (e - 0.5 * bent) / S, 0.0)
        return replace(self, bent=read_only(bent), gain=read_only(gain), bend=bend)

    def placed(
        self, terms: Terms, moved: np.ndarray, stamp: np.ndarray, before: Placed | None, share: float = 1.0
    ) -> Placed:
        """Where events most likely happened, all levels given;  arguments otherwise as of `carried_over`.

        before: where they are placed;  a pixel stays released before each, and what says nothing of its stamp stays
        share: of the way from there
        """
        n = len(self.order)
        earlier = np.zeros(n) if before is None else before.earlier.copy()
        reset_earlier = np.zeros(n)
        usable = (self.sd > 0.0) & (np.abs(self.level) < FAR * self.sd) & ~(terms.background | terms.at_once)
        rate, waits = terms.event.rate, -terms.changes.events.early
        _smooth(
            self.order, self.after, usable, self.level, self.sd**2, rate, moved, stamp, self.left, waits, share,
            earlier, reset_earlier,
        )  # fmt: skip
        most = np.sqrt(MOST_SHARE)
        ratio = np.clip(np.divide(moved, rate, out=np.zeros(n), where=rate > 0.0), -most, most)
        return Placed(*map(read_only, (earlier, reset_earlier, earlier + ratio * reset_earlier)))

    def apply(self, changes: StackedChanges, among: np.ndarray | None = None) -> None:
        """Take from the changes what events before say of them, at those `among` (n,) only."""
        every = np.ones(len(self.order), np.bool_) if among is None else among
        _take(
            changes.events.change, every, self.order, self.after, self.by, self.scale, self.change, self.level, self.sd,
            self.bent,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Placed:
    """Events where they most likely happened.

    earlier, reset_earlier: (n,) by how many seconds before their stamps the events, and those before them, are placed
    back: (n,) seconds by which levels and leaks are carried on along their slopes, from there to the stamps as measured
    """

    earlier: np.ndarray
    reset_earlier: np.ndarray
    back: np.ndarray

    def not_carried_on(self) -> Placed:
        """The same with levels where the events are placed."""
        return replace(self, back=read_only(np.zeros(len(self.back))))

    def rests_at(self, before: Placed | None, terms: Terms) -> bool:
        """Whether levels differ by little from those where events were placed before."""
        went = self.earlier if before is None else self.earlier - before.earlier
        return bool(np.max(np.abs(went) * terms.event.rate / terms.scale, initial=0.0) < RESTS)

    def apply(self, changes: StackedChanges, among: np.ndarray | slice = slice(None)) -> None:
        """Carry the changes on to the stamps, at the events `among` (n,) only."""
        rows, back = changes.events, self.back[among]
        rows.change[among] += back * rows.slope[among]
        rows.drift[among] += back * rows.drift_slope[among]


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


@njit(cache=True, nogil=True, error_model="numpy")
def _smooth(order, after, usable, level, S, rate, moved, stamp, left, waits, share, earlier, reset_earlier):
    """Put the most likely noise of stamps into `earlier`, where they are placed before, and that of resets."""
    n = len(order)
    likely = np.zeros(n)
    later = 0.0  # what the event after adds
    for i in range(n - 1, -1, -1):
        k = order[i]
        own = rate[k] * stamp[k] * level[k] / S[k] if usable[k] else 0.0
        likely[k] = own + later
        later = 0.0
        if after[k] and usable[k]:
            var = stamp[k] * (1.0 - rate[k] * rate[k] * stamp[k] / S[k])
            gain = -left[k] * moved[k] * rate[k] * stamp[k] / S[k]
            later = left[k] * moved[k] * level[k] / S[k]
            if var > 0.0:
                later += gain * (likely[k] - own) / var
    went = 0.0
    for i in range(n):
        k = order[i]
        if not after[k]:
            went = 0.0
        placed = earlier[k]
        # what lies far off, where it is placed or elsewhere, would go to and fro
        to = placed + share * (likely[k] - placed) if usable[k] else placed
        if waits[k] > 0.0:
            to = min(to, placed + went + CLOSER * waits[k])
        reset_earlier[k] = earlier[order[i - 1]] if after[k] else 0.0
        went = to - placed
        earlier[k] = to
