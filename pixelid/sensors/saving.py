"""Maps of a sensor on disk, as arrays and pictures, each before and after shrinkage."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pixelid.arrays import load_arrays
from pixelid.figures.style import INK, MUTED, SEQUENTIAL, legend_above, new_axes, save_figure, styled
from pixelid.figures.words import with_unit
from pixelid.sensors.map import Map
from pixelid.sensors.shrinkage import Population


@styled
def draw_map(m: Map, axes: Any = None) -> Any:
    """A map before and after shrinkage on one colour scale, its error, and the distributions; returns the four axes."""
    if axes is None:
        axes = new_axes(2, 2, 4.3, 3.2).ravel()
    raw = np.exp(m.raw)
    seen = raw[np.isfinite(raw)]
    low, high = np.percentile(seen if len(seen) else m.value, [2, 98])
    for axis, values, title in (
        (axes[0], raw, "each pixel alone"),
        (axes[1], m.value, "shrunk towards the population"),
    ):
        image = axis.imshow(values, vmin=low, vmax=high, cmap=SEQUENTIAL)
        axis.grid(False)
        axis.set(title=title, xlabel="column (pixels)", ylabel="row (pixels)")
        for side in (axis.xaxis, axis.yaxis):
            side.get_major_locator().set_params(integer=True)
    axes[1].figure.colorbar(image, ax=list(axes[:2]), label=with_unit(m.name, m.unit))
    error = axes[2].imshow(100.0 * m.sd, vmin=0.0, cmap=SEQUENTIAL)
    axes[2].set(title="error of the shrunk map", xlabel="column (pixels)", ylabel="row (pixels)")
    axes[2].grid(False)
    for side in (axes[2].xaxis, axes[2].yaxis):
        side.get_major_locator().set_params(integer=True)
    axes[2].figure.colorbar(error, ax=axes[2], label="standard error (%)")
    bins = int(np.clip(2 * np.sqrt(m.value.size), 8, 50))
    edges = np.linspace(low - 0.3 * (high - low), high + 0.3 * (high - low) + 1e-12, bins + 1)
    axes[3].hist(seen, edges, color=MUTED, alpha=0.6, label="each pixel alone")
    axes[3].hist(m.value.ravel(), edges, histtype="step", color=INK, linewidth=1.2, label="shrunk")
    axes[3].set(xlabel=with_unit(m.name, m.unit), ylabel="pixels")
    axes[3].locator_params(axis="x", nbins=5)
    axes[3].yaxis.get_major_locator().set_params(integer=True)
    legend_above(axes)
    return axes


ARRAYS = "maps.npz"
THRESHOLDS = ("on_threshold", "off_threshold")  # of each pixel, whatever shares a bandwidth


def write_maps(events: np.ndarray, maps: Mapping[str, Map], folder: Path) -> None:
    """Write maps.npz and one picture per map into an existing folder.

    maps.npz: events (h, w), and per parameter `name` (shrunk value), `name.sd` (of its log), `name.raw` (the pixel's
    own value), `name.raw_sd` (of its log).
    """
    arrays = {"events": events}
    for name, m in maps.items():
        arrays |= {name: m.value, f"{name}.sd": m.sd, f"{name}.raw": np.exp(m.raw), f"{name}.raw_sd": m.raw_sd}
    np.savez_compressed(folder / ARRAYS, allow_pickle=False, **arrays)
    for m in maps.values():
        save_figure(draw_map(m), folder / f"{m.name}.svg")


def read_maps(entries: Mapping[str, Mapping[str, Any]], folder: Path, block: int) -> tuple[np.ndarray, dict[str, Map]]:
    """What `write_maps` wrote.

    Args:
        entries: the maps of sensor.json by name.
        folder: with maps.npz.
        block: side of the groups of pixels that share a bandwidth.

    Returns:
        Events per pixel (h, w), and the maps by name.

    Raises:
        InputError: no arrays there.
        LookupError: arrays that do not belong to the entries.
        ValueError: arrays that are no maps.
    """
    arrays = load_arrays(folder / ARRAYS)
    events = arrays["events"]
    if events.ndim != 2 or not events.size or events.dtype.kind not in "iu" or (events < 0).any():
        raise ValueError(f"events: expected counts (height, width), found {events.dtype} of shape {events.shape}")
    maps = {}
    for name, entry in entries.items():
        population = Population(_log(entry["mean"]), _number(entry["relative_spread"]), int(entry["estimates"]))
        low, high = (_log(end) for end in entry["mean_interval_95"])
        least, most = (_number(end) for end in entry["relative_spread_interval_95"])
        side = 1 if name in THRESHOLDS else block
        size = (-(-events.shape[0] // side), -(-events.shape[1] // side))
        for key in (name, f"{name}.sd", f"{name}.raw", f"{name}.raw_sd"):
            if arrays[key].dtype.kind != "f" or arrays[key].shape != size:
                found = f"{arrays[key].dtype} of shape {arrays[key].shape}"
                raise ValueError(f"{key}: expected numbers of shape {size}, found {found}")
        with np.errstate(divide="ignore", invalid="ignore"):
            raw, value = np.log(arrays[f"{name}.raw"]), np.log(arrays[name])
        raw_sd, sd = arrays[f"{name}.raw_sd"], arrays[f"{name}.sd"]
        maps[name] = Map(name, entry["unit"], raw, raw_sd, value, sd, population, (low, high), (least, most))
    return events, maps


def _number(value: float | None) -> float:
    """A number as JSON holds it, null where there is none."""
    return float("nan") if value is None else float(value)


def _log(value: float | None) -> float:
    return float(np.log(_number(value)))
