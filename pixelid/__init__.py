"""Identify the circuit of an event camera's pixel from its events."""

__version__ = "0.1.0"
