"""Simulation: events of a circuit under a stimulus, exact in time, with every effect of the library."""

from pixelid.simulate.simulator import simulate, simulate_stream

__all__ = ["simulate", "simulate_stream"]
