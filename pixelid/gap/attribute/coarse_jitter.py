"""Jitters that the density of stamps is enough for, and one longer than the dead time as a candidate.

Of the latter whole paths of true times judge (`imputation/paths.py`).

The density of stamps takes them in the order in which they came.  A jitter of dead times turns that order around, and
what it explains does not show in what the density gains.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pixelid.fit.maximise import Maximum
from pixelid.gap.attribute.attribute import Candidate
from pixelid.gap.attribute.significance import chance_of_gain
from pixelid.gap.detect.pixels import PixelEvidence
from pixelid.gap.imputation.impute import FINEST_PATH_S, JITTER, SIGMA
from pixelid.gap.imputation.paths import Lights, draw_paths, followable
from pixelid.gap.imputation.windows import jitter_windows
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.model import Model
from pixelid.recordings.events import SHORT_QUANTILE
from pixelid.recordings.recording import Recording
from pixelid.recordings.selection import few, only

# Of the shortest intervals, that a jitter may be for the density of stamps, which takes it to first order: events keep
# their order.  Larger ones have times drawn behind them.
MAX_SHARE_IN_DENSITY = 0.1
WIDER = 2.0  # one standard deviation tried to the next, from the finest of a path until stamps are less likely
EVENTS = 2_000  # of the pixels asked, of either pool: about a second for a standard deviation


def is_fine_jitter(candidate: Candidate[Maximum], events: EventTimes) -> bool:
    """Whether a candidate is a jitter that the density of stamps is enough for."""
    shortest = events.shortest_intervals_s(SHORT_QUANTILE)
    return candidate.effect == JITTER and candidate.end.values[SIGMA] < MAX_SHARE_IN_DENSITY * shortest


def coarse_jitter(
    evidence: PixelEvidence, fit: Maximum, start: Model, tried: int, alpha: float, seed: int
) -> Candidate | None:
    """The jitter under which stamps are likeliest on some fit pixels.

    None where the finest is, none can be judged, or what it gains there may be chance: unseen pixels are not asked.

    Args:
        evidence: Of the model under test.
        fit: That model, fitted to stamps in the order in which they came.
        start: It as shipped, which times are followed from: in the other, noise covers for the order of the stamps.
        tried: Number of effects tried.
        alpha: Chance of a gain from which on it is none.
        seed: Of pixels and draws.
    """
    if not followable(evidence.recordings, fit.model):
        return None
    rng = np.random.default_rng(seed)
    pools = (only(evidence.recordings, pixels) for pixels in (evidence.split.fit, evidence.split.select))
    fitting, judging = (few(pool, EVENTS, rng) for pool in pools)
    lights, lights_fitted = Lights(), Lights()
    climb = _climb(fitting, start, seed, lights)
    sigma = max(climb, key=lambda s: climb[s])
    if sigma == FINEST_PATH_S:
        return None
    fitted = float(_log_likelihoods(fitting, fit.model, FINEST_PATH_S, seed, lights_fitted).sum())
    gain = climb[sigma] - max(fitted, climb[FINEST_PATH_S])
    p = chance_of_gain(JITTER, gain, tried)
    if not p < alpha:
        return None
    without, its_lights = (fit.model, lights_fitted) if fitted >= climb[FINEST_PATH_S] else (start, lights)
    behind = _log_likelihoods(judging, start, sigma, seed, lights)
    exact = _log_likelihoods(judging, without, FINEST_PATH_S, seed, its_lights)
    return Candidate(JITTER, replace(fit, model=start.with_effect(JITTER, {SIGMA: sigma})), gain, p, behind - exact)


def _climb(recordings: Sequence[Recording], model: Model, seed: int, lights: Lights) -> dict[float, float]:
    """Standard deviation of a jitter, s → log-likelihood of the stamps, up to the first that lowers it."""
    values = {FINEST_PATH_S: float(_log_likelihoods(recordings, model, FINEST_PATH_S, seed, lights).sum())}
    longest = max(r.stimulus.end_s - r.stimulus.start_s for r in recordings if r.stimulus is not None)
    while (last := max(values)) < longest:
        values[WIDER * last] = float(_log_likelihoods(recordings, model, WIDER * last, seed, lights).sum())
        if values[WIDER * last] < values[last]:
            break
    return values


def _log_likelihoods(
    recordings: Sequence[Recording], model: Model, sigma_s: float, seed: int, lights: Lights
) -> np.ndarray:
    """(pixels,) nats of the stamps of each pixel, true times summed over."""
    windows, stamps = [jitter_windows(r, sigma_s) for r in recordings], [1.0 * r.events.t for r in recordings]
    rng = np.random.default_rng(seed)
    return draw_paths(recordings, windows, stamps, model.circuit(), rng, lights).per_pixel
