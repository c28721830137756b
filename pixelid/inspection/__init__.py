"""Health of a recording, from its events alone: no stimulus and no model needed."""

from pixelid.inspection.health import Health, inspect

__all__ = ["Health", "inspect"]
