"""Which model the data support."""

from pixelid.compare.compare import Comparison, Contender, compare

__all__ = ["Comparison", "Contender", "compare"]
