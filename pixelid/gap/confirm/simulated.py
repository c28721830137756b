"""Counts of simulated pixels that stand beside the measured ones: twins with their thresholds, or whole sensors.

A twin has the thresholds of its pixel as the model reads them from its events, is let go where the pixel's first event
let it go, and is free from then on.  Pixels that share a readout get a whole sensor of twins.  Under shot noise, where
thresholds cannot be read off single events, sensors of other pixels stand in for the twins.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pixelid.gap.confirm.counts import count_events
from pixelid.likelihood.clocks import light_on_clock
from pixelid.likelihood.event_times import EventTimes
from pixelid.likelihood.light_drawn import light_in_a_row
from pixelid.model.model import Model
from pixelid.parallel import map_threads
from pixelid.recordings.recording import Recording
from pixelid.recordings.selection import only
from pixelid.simulate import Twins, simulate_row


def count_twins(
    recordings: Sequence[Recording],
    timely: Sequence[Recording],
    pixels: np.ndarray,
    everyone: np.ndarray,
    model: Model,
    edges: Sequence[np.ndarray],
    copies: int,
    seed: int,
    hot: np.ndarray | None = None,
) -> np.ndarray:
    """(copies, P, cells) counts of twins of the measured pixels."""
    queue = model.has("readout_latency")
    crowd = np.union1d(everyone, pixels) if queue else pixels
    named = {r.name: r for r in timely}
    mine = only([named.get(r.name, r) for r in recordings], crowd)  # true times are lost in some
    on, off = _thresholds(only(timely, crowd), crowd, model)
    exact = model.without_effect("threshold_mismatch").without_effect("hot_pixels")
    extra_hz = model.circuit().hot_hz if hot is not None else 0.0
    sensors, each = (copies, 1) if queue else (1, copies)  # sensors of twins, twins of each pixel in a sensor
    place = np.searchsorted(crowd, pixels)
    watched = (np.arange(each)[:, None] * len(crowd) + place).ravel()
    hot_twins = watched[np.tile(hot, each)] if hot is not None and extra_hz > 0 else np.empty(0, np.int64)
    runs: list[list[Recording]] = [[] for _ in range(sensors)]
    for i, (recording, own) in enumerate(zip(recordings, mine, strict=True)):
        fired = np.full(len(crowd), np.inf)
        first = np.unique(own.events.pixel, return_index=True)
        after = np.zeros(len(crowd))
        place_of_first = np.searchsorted(crowd, first[0])
        circuit = model.circuit().in_recording(recording.name)
        fired[place_of_first] = own.events.t[first[1]] * 1e-9 - circuit.delay
        after[place_of_first] = np.where(own.events.p[first[1]] == 1, 1.0, -1.0)
        gain = circuit.threshold_gain
        twins = Twins(*(np.tile(one, each) for one in (gain * on, gain * off, fired, after)))
        assert recording.stimulus is not None
        seen = light_on_clock(recording, recording.stimulus, circuit), np.tile(crowd, each)
        for k, done in enumerate(runs):
            own_seed = seed + i + 101 * k
            here = exact.in_recording(recording.name)
            light = light_in_a_row(recording, *seen, own_seed)
            run = simulate_row(here, light, len(twins.on), seed=own_seed, twins=twins)
            done.append(_with_hot_events(run, hot_twins, extra_hz, own_seed) if len(hot_twins) else run)
    table = np.stack([count_events(done, watched, edges).table for done in runs])
    return table.reshape(copies, len(pixels), -1)


def _with_hot_events(recording: Recording, pixels: np.ndarray, rate_hz: float, seed: int) -> Recording:
    """The recording with ON events of a Poisson process in some pixels."""
    assert recording.stimulus is not None
    rng, events = np.random.default_rng(seed), recording.events
    start, span = recording.stimulus.start_s, recording.stimulus.duration_s
    place = np.repeat(pixels, rng.poisson(rate_hz * span, len(pixels)))
    t = np.concatenate([events.t, ((start + span * rng.random(len(place))) * 1e9).astype(np.int64)])
    order = np.argsort(t, kind="stable")
    y, x = np.divmod(np.concatenate([events.pixel, place])[order], events.width)
    p = np.concatenate([events.p, np.ones(len(t) - len(events), np.uint8)])[order]
    moved = replace(events, t=t[order], x=x.astype(np.uint16), y=y.astype(np.uint16), p=p)
    return replace(recording, events=moved)


def _thresholds(recordings, pixels: np.ndarray, model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Each pixel's ON and OFF thresholds (P,) as the model reads them from its events."""
    circuit = model.circuit()
    on = np.full(len(pixels), float(np.real(circuit.on_threshold)))
    off = np.full(len(pixels), float(np.real(circuit.off_threshold)))
    likelihood = EventTimes(recordings)
    means = likelihood.terms(circuit).group_mean.reshape(-1, 2)
    seen = np.isin(likelihood.pixel_keys, pixels)
    where = np.searchsorted(pixels, likelihood.pixel_keys[seen])
    off[where], on[where] = np.real(means[seen, 0]), np.real(means[seen, 1])
    return on, off


def count_sensors(
    recordings: Sequence[Recording],
    pixels: np.ndarray,
    everyone: np.ndarray,
    model: Model,
    edges: Sequence[np.ndarray],
    copies: int,
    seed: int,
) -> np.ndarray:
    """(copies, P, cells) counts of P pixels of each of many simulated sensors.

    They are one long row, which is simulated in little more time than each of them; but apart, and whole, where pixels
    share a readout, and apart where each has so many hot ones.

    pixels: (P,) whose light they see;  everyone: these and all others that are active
    """
    queue = model.has("readout_latency")
    crowd = np.concatenate([pixels, np.setdiff1d(everyone, pixels)]) if queue else pixels
    sensors, each = (copies, 1) if queue or model.has("hot_pixels") else (1, copies)
    row = np.tile(crowd, each)
    watched = (np.arange(each)[:, None] * len(crowd) + np.arange(len(pixels))).ravel()

    def counted(sensor: int) -> np.ndarray:
        runs = []
        for i, recording in enumerate(recordings):
            own, light = seed + 101 * sensor + i, recording.stimulus
            assert light is not None
            here = model.in_recording(recording.name)
            light = light_in_a_row(recording, light_on_clock(recording, light, here.circuit()), row, own)
            runs.append(simulate_row(here, light, len(row), seed=own, sensor_seed=seed + sensor))
        return count_events(runs, watched, edges).table

    # sensors take as long as each other, recordings do not
    return np.stack(map_threads(counted, range(sensors))).reshape(copies, len(pixels), -1)
