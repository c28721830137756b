"""What noise of a measured light's trace adds to the errors of a fit: the filter that removes it leaves some.

The filtered trace is taken for the light, noise like the trace's own is added and filtered again, and what the gradient
changes by says how much the optimum would move, one Newton step away.  Its mean square over a few draws is the variance
that the trace's noise adds to each coordinate, bias of the filter included.  Shot noise is left out of both gradients:
to what light does to them it adds in second order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pixelid.fit.event_times import EventTimesObjective
from pixelid.likelihood.event_times import EventTimes
from pixelid.recordings.own_light import with_fine_light
from pixelid.recordings.recording import Recording
from pixelid.stimuli.stimulus import Stimulus
from pixelid.stimuli.trace_noise import ATTRIBUTE, without_noise

DRAWS = 4  # a variance within a factor of two: it is added to one that is known


def trace_errors(
    objective: EventTimesObjective,
    x: np.ndarray,
    covariance: np.ndarray,
    recordings: Sequence[Recording],
    between: str,
    seed: int,
) -> np.ndarray:
    """(d,) standard errors that the noise of traces adds to the coordinates.

    Args:
        objective: That was maximised.
        x: (d,) its optimum.
        covariance: (d, d) there.
        recordings: With filtered lights as they came, before samples were added.
        between: How the light runs between its samples.
        seed: Of the draws.
    """
    noisy = [r for r in recordings if r.attributes.get(ATTRIBUTE, 0.0) > 0.0]
    if not noisy or not np.isfinite(covariance).all():
        return np.zeros(len(x))

    def gradient(light: Sequence[Recording]) -> np.ndarray:
        of, likelihood = objective.likelihood, EventTimes([with_fine_light(recording, between) for recording in light])
        likelihood = likelihood.with_stamps(of.carried, of.clock_share, of.placed)
        return EventTimesObjective(likelihood, objective.coordinates, objective.off).gradient(x)

    rng, here = np.random.default_rng([seed, 41]), gradient(recordings)
    drawn = [gradient([_with_noise(r, rng) for r in recordings]) for _ in range(DRAWS)]
    return np.sqrt(np.mean(np.square((drawn - here) @ covariance), axis=0))


def _with_noise(recording: Recording, rng: np.random.Generator) -> Recording:
    light, sd = recording.stimulus, float(recording.attributes.get(ATTRIBUTE, 0.0))
    if sd == 0.0 or not isinstance(light, Stimulus):
        return recording
    noisy = replace(light, radiance=light.radiance * np.exp(sd * rng.standard_normal(len(light.t))))
    return replace(recording, stimulus=without_noise(noisy))
