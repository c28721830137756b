"""The signal path, one file per stage, and the library of its effects."""

from __future__ import annotations

from pixelid.errors import InputError, did_you_mean
from pixelid.stages import comparator, differencing, photocurrent, photoreceptor, readout, source_follower
from pixelid.stages.circuit import Circuit
from pixelid.stages.effect import Effect

STAGES = (photocurrent, photoreceptor, source_follower, differencing, comparator, readout)
LIBRARY: dict[str, Effect] = {effect.name: effect for stage in STAGES for effect in stage.EFFECTS}


def effect(name: str) -> Effect:
    """The effect of that name.  Raises InputError listing the known ones."""
    try:
        return LIBRARY[name]
    except KeyError:
        raise InputError(f"unknown effect {name!r}; known: {', '.join(LIBRARY)}{did_you_mean(name, LIBRARY)}") from None


__all__ = ["LIBRARY", "STAGES", "Circuit", "Effect", "effect"]
