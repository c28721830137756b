"""The event-time log-likelihood in plain NumPy, one array operation after the other; numbers may be complex steps.

An independent statement of `pixelid/likelihood/density.py`: it sums by `bincount`, classifies by logarithms and takes
log Φ from SciPy.
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
from scipy.special import log_ndtr as real_log_ndtr

from pixelid.likelihood.losses import BACKGROUND_HZ, MISSED


def terms(likelihood, circuit, vector: np.ndarray) -> SimpleNamespace:
    """The pieces of a likelihood's events under a circuit; `vector`: its changes, in the order of the layout."""
    at = likelihood.layout
    changes = at.stacked(vector)
    change, slope, drift, drift_slope, opposite, opposite_drift, early = changes.events
    rise, rise_drift, fall, fall_drift = changes.ends
    on, off = circuit.on_threshold, circuit.off_threshold
    growth = 1.0 + circuit.threshold_drift * at.time_s
    m, link = circuit.polarity_memory, at.sign * at.previous_sign
    f, f_other = 1.0 + m * link, 1.0 - m * link  # C_i (1 + m p p'), of the event's own polarity and of the other
    change, slope, drift, drift_slope = (row / f for row in (change, slope, drift, drift_slope))
    opposite, opposite_drift = opposite / f_other, opposite_drift / f_other
    f_rise, f_fall = 1.0 + m * at.last_sign, 1.0 - m * at.last_sign
    rise, rise_drift, fall, fall_drift = rise / f_rise, rise_drift / f_rise, fall / f_fall, fall_drift / f_fall
    z = at.sign * (change + on * drift) / growth
    rate = at.sign * (slope + on * drift_slope) / growth - z * circuit.threshold_drift / growth
    width_of_release = np.sqrt(at.tick_s**2 / 6.0 + 2.0 * circuit.jitter**2 + (1e-3 * circuit.silent) ** 2)
    window = 5.0 * width_of_release
    released = (np.abs(early.real) < window.real) & (np.real(circuit.silent) > 0)
    ahead = z + rate * (window + early)  # where the change is when the window ends
    impossible = released | ~(rate.real > 0) | (early.real >= 0) | ~(np.abs(z.real) < 1e6) | ~(rate.real < 1e12)
    rate = np.where(impossible, 1.0, rate)
    z = np.where(impossible, 0.0, z)
    width = rate * rate * likelihood.clock_share * (at.tick_s**2 / 12.0 + circuit.jitter**2)
    variance = (circuit.noise * np.where(at.sign > 0, on, off) / f) ** 2 + width
    C = np.where(np.arange(at.groups) % 2 == 1, on, off)
    spread = (circuit.mismatch * C) ** 2
    background = impossible
    centre, extra = C.real, spread.real
    for _ in range(2):
        total = variance.real + extra[at.group]
        away = z.real - centre[at.group]
        log_density = np.log(rate.real) - 0.5 * np.log(2.0 * np.pi * total) - 0.5 * away**2 / total
        background = impossible | (log_density < np.log(BACKGROUND_HZ))
        weight = np.where(background, 0.0, 1.0 / variance.real)
        shrink = 1.0 + spread.real * sum_by(at.group, weight, at.groups)
        centre = (C.real + spread.real * sum_by(at.group, weight * z.real, at.groups)) / shrink
        extra = spread.real / shrink
    weight = np.where(background, 0.0, 1.0 / variance)
    own = (C + spread * sum_by(at.group, weight * z, at.groups)) / (1.0 + spread * sum_by(at.group, weight, at.groups))
    variance = (circuit.noise * own[at.group] / f) ** 2 + width
    weight = np.where(background, 0.0, 1.0 / variance)

    W, A = sum_by(at.group, weight, at.groups), sum_by(at.group, weight * z, at.groups)
    seen = W.real > 0
    safe = np.where(seen, W, 1.0)
    z_bar = A / safe
    mean_variance = spread + 1.0 / safe
    group_term = -0.5 * np.log(safe * mean_variance) - 0.5 * (z_bar - C) ** 2 / mean_variance
    group_term = np.where(seen, group_term, 0.0)
    group_variance = spread / (1.0 + spread * W)
    group_mean = (C + spread * A) / (1.0 + spread * W)
    within = z - z_bar[at.group]
    event_term = -0.5 * np.log(2.0 * np.pi * variance) - 0.5 * within * within * weight + np.log(rate)
    event_term = np.where(background, np.log(BACKGROUND_HZ), event_term)

    def sd(group, factor):
        return np.sqrt((circuit.noise * group_mean[group] / factor) ** 2 + group_variance[group])

    at_once = log_ndtr((ahead - group_mean[at.group]) / sd(at.group, f)) - 0.5 * (early / width_of_release) ** 2
    at_once = at_once - np.log(np.sqrt(2.0 * np.pi) * width_of_release)
    released = released & (at_once.real > np.log(BACKGROUND_HZ))
    event_term = np.where(released, at_once, event_term)
    background = background & ~released
    z = np.where(released, ahead, z)
    variance = np.where(released, (circuit.noise * group_mean[at.group] / f) ** 2, variance)
    other = at.group ^ 1
    reached = (opposite + on * opposite_drift) / growth
    survives = log_survival((group_mean[other] - reached) / sd(other, f_other))
    event_term = event_term + np.where(reached.real > 0, survives, 0.0)
    if likelihood.carried is not None:
        event_term = event_term + np.where(background, 0.0, likelihood.carried.gain)
    ON, OFF = 2 * at.last_pixel + 1, 2 * at.last_pixel
    grown = 1.0 + circuit.threshold_drift * at.last_time_s
    end_term = log_survival((group_mean[ON] - (rise + on * rise_drift) / grown) / sd(ON, f_rise))
    end_term = end_term + log_survival((group_mean[OFF] - (fall + on * fall_drift) / grown) / sd(OFF, f_fall))
    per_pixel = (
        sum_by(at.pixel, event_term, at.pixels)
        + sum_by(at.last_pixel, end_term, at.pixels)
        + group_term.reshape(-1, 2).sum(axis=1)
    )
    per_recording = sum_by(at.recording, event_term, at.recordings)
    per_recording = per_recording + sum_by(at.last_recording, end_term, at.recordings)
    return SimpleNamespace(
        z=z, log_rate=np.log(rate), scale=np.sqrt(variance), background=background, reached=reached, weight_sum=W,
        weighted_mean=z_bar, mean_variance=mean_variance, group_mean=group_mean, group_variance=group_variance,
        per_pixel=per_pixel, per_recording=per_recording, total=per_pixel.sum(),
    )  # fmt: skip


def log_survival(margin: np.ndarray) -> np.ndarray:
    """Log chance that a threshold `margin` standard deviations above an extreme was not reached, or its event lost."""
    return np.log(MISSED + (1.0 - MISSED) * np.exp(log_ndtr(margin)))


def sum_by(index: np.ndarray, values: np.ndarray, size: int) -> np.ndarray:
    """(size,) sums of `values` by index."""
    if np.iscomplexobj(values):
        return np.bincount(index, values.real, size) + 1j * np.bincount(index, values.imag, size)
    return np.bincount(index, values, size)


def log_ndtr(x: np.ndarray) -> np.ndarray:
    """log Φ; of a complex step x + ih: log Φ(x) + i h φ(x)/Φ(x), exact to first order in h."""
    if not np.iscomplexobj(x):
        return real_log_ndtr(x)
    real = real_log_ndtr(x.real)
    hazard = np.exp(-0.5 * x.real**2 - 0.5 * np.log(2 * np.pi) - real)
    return real + 1j * x.imag * hazard
