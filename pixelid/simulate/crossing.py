"""The first time inside a step at which the change reaches a threshold, exact to far below a nanosecond.

The step is walked from left to right in pieces [a, b].  A piece is
    skipped   when bounds on the slope show that no threshold is within reach (`step.slope_bound`);
    searched  when the cubic through its ends' values and slopes predicts its midpoint, so that the cubic can be
              trusted to show every hump; crossings and humps are then polished on the closed form itself;
    halved    otherwise.
Nothing that rises above a threshold and comes back is missed, except by less than a millionth of the threshold.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pixelid.dynamics.equations import PRESENT_BELOW
from pixelid.simulate.step import change, cubic, probe

DEPTH = 64
SMALLEST_S = 1e-11  # pieces are not halved below
ACCURACY_S = 1e-14  # of a root: its error moves the reset level, and with it every later event
TRUST = 1e-3  # of the smaller threshold: agreement of cubic and closed form at the midpoint of a piece
NOTHING = -1.0


@njit(forceinline=True, error_model="numpy")
def _margin(x, sign, step, chain, reset, threshold, rate):
    """(g, dg/dt) at x, g = sign · change − threshold(x): an event fires when g ≥ 0."""
    _, d, slope, _ = probe(x, step, chain)
    c, cs, _, _ = change(x, d, slope, step, chain[3], reset)
    return sign * c - threshold - rate * x, sign * cs - rate


@njit(forceinline=True, error_model="numpy")
def _cubic_root(h, ga, sa, gb, sb):
    """(fraction of h, slope there) where a cubic with g(0) < 0 ≤ g(h) crosses zero: Newton's method in its bracket.

    A move out of the bracket goes to its end, where a root may sit within rounding, and halves it the next time.
    """
    slope_a, slope_b = h * sa, h * sb
    quadratic = 3.0 * (gb - ga) - 2.0 * slope_a - slope_b
    third = slope_a + slope_b - 2.0 * (gb - ga)
    low, high, p = 0.0, 1.0, ga / (ga - gb)
    slope, clamped = 0.0, False
    for _ in range(100):
        value = ga + p * (slope_a + p * (quadratic + p * third))
        slope = slope_a + p * (2.0 * quadratic + 3.0 * p * third)
        low, high = (p, high) if value < 0.0 else (low, p)
        move = value / slope
        after = p - move
        if abs(move) < 1e-7 or high - low < 1e-15:
            p = min(max(after, 0.0), 1.0)
            break
        if low < after < high:
            clamped = False
        elif not clamped and after == after:
            after = low if after <= low else high
            clamped = True
        else:
            after = 0.5 * (low + high)
            clamped = False
        p = after
    return p, slope / h


@njit(cache=True, error_model="numpy")
def _root(xa, ga, sa, xb, gb, sb, K, sign, step, chain, reset, threshold, rate):
    """The root of g in [xa, xb], g(xa) < 0 ≤ g(xb): of cubics through ever closer values of the closed form.

    A cubic through [xa, xb] errs by about K (x − xa)² (x − xb)².  Each value found gives K; the loop ends when the
    error of the root is below ACCURACY_S.
    """
    for _ in range(60):
        h = xb - xa
        p, slope = _cubic_root(h, ga, sa, gb, sb)
        x = xa + p * h
        around = (x - xa) * (xb - x)
        if K * around * around < ACCURACY_S * abs(slope) or h < ACCURACY_S:
            return x
        g, s = _margin(x, sign, step, chain, reset, threshold, rate)
        K = abs(g - cubic(p, h, ga, gb, sa, sb)[0]) / (around * around)
        if g < 0.0:
            xa, ga, sa = x, g, s
        else:
            xb, gb, sb = x, g, s
        if xb - xa > 0.9 * h:  # halve what is left, or a root near one end keeps the other far
            x = 0.5 * (xa + xb)
            g, s = _margin(x, sign, step, chain, reset, threshold, rate)
            if g < 0.0:
                xa, ga, sa = x, g, s
            else:
                xb, gb, sb = x, g, s
    return xb


@njit(forceinline=True, error_model="numpy")
def _summit(h, fa, fb, sa, sb):
    """Fraction in (0, 1) at which the cubic has its local maximum, or −1."""
    # slope(p) = sa + 2 k p + m p²
    k = 3.0 * (fb - fa) / h - 2.0 * sa - sb
    m = 3.0 * (sa + sb) - 6.0 * (fb - fa) / h
    inside = k * k - m * sa
    if inside <= 0.0:
        return -1.0
    q = -k + np.sqrt(inside) if k < 0.0 else -k - np.sqrt(inside)
    # roots q/m and sa/q; the maximum is where the slope's derivative 2 k + 2 m p is negative
    for p in (q / m, sa / q):
        if 0.0 < p < 1.0 and k + m * p < 0.0:
            return p
    return -1.0


@njit(cache=True, error_model="numpy")
def _search(xa, ga, sa, xb, gb, sb, K, sign, step, chain, reset, threshold, rate, slack):
    """The first crossing of a piece that its cubic describes to within `slack`, or `NOTHING`; K: see `_root`."""
    last, g_last, s_last = xb, gb, sb
    for _ in range(12):
        h = xb - xa
        if h < SMALLEST_S:
            break
        p = _summit(h, ga, gb, sa, sb)
        if p < 0.0 or cubic(p, h, ga, gb, sa, sb)[0] < -slack:
            break
        x = xa + p * h
        g, s = _margin(x, sign, step, chain, reset, threshold, rate)
        if g >= 0.0:
            return _root(xa, ga, sa, x, g, s, K, sign, step, chain, reset, threshold, rate)
        if s > 0.0:
            xa, ga, sa = x, g, s
        else:
            xb, gb, sb = x, g, s
        slack *= 0.1
    if g_last < 0.0:
        return NOTHING
    return _root(xa, ga, sa, last, g_last, s_last, K, sign, step, chain, reset, threshold, rate)


@njit(forceinline=True, error_model="numpy")
def _predicted(h, ca, sa, cb, sb, on_a, on_b, off_a, off_b):
    """Fraction of the piece at which to compare cubic and closed form: its crossing where it ends beyond a threshold,
    else the middle."""
    p = 0.5
    if cb >= on_b:
        p = _cubic_root(h, ca - on_a, sa, cb - on_b, sb)[0]
    elif -cb >= off_b:
        p = _cubic_root(h, -ca - off_a, -sa, -cb - off_b, -sb)[0]
    return min(max(p, 0.05), 0.95)


@njit(cache=True, error_model="numpy")
def first_crossing(x0, here, step, chain, reset, on, on_rate, off, off_rate, scratch, stop):
    """(x, polarity) of the first event after x0 ≤ stop ≤ tau: polarity 1 ON, 0 OFF, −1 none.

    here: `probe` at x0;  on, off: thresholds at the start of the step, growing at on_rate, off_rate per second;
    scratch: (6, DEPTH) work space.
    """
    wd = chain[3]
    level = reset[0]
    trust = TRUST * min(on, off)
    _, da, slope, bound = here
    ca, sa, fa, _ = change(x0, da, slope, step, wd, reset)
    xa = x0
    if ca >= on + on_rate * x0:
        return x0, 1
    if -ca >= off + off_rate * x0:
        return x0, 0
    _, d, slope, later = probe(stop, step, chain)
    scratch[0, 0], scratch[1, 0], scratch[5, 0] = stop, d, later
    scratch[2, 0], scratch[3, 0], scratch[4, 0], _ = change(stop, d, slope, step, wd, reset)
    top = 0
    while top >= 0:
        xb, db, cb, sb, fb, later = (
            scratch[0, top], scratch[1, top], scratch[2, top], scratch[3, top], scratch[4, top], scratch[5, top]
        )  # fmt: skip
        h = xb - xa
        reach = 0.5 * (da + db)
        spare = 0.5 * bound * h
        # drift only grows, the decaying part only fades: both extremes are at the ends
        drift_a, drift_b = ca - (da - level - fa), cb - (db - level - fb)
        upper = reach + spare - level - min(fa, fb) + max(drift_a, drift_b)
        lower = reach - spare - level - max(fa, fb) + min(drift_a, drift_b)
        on_a, on_b, off_a, off_b = on + on_rate * xa, on + on_rate * xb, off + off_rate * xa, off + off_rate * xb
        if upper >= min(on_a, on_b) or -lower >= min(off_a, off_b):
            p = _predicted(h, ca, sa, cb, sb, on_a, on_b, off_a, off_b)
            xm = xa + p * h
            _, dm, slope, bound_m = probe(xm, step, chain)
            cm, sm, fm, _ = change(xm, dm, slope, step, wd, reset)
            predicted, _ = cubic(p, h, ca, cb, sa, sb)
            around = p * (1.0 - p) * h * h
            K = abs(predicted - cm) / (around * around)  # of the cubic's error K (x − xa)² (x − xb)²
            error = 0.0625 * K * h * h * h * h
            swing = h * h * step[5] if step[6] < PRESENT_BELOW and not chain[5] else 0.0
            if (error > trust or (swing > 16.0 and spare > trust)) and h > SMALLEST_S and top + 1 < DEPTH:
                top += 1
                scratch[0, top], scratch[1, top], scratch[2, top] = xm, dm, cm
                scratch[3, top], scratch[4, top], scratch[5, top] = sm, fm, bound_m
                continue
            for half in range(2):
                xl, cl, sl = (xa, ca, sa) if half == 0 else (xm, cm, sm)
                xr, cr, sr = (xm, cm, sm) if half == 0 else (xb, cb, sb)
                rise, fall = NOTHING, NOTHING
                if upper >= min(on_a, on_b):
                    rise = _search(
                        xl, cl - on - on_rate * xl, sl - on_rate, xr, cr - on - on_rate * xr, sr - on_rate,
                        K, 1.0, step, chain, reset, on, on_rate, trust,
                    )  # fmt: skip
                if -lower >= min(off_a, off_b):
                    fall = _search(
                        xl, -cl - off - off_rate * xl, -sl - off_rate, xr, -cr - off - off_rate * xr, -sr - off_rate,
                        K, -1.0, step, chain, reset, off, off_rate, trust,
                    )  # fmt: skip
                if rise >= 0.0 and (fall < 0.0 or rise <= fall):
                    return rise, 1
                if fall >= 0.0:
                    return fall, 0
        xa, da, ca, sa, fa, bound = xb, db, cb, sb, fb, later
        top -= 1
    return NOTHING, -1
