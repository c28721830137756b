"""Finer samples of a recorded stimulus, where the closed-form step or the interpolation needs them.

The photoreceptor is linearised once per step, an error of second order in the change of log radiance over the
step; and a recorded stimulus may be the samples of a smooth light, whose course between them is not a straight
line.  Both errors reach fits: at 50 µs samples of a 400-level chirp they move α and β by 20 standard errors.
"""

from __future__ import annotations

from typing import overload

import numpy as np

from pixelid.errors import InputError
from pixelid.parallel import map_threads
from pixelid.stimuli.course import course
from pixelid.stimuli.drive import refined, refined_radiance
from pixelid.stimuli.pixel_lights import Light, PixelLights, lights_in
from pixelid.stimuli.stimulus import Stimulus

LARGEST_CHANGE = 0.02  # of log radiance within one step
# After a jump of held light, s: photoreceptors ring at some kHz, what follows is slow.  On 2 ms steps at 200
# fA the survivals that samples alone miss are 458 nats; these miss 11, and 240 in a geometric series 13.
AFTER_JUMPS_S = np.concatenate(
    [np.geomspace(5e-6, 3e-4, 30), np.arange(3.4e-4, 3e-3, 4e-5), np.geomspace(3.1e-3, 5e-2, 20)]
)
# At least so many steps in a light: what a circuit makes of it may change with time though the light does not
# (`stages/modulation.py`).  A relaxation by a half within a fiftieth of the light then errs by 1e-4 of log radiance.
LEAST_STEPS, STEPS_IN_ALL = 2048, 50_000  # in each light, in all lights of a recording
MOST_ADDED = 2_000_000  # samples, of some hundred bytes each in a likelihood


@overload
def resampled(stimulus: Stimulus, between: str = ..., largest_change: float = ...) -> Stimulus: ...
@overload
def resampled(stimulus: Light, between: str = ..., largest_change: float = ...) -> Light: ...
def resampled(stimulus: Light, between: str = "linear", largest_change: float = LARGEST_CHANGE) -> Light:
    """The stimulus with steps split until each changes log radiance by at most `largest_change`.

    between: "linear", log radiance is linear between the samples; "smooth", it follows cubic splines through them
    that meet at its corners (`course`).  Of lights of pixels' own each is split for itself.  Held stimuli, videos,
    "shape" stimuli and stimuli of fewer than four samples come back as they are.
    Raises InputError for an unknown `between`.
    """
    if between not in ("linear", "smooth"):
        raise InputError(f"between must be 'linear' or 'smooth', found {between!r}")
    if isinstance(stimulus, PixelLights):
        finer = map_threads(lambda light: resampled(light, between, largest_change), stimulus.lights)
        return stimulus.with_lights(finer)
    if stimulus.interpolation == "previous" or stimulus.unit == "shape" or not stimulus.full_field:
        return stimulus
    if len(stimulus.t) < 4:
        return stimulus
    u = np.log(stimulus.radiance.astype(np.float64))
    gaps = np.diff(stimulus.t)
    wanted = np.abs(np.diff(u)) / largest_change
    smooth = None
    largest_bend = 2e-5  # distance of a step's chord from the spline, log radiance
    if between == "smooth":
        smooth = course(stimulus.t, u)
        curvature = np.abs(smooth(stimulus.t, 2))
        bend = np.maximum(curvature[1:], curvature[:-1]) * gaps**2 / 8.0
        wanted = np.maximum(wanted, np.sqrt(bend / largest_bend))
    most_parts = 64
    parts = np.clip(np.ceil(wanted), 1, most_parts).astype(np.int64)
    if smooth is None and parts.max() == 1:
        return stimulus
    left = np.repeat(np.arange(len(gaps)), parts)
    first = np.concatenate([[0], np.cumsum(parts)[:-1]])
    weight = (np.arange(len(left)) - first[left]) / parts[left]
    t = np.append(stimulus.t[left] + weight * gaps[left], stimulus.t[-1])
    if smooth is not None:
        t = np.union1d(t, smooth.corners)
        fine = smooth(t)
        span = float(np.ptp(u))
        if (
            fine.min() < u.min() - span or fine.max() > u.max() + span
        ):  # splines that ring: no samples of a smooth light
            return resampled(stimulus, "linear", largest_change)
    else:
        fine = np.append((1.0 - weight) * u[left] + weight * u[left + 1], u[-1])
    return Stimulus(t, np.exp(fine), stimulus.unit, stimulus.interpolation)


