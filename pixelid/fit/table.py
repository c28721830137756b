"""Numbers as the terminal and the reports show them."""

from pixelid.results import number

__all__ = ["number"]
