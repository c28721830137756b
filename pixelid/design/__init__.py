"""The next experiment: which stimulus of a menu tells most about the circuit, and what it would tell."""

from pixelid.design.design import recommend
from pixelid.design.menu import Candidate, default_menu, read_menu

__all__ = ["Candidate", "default_menu", "read_menu", "recommend"]
