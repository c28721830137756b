"""Frequency and step response of a chain of poles with unit gain at DC, for small changes of ln L.

    H(jω) = Π p / (jω + p)         step: y(t) = Π p · tⁿ · exp[0, −p₁t, …, −pₙt]

the latter a divided difference (`dynamics.divided`), exact wherever poles meet and where they are complex.

−3 dB frequency: the highest frequency at which |H| = 1/√2 (a resonance may cross it more than once).
Step time: when y first reaches 1 − 1/e = 63.2 %, the time constant of a single pole.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.optimize import brentq

from pixelid.dynamics.divided import exp_divided_difference

LEVEL = 1.0 - math.exp(-1.0)


def gain(poles: np.ndarray, frequency_hz) -> np.ndarray:
    """(…) complex H at frequencies (…) Hz of the chain with poles (n,) rad/s."""
    s = 2j * np.pi * np.asarray(frequency_hz, dtype=float)
    return np.prod(poles / (s[..., None] + poles), axis=-1)


def bandwidth_hz(poles: np.ndarray) -> float:
    """The −3 dB frequency [Hz] of the chain with poles (n,) rad/s."""
    slowest = np.abs(poles).min()
    p = poles / slowest
    # with y = 1/ω²: |jω + p|² / |p|² = 1 + 1/(y |p|²) for a real pole; multiplied by yⁿ, a polynomial in y whose
    # wanted root is of order 1 and whose other roots are smaller
    product = np.array([1.0])
    for real in p[np.abs(p.imag) == 0]:
        product = np.polymul(product, [1.0, 1.0 / real.real**2])
    for upper in p[p.imag > 0]:
        square = abs(upper) ** 2
        product = np.polymul(product, [1.0, 2 * (upper.real**2 - upper.imag**2) / square**2, 1.0 / square**2])
    product[0] -= 2.0
    roots = np.roots(product)
    y = min(root.real for root in roots if abs(root.imag) < 1e-6 * abs(root) and root.real > 0)
    log_w = -0.5 * math.log(y)
    for _ in range(3):  # Newton on ln|H|² + ln 2 over ln ω
        w = math.exp(log_w)
        size = np.abs(1j * w + p) ** 2
        value = np.log(np.abs(p) ** 2 / size).sum() + math.log(2.0)
        log_w += value / (2.0 * w * (w + p.imag) / size).sum()
    return float(slowest * math.exp(log_w) / (2 * np.pi))


def step_response(poles: np.ndarray, t) -> np.ndarray:
    """(m,) response at times t (m,) seconds to a unit step of ln L at t = 0."""
    t = np.asarray(t, dtype=float)
    order = len(poles)
    out = np.zeros(len(t))
    for i, time in enumerate(t):
        if time > 0:
            value = exp_divided_difference(np.append(0.0, -poles * time)) * np.prod(poles * time)
            out[i] = value.real
    return out if order else np.ones(len(t))


def step_time_s(poles: np.ndarray) -> float:
    """Seconds until the step response first reaches `LEVEL`."""

    def short(time: float) -> float:
        return float(step_response(poles, [time])[0]) - LEVEL

    part = (float((1.0 / poles).real.sum()) + 1.0 / float(np.abs(poles).min())) / 24
    end = part
    while short(end) < 0:
        end += part
    return float(brentq(short, end - part, end, xtol=1e-12 * end))  # type: ignore[arg-type]
