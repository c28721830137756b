"""Cells: what the regions of interest of one condition agree on, and which rows are spoiled.

A mean over edges of which one gave no latency is short by that edge's share f, and the standard deviation between
edges shows it: √(f (1−f)) of the true value, r = √(f / (1−f)) of the one written.  So f = r² / (1 + r²), and what is
written is 1 − f times what was meant.  Rows that scatter as much because of stragglers say so in their maximum.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pixelid.tables.latency.reading import STATISTICS, LatencyTable

# Latencies of a region repeat within 1 to 13 % of their median in clean rows of the public table, and scatter by 24 to
# 60 % in those that lack an edge
LARGEST_REPEATABLE = 0.2
MOST_LOST = 0.5  # an edge in two; more is no latency at all
MOST_SCATTERED = 0.5  # of a camera's rows (22 % in the public table); where more do, that is how its latencies repeat
STRAGGLER = 5.0  # times the median, of a maximum: mismatch alone reaches 3
SURPLUS_PIXELS = 1.3  # times those of other regions: pixels of outside it, from the edge that is lost
LOST_ERROR = 0.05  # of what is put right for a lost edge: f is known from one scattered number
# Of the largest value of a figure's panel: a pixel row of the public table's figures, 6 inches at 100 dpi of which 77 %
# are axes.  A table that was written as numbers loses nothing by it but where stragglers reach 50 times the median
PANEL = 1.0 / 462.0
UNRESOLVED = 0.1  # relative error of a cell's own median beyond which it is not to be trusted


@dataclass(frozen=True)
class Cells:
    """One row per camera, lens, edge, irradiance and setting.

    table: medians over clean regions;  error: statistic → (cells,) relative scatter of that median
    cell: (rows,) of the original table, which cell each belongs to
    lost: (rows,) share of edges without a latency, 0 where all have one;  spoiled: (rows,) not to be trusted
    """

    table: LatencyTable
    error: dict[str, np.ndarray]
    cell: np.ndarray
    lost: np.ndarray
    spoiled: np.ndarray


def gather(table: LatencyTable) -> Cells:
    """The cells of a table."""
    lost, spoiled = lost_edges(table)
    keys = list(
        zip(table.camera, table.lens, table.on, table.irradiance, table.setting, np.nan_to_num(table.bias), strict=True)
    )
    place = {key: k for k, key in enumerate(dict.fromkeys(keys))}
    cell = np.array([place[key] for key in keys])
    first = np.array([np.flatnonzero(cell == k)[0] for k in range(len(place))])
    values = {name: np.full(len(place), np.nan) for name in STATISTICS}
    error = {name: np.zeros(len(place)) for name in STATISTICS}
    pixels = np.empty(len(place))
    for k in range(len(place)):
        rows = np.flatnonzero(cell == k)
        clean = rows[~spoiled[rows] & np.isfinite(table.latency_s["median"][rows])]
        short = not len(clean)
        use = rows[lost[rows] > 0] if short and (lost[rows] > 0).any() else rows if short else clean
        pixels[k] = np.median(table.pixels[use])
        for name in STATISTICS:
            panel = PANEL * np.nanmax(
                np.append(table.latency_s["max" if name in ("min", "median") else name][rows], 0.0)
            )
            if short and name in ("stdev", "sd"):
                continue
            found = table.latency_s[name][use] / (1.0 - lost[use])
            found = found[np.isfinite(found)]
            if not len(found):
                continue
            values[name][k] = np.median(found)
            scatter = 1.48 * np.median(np.abs(found - values[name][k])) * 1.25 / np.sqrt(len(found))
            error[name][k] = np.hypot(scatter, panel) / max(values[name][k], 1e-9) + LOST_ERROR * short
    spoiled = spoiled | (error["median"][cell] > UNRESOLVED)
    return Cells(
        replace(table.select(_mask(first, len(table))), pixels=pixels, latency_s=values), error, cell, lost, spoiled
    )


def lost_edges(table: LatencyTable) -> tuple[np.ndarray, np.ndarray]:
    """(rows,) share of edges that gave no latency, and (rows,) whether the row is spoiled, by that or by stragglers."""
    latency = table.latency_s
    with np.errstate(invalid="ignore", divide="ignore"):
        r = latency["stdev"] / latency["median"]
        share = r**2 / (1.0 + r**2)
        scattered = r > LARGEST_REPEATABLE
        straggling = latency["max"] > STRAGGLER * latency["median"]
    surplus, known = np.zeros(len(table), bool), np.isfinite(r)
    for camera in np.unique(table.camera):
        here = table.camera == camera
        counted = here & table.counted
        if counted.any():
            many = counted & (table.pixels > SURPLUS_PIXELS * np.quantile(table.pixels[counted], 0.25))
            # larger regions count more pixels, too: it is the edge that is lost where such rows scatter
            if _share(scattered, many & known) > 0.5:
                surplus |= many
        if _share(scattered, here & known) > MOST_SCATTERED:
            scattered = scattered & (~here | surplus)
    short = (scattered | surplus) & ~straggling
    usual = share[short & scattered & (share < MOST_LOST)]
    share = np.where(scattered, share, np.median(usual) if len(usual) else 0.0)
    lost = np.where(short & (share < MOST_LOST), share, 0.0)
    return np.nan_to_num(lost), scattered | surplus


def _share(flags: np.ndarray, among: np.ndarray) -> float:
    """Of the rows in question, 0 of none."""
    return float(np.mean(flags[among])) if among.any() else 0.0


def _mask(index: np.ndarray, size: int) -> np.ndarray:
    keep = np.zeros(size, bool)
    keep[index] = True
    return keep
