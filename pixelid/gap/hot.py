"""Hot pixels: those that fire ON while all others are silent.

Recordings are cut into short stretches; a stretch is quiet when at most a fifth of the pixels fire in it.  What a pixel
fires in quiet stretches is compared with what the other pixels do there, by Poisson's law.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2, poisson

from pixelid.gap.readout import Fingerprint
from pixelid.recordings.recording import Recording

STRETCHES = 64  # per recording
SILENT = 0.2  # share of pixels that may fire in a quiet stretch
FEWEST_EVENTS, FEWEST_PIXELS = 5, 8
SURE = 1e-9  # chance of any pixel doing so by accident


@dataclass(frozen=True)
class Hot:
    """pixels: (k,) flat indices of the hot ones;  print: what the result says of them"""

    pixels: np.ndarray
    print: Fingerprint


def hot_pixels(recordings: Sequence[Recording]) -> Hot | None:
    """The hot pixels of a sensor's recordings; None where there are none, or no quiet stretch to see them in."""
    pixels = np.unique(np.concatenate([r.events.pixel for r in recordings]))
    if len(pixels) < FEWEST_PIXELS:
        return None
    fired, quiet_s = np.zeros(len(pixels)), 0.0
    for r in recordings:
        if r.stimulus is None:
            continue
        start, span = float(r.stimulus.t[0]), r.stimulus.duration_s
        cell = np.clip(((r.events.t * 1e-9 - start) / span * STRETCHES).astype(np.int64), 0, STRETCHES - 1)
        row = np.searchsorted(pixels, r.events.pixel)
        every = np.bincount(row * STRETCHES + cell, minlength=len(pixels) * STRETCHES).reshape(-1, STRETCHES)
        on = np.bincount(row * STRETCHES + cell, r.events.p == 1, len(pixels) * STRETCHES).reshape(-1, STRETCHES)
        quiet = (every > 0).mean(axis=0) <= SILENT
        fired += on[:, quiet].sum(axis=1)
        quiet_s += quiet.sum() * span / STRETCHES
    usual = np.sort(fired)[: max(int(0.8 * len(fired)), 1)]
    expected = (usual.sum() + 1.0) / len(usual)
    chance = len(pixels) * poisson.sf(fired - 1, expected)
    hot = (fired >= FEWEST_EVENTS) & (chance < SURE)
    count, total = int(hot.sum()), float(fired[hot].sum() - hot.sum() * usual.mean())
    if count == 0 or quiet_s <= 0:
        return None
    exposure = count * quiet_s
    interval = (float(chi2.ppf(0.025, 2 * total) / 2 / exposure), float(chi2.ppf(0.975, 2 * total + 2) / 2 / exposure))
    gain = float(np.sum(fired[hot] * np.log(fired[hot] / expected) - fired[hot] + expected))
    return Hot(
        pixels[hot],
        Fingerprint(
            "hot_pixels", "hot_pixels.rate_hz", total / exposure, interval, float(chance[hot].max()),
            gain / max(float(fired[hot].sum()), 1.0), float(fired[hot].sum()) / sum(len(r.events) for r in recordings),
            f"{count} of {len(pixels)} pixels fire ON while the others are silent",
        ),
    )  # fmt: skip
