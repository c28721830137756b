"""Tables of event rate against the frequency of a blinking light: bandwidth, dead time and noise per setting."""

from pixelid.rates.pixel import fit_pixel
from pixelid.rates.table import RateTable, read_table

__all__ = ["RateTable", "fit_pixel", "read_table"]
