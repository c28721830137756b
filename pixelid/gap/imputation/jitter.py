"""The jitter of timestamps, told by imputed times: its spread, exchanged stamps, and whether it is one normal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import expit
from scipy.stats import chi2

from pixelid.gap.imputation.draws import Draw
from pixelid.gap.imputation.windows import Windows
from pixelid.recordings.recording import Recording

MAX_COST_NATS = 8.0  # of one event's jitter, four standard deviations: events farther off have other causes
# Of a polarity: from there on χ² is exceeded at most 1.3 times as often as it says, at chances from 1e-2 to 1e-4; by 16
# events 1.6 times, by 5 up to 6 times, by two up to 100 times (a million draws each).
MIN_EVENTS = 30
MAX_LOG_MOVE = 0.5  # of the spread between two estimates


def uneven(
    recordings: Sequence[Recording],
    windows: Sequence[Windows],
    times: Sequence[np.ndarray],
    max_divergence_nats: float,
    alpha: float,
) -> bool:
    """Whether imputed displacements differ between recordings or polarities by more than one normal allows.

    A common normal is what a jitter is; a delay of one polarity, say, is not.  With mean m and standard deviation s of
    a recording's polarity, in units of the jitter's, the relative entropy per event is (m² + s² − 1 − ln s²)/2; twice
    n times that is χ² with two degrees of freedom where the normal holds, and what that allows, among so many
    recordings and polarities, is taken off.  Of a few events it does not hold, and they say little: they are not asked.
    """
    groups = []
    for recording, window, t in zip(recordings, windows, times, strict=True):
        assert window.stamp is not None
        late = (window.stamp - t) / window.sd
        groups += [late[recording.events.p == polarity] for polarity in (0, 1)]
    groups = [some for some in groups if len(some) >= MIN_EVENTS and some.std() > 0]
    for some in groups:
        mean, variance = float(some.mean()), float(some.var())
        divergence = 0.5 * (mean**2 + variance - 1.0 - np.log(variance))
        if divergence - 0.5 * float(chi2.isf(alpha / len(groups), 2)) / len(some) > max_divergence_nats:
            return True
    return False


def exchange_stamps(
    recordings: Sequence[Recording], windows: Sequence[Windows], times: Sequence[np.ndarray], rng: np.random.Generator
) -> list[Windows]:
    """The windows with stamps drawn anew: jitter lets successive events of a pixel and polarity swap theirs."""
    drawn = []
    for recording, window, t in zip(recordings, windows, times, strict=True):
        assert window.stamp is not None
        order = np.lexsort((t, recording.events.p, recording.events.pixel))
        pixel, polarity, stamp = recording.events.pixel[order], recording.events.p[order], window.stamp[order]
        moment = t[order]
        for start in (0, 1):
            k = np.arange(start, len(order) - 1, 2)
            k = k[(pixel[k] == pixel[k + 1]) & (polarity[k] == polarity[k + 1])]
            gain = (stamp[k + 1] - stamp[k]) * (moment[k] - moment[k + 1]) / window.sd**2
            k = k[rng.random(len(k)) < expit(gain)]
            stamp[k], stamp[k + 1] = stamp[k + 1], stamp[k]
        back = np.empty_like(stamp)
        back[order] = stamp
        drawn.append(replace(window, stamp=back))
    return drawn


def estimate_spread(draw: Draw, sd: float) -> tuple[float, float]:
    """(standard deviation of the jitter, ns, that makes the misses likeliest;  its relative standard error).

    Each event's own time is integrated over, which makes alternating draws and estimates settle sooner.  sd: the last
    """

    def loss(log_sd: float) -> float:
        variance = np.exp(2.0 * log_sd) + draw.variance
        return float(np.sum(0.5 * np.log(variance) + np.minimum(0.5 * draw.miss**2 / variance, MAX_COST_NATS)))

    best = minimize_scalar(loss, bounds=(np.log(sd) - MAX_LOG_MOVE, np.log(sd) + MAX_LOG_MOVE), method="bounded")
    estimate = float(np.exp(best.x))
    told = np.sum(2.0 * (estimate**2 / (estimate**2 + draw.variance)) ** 2)
    return estimate, float(1.0 / np.sqrt(max(told, 1.0)))
