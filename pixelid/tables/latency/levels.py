"""The lights that a table's steps end in: after a step the circuit is linear, with the poles of that light."""

from __future__ import annotations

from dataclasses import dataclass

from pixelid.tables.latency.reading import LatencyTable


@dataclass(frozen=True)
class Level:
    """Light after a step: whether the LED went on, through which lens, and its irradiance while lit [W/m²]."""

    on: bool
    lens: str
    irradiance: float

    @property
    def name(self) -> str:
        """As its parameter is called."""
        return f"departure[{'on' if self.on else 'off'}, {self.lens}, {self.irradiance:g}]"


def levels_of(table: LatencyTable) -> tuple[Level, ...]:
    """In order of edge (on first), lens and irradiance."""
    keys = zip(table.on.tolist(), table.lens.tolist(), table.irradiance.tolist(), strict=True)
    return tuple(Level(*key) for key in sorted(set(keys), key=lambda key: (not key[0], *key[1:])))
