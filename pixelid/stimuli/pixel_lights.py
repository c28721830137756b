"""Light that differs from pixel to pixel, as groups of pixels with a light each.

Pixels that see the same light share one trajectory, and every light keeps the times at which it is sampled: a bright
edge that crosses the sensor needs fine steps in each pixel at another moment.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from hashlib import blake2b
from itertools import pairwise
from zlib import crc32

import numpy as np

from pixelid.errors import InputError
from pixelid.stimuli.stimulus import Stimulus

UNKNOWN = -1  # in `of_pixel`: a pixel whose light is not known
MOST_VALUES = 500_000_000  # of frames in memory, 2 GB; as for built-in videos


@dataclass(frozen=True, repr=False, eq=False)
class PixelLights:
    """Pixels in groups that share a light.

    Example:
        >>> import numpy as np
        >>> from pixelid.stimuli.pixel_lights import PixelLights
        >>> from pixelid.stimuli.shapes import sine
        >>> PixelLights.of_groups([sine(), sine(phase=1.0)], np.array([[0, 0, 1]]))
        light 50 … 150 relative, 2 lights of 3 × 1 pixels, 40002 samples in 1 s

    lights: full-field stimuli with one unit, one interpolation, and the same first and last time
    of_pixel: (height, width) int32, which of them each pixel sees; `UNKNOWN` where nobody knows
    """

    lights: tuple[Stimulus, ...]
    of_pixel: np.ndarray

    def __repr__(self) -> str:
        low, high = (f(float(f(light.radiance)) for light in self.lights) for f in (min, max))
        height, width = self.of_pixel.shape
        size = f"{len(self.lights)} lights of {width} × {height} pixels"
        return f"light {low:.4g} … {high:.4g} {self.unit}, {size}, {self.samples} samples in {self.duration_s:.4g} s"

    @property
    def full_field(self) -> bool:
        """Whether one radiance serves every pixel: no."""
        return False

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the sensor."""
        return self.of_pixel.shape[1], self.of_pixel.shape[0]

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """The arrays it is made of, by the names that files give them: the samples of all lights one after the other.

        first: (lights + 1,) where those of each light begin, and where the last ones end
        """
        return {
            "t": np.concatenate([light.t for light in self.lights]),
            "radiance": np.concatenate([light.radiance for light in self.lights]),
            "first": np.concatenate([[0], np.cumsum([len(light.t) for light in self.lights])]),
            "of_pixel": self.of_pixel,
        }

    @property
    def unit(self) -> str:
        """Of all lights."""
        return self.lights[0].unit

    @property
    def interpolation(self) -> str:
        """Of all lights."""
        return self.lights[0].interpolation

    @property
    def start_s(self) -> float:
        """Time of the first sample of every light."""
        return self.lights[0].start_s

    @property
    def end_s(self) -> float:
        """Time of the last sample of every light."""
        return self.lights[0].end_s

    @property
    def duration_s(self) -> float:
        """Seconds from the first to the last sample."""
        return self.lights[0].duration_s

    @property
    def samples(self) -> int:
        """Of all lights together."""
        return sum(len(light.t) for light in self.lights)

    @cached_property
    def _flat(self) -> np.ndarray:
        return self.of_pixel.ravel()

    def brighter_by(self, factor: float) -> PixelLights:
        """Every light, `factor` times as bright."""
        return replace(self, lights=tuple(light.brighter_by(factor) for light in self.lights))

    def of_pixels(self, pixels: np.ndarray) -> np.ndarray:
        """(n,) index of the light of each flat pixel index (n,).

        Raises:
            InputError: a pixel lies outside, or its light is not known.
        """
        if len(pixels) and int(pixels.max()) >= self._flat.size:
            height, width = self.of_pixel.shape
            raise InputError(
                f"stimulus: expected light of every pixel with events, found {width} x {height} pixels of light"
            )
        found = self._flat[pixels]
        if (found < 0).any():
            pixel = int(pixels[np.argmax(found < 0)])
            y, x = divmod(pixel, self.of_pixel.shape[1])
            raise InputError(f"stimulus: expected light of every pixel with events, pixel ({x}, {y}) has none")
        return found

    def arranged(self, pixels: np.ndarray) -> PixelLights:
        """The light of a row of pixels: `pixels` (n,) flat indices, in this order."""
        which, light = np.unique(self.of_pixels(pixels), return_inverse=True)
        return PixelLights(tuple(self.lights[k] for k in which), light.astype(np.int32)[None, :])

    def restricted(self, pixels: np.ndarray) -> PixelLights:
        """The light of some pixels, flat indices, at their places; that of all others is forgotten."""
        which, light = np.unique(self.of_pixels(pixels), return_inverse=True)
        of_pixel = np.full(self._flat.size, UNKNOWN, np.int32)
        of_pixel[pixels] = light
        return PixelLights(tuple(self.lights[k] for k in which), of_pixel.reshape(self.of_pixel.shape))

    def with_lights(self, lights: Sequence[Stimulus]) -> PixelLights:
        """The same pixels under other lights, one for each."""
        return replace(self, lights=tuple(lights))

    def shifted(self, by_s: float, rate: float = 1.0) -> PixelLights:
        """The same light, its clock slower by `rate` and then later by `by_s`."""
        return self.with_lights([light.shifted(by_s, rate) for light in self.lights])

    def until(self, end_s: float) -> PixelLights:
        """The light up to `end_s`, where all of it ends; two samples at least."""
        if end_s >= self.end_s:
            return self
        end_s = max(end_s, max(float(light.t[1]) for light in self.lights))
        return self.with_lights([_cut(light, end_s) for light in self.lights])

    def own_seed(self, seed: int) -> int:
        """A seed that differs from stimulus to stimulus, see `Stimulus.own_seed`."""
        own = 0
        for array in self.arrays.values():
            own = crc32(np.ascontiguousarray(array).tobytes(), own)
        return (own + seed) % (1 << 31)

    def as_video(self) -> Stimulus:
        """The same light as frames at all times at which any of it is sampled.

        Raises:
            InputError: a pixel's light is not known, or the frames would not fit `MOST_VALUES`.
        """
        which = self.of_pixels(np.arange(self._flat.size))
        t = np.unique(np.concatenate([light.t for light in self.lights]))
        if len(t) * len(which) > MOST_VALUES:
            frames = f"{len(t)} frames of {len(which)} pixels"
            raise InputError(f"stimulus: {frames} cannot be held in memory; take fewer pixels (--pixels)")
        lights = np.empty((len(t), len(self.lights)), np.float32)
        for k, light in enumerate(self.lights):
            if len(light.t) == len(t):
                lights[:, k] = light.radiance
            elif self.interpolation == "previous":
                lights[:, k] = light.radiance[np.searchsorted(light.t, t, side="right") - 1]
            else:
                lights[:, k] = np.exp(_log_at(light, t))
        return Stimulus(t, lights[:, which].reshape(len(t), *self.of_pixel.shape), self.unit, self.interpolation)

    def average(self) -> Stimulus:
        """The geometric mean over pixels, as a full-field light to look at."""
        average_samples = 4096  # of the average over pixels, which is only shown
        grid = np.linspace(self.start_s, self.end_s, average_samples)
        counts = np.bincount(self._flat[self._flat >= 0], minlength=len(self.lights))
        total = np.zeros(len(grid))
        for light, count in zip(self.lights, counts, strict=True):
            total += count * np.interp(grid, light.t, np.log(np.maximum(light.radiance, 1e-300)))
        return Stimulus(grid, np.exp(total / max(counts.sum(), 1)), self.unit, self.interpolation)

    @staticmethod
    def of_groups(lights: Sequence[Stimulus], of_pixel: np.ndarray, *, where: str = "stimulus") -> PixelLights:
        """Validated groups.

        Args:
            lights: Full-field stimuli.
            of_pixel: (height, width), which light each pixel sees; negative where it is not known.
            where: Named in errors.

        Raises:
            InputError: no light, lights that differ in unit, interpolation or span, or an index of none of them.
        """
        of_pixel = np.asarray(of_pixel)
        if not lights or not all(light.full_field for light in lights):
            raise InputError(f"{where}: expected full-field lights, one for each group of pixels")
        kinds = {(light.unit, light.interpolation) for light in lights}
        if len(kinds) > 1:
            raise InputError(f"{where}: expected lights of one unit and interpolation, found {sorted(kinds)}")
        spans = {(light.start_s, light.end_s) for light in lights}
        if len(spans) > 1:
            raise InputError(f"{where}: expected lights of one span of time, found {len(spans)}: {sorted(spans)[:3]}")
        if of_pixel.ndim != 2 or of_pixel.dtype.kind not in "iu" or of_pixel.size == 0:
            found = f"{of_pixel.dtype} of shape {of_pixel.shape}"
            raise InputError(f"{where}/of_pixel: expected whole numbers (height, width), found {found}")
        if int(of_pixel.max()) >= len(lights):
            raise InputError(f"{where}/of_pixel: expected 0..{len(lights) - 1}, found {int(of_pixel.max())}")
        return PixelLights(tuple(lights), np.maximum(of_pixel, UNKNOWN).astype(np.int32))

    @staticmethod
    def from_arrays(
        t, radiance, first, of_pixel, unit="relative", interpolation="linear", *, where="stimulus"
    ) -> PixelLights:
        """Validated groups from `arrays`.  Raises InputError as `of_groups` and `Stimulus.from_arrays`."""
        t, radiance, first = np.asarray(t), np.asarray(radiance), np.asarray(first)
        if t.ndim != 1 or radiance.ndim != 1:
            raise InputError(f"{where}: expected t and radiance of one axis, found shapes {t.shape}, {radiance.shape}")
        ends = first.dtype.kind in "iu" and first.ndim == 1 and len(first) >= 2 and first[0] == 0
        if not ends or first[-1] != len(t) or (np.diff(first.astype(np.int64)) < 2).any() or len(t) != len(radiance):
            raise InputError(f"{where}/first: expected where the samples of each light begin, 0..{len(t)}")
        lights = [
            Stimulus.from_arrays(t[a:b], radiance[a:b], unit, interpolation, where=f"{where}: light {k}")
            for k, (a, b) in enumerate(pairwise(first.tolist()))
        ]
        return PixelLights.of_groups(lights, of_pixel, where=where)

    @staticmethod
    def of_video(video: Stimulus, pixels: np.ndarray | None = None) -> PixelLights:
        """The light of a video's pixels (of those flat indices only), equal ones in one group."""
        assert not video.full_field
        height, width = video.radiance.shape[1:]
        columns = video.radiance.reshape(len(video.t), -1)
        of_pixel = np.full(height * width, UNKNOWN, np.int32)
        group: dict[bytes, int] = {}
        lights: list[Stimulus] = []
        for pixel in np.arange(height * width) if pixels is None else np.unique(pixels):
            column = np.ascontiguousarray(columns[:, pixel])
            key = blake2b(column.tobytes(), digest_size=16).digest()
            of_pixel[pixel] = group.setdefault(key, len(lights))
            if of_pixel[pixel] == len(lights):
                lights.append(Stimulus(video.t, column, video.unit, video.interpolation))
        return PixelLights(tuple(lights), of_pixel.reshape(height, width))


