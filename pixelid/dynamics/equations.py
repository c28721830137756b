"""The pixel's equations, written once, in plain arithmetic.

Every function here uses only + − × ÷ on scalars, so the same lines serve floats, complex steps, Numba,
CasADi symbols and torch tensors; the engines supply the transcendental functions (`selected_factors` takes them).

State, in signal order (Low & Lee, arXiv 2409.17988, supplement):

    v  = d ln Lp / dt      photoreceptor output slope
    y  = ln Lp             photoreceptor output
    s  = ln Lsf            source follower output
    e  = ln Lsf2           output of an optional second follower pole
    z                      low-pass inside the optional lower cutoff (high-pass output h = e − z)
    d  = ln Ldiff          differencing amplifier output, never reset

A stage that is absent has a cutoff so high (`ABSENT_*`) that its closed form is the identity in floating
point; the lower cutoff is absent at 0.  One kernel therefore serves every model order.
"""

from __future__ import annotations

import math

from numba.extending import register_jitable

# Absent low-pass stages sit at infinite frequency.  The values differ so that no two absent poles coincide.
ABSENT_FOLLOWER = 1e30
ABSENT_EXTRA = 1e32
ABSENT_DIFFERENCING = 1e35
ABSENT_PHOTORECEPTOR = 1e40
PRESENT_BELOW = 1e29


@register_jitable
def photoreceptor_rates(dynamics, radiance):
    """(ωn², 2ζωn) of the photoreceptor under `radiance`: (α L', β + γ L'), L' = L + floor.

    dynamics: anything with the attributes alpha, beta, gamma and floor, see `trajectory.Dynamics`
    """
    seen = radiance + dynamics.floor
    return dynamics.alpha * seen, dynamics.beta + dynamics.gamma * seen


@register_jitable
def light_integral(radiance, rate, tau):
    """∫ L dt over `tau`, log radiance a ramp of slope `rate` that begins at `radiance`."""
    return radiance * tau * mean_of_exponential(rate * tau)


@register_jitable
def mean_of_exponential(x):
    """(eˣ − 1)/x for floats, by its series where the difference would cancel."""
    if abs(x) < 1e-3:
        return 1.0 + x * (0.5 + x * (1.0 / 6.0 + x * (1.0 / 24.0 + x / 120.0)))
    return math.expm1(x) / x


def derivatives_photoreceptor(v, y, u, a, b2):
    """(dv/dt, dy/dt) of y'' + 2ζωn y' + ωn² y = ωn² u, with a = ωn², b2 = 2ζωn."""
    return a * (u - y) - b2 * v, v


def derivative_low_pass(output, drive, cutoff):
    """d output/dt of a first-order low-pass at `cutoff` rad/s."""
    return cutoff * (drive - output)


# ---------------------------------------------------------------------------------------------------------
# One step with a linear input, in closed form.
#
# Over a step the input is the ramp u0 + r τ.  A linear chain of unit DC gain has the particular solution
# "ramp, delayed": stage j follows u0 + r (τ − T_j), T_j the sum of the delays b2/a, 1/ω1, … up to it.  What
# remains, ε = state − particular, obeys the homogeneous equations, whose solutions are exponentials:
#
#     photoreceptor   (ε_y, ε_v) propagate by (f1, g; −a g, f2)
#     low-pass at w   driven by  c0 ε_y + c1 ε_v + Σ m_i exp(−w_i τ)   answers with
#                     c0' ε_y + c1' ε_v + Σ m_i w/(w − w_i) exp(−w_i τ) + m exp(−w τ)
#
# (c0', c1') solves  −a c1' + w c0' = w c0,  c0' + (w − b2) c1' = w c1, i.e. the drive's transfer function at
# −w.  The solution exists while no two poles coincide; near coincidences the engines use `coincident.py`.
# ---------------------------------------------------------------------------------------------------------


