"""What mains flicker alone says about pixels: one frequency, unknown phase and contrast."""

from pixelid.flicker.fit import FlickerFit, fit_flicker

__all__ = ["FlickerFit", "fit_flicker"]
