"""What a camera with shot noise has beside it, told by the likelihood of events whose levels the noise has moved.

That likelihood (`likelihood/shot_noise.py`) is approximate: where noise is strong, effects that are not there gain
hundreds of nats in it.  They gain as much in sessions simulated with the noise and without them, so an effect counts by
what it gains more there than in those (a parametric bootstrap; Davison & Hinkley 1997, Bootstrap Methods, ch. 4).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm

from pixelid.cluster import Work
from pixelid.fit.again import simulate_again
from pixelid.fit.cache import FitCache, map_fits
from pixelid.fit.maximise import Maximum, maximise
from pixelid.gap.attribute.attribute import Candidate
from pixelid.gap.criteria import Criteria
from pixelid.gap.detect.pixels import PixelEvidence
from pixelid.gap.options import Options
from pixelid.likelihood.event_times import EventTimes
from pixelid.likelihood.shot_noise import under_shot_noise
from pixelid.model.model import Model
from pixelid.stages.circuit import Circuit

REPLICATES = 2
SEED_OFFSET = 7001  # of their seeds: none of those of `shot_noise.py` (31 apart)
MAX_STEPS = 30  # of a fit


def settled_under_noise(evidence: PixelEvidence, model: Model, cache: FitCache | None) -> tuple[PixelEvidence, Maximum]:
    """(the evidence under a model's shot noise, the model fitted there);  its density is held."""
    circuit, fit = _settled(evidence.training, model, cache)
    return evidence.each(lambda pool: _under(pool, circuit)), fit


def beyond_sessions_without(
    evidence: PixelEvidence, truth: Model, able: Sequence[Candidate[Maximum]], tried: int, options: Options,
    cache: FitCache | None, work: Work,
) -> list[Candidate[Maximum]]:  # fmt: skip
    """Candidates whose p is the chance of what each gains beyond its gain in sessions simulated without it.

    Sessions of a few pixels are made first, and of as many as were fitted only where those leave it open.

    Args:
        evidence: Without noise.
        truth: What the sessions are simulated from, its noise held; it lacks the candidates.
        able: The candidates.
        tried: Number of effects.
        options: Of the search.
        cache: Fits already made.
        work: Who simulates and fits.
    """
    judged = list(able)
    for pool in (evidence.screening, evidence.fitting):
        gains = _GainsWithout(pool, truth, tuple(candidate.end.model for candidate in able))
        seeds = [options.seed + SEED_OFFSET + 31 * k for k in range(REPLICATES)]
        without = np.array(map_fits(work, gains, seeds, cache)).T
        share = pool.events / evidence.fitting.events
        judged = [
            replace(c, p=chance_of_excess(c.gain, own, tried, options.criteria, share))
            for c, own in zip(able, without, strict=True)
        ]
        if pool is evidence.fitting or min(c.p for c in judged) < options.alpha_each:
            break
    return judged


@dataclass(frozen=True)
class _GainsWithout:
    """Nats that models with an effect gain in one session of a pool's pixels, simulated under `truth` with a seed."""

    pool: EventTimes
    truth: Model
    models: tuple[Model, ...]

    def __call__(self, seed: int, cache: FitCache | None) -> list[float]:
        like = self.pool
        made = EventTimes(simulate_again(like.recordings, self.truth, like.flat_pixels, None, seed))
        circuit, base = _settled(made, self.truth, cache)
        pool = _under(made, circuit)
        ends = [maximise(pool, m, tolerance=0.02, max_steps=MAX_STEPS, cache=cache) for m in self.models]
        return [max(end.value - base.value, 0.0) for end in ends]


def _settled(events: EventTimes, model: Model, cache: FitCache | None) -> tuple[Circuit, Maximum]:
    """(the circuit near the optimum whose noise the events are taken with, the model fitted to them so)."""

    def fitted(start: Model) -> Maximum:
        pool = _under(events, start.circuit())
        return maximise(pool, start, tolerance=0.02, max_steps=MAX_STEPS, cache=cache)

    near = fitted(model).model
    return near.circuit(), fitted(near)


def _under(events: EventTimes, circuit: Circuit) -> EventTimes:
    return under_shot_noise(events.weighed(circuit), circuit)


def chance_of_excess(gain: float, without: np.ndarray, tried: int, criteria: Criteria, share: float = 1.0) -> float:
    """Chance of a gain where sessions without the effect gain as much as `without`, of `tried` effects.

    The root of twice a gain is about normal, of unit variance; gains grow with events.  share: of the events behind
    `gain` that such a session has
    """
    usual = float(np.mean(np.sqrt(2.0 * without / share)))
    error = math.hypot(math.sqrt(1.0 + 1.0 / (share * len(without))), criteria.artefact_error_share * usual)
    return min(1.0, tried * float(norm.sf((math.sqrt(2.0 * max(gain, 0.0)) - usual) / error)))
