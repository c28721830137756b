"""Evenness of the field: what each pixel sees over what the light says, a random effect estimated from its bandwidth.

A photoreceptor's bandwidth goes with its light, so a pixel that sees 3 % more is faster by as much.  Log-likelihoods of
each pixel under a light a little dimmer and brighter give its own estimate d and information I.  With gains normal over
the pixels, of standard deviation s, d is normal with variance s² + 1/I: s is its maximum-likelihood value (Morris 1983,
JASA 78, 47), and a gain is d shrunk by s²/(s² + 1/I).  The mean gain is the level of the light.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pixelid.likelihood.event_times import EventTimes
from pixelid.recordings.bench import gains_of_pixels, with_pixel_gains
from pixelid.recordings.recording import Recording
from pixelid.stages.circuit import Circuit

STEP, FARTHEST = 0.02, 0.2  # of ln light: gains that are tried; a pixel's log-likelihood is a parabola about its best
SCALES = np.concatenate([[0.0], np.geomspace(1e-3, 0.5, 200)])  # of s, in which the best is looked for


@dataclass(frozen=True)
class Field:
    """(k,) flat indices of pixels, (k,) ln gain of each, and the standard deviation of ln gain over pixels."""

    pixels: np.ndarray
    gains: np.ndarray
    sd: float

    def on(self, recordings: Sequence[Recording]) -> list[Recording]:
        """The recordings with these gains on top of those that they have."""
        return [with_pixel_gains(r, self.pixels, gains_of_pixels(r, self.pixels) + self.gains) for r in recordings]


def field_of(likelihood: EventTimes, circuit: Circuit) -> Field | None:
    """How the field differs from what the likelihood's recordings have; None where nothing shows.

    Args:
        likelihood: Of event times under full-field light.
        circuit: Where that is greatest.
    """
    trials = STEP * np.arange(-round(FARTHEST / STEP), round(FARTHEST / STEP) + 1)
    values = np.array([likelihood.terms(circuit.brighter_by(float(np.exp(trial)))).per_pixel for trial in trials])
    best = np.clip(np.argmax(np.where(np.isfinite(values), values, -np.inf), axis=0), 1, len(trials) - 2)
    dimmer, here, brighter = (values[best + k, np.arange(values.shape[1])] for k in (-1, 0, 1))
    information = (2.0 * here - dimmer - brighter) / STEP**2
    known = np.isfinite(information) & (information > 0.0)
    if known.sum() < 2:
        return None
    information = information[known]
    own = trials[best][known] + (brighter - dimmer)[known] / (2.0 * STEP) / information
    own -= np.sum(own * information) / np.sum(information)
    variance = SCALES[:, None] ** 2 + 1.0 / information
    nats = -0.5 * np.sum(np.log(variance) + own**2 / variance, axis=1)
    k = int(np.argmax(nats))
    # Nats that unevenness must be worth.  Twice that is 9.5, which a χ² with half a degree of freedom exceeds in one
    # of 1000 even fields; a fit that describes its data badly makes pixels differ more, and its field is estimated
    # again.
    least_nats = 4.8
    if nats[k] - nats[0] < least_nats:
        return None
    shrunk = own * SCALES[k] ** 2 / (SCALES[k] ** 2 + 1.0 / information)
    return Field(likelihood.flat_pixels[known], shrunk - shrunk.mean(), float(SCALES[k]))
