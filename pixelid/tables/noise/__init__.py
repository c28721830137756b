"""Noise events of still scenes: rates and intervals against illuminance, and what they say about the pixel."""