def _cut(light: Stimulus, end_s: float) -> Stimulus:
    """The light up to `end_s`, with a sample there."""
    keep = int(np.searchsorted(light.t, end_s))
    if light.interpolation == "previous":
        last = light.radiance[max(keep - 1, 0)]
    else:
        last = np.exp(np.interp(end_s, light.t, np.log(np.maximum(light.radiance, 1e-300))))
    return replace(light, t=np.append(light.t[:keep], end_s), radiance=np.append(light.radiance[:keep], last))


Light = Stimulus | PixelLights


def light_from_arrays(columns: Mapping[str, np.ndarray], unit: str, interpolation: str, where: str) -> Light:
    """The light whose `arrays` a file holds.

    Raises:
        InputError: naming `where`, for an array that is missing, and as the lights' own constructors.
    """
    missing = [name for name in ("t", "radiance") if name not in columns]
    if missing:
        raise InputError(f"{where}/{missing[0]}: missing; expected t and radiance, found {', '.join(columns)}")
    if "of_pixel" not in columns:
        return Stimulus.from_arrays(columns["t"], columns["radiance"], unit, interpolation, where=where)
    if "first" not in columns:
        raise InputError(f"{where}/first: missing; expected where the samples of each light begin")
    return PixelLights.from_arrays(
        columns["t"], columns["radiance"], columns["first"], columns["of_pixel"], unit, interpolation, where=where
    )


