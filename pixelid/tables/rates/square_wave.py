"""Events per cycle of one pixel under a square wave: the fluid limit with bandwidth, dead time, noise and hysteresis.

**Signal.**  A square wave of log contrast P passes a first-order follower of time constant τ.  Half a period H after
each edge the output has come G (1 − e^{−H/τ}) closer, G = P/(1 + e^{−H/τ}) in the periodic steady state; its swing is
P tanh(H/2τ).  In units of the threshold C the distance to go is y(t) = (G/C) e^{−t/τ} and the slope q = y/τ [1/s].

**Dead time** ρ: the amplifier is held in reset and the change in between is lost, so events follow at 1/(1/q + ρ), and
an edge without noise gives (τ/ρ) ln[(1 + ρ q(0)) / (1 + ρ q(H))] events.

**Noise.**  A comparator that sees a drift q and diffusing noise between two thresholds ±C leaves the interval at the
rate r(q) = q coth(q/ν), the inverse of the mean exit time C/v tanh(vC/2D) of a Wiener process, ν = 2D/C².  It is ν
without light changes and q when the signal dominates: noise and signal do not add up.  Relative photocurrent noise
falls with light, and events with it steeply: noise is ν e^{−y}, y the thresholds above the dark level.  So light that
blinks faster than the pixel follows, and is therefore never dark for it, is also never noisy.

**Hysteresis.**  At each turn the comparator's reference is up to one threshold away: averaged over where it is, a swing
of x thresholds gives max(x − 1, 0) events per edge.  Noise brings the reference back: the loss is e^{−n0} with n0 the
noise events of the dark half.  The corner is rounded over `ROUNDING` thresholds (threshold noise).

Sources: fluid limit and dead time: `docs/model.md`, "Events"; exit time: Gardiner, Handbook of Stochastic Methods,
section 5.2.7.
"""

from __future__ import annotations

import numpy as np

ROUNDING = 0.06  # thresholds; between the 2 % and 10 % noise of thresholds, and cells where it shows have few events
NODES, WEIGHTS = np.polynomial.legendre.leggauss(64)


def exit_rate(q: np.ndarray, noise_hz) -> np.ndarray:
    """Threshold crossings [1/s] under drift q ≥ 0 [thresholds/s] and noise of `noise_hz` crossings/s at rest."""
    noise_hz = np.maximum(noise_hz, 1e-12)
    x = q / noise_hz
    return noise_hz * np.where(x < 1e-3, 1.0 + x * x / 3.0, x / np.tanh(np.clip(x, 1e-3, 350.0)))


def edge_events(swing, tau_s, dead_s, half_s) -> np.ndarray:
    """Events of one edge without noise, before hysteresis; closed form.  Arguments broadcast.

    swing: log contrast over threshold;  tau_s: of the follower;  dead_s: after each event;  half_s: half a period.
    """
    decay = np.exp(-np.minimum(half_s / tau_s, 700.0))
    first = swing / (1.0 + decay) / tau_s
    return tau_s / dead_s * np.log1p(dead_s * first * (1.0 - decay) / (1.0 + dead_s * first * decay))


def after_hysteresis(events, loss) -> np.ndarray:
    """max(events − loss, 0) with its corner rounded, exactly 0 at 0 events."""
    rounded = np.logaddexp(0.0, (events - loss) / ROUNDING) - np.logaddexp(0.0, -loss / ROUNDING)
    return np.maximum(ROUNDING * rounded, 0.0)


def events_per_cycle(frequency_hz, swing, tau_s, dead_s, noise_hz) -> np.ndarray:
    """Events (both polarities) per cycle; arguments broadcast.

    swing, tau_s, dead_s: as `edge_events`;  noise_hz: events per second in the dark, before dead time.
    """
    f, swing, tau, dead, noise = np.broadcast_arrays(*np.atleast_1d(frequency_hz, swing, tau_s, dead_s, noise_hz))
    half = 0.5 / f
    bright = edge_events(swing, tau, dead, half)
    # the dark half: its first 16 τ by quadrature, the rest at the noise rate alone
    until = np.minimum(half, 16.0 * tau)
    level = swing / (1.0 + np.exp(-np.minimum(half / tau, 700.0)))
    t = 0.5 * until[..., None] * (1.0 + NODES)
    y = level[..., None] * np.exp(-t / tau[..., None])
    local = noise[..., None] * np.exp(-y)
    with_signal = exit_rate(y / tau[..., None], local)
    dead_ = dead[..., None]
    dark = 0.5 * until * (WEIGHTS * with_signal / (1.0 + dead_ * with_signal)).sum(-1)
    still = 0.5 * until * (WEIGHTS * local / (1.0 + dead_ * local)).sum(-1)
    rest = (half - until) * noise / (1.0 + dead * noise)
    loss = np.exp(-still - rest)
    return after_hysteresis(bright, loss) + still + rest + after_hysteresis(dark - still, loss)


def rate(frequency_hz, swing, tau_s, dead_s, noise_hz) -> np.ndarray:
    """Events per second; see `events_per_cycle`."""
    return np.asarray(frequency_hz) * events_per_cycle(frequency_hz, swing, tau_s, dead_s, noise_hz)
