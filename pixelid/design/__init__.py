"""The next experiment: which stimulus of a menu adds most to what is known of the circuit, and how much."""

from pixelid.design.design import recommend
from pixelid.design.menu import Candidate, default_menu, read_menu

__all__ = ["Candidate", "default_menu", "read_menu", "recommend"]
