"""A sensor fit on disk: maps as arrays and pictures, the population as JSON."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pixelid.figures.style import save_figure
from pixelid.sensors.figures import draw_map
from pixelid.sensors.sensor import SensorFit


def save(fit: SensorFit, folder: Path) -> None:
    """Write sensor.json, maps.npz and one picture per map into an existing folder."""
    fit.write(folder)


def write_maps(fit: SensorFit, folder: Path) -> None:
    """Write maps.npz and one picture per map into an existing folder.

    maps.npz: events (h, w), and per parameter `name` (shrunk value), `name.sd` (of its log), `name.raw` (the pixel's
    own value), `name.raw_sd` (of its log).
    """
    arrays = {"events": fit.events}
    for name, m in fit.maps.items():
        arrays |= {name: m.value, f"{name}.sd": m.sd, f"{name}.raw": np.exp(m.raw), f"{name}.raw_sd": m.raw_sd}
    np.savez_compressed(folder / "maps.npz", allow_pickle=False, **arrays)
    for m in fit.maps.values():
        save_figure(draw_map(m), folder / f"{m.name}.svg")
