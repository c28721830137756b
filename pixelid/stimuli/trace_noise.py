"""Noise of a measured light: estimated from the trace, and removed before anybody takes a derivative of it.

A photodiode's trace has white noise and the steps of a converter.  A pixel sees neither, but the extremes of a light
that barely moves would be those of the noise, and events would seem to have no cause.  The noise's standard deviation
is read off fourth differences, in which a light that is sampled finely leaves nothing; coefficients of a stationary
wavelet transform that noise explains are set to zero (Donoho & Johnstone 1994, Biometrika 81, 425; in the
translation-invariant form of Coifman & Donoho 1995), so that steps keep their edges and chirps their amplitude.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from pixelid.stimuli.stimulus import Stimulus

if TYPE_CHECKING:
    from pixelid.recordings.recording import Recording

ATTRIBUTE = "trace_noise"  # of a recording: sd of the noise on ln L that was filtered out
FOURTH, SECOND = np.array([1.0, -4.0, 6.0, -4.0, 1.0]), np.array([1.0, -2.0, 1.0])
BLOCK = 256  # samples whose scatter is read at once: light that moves fast in some of them does not matter
QUANTILE, EXPECTED = 0.25, 0.93  # of the blocks' estimates, and what a quarter of 256 white samples have of their sd
LARGEST = 0.05  # of ln L: more is no photodiode's noise but a light that jumps from sample to sample
SMALLEST = 1e-7  # of ln L: below a single-precision number's rounding nothing is measured
WAVELET = "sym8"  # 8 vanishing moments: chirps to a tenth of the sampling rate stay in few coefficients


def noise_sd(light: Stimulus) -> float:
    """Standard deviation of the white noise on ln L; 0 where there is none, or where light may be what varies."""
    steps = np.diff(light.t)
    uneven = len(steps) < 2 * BLOCK or np.ptp(steps) > 0.01 * steps[0]
    if not light.full_field or light.interpolation != "linear" or uneven or not (light.radiance > 0).all():
        return 0.0
    logs = np.log(light.radiance)
    by_fourth, by_second = (_scatter(logs, kernel) for kernel in (FOURTH, SECOND))
    # Ratio of two estimates of one white noise; of a light that bends they differ by its samples per period
    alike = 1.25
    white = SMALLEST < by_fourth < LARGEST and by_second < alike * by_fourth and by_fourth < alike * by_second
    return by_fourth if white else 0.0


def without_noise(light: Stimulus) -> Stimulus:
    """The light without the white noise of its trace; itself where it has none."""
    sd = noise_sd(light)
    if sd == 0.0:
        return light
    import pywt

    logs = np.log(light.radiance)
    n = len(logs)
    coarsest = 64  # samples of the coarsest level at least
    levels = int(np.log2(n / coarsest))
    whole = 2**levels
    left = whole // 2
    padded = np.pad(logs, (left, -(n + left) % whole + whole), mode="reflect", reflect_type="odd")
    smooth, *details = pywt.swt(padded, WAVELET, level=levels, norm=True, trim_approx=True)
    limit = sd * np.sqrt(2.0 * np.log(n))  # no coefficient of n of pure noise is above, as a rule
    kept = [pywt.threshold(d, limit / 2 ** (0.5 * (levels - i)), "hard") for i, d in enumerate(details)]
    filtered = pywt.iswt([smooth, *kept], WAVELET, norm=True)[left : left + n]
    return replace(light, radiance=np.exp(filtered))


def without_trace_noise(recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings, each with its light as `without_noise` has it, and with the noise's sd among its attributes."""
    filtered = []
    for recording in recordings:
        light = recording.stimulus
        sd = noise_sd(light) if isinstance(light, Stimulus) else 0.0
        if sd > 0.0 and isinstance(light, Stimulus):
            attributes = {**recording.attributes, ATTRIBUTE: sd}
            recording = replace(recording, stimulus=without_noise(light), attributes=attributes)
        filtered.append(recording)
    return filtered


def _scatter(logs: np.ndarray, kernel: np.ndarray) -> float:
    """Standard deviation of white noise that leaves such differences in the quiet part of the blocks."""
    differences = np.convolve(logs, kernel, "valid") / np.sqrt(kernel @ kernel)
    blocks = differences[: len(differences) // BLOCK * BLOCK].reshape(-1, BLOCK)
    return float(np.quantile(1.4826 * np.median(np.abs(blocks), axis=1), QUANTILE)) / EXPECTED
