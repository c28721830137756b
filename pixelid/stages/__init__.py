"""The signal path, one file per stage, and the library of its effects."""

from __future__ import annotations

from collections.abc import Iterable

from pixelid.errors import InputError, did_you_mean
from pixelid.stages import comparator, differencing, photocurrent, photoreceptor, readout, source_follower
from pixelid.stages.circuit import Circuit
from pixelid.stages.described import PREFIX, described
from pixelid.stages.effect import Effect

STAGES = (photocurrent, photoreceptor, source_follower, differencing, comparator, readout)
LIBRARY: dict[str, Effect] = {effect.name: effect for stage in STAGES for effect in stage.EFFECTS}


def effect(name: str) -> Effect:
    """The effect of that name, of the library or described.  Raises InputError listing the known ones."""
    if name.startswith(PREFIX):
        return described(name)
    try:
        return LIBRARY[name]
    except KeyError:
        raise InputError(f"unknown effect {name!r}; known: {', '.join(LIBRARY)}{did_you_mean(name, LIBRARY)}") from None


def in_signal_order(names: Iterable[str]) -> tuple[str, ...]:
    """Effects in the order in which a signal meets them; described ones, which may modulate any, come last."""
    order = list(LIBRARY)
    return tuple(sorted(names, key=lambda name: (order.index(name) if name in LIBRARY else len(order), name)))


__all__ = ["LIBRARY", "STAGES", "Circuit", "Effect", "effect", "in_signal_order"]
