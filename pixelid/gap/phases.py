"""The steps that a search goes through."""

from __future__ import annotations

from enum import Enum


class Phase(Enum):
    """The step that comes next."""

    UNDO_READOUT = "undo the readout"
    NAME = "name an effect"
    SHOT_NOISE = "look for shot noise"
    BESIDE_SHOT_NOISE = "look beside shot noise"
    DISCOUNT = "discount imputation noise"
    WITHDRAW = "withdraw"
    CONFIRM = "confirm"
