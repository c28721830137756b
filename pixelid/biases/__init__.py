"""Bias settings of a camera as currents, and currents as values of the pixel's parameters."""

from pixelid.biases.currents import Current, Currents, currents_of, has_jaer_biases
from pixelid.biases.implied import Implied, Value, implied_by

__all__ = ["Current", "Currents", "Implied", "Value", "currents_of", "has_jaer_biases", "implied_by"]
