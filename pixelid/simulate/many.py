"""First crossings of many pixels at once, in vector form, where the way to them is plain.

The search is that of `crossing.py`, for pixels without leak or drift: one cubic through the step's ends, compared with
the closed form once inside, brackets the crossing, and ever closer cubics find it.  Where anything else happens (both
thresholds within reach, a hump, a cubic that the step does not follow, a crossing not found in `ROUNDS`), the pixel is
left to `comparator.events_in_step`, which begins again.  Rows are those of `dynamics.blocks`, for the steps from the
beginning to the time looked at, and those below; one column per pixel searched.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pixelid.dynamics import blocks
from pixelid.dynamics.blocks import (
    B2,
    BLOCK,
    D0,
    D1,
    KD,
    P0,
    P1,
    Q0,
    Q1,
    RT,
    S0,
    S1,
    TAU,
    U0,
    V0,
    V1,
    Y0,
    Y1,
    A,
    R,
)  # fmt: skip
from pixelid.dynamics.equations import PRESENT_BELOW
from pixelid.dynamics.vector_math import vexp
from pixelid.simulate import comparator
from pixelid.simulate.chain_step import SPARE
from pixelid.simulate.crossing import ACCURACY_S, TRUST

ROUNDS = 5  # of closer cubics; two or three find nearly all crossings
SETTLED = 1e-7  # last move of Newton's method on a cubic, as a fraction of its bracket: the next would be its square
LANES = 8  # columns are taken in whole vectors: what the last one has too many nobody reads

# Rows after those of `chain_step`.  LAST_S, LAST_D: follower and output where the step ends;  LEVEL … RELEASE: of the
# comparator;  SIGN, THRESHOLD: of the event looked for, margin = SIGN · change − THRESHOLD;  XA … SB: the bracket, its
# margins and their slopes;  K: of the cubic's error (`crossing._root`);  P, SLOPE, MOVE: a cubic's root;  X: time;
# PLAIN: whether the search holds;  HIT: whether there is an event;  FOUND: whether its time X is exact
(
    LAST_S, LAST_D, LEVEL, DECAY, ON, OFF, RELEASE, SIGN, THRESHOLD, XA, GA, SA, XB, GB, SB, K, P, SLOPE, MOVE, X,
    PLAIN, HIT, FOUND,
) = range(SPARE + 1, SPARE + 24)  # fmt: skip
ROWS = FOUND + 1


@njit(cache=True, nogil=True, error_model="numpy")
def take(w, local, which, count, q):
    """Copy the columns which[:count] of a tile's steps w and comparators `local` (FIELDS, n) into q."""
    for j in range(count):
        i = which[j]
        q[j + V0 * BLOCK], q[j + Y0 * BLOCK] = w[i + V0 * BLOCK], w[i + Y0 * BLOCK]
        q[j + S0 * BLOCK], q[j + D0 * BLOCK] = w[i + S0 * BLOCK], w[i + D0 * BLOCK]
        q[j + U0 * BLOCK], q[j + R * BLOCK], q[j + RT * BLOCK] = w[i + U0 * BLOCK], w[i + R * BLOCK], w[i + RT * BLOCK]
        q[j + A * BLOCK], q[j + B2 * BLOCK] = w[i + A * BLOCK], w[i + B2 * BLOCK]
        q[j + P0 * BLOCK], q[j + P1 * BLOCK] = w[i + P0 * BLOCK], w[i + P1 * BLOCK]
        q[j + Q0 * BLOCK], q[j + Q1 * BLOCK] = w[i + Q0 * BLOCK], w[i + Q1 * BLOCK]
        q[j + SPARE * BLOCK] = w[i + SPARE * BLOCK]
        q[j + LAST_S * BLOCK], q[j + LAST_D * BLOCK] = w[i + S1 * BLOCK], w[i + D1 * BLOCK]
        q[j + LEVEL * BLOCK], q[j + DECAY * BLOCK] = local[comparator.LEVEL, i], local[comparator.DECAY, i]
        q[j + ON * BLOCK], q[j + OFF * BLOCK] = local[comparator.ON, i], local[comparator.OFF, i]
        q[j + RELEASE * BLOCK] = local[comparator.RELEASE, i]


