"""What other simulators take for light: grey levels of an image, and the radiance that they stand for."""

from __future__ import annotations

from dataclasses import dataclass

from pixelid.errors import InputError

GREY_LEVELS = 255.0  # of a white pixel
IRRADIANCE = ("W/m2", "lux")  # units in which 255 of them is hardly what white means


@dataclass(frozen=True)
class Light:
    """How images show radiance.

    Attributes:
        white: Radiance of a white pixel, 255 grey levels, in the model's unit.
        level: Radiance at which a simulator's single number stands for what depends on light.
        unit: Of both.
    """

    white: float = GREY_LEVELS
    level: float = GREY_LEVELS
    unit: str = "radiance"

    def __post_init__(self) -> None:
        if not 0 < self.white < float("inf"):
            raise InputError(f"--white: expected a positive radiance, found {self.white:g}")
        if not 0 < self.level <= self.white:
            raise InputError(f"--level: expected a radiance above 0 and at most white ({self.white:g}), "
                             f"found {self.level:g}")  # fmt: skip

    @property
    def per_grey(self) -> float:
        """Radiance of one grey level."""
        return self.white / GREY_LEVELS

    @property
    def grey(self) -> float:
        """The level in grey levels."""
        return self.level / self.per_grey
