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
from pixelid.stimuli.pixel_lights import Light, PixelLights
from pixelid.stimuli.stimulus import Stimulus

LARGEST_CHANGE = 0.02  # of log radiance within one step
LARGEST_BEND = 2e-5  # distance of a step's chord from the spline, log radiance
MOST_PARTS = 64


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
    if between == "smooth":
        smooth = course(stimulus.t, u)
        curvature = np.abs(smooth(stimulus.t, 2))
        bend = np.maximum(curvature[1:], curvature[:-1]) * gaps**2 / 8.0
        wanted = np.maximum(wanted, np.sqrt(bend / LARGEST_BEND))
    parts = np.clip(np.ceil(wanted), 1, MOST_PARTS).astype(np.int64)
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
