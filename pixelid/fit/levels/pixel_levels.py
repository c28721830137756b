"""Gain and background of every pixel: what may be asked for, what a fit finds, and light as the pixels saw it.

A pixel sees gain · L(t) + background of the light L that was recorded: vignetting and photodiodes differ, stray light
and dark current add.  Over the pixels of a camera ln gain is normal about 0, its scale the standard deviation, and
background half-normal, its scale the root mean square.  How they are found: `objective.py`, `scales.py`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
from scipy.special import ndtr, ndtri

from pixelid.errors import InputError, shown
from pixelid.likelihood.layout import FLAT_BITS
from pixelid.model.model import Model
from pixelid.recordings.recording import Recording
from pixelid.recordings.selection import only
from pixelid.recordings.sensor_light import is_measured
from pixelid.stimuli.pixel_lights import UNKNOWN, PixelLights, pixel_lights
from pixelid.stimuli.stimulus import Stimulus

GAIN, BACKGROUND = "gain", "background"
KINDS = (GAIN, BACKGROUND)
DARK = "dark_current.radiance"
FAR = 6.0  # standard deviations of a level's prior, beyond which none of 10⁸ pixels lies
FEWEST = 4  # pixels that can tell a scale: its 95 % interval is a factor of 7 wide then

PixelLevelsLike: TypeAlias = "str | Mapping[str, float | None] | Wanted | None"


@dataclass(frozen=True)
class Scales:
    """How far levels spread over pixels; None: they do not, gain 1 and background 0.

    gain: standard deviation of ln gain;  background: root mean square, in the light's unit
    """

    gain: float | None = None
    background: float | None = None

    @property
    def kinds(self) -> tuple[str, ...]:
        """What is free, in the order of the columns of u."""
        return tuple(kind for kind in KINDS if getattr(self, kind) is not None)

    def levels(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(gain, background) (pixels,) at u (pixels, kinds), which is standard normal over pixels.

        gain = exp(scale · u); background = scale · `half_normal`(u).
        """
        gain, background = np.ones(len(u)), np.zeros(len(u))
        for column, kind in enumerate(self.kinds):
            if kind == GAIN:
                gain = np.exp(self.gain * u[:, column])
            else:
                background = self.background * half_normal(u[:, column])
        return gain, background


def half_normal(u: np.ndarray) -> np.ndarray:
    """|ξ| of standard normal ξ as an increasing function of u, standard normal as well: never on the bound 0."""
    return -ndtri(0.5 * ndtr(-u))


def half_normal_slope(u: np.ndarray) -> np.ndarray:
    """Its derivative: the ratio of both densities."""
    return 0.5 * np.exp(0.5 * (half_normal(u) ** 2 - u**2))


@dataclass(frozen=True)
class Wanted:
    """Which levels a fit shall find, and the scales that are given; those of others are estimated."""

    kinds: tuple[str, ...]
    given: Mapping[str, float]

    @staticmethod
    def of(asked: PixelLevelsLike, where: str = "pixel_levels") -> Wanted | None:
        """From words ("gain", "background", "both", "gain=0.2,background=3") or {"gain": 0.2, "background": None}.

        Raises InputError for anything else; `where` names the option.
        """
        if asked is None or isinstance(asked, Wanted):
            return asked
        expected = f"{where}: expected gain, background or both, or a scale with it (gain=0.2)"
        if isinstance(asked, str):
            words = ",".join(KINDS) if asked.strip() == "both" else asked
            parts = [part.partition("=") for part in words.split(",")]
            pairs = [(name.strip(), value.strip() if sign else None) for name, sign, value in parts]
        elif isinstance(asked, Mapping):
            pairs = list(asked.items())
        else:
            raise InputError(f"{expected}, found {shown(asked)}")
        names, given = [name for name, _ in pairs], {}
        if not names or len(set(names)) < len(names) or not set(names) <= set(KINDS):
            raise InputError(f"{expected}, found {shown(asked)}")
        for name, value in pairs:
            if value is None:
                continue
            try:
                given[name] = float(value)
            except (TypeError, ValueError):
                given[name] = math.nan
            if not 0 < given[name] < math.inf:
                raise InputError(f"{where}: {name}: expected a positive number, its scale, found {shown(value)}")
        return Wanted(tuple(kind for kind in KINDS if kind in names), given)

    def separable(self, model: Model) -> bool:
        """Whether no free parameter of the model is what levels common to all pixels are."""
        return BACKGROUND not in self.kinds or DARK not in model.parameters or not model.parameter(DARK).free

    def check(self, recordings: Sequence[Recording], model: Model, form: str) -> None:
        """Raise InputError where levels of pixels cannot be identified: by these recordings, or with this model."""
        if any(recording.pooled for recording in recordings):
            raise InputError("pixel_levels: pooled recordings have no pixels whose levels could differ")
        if any(map(is_measured, recordings)):
            raise InputError("pixel_levels: light that the pixels measured themselves holds their gain and background")
        lights = [recording.stimulus for recording in recordings if recording.stimulus is not None]
        if any(light.unit == "shape" for light in lights):
            raise InputError("pixel_levels: light of unit shape has no level of its own that pixels' could differ from")
        if len({light.unit for light in lights}) > 1 or len({_sensor(recording) for recording in recordings}) > 1:
            raise InputError("pixel_levels: expected recordings of one sensor, their light in one unit")
        if form != "discrete":
            raise InputError("pixel_levels: found in the discrete form only")
        if not self.separable(model):
            raise InputError(
                f"pixel_levels: a background that all pixels share is a dark current: hold it (--fix {DARK}=VALUE) or "
                "remove it (--without dark_current)"
            )
        pixels = len(np.unique(np.concatenate([recording.events.pixel for recording in recordings])))
        if GAIN in self.kinds and pixels < 2:
            raise InputError("pixel_levels: the gain of a single pixel is the radiance's scale; expected two or more")
        if pixels < FEWEST and set(self.kinds) - set(self.given):
            raise InputError(f"pixel_levels: {pixels} pixels do not identify how far levels spread; give it (gain=0.2)")
        samples = sum(_mean_samples(light) for light in lights) * pixels
        most_samples = 40_000_000  # of all pixels' lights: 3 GB with their trajectories
        if samples > most_samples:
            raise InputError(
                f"pixel_levels: every pixel has light of its own, {pixels} of them {samples:.2g} samples; "
                "take fewer pixels (--pixels)"
            )


