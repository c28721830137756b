"""Tables of event rate against the frequency of a blinking light: bandwidth, dead time and noise per setting."""

from pixelid.tables.rates.pixel import fit_pixel
from pixelid.tables.rates.reading import RateTable, read_table

__all__ = ["RateTable", "fit_pixel", "read_table"]
