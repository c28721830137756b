"""Recordings as they would be with a perfect readout: true times drawn under the model, stage by stage.

First only recordings whose windows are short, until thresholds and their noise settle; then those with longer windows,
whose times first follow the model so found.  Filters are held near the model's values by a wide prior meanwhile.  A
recording whose events mostly waited for far longer (a saturated readout) has lost its times: it is left out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pixelid.fit.starts import feasible
from pixelid.gap.climb import climbed
from pixelid.gap.latent import (
    Windows,
    beginning,
    drawn,
    queue_windows,
    ranked,
    tick_windows,
    with_times,
)
from pixelid.gap.readout import Fingerprint
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.model import Model
from pixelid.parameters.parameter import Prior
from pixelid.recordings.recording import Recording
from pixelid.recordings.selection import few
from pixelid.stimuli.resample import resampled

SHORT, LONG = 20.0, 200.0  # of the service time: windows (9 of 10) of the first stage, and of the second
SCOUT_EVENTS = 6_000  # events of the pixels that a first fit looks at
SWEEPS = (20, 8)  # rounds of draws and refits in each stage
SETTLING = 60  # draws without refits before the second stage
WIDTH = 0.5  # standard deviation of the prior on log filters
FILTERS = ("alpha", "beta", "gamma", "alpha_over_beta", "sf_cutoff_hz", "diff_cutoff_hz")
TORN = 0.01  # share of a recording's events without a cause from which on its times count as lost
FINEST_S = 5e-6  # a tick finer than this is a width of the density, not a window


@dataclass(frozen=True)
class Restored:
    """recordings: at true times;  lost: names of those left out"""

    recordings: tuple[Recording, ...]
    lost: tuple[str, ...]


def restored(
    recordings: Sequence[Recording],
    found: Fingerprint,
    model: Model,
    seed: int,
    report: Callable[[str], None] = lambda what: None,
) -> Restored:
    """The recordings without what the fingerprint says the readout did to their times."""
    if found.effect == "timestamp_quantisation":
        if found.value < FINEST_S:
            return Restored(tuple(_ticked(r, found.value) for r in recordings), ())
        windows = [tick_windows(r, found.value) for r in recordings]
    else:
        windows = [queue_windows(r, found.value) for r in recordings]
    reach = np.array([np.quantile(w.hi - w.lo, 0.9) if len(w.hi) else 0.0 for w in windows])
    unit = 1e9 * found.value
    kept = np.flatnonzero(reach <= LONG * unit)
    if sum(len(windows[i].hi) for i in kept) < 100:
        kept = np.flatnonzero(reach <= np.sort(reach)[len(reach) // 2])
    lost = tuple(r.name for i, r in enumerate(recordings) if i not in kept)
    fine = [recordings[i].with_stimulus(resampled(recordings[i].stimulus, "smooth")) for i in kept]  # type: ignore[arg-type]
    windows = [windows[i] for i in kept]
    times = beginning(fine, windows, found.effect == "readout_latency")
    rng = np.random.default_rng(seed)
    short = [i for i in range(len(fine)) if reach[kept[i]] <= SHORT * unit]
    model = _reined(model)
    pixels = len(np.unique(np.concatenate([r.events.pixel for r in recordings])))
    timed = with_times([fine[i] for i in short] or fine, [times[i] for i in short] or times)
    scout = EventTimes(few(timed, SCOUT_EVENTS, np.random.default_rng(seed)))
    model = climbed(scout, feasible(model, scout), tolerance=0.1, max_steps=30).model
    if sum(len(windows[i].hi) for i in short) >= 100:
        part = [fine[i] for i in short], [windows[i] for i in short]
        their, model = _alternate(*part, [times[i] for i in short], model, rng, SWEEPS[0], report)
        if found.effect == "readout_latency":
            times = ranked(fine, windows, model, pixels, seed)
        for i, t in zip(short, their, strict=True):
            times[i] = t
        for _ in range(SETTLING):
            times = drawn(fine, windows, times, model, rng)
    times, model = _alternate(fine, windows, times, model, rng, SWEEPS[1], report)
    torn = _torn(with_times(fine, times), model)
    lost += tuple(r.name for r, gone in zip(fine, torn, strict=True) if gone)
    kept = kept[~torn]
    fine, times = ([x for x, gone in zip(each, torn, strict=True) if not gone] for each in (fine, times))
    back = [r.with_stimulus(recordings[i].stimulus) for r, i in zip(with_times(fine, times), kept, strict=True)]  # type: ignore[arg-type]
    return Restored(tuple(back), lost)


def _torn(recordings: Sequence[Recording], model: Model) -> np.ndarray:
    """(recordings,) bool: too many events without a cause."""
    likelihood = EventTimes(recordings)
    stray = likelihood.terms(model.circuit()).stray
    n = np.bincount(likelihood.recording_of_event, minlength=len(recordings))
    return np.bincount(likelihood.recording_of_event, stray, len(recordings)) > TORN * np.maximum(n, 1)


def _reined(model: Model) -> Model:
    """The model with a wide prior on its free filters, about where they are."""
    parameters = {
        name: replace(p, prior=Prior(p.to_coordinate(p.value), WIDTH)) if name in FILTERS and p.free else p
        for name, p in model.parameters.items()
    }
    return replace(model, parameters=parameters)


def _alternate(
    recordings: Sequence[Recording], windows: Sequence[Windows], times: list[np.ndarray], model: Model,
    rng: np.random.Generator, sweeps: int, report: Callable[[str], None],
) -> tuple[list[np.ndarray], Model]:  # fmt: skip
    for _ in range(sweeps):
        report("true times")
        for _ in range(2):
            times = drawn(recordings, windows, times, model, rng)
        model = climbed(EventTimes(with_times(recordings, times)), model, tolerance=0.5, max_steps=4).model
    return times, model


def _ticked(recording: Recording, tick_s: float) -> Recording:
    """The same events, known to be as wide as the tick."""
    return replace(recording, events=replace(recording.events, tick_ns=max(round(1e9 * tick_s), 1)))
