"""What mains flicker alone says about pixels: one frequency, unknown phase and contrast."""

from pixelid.tables.flicker.fit import FlickerFit, fit_flicker

__all__ = ["FlickerFit", "fit_flicker"]
