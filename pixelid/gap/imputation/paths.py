"""Whole paths of true times behind a jitter, a coarse tick or a queue, pixel by pixel (`lattice.py`).

Where times are blurred by more than a threshold's noise makes of an interval, moving one time between its neighbours
gets nowhere: each is held by the next.  Here all times of a pixel are drawn together, and with them the order of its ON
and OFF events, which a blur can turn around; a queue keeps it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pixelid.dynamics.equations import PRESENT_BELOW
from pixelid.gap.imputation.chances import BLOCK, Light, Thresholds
from pixelid.gap.imputation.lattice import draw_path
from pixelid.gap.imputation.windows import Windows, with_times
from pixelid.likelihood.clocks import light_on_clock
from pixelid.likelihood.density import BACKGROUND_HZ
from pixelid.likelihood.event_times import EventTimes
from pixelid.likelihood.leaked import light_until
from pixelid.likelihood.located import located
from pixelid.likelihood.trajectories import Trajectories
from pixelid.model.model import Model
from pixelid.parallel import map_threads
from pixelid.recordings.recording import Recording
from pixelid.recordings.sensor_light import is_measured
from pixelid.stages.circuit import Circuit
from pixelid.stages.differencing import leaked, leaks
from pixelid.stimuli.stimulus import Stimulus

REACH = 6.0  # standard deviations of a jitter that a stamp can be off by
FINEST_CELL_S = 2e-6  # the least step of the fastest edges: level moves by half a noise there
MOST_REMEMBERED = 16_000_000  # cells of all recordings under one model: 0.4 GB


@dataclass(frozen=True)
class Paths:
    """Times drawn.

    times: (n,) ns per recording, in the order of its events
    log_likelihoods: flat pixel → nats of its stamps, in all recordings
    stuck: pixels (in one recording each) without a path, which keep the times they had
    """

    times: list[np.ndarray]
    log_likelihoods: dict[int, float]
    stuck: int

    @property
    def per_pixel(self) -> np.ndarray:
        """(pixels,) nats, in order of the pixels."""
        return np.array([self.log_likelihoods[pixel] for pixel in sorted(self.log_likelihoods)])


def followable(recordings: Sequence[Recording], model: Model) -> bool:
    """Whether paths can be drawn: full-field light that is known between its samples, nothing described."""
    return not model.circuit().described and all(
        isinstance(r.stimulus, Stimulus) and r.stimulus.full_field and not is_measured(r) for r in recordings
    )


def is_summed_whole(circuit: Circuit) -> bool:
    """Whether sums over paths know all that a circuit's next event hangs on: neither a silence nor lost events."""
    return circuit.silent == 0.0 and circuit.lost == 0.0


def draw_paths(
    recordings: Sequence[Recording], windows: Sequence[Windows], times: Sequence[np.ndarray], circuit: Circuit,
    rng: np.random.Generator, lights: Lights | None = None, among: np.ndarray | None = None,
) -> Paths:  # fmt: skip
    """All times drawn anew, given stamps in the order of the present times (n,) ns per recording.

    Args:
        recordings: As a fit reads them.
        windows: Of a jitter, a tick or a queue.
        times: The present ones; they tell each pixel's thresholds, and which stamp of a polarity is whose.
        circuit: That the times follow.
        rng: Of the draws.
        lights: What was made of the light before, where the same circuit draws more than once.
        among: (recordings,) bool, whose times are drawn; None: of all.  The others tell of thresholds.
    """
    lights = lights or Lights()
    thresholds = _thresholds(recordings, times, circuit)
    seeds = rng.integers(1 << 62, size=len(recordings))

    def drawn(job) -> tuple[np.ndarray, dict[int, float], int]:
        recording, window, t, own, seed = job
        here = circuit.in_recording(recording.name)
        return _draw(recording, window, t, lights.of(recording, here), own, np.random.default_rng(seed))

    jobs = list(zip(recordings, windows, times, thresholds, seeds, strict=True))
    chosen = range(len(jobs)) if among is None else np.flatnonzero(among)
    made = map_threads(drawn, [jobs[k] for k in chosen])
    total, found = {}, list(times)
    for k, (t, values, _) in zip(chosen, made, strict=True):
        found[k] = t
        for pixel, value in values.items():
            total[pixel] = total.get(pixel, 0.0) + value
    return Paths(found, total, sum(stuck for _, _, stuck in made))


def _thresholds(
    recordings: Sequence[Recording], times: Sequence[np.ndarray], circuit: Circuit
) -> list[dict[int, Thresholds]]:
    """Per recording: flat pixel → its thresholds, given the present times."""
    likelihood = EventTimes(with_times(recordings, times))
    terms, at = likelihood.terms(circuit), likelihood.layout
    mean = terms.group_mean.reshape(-1, 2)
    sd = np.sqrt((circuit.noise * mean) ** 2 + terms.group_variance.reshape(-1, 2))
    found = []
    for i, intervals in enumerate(likelihood.intervals):
        pixels = at.last_pixel[at.last_recording == i]
        found.append({
            int(flat): Thresholds(mean[k, 1], mean[k, 0], sd[k, 1], sd[k, 0], float(circuit.polarity_memory))
            for flat, k in zip(intervals.last_pixel, pixels, strict=True)
        })  # fmt: skip
    return found