def with_overshoots(light: Light, between: str = "linear") -> Light:
    """Light as a likelihood looks at it: `resampled`, and held light with more samples after each jump.

    A likelihood asks at samples only how far a pixel's output has gone; after a jump it may overshoot and return.  No
    step is long.
    """
    finer = resampled(light, between)
    after = _after_jumps(sum(len(_jumps(one)) for one in lights_in(finer)))
    if isinstance(finer, PixelLights):
        finer = finer.with_lights(map_threads(lambda one: _sampled_after_jumps(one, after), finer.lights))
    else:
        finer = _sampled_after_jumps(finer, after)
    return without_long_steps(finer)


@overload
def without_long_steps(light: Stimulus) -> Stimulus: ...
@overload
def without_long_steps(light: Light) -> Light: ...
def without_long_steps(light: Light) -> Light:
    """The same light in `LEAST_STEPS` steps or more (each of many lights in fewer), none much longer than others."""
    lights = lights_in(light)
    steps = min(LEAST_STEPS, STEPS_IN_ALL // len(lights))
    if isinstance(light, PixelLights):
        return light.with_lights(map_threads(lambda one: _in_steps(one, steps), lights))
    return _in_steps(light, steps)


def _in_steps(stimulus: Stimulus, steps: int) -> Stimulus:
    if not stimulus.full_field or stimulus.unit == "shape":
        return stimulus
    longest = stimulus.duration_s / max(steps, 1)
    t, left, weight = refined(stimulus.t, longest)
    if len(t) == len(stimulus.t):
        return stimulus
    if stimulus.interpolation == "linear":
        light = refined_radiance(stimulus.t, stimulus.radiance.astype(np.float64), longest)[1]
    else:
        light = stimulus.radiance[left + (weight == 1.0)]
    return Stimulus(t, light, stimulus.unit, stimulus.interpolation)


def _after_jumps(jumps: int) -> np.ndarray:
    """s after each of so many jumps: fewer where all would be more than `MOST_ADDED`, as of a video's pixels."""
    each = MOST_ADDED // max(jumps, 1)
    return AFTER_JUMPS_S if each >= len(AFTER_JUMPS_S) else np.geomspace(5e-6, 5e-2, each) if each > 1 else np.empty(0)


def _jumps(stimulus: Stimulus) -> np.ndarray:
    """(k,) samples at which held light jumps."""
    if stimulus.interpolation != "previous" or stimulus.unit == "shape" or not stimulus.full_field:
        return np.empty(0, np.int64)
    return np.flatnonzero(np.abs(np.diff(np.log(stimulus.radiance.astype(np.float64)))) > LARGEST_CHANGE) + 1


def _sampled_after_jumps(stimulus: Stimulus, after: np.ndarray) -> Stimulus:
    """Held light with samples of the same radiance `after` (m,) s each jump, as far as the step lasts."""
    jumps = _jumps(stimulus)
    if not len(jumps) or not len(after):
        return stimulus
    ends = np.append(stimulus.t, np.inf)[jumps + 1]
    added = stimulus.t[jumps, None] + after
    t = np.union1d(stimulus.t, added[(added < ends[:, None]) & (added < stimulus.t[-1])])
    held = stimulus.radiance[np.searchsorted(stimulus.t, t, side="right") - 1]
    return Stimulus(t, held, stimulus.unit, stimulus.interpolation)
