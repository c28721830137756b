"""What the light did: radiance over time, full-field or one value per pixel."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING
from zlib import crc32

import numpy as np

from pixelid.errors import InputError, shown

if TYPE_CHECKING:
    from jaxtyping import Float, Float64

UNITS = ("relative", "lux", "W/m2", "fA", "shape")  # the usual ones; any other short word is kept as it is written
SAME_UNITS = {
    **{unit.lower(): unit for unit in UNITS}, "lx": "lux", "w/m²": "W/m2", "w/m^2": "W/m2", "wm2": "W/m2",
    "radiance": "relative", "": "relative",
}  # fmt: skip
_UNIT = re.compile(r"[^\W\d_][\w²³/·^%.*µμ-]{0,15}|%")  # a letter first: no number passes for a unit
WITHOUT_SCALE = ("relative", "shape")  # units that say nothing of how bright the light was
INTERPOLATIONS = ("linear", "previous")


def unit_named(unit: object, *, where: str = "stimulus") -> str:
    """The unit of light that a text means; one that is not known is kept as it is written.

    >>> unit_named("lx"), unit_named("W/m²"), unit_named("V")
    ('lux', 'W/m2', 'V')

    Raises:
        InputError: it is no short word.
    """
    if isinstance(unit, str) and (unit.lower() in SAME_UNITS or _UNIT.fullmatch(unit)):
        return SAME_UNITS.get(unit.lower(), unit)
    raise InputError(f"{where}: unit must be {', '.join(UNITS)} or another short word as V, found {shown(unit)}")


@dataclass(frozen=True, repr=False)
class Stimulus:
    """Radiance sampled at `t`.

    t: (n,) float64 seconds, strictly increasing, same time zero as the events
    radiance: (n,) full-field, or (n, height, width) per pixel; > 0 except for unit "shape" (≥ 0)
    unit: "relative", "shape" (known up to offset and gain), or a short word as "lux", "W/m2", "fA", "V"
    interpolation: "linear" (log radiance is linear between samples) or "previous" (held)
    """

    t: Float64[np.ndarray, " samples"]
    radiance: Float[np.ndarray, " samples ..."]
    unit: str = "relative"
    interpolation: str = "linear"

    def __repr__(self) -> str:
        low, high = float(self.radiance.min()), float(self.radiance.max())
        size = "full field" if self.full_field else f"{self.radiance.shape[2]} × {self.radiance.shape[1]} pixels"
        return f"light {low:.4g} … {high:.4g} {self.unit}, {size}, {len(self.t)} samples in {self.duration_s:.4g} s"

    def own_seed(self, seed: int) -> int:
        """A seed that differs from stimulus to stimulus, so that one camera's recordings do not repeat their noise."""
        return (crc32(self.radiance.tobytes(), crc32(self.t.tobytes())) + seed) % (1 << 31)

    @property
    def full_field(self) -> bool:
        """Whether one radiance serves every pixel."""
        return self.radiance.ndim == 1

    @property
    def size(self) -> tuple[int, int] | None:
        """(width, height) of light of each pixel's own; None of full-field light."""
        return None if self.full_field else (self.radiance.shape[2], self.radiance.shape[1])

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """The arrays it is made of, by the names that files give them."""
        return {"t": self.t, "radiance": self.radiance}

    @property
    def start_s(self) -> float:
        """Time of the first sample."""
        return float(self.t[0])

    @property
    def end_s(self) -> float:
        """Time of the last sample."""
        return float(self.t[-1])

    @property
    def duration_s(self) -> float:
        """Seconds from the first to the last sample."""
        return float(self.t[-1] - self.t[0])

    def average(self) -> Stimulus:
        """The mean over pixels, as a full-field light to look at; full-field light as it is."""
        return self if self.full_field else replace(self, radiance=self.radiance.mean(axis=(1, 2)))

    def brighter_by(self, factor: float) -> Stimulus:
        """The light, `factor` times as bright."""
        return replace(self, radiance=self.radiance * factor)

    def until(self, end_s: float) -> Stimulus:
        """The light up to `end_s`, with a sample there; all of a light that ends before, and two samples at least.

        Between samples radiance is taken as linear (log radiance, which it is in, differs by less than a step of the
        light), or held with interpolation "previous".
        """
        after = max(int(np.searchsorted(self.t, end_s)), 1)
        if after == len(self.t):
            return self
        before = self.t[after - 1]
        end_s = end_s if end_s > before else float(self.t[after])
        value = self.radiance[after - 1]
        if self.interpolation != "previous":
            value = value + (self.radiance[after] - value) * (end_s - before) / (self.t[after] - before)
        t, radiance = np.append(self.t[:after], end_s), np.concatenate([self.radiance[:after], np.asarray([value])])
        return replace(self, t=t, radiance=radiance.astype(self.radiance.dtype))

    def shifted(self, by_s: float, rate: float = 1.0) -> Stimulus:
        """The same light, its clock slower by `rate` and then later by `by_s`: t becomes rate · t + by_s."""
        return replace(self, t=rate * self.t + by_s)

    @staticmethod
    def from_arrays(t, radiance, unit="relative", interpolation="linear", *, where="stimulus") -> Stimulus:
        """A validated stimulus.

        Raises InputError naming `where` for too few samples, times that do not increase, shapes that do
        not match, NaN or infinite values, radiance ≤ 0 (< 0 for "shape"), a unit that is no short word, and unknown
        interpolation.
        """
        t, radiance = np.asarray(t), np.asarray(radiance)
        if t.dtype.kind not in "fiu":
            raise InputError(f"{where}/t: expected numbers, found {t.dtype}")
        t = t.astype(np.float64, copy=False)
        if radiance.dtype.kind not in "fiu":
            raise InputError(f"{where}/radiance: expected numbers, found {radiance.dtype}")
        if radiance.dtype not in (np.float32, np.float64):
            radiance = radiance.astype(np.float64)
        unit = unit_named(unit, where=where)
        if interpolation not in INTERPOLATIONS:
            raise InputError(
                f"{where}: interpolation must be one of {', '.join(INTERPOLATIONS)}, found {shown(interpolation)}"
            )
        if t.ndim != 1 or len(t) < 2:
            raise InputError(f"{where}/t: expected at least two samples, found shape {t.shape}")
        if radiance.ndim not in (1, 3) or radiance.shape[0] != len(t):
            raise InputError(
                f"{where}/radiance: expected ({len(t)},) or ({len(t)}, height, width), found {radiance.shape}"
            )
        if not np.isfinite(t).all():
            raise InputError(f"{where}/t: sample {int(np.argmin(np.isfinite(t)))} is not finite")
        if not (np.diff(t) > 0).all():
            k = int(np.argmin(np.diff(t) > 0)) + 1
            raise InputError(f"{where}/t: times must increase, sample {k} does not follow sample {k - 1}")
        if not np.isfinite(radiance).all():
            raise InputError(f"{where}/radiance: contains NaN or infinite values")
        low = float(radiance.min())
        if low < 0 or (low == 0 and unit != "shape"):
            raise InputError(f"{where}/radiance: must be positive, found {low:g}")
        return Stimulus(t, radiance, unit, interpolation)