def _draw(
    recording: Recording, window: Windows, t: np.ndarray, light: Light | None, thresholds: dict[int, Thresholds],
    rng: np.random.Generator,
) -> tuple[np.ndarray, dict[int, float], int]:  # fmt: skip
    """(times (n,) ns, flat pixel → log-likelihood, pixels stuck) of one recording."""
    values: dict[int, float] = {}
    drawn, stuck = t.copy(), 0
    if light is None:
        return drawn, values, 0
    stamp = window.centre
    sd = 1e-9 * window.sd
    reach = np.full(len(t), REACH * sd) if window.stamp is not None else 0.5e-9 * (window.hi - window.lo)
    of_stamp = -float(np.log(sd * np.sqrt(2.0 * np.pi))) if np.isfinite(sd) else 0.0
    order = np.lexsort((t, recording.events.pixel))
    pixel, rising = recording.events.pixel[order], recording.events.p[order] == 1
    for chunk in np.split(np.arange(len(order)), np.flatnonzero(np.diff(pixel)) + 1):
        on, off = order[chunk[rising[chunk]]], order[chunk[~rising[chunk]]]
        own, times = int(pixel[chunk[0]]), (np.empty(len(on)), np.empty(len(off)))
        uniform = rng.random(2 * len(chunk))
        value = draw_path(
            light, thresholds[own], 1e-9 * stamp[on], 1e-9 * stamp[off], sd, reach[on], reach[off],
            window.in_order, BACKGROUND_HZ, uniform, *times,
        )  # fmt: skip
        values[own] = len(chunk) * of_stamp
        if not np.isfinite(value):
            stuck += 1
            continue
        values[own] += value
        for some, at in zip((on, off), times, strict=True):
            drawn[some] = np.clip(1e9 * at, window.lo[some], window.hi[some])
    return drawn, values, stuck


class Lights:
    """What circuits make of recordings' light, remembered up to `MOST_REMEMBERED` cells.

    The light of a recording hangs on neither its pixels nor how far stamps are off.
    """

    def __init__(self) -> None:
        self._made: dict[tuple, tuple[Stimulus, Light]] = {}
        self._cells = 0

    def of(self, recording: Recording, circuit: Circuit) -> Light | None:
        """The light of a recording under a circuit; None without events."""
        if not len(recording.events):
            return None
        stimulus = recording.stimulus
        assert isinstance(stimulus, Stimulus)
        end = max(stimulus.end_s, 1e-9 * float(recording.events.t[-1]))
        key = (id(stimulus), end, circuit)
        if key in self._made:
            return self._made[key][1]
        on_clock = light_on_clock(recording, stimulus, circuit)
        assert isinstance(on_clock, Stimulus)
        made = _light(on_clock, end, circuit)
        if self._cells + len(made.output) <= MOST_REMEMBERED:
            self._cells += len(made.output)
            self._made[key] = stimulus, made  # the stimulus is kept: an id is its own while it lives
        return made


def _light(stimulus: Stimulus, end: float, circuit: Circuit) -> Light:
    """What a circuit makes of the light until `end` s, on cells of at most `FINEST_CELL_S`."""
    span = end - stimulus.start_s
    most_cells = 2_000_000  # of one recording: 48 MB
    step = max(FINEST_CELL_S, span / most_cells)
    times = stimulus.start_s + step * np.arange(int(span / step) + 2)
    trajectory, _, drive = Trajectories([stimulus], end).of(circuit, keep=False)
    on_light = times - circuit.delay
    first = np.array([0, len(trajectory.t)])
    zeros = np.zeros(len(times), np.int64)
    sample = located(trajectory.t, on_light, zeros, first, zeros)
    level, output = trajectory.outputs_at(on_light, sample)
    drift = np.zeros(len(times))
    if leaks(circuit):
        lights = light_until(on_light, sample, trajectory.t, drive.log_light)
        drift = circuit.on_threshold * leaked(circuit, on_light - on_light[0], lights - lights[0])
    blocks = np.append(output, np.full(-len(output) % BLOCK, output[-1])).reshape(-1, BLOCK)
    decay = circuit.differencing if circuit.differencing < PRESENT_BELOW else np.inf
    return Light(
        stimulus.start_s, step, output, level, drift, blocks.max(axis=1), blocks.min(axis=1),
        float(circuit.threshold_drift), float(decay), float(circuit.refractory),
    )  # fmt: skip
