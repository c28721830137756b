"""A sensor fit on disk: maps as arrays and pictures, the population as JSON."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pixelid.sensors.sensor import Map, SensorFit


def save(fit: SensorFit, folder: Path) -> None:
    """Write sensor.json, maps.npz and one picture per map into an existing folder."""
    fit.write(folder)


def write_maps(fit: SensorFit, folder: Path) -> None:
    """Write maps.npz and one picture per map into an existing folder.

    maps.npz: events (h, w), and per parameter `name` (shrunk value), `name.sd` (of its log), `name.raw` (the pixel's
    own
    value), `name.raw_sd` (of its log).
    """
    arrays = {"events": fit.events}
    for name, m in fit.maps.items():
        arrays |= {name: m.value, f"{name}.sd": m.sd, f"{name}.raw": np.exp(m.raw), f"{name}.raw_sd": m.raw_sd}
    np.savez_compressed(folder / "maps.npz", allow_pickle=False, **arrays)
    for m in fit.maps.values():
        _picture(m, folder / f"{m.name}.png")


def _picture(m: Map, path: Path) -> None:
    """The map before and after shrinkage, on one colour scale, and the two distributions."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 3, figsize=(13, 3.6), layout="constrained")
    raw = np.exp(m.raw)
    seen = raw[np.isfinite(raw)]
    low, high = np.percentile(seen if len(seen) else m.value, [2, 98])
    for axis, values, title in (
        (axes[0], raw, "each pixel alone"),
        (axes[1], m.value, "shrunk towards the population"),
    ):
        image = axis.imshow(values, vmin=low, vmax=high, interpolation="nearest")
        axis.set_title(title)
    figure.colorbar(image, ax=axes[:2], label=f"{m.name} [{m.unit}]")
    edges = np.linspace(low - 0.3 * (high - low), high + 0.3 * (high - low) + 1e-12, 50)
    axes[2].hist(seen, edges, alpha=0.5, label="alone")
    axes[2].hist(m.value.ravel(), edges, alpha=0.5, label="shrunk")
    axes[2].set_xlabel(f"{m.name} [{m.unit}]")
    axes[2].legend()
    figure.savefig(path, dpi=100)
    plt.close(figure)
