"""Whole sensors: maps of thresholds and bandwidth, shrunk towards their population, on one core or a cluster."""

from pixelid.sensors.sensor import SensorFit, fit_sensor

__all__ = ["SensorFit", "fit_sensor"]
