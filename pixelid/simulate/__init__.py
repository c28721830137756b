"""Simulation: events of a circuit under a stimulus, exact in time, with every effect of the library."""

from pixelid.simulate.full_field import Twins
from pixelid.simulate.row import simulate_row
from pixelid.simulate.simulator import simulate, simulate_stream

__all__ = ["Twins", "simulate", "simulate_row", "simulate_stream"]
