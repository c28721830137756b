"""The samples of the light between which times lie."""

from __future__ import annotations

import numpy as np
from numba import njit


def located(t: np.ndarray, times: np.ndarray, near: np.ndarray, first: np.ndarray, light_of: np.ndarray) -> np.ndarray:
    """(k,) indices of the samples t[i] ≤ time < t[i + 1], searched from the samples `near` (k,) on.

    first: (lights + 1,) where the samples of each light begin, and where the last ones end;  light_of: (k,) whose
    samples to search
    """
    sample = np.empty(len(times), np.int64)
    _locate_all(t, times, near, first, light_of, sample)
    return sample


@njit(cache=True, error_model="numpy")
def _locate(t, time, near, begin, end):
    k = near
    last = end - 1
    if k > last or k < begin:
        k = begin
    if time < t[k] or (k + 16 < last and time > t[k + 16]):
        k = max(begin + np.searchsorted(t[begin:end], time, side="right") - 1, begin)
    while k < last and t[k + 1] <= time:
        k += 1
    return k


@njit(cache=True, nogil=True, error_model="numpy")
def _locate_all(t, times, near, first, light_of, sample):
    """Most samples are even, and the guess is right: a branch for each sample passed costs more than all the rest."""
    for i in range(len(times)):
        light, time, k = light_of[i], times[i], near[i]
        begin, end = first[light], first[light + 1]
        if begin <= k < end - 1:
            ahead = (time - t[k]) / (t[k + 1] - t[k])
            if 0.0 <= ahead < end - 1 - k:
                guess = k + np.int64(ahead)
                if t[guess] <= time < t[guess + 1]:
                    sample[i] = guess
                    continue
        sample[i] = _locate(t, time, k, begin, end)
