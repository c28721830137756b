"""Events counted in the cells of the free-run gap, per pixel.

Cells are the counts of a pixel per recording and polarity: in the whole recording, its halves, quarters and eighths,
and by the wait since the event before.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pixelid.recordings.recording import Recording

PARTS, WAITS = (1, 2, 4, 8), 6


@dataclass(frozen=True)
class Counts:
    """Counts of each pixel (pixels, cells);  recording, block: (cells,) where each cell belongs; the blocks of a
    recording are its cells of one size and polarity."""

    table: np.ndarray
    recording: np.ndarray
    block: np.ndarray


def count_events(
    recordings: Sequence[Recording], pixels: np.ndarray, wait_edges: Sequence[np.ndarray], after_first: bool = False
) -> Counts:
    """The counts of the given pixels in the cells of each recording; after_first: without each pixel's first event."""
    tables, home, blocks = [], [], []
    highest = max([int(pixels.max(initial=0)), *(int(r.events.pixel.max(initial=0)) for r in recordings)])
    place = np.full(highest + 1, -1)
    place[pixels] = np.arange(len(pixels))
    for k, (recording, edges) in enumerate(zip(recordings, wait_edges, strict=True)):
        events, stimulus = recording.events, recording.stimulus
        assert stimulus is not None
        row = place[events.pixel]
        mine = row >= 0
        if after_first:
            mine[np.unique(events.pixel, return_index=True)[1]] = False
        row, t, p = row[mine], events.t[mine] * 1e-9, events.p[mine].astype(np.int64)
        start, span = stimulus.start_s, stimulus.end_s - stimulus.start_s
        sorted_by = []
        for parts in PARTS:
            stretch = np.clip(((t - start) / span * parts).astype(np.int64), 0, parts - 1)
            sorted_by.append((row, p, stretch, parts))
        order = np.lexsort((t, row))
        same = np.flatnonzero(row[order][1:] == row[order][:-1]) + 1
        later = order[same]
        wait = t[later] - t[order[same - 1]]
        sorted_by.append((row[later], p[later], np.searchsorted(edges, wait), WAITS))
        for b, (rows, polarity, cell, cells) in enumerate(sorted_by):
            tables.append(_table(rows, polarity * cells + cell, len(pixels), 2 * cells))
            home.append(np.full(2 * cells, k))
            blocks.append(np.repeat([2 * b, 2 * b + 1], cells))
    return Counts(np.concatenate(tables, axis=1), np.concatenate(home), np.concatenate(blocks))


def cell_weights(counts: Counts, shown: np.ndarray) -> np.ndarray:
    """(cells,) each cell's weight: equal within a block, equal blocks within a recording, equal recordings; sum 1."""
    weights = np.zeros(len(shown))
    recordings = np.unique(counts.recording[shown])
    for i in recordings:
        blocks = np.unique(counts.block[shown & (counts.recording == i)])
        for b in blocks:
            inside = shown & (counts.recording == i) & (counts.block == b)
            weights[inside] = 1.0 / (len(recordings) * len(blocks) * inside.sum())
    return weights


def wait_edges(recording: Recording) -> np.ndarray:
    """(WAITS − 1,) edges between waits, the same for measurement and models: quantiles of what was measured.

    Where the waits of half a cell are alike (the end of a silence, few ticks of a clock), an edge through them would
    count their rounding: it lies below them.
    """
    events = recording.events
    order = np.lexsort((events.t, events.pixel))
    pixel, t = events.pixel[order], events.t[order] * 1e-9
    waits = np.diff(t)[pixel[1:] == pixel[:-1]]
    if len(waits) < WAITS:
        return np.linspace(0.01, 1.0, WAITS - 1)
    edges, waits = np.quantile(waits, np.linspace(0, 1, WAITS + 1)[1:-1]), np.sort(waits)
    alike = 0.005  # of a wait: a silence as it was found, and stamps, err by less
    around = [np.searchsorted(waits, edges * (1.0 + side * alike)) for side in (-1, 1)]
    crowded = around[1] - around[0] > 0.5 * len(waits) / WAITS
    return np.where(crowded, edges * (1.0 - 2.0 * alike), edges)


def _table(row, cell, rows, cells) -> np.ndarray:
    return np.bincount(row * cells + cell, minlength=rows * cells).reshape(rows, cells).astype(float)
