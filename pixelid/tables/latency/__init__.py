"""Tables of first-event latency after a light step, against irradiance, threshold setting and edge."""

from pixelid.tables.latency.fit import fit_latency
from pixelid.tables.latency.reading import LatencyTable, read_tables

__all__ = ["LatencyTable", "fit_latency", "read_tables"]