@njit(cache=True, nogil=True, error_model="numpy")
def release(q, count, t0, tau, w1, wd):
    """The pixels whose dead time ends in the step: fill LEVEL and DECAY at its end, PLAIN where no event can follow.

    w1, wd: cutoffs in rad/s of follower and amplifier
    """
    n = -(-count // LANES) * LANES
    _releases(q, n, t0, tau)
    blocks.states_after(q, n, w1, wd)
    _bound_until_end(q, n, tau, w1 if w1 < PRESENT_BELOW else 0.0, wd)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _releases(q, n, t0, tau):
    for i in range(n):
        q[i + TAU * BLOCK] = min(max(q[i + RELEASE * BLOCK] - t0, 0.0), tau)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _bound_until_end(q, n, tau, w1, wd):
    for i in range(n):
        x, r = q[i + TAU * BLOCK], q[i + R * BLOCK]
        y, s, d = q[i + Y1 * BLOCK], q[i + S1 * BLOCK], q[i + D1 * BLOCK]
        ey, ev = y - q[i + U0 * BLOCK] - r * x + q[i + RT * BLOCK], q[i + V1 * BLOCK] - r
        bound = abs(r) + np.sqrt(ev * ev + q[i + A * BLOCK] * ey * ey)
        bound = max(bound, max(w1 * abs(y - s), wd * abs(s - d)))
        left = tau - x
        decay = d - s
        faded = decay * vexp(-wd * left)
        middle, spare = 0.5 * (d + q[i + LAST_D * BLOCK]) - s, 0.5 * bound * left
        high, low = middle + spare - min(decay, faded), middle - spare - max(decay, faded)
        q[i + LEVEL * BLOCK], q[i + DECAY * BLOCK] = s, faded
        plain = 1.0 if high < q[i + ON * BLOCK] else 0.0
        q[i + PLAIN * BLOCK] = plain if -low < q[i + OFF * BLOCK] else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def search(q, count, tau, w1, wd):
    """The live pixels that may fire: fill PLAIN, HIT, SIGN and X, the times of the events since the step began."""
    n = -(-count // LANES) * LANES
    _ends(q, n, tau, wd, np.exp(-wd * tau))
    _roots(q, n)
    _first_looks(q, n, tau)
    blocks.states_after(q, n, w1, wd)
    _judge(q, n, tau, wd)
    _halve(q, n, tau)
    for _ in range(ROUNDS):
        _roots(q, n)
        if _unfound(q, count, n) == 0.0:
            return
        blocks.states_after(q, n, w1, wd)
        _closer(q, n, wd)
    _give_up(q, n)


@njit(inline="always", error_model="numpy")
def _cubic(p, h, f0, f1, s0, s1):
    """The value of `step.cubic`."""
    back = 1.0 - p
    rest = h * p * back * (s0 * back - s1 * p)
    return f0 * (1.0 + 2.0 * p) * back * back + f1 * (1.0 + 2.0 * back) * p * p + rest


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _ends(q, n, tau, wd, kd):
    """Margins at both ends, for the polarity within reach."""
    for i in range(n):
        level, decay = q[i + LEVEL * BLOCK], q[i + DECAY * BLOCK]
        on, off, spare = q[i + ON * BLOCK], q[i + OFF * BLOCK], q[i + SPARE * BLOCK]
        d0, d1 = q[i + D0 * BLOCK], q[i + LAST_D * BLOCK]
        faded = decay * kd
        middle = 0.5 * (d0 + d1) - level
        rise = 1.0 if middle + spare - min(decay, faded) >= on else 0.0
        fall = 1.0 if max(decay, faded) + spare - middle >= off else 0.0
        sign = 1.0 if rise > 0.0 else -1.0
        threshold = on if rise > 0.0 else off
        ga, gb = sign * (d0 - level - decay) - threshold, sign * (d1 - level - faded) - threshold
        q[i + SIGN * BLOCK], q[i + THRESHOLD * BLOCK] = sign, threshold
        q[i + XA * BLOCK], q[i + GA * BLOCK] = 0.0, ga
        q[i + XB * BLOCK], q[i + GB * BLOCK] = tau, gb
        q[i + SA * BLOCK] = sign * wd * (q[i + S0 * BLOCK] - d0 + decay)
        q[i + SB * BLOCK] = sign * wd * (q[i + LAST_S * BLOCK] - d1 + faded)
        q[i + PLAIN * BLOCK] = (1.0 if ga < 0.0 else 0.0) if rise * fall == 0.0 else 0.0


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _roots(q, n):
    """Where the cubics of the brackets cross zero: `crossing._cubic_root` of a fixed number of steps."""
    for i in range(n):
        ga, gb, h = q[i + GA * BLOCK], q[i + GB * BLOCK], q[i + XB * BLOCK] - q[i + XA * BLOCK]
        first, last = h * q[i + SA * BLOCK], h * q[i + SB * BLOCK]
        quadratic = 3.0 * (gb - ga) - 2.0 * first - last
        third = first + last - 2.0 * (gb - ga)
        low, high, p = 0.0, 1.0, ga / (ga - gb)
        move, slope = 1.0, 1.0
        for _ in range(5):
            value = ga + p * (first + p * (quadratic + p * third))
            slope = first + p * (2.0 * quadratic + 3.0 * p * third)
            low = p if value < 0.0 else low
            high = high if value < 0.0 else p
            move = value / slope
            after = p - move
            bounded = after if after >= low else 0.5 * (low + high)  # it stays where it has converged to an end
            p = bounded if after <= high else 0.5 * (low + high)
        q[i + P * BLOCK], q[i + SLOPE * BLOCK], q[i + MOVE * BLOCK] = p, slope / h, abs(move)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _first_looks(q, n, tau):
    """Where to compare cubic and closed form: `crossing._predicted`."""
    for i in range(n):
        p = min(max(q[i + P * BLOCK], 0.05), 0.95)
        p = p if q[i + GB * BLOCK] >= 0.0 else 0.5
        q[i + P * BLOCK] = p
        q[i + TAU * BLOCK] = p * tau


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _judge(q, n, tau, wd):
    """The margin where the step was looked at, and whether its cubic describes it there; X: the place."""
    for i in range(n):
        p, sign, d = q[i + P * BLOCK], q[i + SIGN * BLOCK], q[i + D1 * BLOCK]
        faded = q[i + DECAY * BLOCK] * q[i + KD * BLOCK]
        margin = sign * (d - q[i + LEVEL * BLOCK] - faded) - q[i + THRESHOLD * BLOCK]
        expected = _cubic(
            p, tau, q[i + GA * BLOCK], q[i + GB * BLOCK], q[i + SA * BLOCK], q[i + SB * BLOCK]
        )  # fmt: skip
        around = p * (1.0 - p)
        ratio = abs(expected - margin) / (around * around)
        trust = TRUST * min(q[i + ON * BLOCK], q[i + OFF * BLOCK])
        swings = 1.0 if tau * tau * q[i + A * BLOCK] > 16.0 else 0.0
        loose = swings if q[i + SPARE * BLOCK] > trust else 0.0
        fits = q[i + PLAIN * BLOCK] if 0.0625 * ratio <= trust else 0.0
        q[i + PLAIN * BLOCK] = fits if loose == 0.0 else 0.0
        q[i + K * BLOCK] = ratio / (tau * tau * tau * tau)
        q[i + X * BLOCK] = q[i + TAU * BLOCK]
        q[i + MOVE * BLOCK] = margin
        q[i + SLOPE * BLOCK] = sign * wd * (q[i + S1 * BLOCK] - d + faded)


@njit(inline="always", error_model="numpy")
def _humps(h, fa, fb, sa, sb, slack):
    """1.0 where the cubic over length h has a maximum inside (`crossing._summit`) of −slack or more."""
    k = 3.0 * (fb - fa) / h - 2.0 * sa - sb
    m = 3.0 * (sa + sb) - 6.0 * (fb - fa) / h
    inside = k * k - m * sa
    root = np.sqrt(max(inside, 0.0))
    turn = -k + root if k < 0.0 else -k - root
    first, second = turn / m, sa / turn
    first_counts = (1.0 if first > 0.0 else 0.0) * (1.0 if first < 1.0 else 0.0) * (1.0 if k + m * first < 0.0 else 0.0)
    second_counts = (
        (1.0 if second > 0.0 else 0.0) * (1.0 if second < 1.0 else 0.0) * (1.0 if k + m * second < 0.0 else 0.0)
    )
    first_counts = first_counts if _cubic(first, h, fa, fb, sa, sb) >= -slack else 0.0
    second_counts = second_counts if _cubic(second, h, fa, fb, sa, sb) >= -slack else 0.0
    return max(first_counts, second_counts) if inside > 0.0 else 0.0


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _halve(q, n, tau):
    """The half of the step that the crossing lies in; not PLAIN where a hump may hold another."""
    for i in range(n):
        x, g, s = q[i + X * BLOCK], q[i + MOVE * BLOCK], q[i + SLOPE * BLOCK]
        ga, sa, gb, sb = q[i + GA * BLOCK], q[i + SA * BLOCK], q[i + GB * BLOCK], q[i + SB * BLOCK]
        slack = TRUST * min(q[i + ON * BLOCK], q[i + OFF * BLOCK])
        early = 1.0 if g >= 0.0 else 0.0
        hump = _humps(x, ga, g, sa, s, slack)
        later = _humps(tau - x, g, gb, s, sb, slack)
        hump = max(hump, later if early == 0.0 else 0.0)
        q[i + PLAIN * BLOCK] = q[i + PLAIN * BLOCK] if hump == 0.0 else 0.0
        q[i + HIT * BLOCK] = 1.0 if max(g, gb) >= 0.0 else 0.0
        q[i + XA * BLOCK], q[i + XB * BLOCK] = (0.0 if early > 0.0 else x), (x if early > 0.0 else tau)
        q[i + GA * BLOCK], q[i + GB * BLOCK] = (ga if early > 0.0 else g), (g if early > 0.0 else gb)
        q[i + SA * BLOCK], q[i + SB * BLOCK] = (sa if early > 0.0 else s), (s if early > 0.0 else sb)
        q[i + FOUND * BLOCK] = 0.0


@njit(cache=True, nogil=True, error_model="numpy", fastmath=blocks.REORDERED)
def _unfound(q, count, n):
    """Where to look next; how many events still lack an exact time."""
    for i in range(n):
        h = q[i + XB * BLOCK] - q[i + XA * BLOCK]
        x = q[i + XA * BLOCK] + q[i + P * BLOCK] * h
        around = (x - q[i + XA * BLOCK]) * (q[i + XB * BLOCK] - x)
        exact = 1.0 if q[i + K * BLOCK] * around * around < ACCURACY_S * abs(q[i + SLOPE * BLOCK]) else 0.0
        exact = 1.0 if h < ACCURACY_S else exact
        exact = exact if q[i + MOVE * BLOCK] < SETTLED else 0.0
        before = q[i + FOUND * BLOCK]
        q[i + X * BLOCK] = q[i + X * BLOCK] if before > 0.0 else x
        q[i + TAU * BLOCK] = x
        q[i + FOUND * BLOCK] = max(before, exact)
    left = 0.0
    for i in range(count):
        left += q[i + HIT * BLOCK] * q[i + PLAIN * BLOCK] * (1.0 - q[i + FOUND * BLOCK])
    return left


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _closer(q, n, wd):
    """The brackets with one end at the time just looked at."""
    for i in range(n):
        x, sign, d = q[i + TAU * BLOCK], q[i + SIGN * BLOCK], q[i + D1 * BLOCK]
        faded = q[i + DECAY * BLOCK] * q[i + KD * BLOCK]
        g = sign * (d - q[i + LEVEL * BLOCK] - faded) - q[i + THRESHOLD * BLOCK]
        s = sign * wd * (q[i + S1 * BLOCK] - d + faded)
        xa, xb = q[i + XA * BLOCK], q[i + XB * BLOCK]
        ga, gb, sa, sb = q[i + GA * BLOCK], q[i + GB * BLOCK], q[i + SA * BLOCK], q[i + SB * BLOCK]
        around = (x - xa) * (xb - x)
        q[i + K * BLOCK] = abs(g - _cubic(q[i + P * BLOCK], xb - xa, ga, gb, sa, sb)) / (around * around)
        below = 1.0 if g < 0.0 else 0.0
        q[i + XA * BLOCK], q[i + XB * BLOCK] = (x if below > 0.0 else xa), (xb if below > 0.0 else x)
        q[i + GA * BLOCK], q[i + GB * BLOCK] = (g if below > 0.0 else ga), (gb if below > 0.0 else g)
        q[i + SA * BLOCK], q[i + SB * BLOCK] = (s if below > 0.0 else sa), (sb if below > 0.0 else s)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _give_up(q, n):
    for i in range(n):
        q[i + PLAIN * BLOCK] = q[i + PLAIN * BLOCK] if q[i + FOUND * BLOCK] >= q[i + HIT * BLOCK] else 0.0
