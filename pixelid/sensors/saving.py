"""Maps of a sensor on disk, as arrays and pictures."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from pixelid.figures.style import save_figure
from pixelid.sensors.figures import draw_map
from pixelid.sensors.map import Map


def write_maps(events: np.ndarray, maps: Mapping[str, Map], folder: Path) -> None:
    """Write maps.npz and one picture per map into an existing folder.

    maps.npz: events (h, w), and per parameter `name` (shrunk value), `name.sd` (of its log), `name.raw` (the pixel's
    own value), `name.raw_sd` (of its log).
    """
    arrays = {"events": events}
    for name, m in maps.items():
        arrays |= {name: m.value, f"{name}.sd": m.sd, f"{name}.raw": np.exp(m.raw), f"{name}.raw_sd": m.raw_sd}
    np.savez_compressed(folder / "maps.npz", allow_pickle=False, **arrays)
    for m in maps.values():
        save_figure(draw_map(m), folder / f"{m.name}.svg")