@register_jitable
def low_pass_response(c0, c1, a, b2, w):
    """(c0', c1') of a low-pass at `w` driven by c0 ε_y + c1 ε_v.  Written so that w → ∞ is the identity."""
    q = w / (a + w * (w - b2))
    return q * (c0 * (w - b2) + a * c1), q * (w * c1 - c0)


@register_jitable
def responses(a, b2, w1, wd):
    """(p0, p1, q0, q1): how follower and differencing amplifier answer ε_y and ε_v."""
    p0, p1 = low_pass_response(1.0, 0.0, a, b2, w1)
    q0, q1 = low_pass_response(p0, p1, a, b2, wd)
    return p0, p1, q0, q1


@register_jitable
def modes_of(state, u0, r, delays, pq, gain):
    """(ε_y, ε_v, m, m1, n) at the beginning of a step: the amplitudes of its exponentials.

    state: (v, y, s, d);  delays: (b2/a, … + 1/w1, … + 1/wd);  pq: of `responses`;  gain: wd/(wd − w1)
    """
    v, y, s, d = state
    ty, ts, td = delays
    p0, p1, q0, q1 = pq
    ev = v - r
    ey = y - u0 + r * ty
    m = s - u0 + r * ts - p0 * ey - p1 * ev
    m1 = m * gain
    n = d - u0 + r * td - q0 * ey - q1 * ev - m1
    return ey, ev, m, m1, n


@register_jitable
def state_of(modes, u1, r, a, pr, delays, pq, k1, kd):
    """(v, y, s, d) where the input has reached u1; pr: (f1, f2, g);  k1, kd: exp(−w1 τ), exp(−wd τ)."""
    ey, ev, m, m1, n = modes
    f1, f2, g = pr
    ty, ts, td = delays
    p0, p1, q0, q1 = pq
    ey, ev = f1 * ey + g * ev, f2 * ev - a * g * ey
    return (
        r + ev,
        u1 - r * ty + ey,
        u1 - r * ts + p0 * ey + p1 * ev + m * k1,
        u1 - r * td + q0 * ey + q1 * ev + m1 * k1 + n * kd,
    )


def selected_factors(op, a, b2, tau):
    """(f1, f2, g) of `kernels.photoreceptor_factors`, by selection; unselected branches stay finite.

    op: exp, sqrt, sin, cos, abs and where of vectors: the module torch, or an engine's `Operations`
    """
    b = 0.5 * b2
    disc = b * b - a
    x = disc * tau * tau
    near = op.abs(x) < 0.3
    away = op.where(near, 1.0 + 0.0 * disc, disc)
    over = away > 0.0
    root = op.sqrt(op.abs(away))
    half = 0.5 / root
    fast = b + op.where(over, root, 0.0 * root)
    slow = op.where(over, a / fast, b)
    e_fast, e_slow = op.exp(-fast * tau), op.exp(-slow * tau)
    phase = op.where(over, 0.0 * tau, root * tau)
    g_far = op.where(over, (e_slow - e_fast) * half, e_slow * op.sin(phase) * 2.0 * half)
    f1_far = op.where(over, (fast * e_slow - slow * e_fast) * half, e_slow * op.cos(phase) + b * g_far)
    f2_far = op.where(over, (fast * e_fast - slow * e_slow) * half, e_slow * op.cos(phase) - b * g_far)
    x = op.where(near, x, 0.0 * x)
    c = 1.0 + x / 2.0 * (1.0 + x / 12.0 * (1.0 + x / 30.0 * (1.0 + x / 56.0 * (1.0 + x / 90.0 * (1.0 + x / 132.0)))))
    s = 1.0 + x / 6.0 * (1.0 + x / 20.0 * (1.0 + x / 42.0 * (1.0 + x / 72.0 * (1.0 + x / 110.0 * (1.0 + x / 156.0)))))
    eb = op.exp(-op.where(near, b, 0.0 * b) * tau)
    g_near = eb * tau * s
    return (
        op.where(near, eb * c + b * g_near, f1_far),
        op.where(near, eb * c - b * g_near, f2_far),
        op.where(near, g_near, g_far),
    )