def pixel_lights(light: Stimulus | PixelLights, pixels: np.ndarray | None = None) -> PixelLights | None:
    """Light of each pixel's own in groups (a video's, of these pixels), None of full-field light."""
    if isinstance(light, PixelLights):
        return light
    return None if light.full_field else PixelLights.of_video(light, pixels)


def lights_in(light: Light) -> tuple[Stimulus, ...]:
    """The lights of all groups of pixels, or the one that every pixel sees."""
    return light.lights if isinstance(light, PixelLights) else (light,)


def in_a_row(light: Light, pixels: np.ndarray) -> Light:
    """The light of a sensor of one row whose pixels see what `pixels` (n,), flat indices, see; full-field as it is."""
    grouped = pixel_lights(light, pixels)
    return light if grouped is None else grouped.arranged(pixels)


def log_radiance_at(light: Light, pixel: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    """(n,) log radiance that pixels (n,), flat indices, saw at times (n,), log radiance linear between samples."""
    grouped = pixel_lights(light, pixel)
    if grouped is None:
        return _log_at(light, time_s)  # pyright: ignore[reportArgumentType]
    which, out = grouped.of_pixels(pixel), np.empty(len(time_s))
    for k in np.unique(which):
        out[which == k] = _log_at(grouped.lights[k], time_s[which == k])
    return out


def _log_at(light: Stimulus, time_s: np.ndarray) -> np.ndarray:
    return np.interp(time_s, light.t, np.log(np.maximum(light.radiance, 1e-300)))