@dataclass(frozen=True)
class PixelLevels:
    """What a fit found of the levels of p pixels.

    x, y: (p,) where they are;  gain, ln_gain_sd, background, background_sd: (p,), empty where not asked for
    scales: by kind, {"value", "unit", "interval_95", "given"}
    camera: by free parameter of the camera, standard errors in fitting coordinates: "sd", "sd_if_levels_known",
        "sd_of_these_pixels" (if the mean of their ln gain were known to be 0), "growth" of the first over the second
    ln_gain_sd is that about the mean of these pixels;  background: the median of what is likely
    notes: what cannot be identified, in words
    """

    x: np.ndarray
    y: np.ndarray
    gain: np.ndarray
    ln_gain_sd: np.ndarray
    background: np.ndarray
    background_sd: np.ndarray
    scales: Mapping[str, Mapping[str, Any]]
    camera: Mapping[str, Mapping[str, float]]
    notes: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """The entry in fit.json."""
        arrays = {name: getattr(self, name) for name in _ARRAYS}
        return {
            "pixels": {name: array for name, array in arrays.items() if len(array)},
            "scales": {kind: dict(scale) for kind, scale in self.scales.items()},
            "camera": {name: dict(sd) for name, sd in self.camera.items()},
            "notes": list(self.notes),
        }

    @staticmethod
    def from_dict(document: Mapping[str, Any]) -> PixelLevels:
        """From the entry in fit.json.  Raises ValueError where its arrays do not belong together."""
        pixels = document["pixels"]
        arrays = {name: np.array(pixels.get(name, ()), float) for name in _ARRAYS}
        arrays |= {name: arrays[name].astype(np.int64) for name in ("x", "y")}
        if any(a.ndim != 1 or len(a) not in (0, len(arrays["x"])) for a in (arrays["y"], *arrays.values())):
            raise ValueError("pixel_levels.pixels: arrays of different lengths")
        scales, camera = document["scales"], document["camera"]
        for scale in scales.values():
            if not isinstance(scale["value"], float | int) or not isinstance(scale["unit"], str):
                raise ValueError("pixel_levels.scales: expected a value and its unit")
            if scale["interval_95"] is not None and len(scale["interval_95"]) != 2:
                raise ValueError("pixel_levels.scales: expected an interval of two ends")
        return PixelLevels(**arrays, scales=scales, camera=camera, notes=tuple(map(str, document["notes"])))

    def seen(self, recordings: Sequence[Recording]) -> list[Recording]:
        """The recordings with the light that each of these pixels saw; of other pixels nothing is left."""
        flat = self.y * recordings[0].events.width + self.x
        gain = dict(zip(flat, self.gain if len(self.gain) else np.ones(len(flat)), strict=True))
        background = dict(zip(flat, self.background if len(self.background) else np.zeros(len(flat)), strict=True))
        out = []
        for recording in with_own_lights(only(recordings, flat)):
            light = recording.stimulus
            assert isinstance(light, PixelLights)
            pixels = np.unique(recording.events.pixel)
            lights = [seen_by(light.lights[k], gain[p], background[p]) for k, p in enumerate(pixels)]
            out.append(recording.with_stimulus(light.with_lights(lights)))
        return out


_ARRAYS = ("x", "y", "gain", "ln_gain_sd", "background", "background_sd")


def seen_by(light: Stimulus, gain: float, background: float) -> Stimulus:
    """What a pixel saw of a full-field light; in double precision, for differences of close levels."""
    return replace(light, radiance=gain * light.radiance.astype(np.float64) + background)


def with_own_lights(recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings with a light for each pixel that fires in them, in order of the pixels, shared by none."""
    out = []
    for recording in recordings:
        light, pixels = recording.stimulus, np.unique(recording.events.pixel)
        assert light is not None
        grouped = pixel_lights(light, pixels)
        if grouped is None:
            assert isinstance(light, Stimulus)
            height, width, lights = recording.events.height, recording.events.width, (light,) * len(pixels)
        else:
            height, width = grouped.of_pixel.shape
            lights = tuple(grouped.lights[k] for k in grouped.of_pixels(pixels))
        of_pixel = np.full(height * width, UNKNOWN, np.int32)
        of_pixel[pixels] = np.arange(len(pixels))
        out.append(recording.with_stimulus(PixelLights(lights, of_pixel.reshape(height, width))))
    return out


def places(pixel_keys: np.ndarray, width: int) -> tuple[np.ndarray, np.ndarray]:
    """(x, y) (p,) of pixels by their keys in a likelihood's layout."""
    y, x = np.divmod(pixel_keys & ((1 << FLAT_BITS) - 1), width)
    return x, y


def _sensor(recording: Recording) -> tuple[str, int, int]:
    return recording.sensor, recording.events.width, recording.events.height


def _mean_samples(light: Stimulus | PixelLights) -> float:
    return light.samples / len(light.lights) if isinstance(light, PixelLights) else len(light.t)