def step_two_poles(state, u0, r, tau, a, b2, w1, wd, pr, k1, kd):
    """One step of photoreceptor → follower → differencing amplifier.

    state: (v, y, s, d); pr: (f1, f2, g); k1, kd: exp(−w1 τ), exp(−wd τ).  Returns the state at τ.
    """
    ty = b2 / a
    ts = ty + 1.0 / w1
    delays, pq = (ty, ts, ts + 1.0 / wd), responses(a, b2, w1, wd)
    modes = modes_of(state, u0, r, delays, pq, wd / (wd - w1))
    return state_of(modes, u0 + r * tau, r, a, pr, delays, pq, k1, kd)


def step_full_chain(state, u0, r, tau, a, b2, w1, w2, wh, wd, pr, k1, k2, kh, kd):
    """One step of the full chain, with the extra pole w2 and the lower cutoff wh (0: absent).

    state: (v, y, s, e, z, d).  With the lower cutoff the amplifier is driven by h = e − z, whose ramp
    response is the constant r/wh.  Returns the state at τ.
    """
    v, y, s, e, z, d = state
    f1, f2, g = pr
    ty = b2 / a
    ts = ty + 1.0 / w1
    te = ts + 1.0 / w2
    ev = v - r
    ey = y - u0 + r * ty
    ey1 = f1 * ey + g * ev
    ev1 = f2 * ev - a * g * ey
    u1 = u0 + r * tau
    # follower: s = p·ε + m k1
    p0, p1 = low_pass_response(1.0, 0.0, a, b2, w1)
    m = s - u0 + r * ts - p0 * ey - p1 * ev
    # extra pole: e = q·ε + m1 k1 + n k2
    q0, q1 = low_pass_response(p0, p1, a, b2, w2)
    m1 = m * w2 / (w2 - w1)
    n = e - u0 + r * te - q0 * ey - q1 * ev - m1
    s1 = u1 - r * ts + p0 * ey1 + p1 * ev1 + m * k1
    e1 = u1 - r * te + q0 * ey1 + q1 * ev1 + m1 * k1 + n * k2
    if wh == 0.0:
        x0, x1 = low_pass_response(q0, q1, a, b2, wd)
        o1 = m1 * wd / (wd - w1)
        o2 = n * wd / (wd - w2)
        td = te + 1.0 / wd
        od = d - u0 + r * td - x0 * ey - x1 * ev - o1 - o2
        d1 = u1 - r * td + x0 * ey1 + x1 * ev1 + o1 * k1 + o2 * k2 + od * kd
        return ev1 + r, u1 - r * ty + ey1, s1, e1, z, d1
    # lower cutoff: z = low-pass of e at wh; h = e − z
    th = te + 1.0 / wh
    z0, z1 = low_pass_response(q0, q1, a, b2, wh)
    zm1 = m1 * wh / (wh - w1)
    zn = n * wh / (wh - w2)
    zh = z - u0 + r * th - z0 * ey - z1 * ev - zm1 - zn
    z_next = u1 - r * th + z0 * ey1 + z1 * ev1 + zm1 * k1 + zn * k2 + zh * kh
    # amplifier driven by h, in the same basis
    x0, x1 = low_pass_response(q0 - z0, q1 - z1, a, b2, wd)
    o1 = (m1 - zm1) * wd / (wd - w1)
    o2 = (n - zn) * wd / (wd - w2)
    oh = -zh * wd / (wd - wh)
    level = r / wh
    od = d - level - x0 * ey - x1 * ev - o1 - o2 - oh
    d1 = level + x0 * ey1 + x1 * ev1 + o1 * k1 + o2 * k2 + oh * kh + od * kd
    return ev1 + r, u1 - r * ty + ey1, s1, e1, z_next, d1
