"""Fitting: one function from recordings and a model to values with intervals."""

from pixelid.fit.fit import fit
from pixelid.fit.result import Estimate, FitResult

__all__ = ["Estimate", "FitResult", "fit"]
