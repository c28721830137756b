"""Light for simulations of a recording: as it is, or random paths where only samples of it are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pixelid.likelihood.light_between_samples import told
from pixelid.recordings.bench import gains_of_pixels
from pixelid.recordings.recording import Recording
from pixelid.stimuli.pixel_lights import Light, PixelLights, in_a_row
from pixelid.stimuli.stimulus import Stimulus

# Of all pixels of a row together, where noise asks for the light of each: 0.4 GB.  Beyond, the field counts as even.
MOST_SAMPLES = 100_000_000
PARTS = 16  # of every gap: events come within a twentieth of it


def light_in_a_row(recording: Recording, light: Light, pixels: np.ndarray, seed: int) -> Light:
    """What a sensor of one row sees whose pixels see what `pixels` (n,), flat indices, of the recording see.

    Between the samples of a light that the sensor measured itself every pixel has a path of its own: a Brownian bridge
    of the variance that the recording shows (`light_between_samples.told`).
    """
    row, found = _uneven(recording, in_a_row(light, pixels), pixels), told(recording)
    if found is None or not isinstance(row, PixelLights):
        return row
    rng = np.random.default_rng([seed, 14])
    of_pixel = row.of_pixel.ravel()
    paths = [_path(row.lights[k], found.variance, rng) for k in of_pixel]
    return replace(row, lights=tuple(paths), of_pixel=np.arange(len(paths), dtype=np.int32).reshape(row.of_pixel.shape))


def _uneven(recording: Recording, row: Light, pixels: np.ndarray) -> Light:
    """Light in a row with what each pixel sees more or less of it."""
    gains = gains_of_pixels(recording, pixels)
    if not gains.any() or not isinstance(row, Stimulus) or len(pixels) * len(row.t) > MOST_SAMPLES:
        return row
    values, which = np.unique(gains, return_inverse=True)
    lights = tuple(replace(row, radiance=row.radiance * np.exp(gain)) for gain in values)
    return PixelLights(lights, which.astype(np.int32).reshape(1, -1))


def _path(light: Stimulus, variance: float, rng: np.random.Generator) -> Stimulus:
    """A Brownian bridge in ln L between each two samples, linear in PARTS steps; before the first measurement and after
    the last one it is open at that end."""
    u, w = np.log(light.radiance), np.arange(PARTS) / PARTS
    walk = np.cumsum(rng.normal(0.0, np.sqrt(variance / PARTS), (len(u) - 1, PARTS + 1)), axis=1)
    walk -= walk[:, :1]
    tied = walk - np.linspace(0.0, 1.0, PARTS + 1) * walk[:, -1:]
    tied[0], tied[-1] = walk[0] - walk[0, -1], walk[-1]
    line = u[:-1, None] + w * np.diff(u)[:, None] + tied[:, :-1]
    t = light.t[:-1, None] + w * np.diff(light.t)[:, None]
    end = u[-1] + tied[-1, -1]
    return replace(light, t=np.append(t.ravel(), light.t[-1]), radiance=np.exp(np.append(line.ravel(), end)))
