"""Light for per-pixel trajectories, in blocks of gaps between frames: bounded memory, however long the video.

Each gap is cut into equal steps, log radiance linear between the frames, by what happens within it:

    mains flicker   64 steps per cycle (as `drive`)
    shot noise      `noise_step`: white noise, drawn per knot and linear in between, must reach well beyond the
                    photoreceptor's bandwidth at the brightest pixel of the gap
    slew limit      `slew.longest_step`

The cutting depends on the gap alone, so results do not depend on the blocks.  It happens inside the compiled loop
over a tile: refined frames are never held in memory.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np

from pixelid.dynamics import slew
from pixelid.dynamics.equations import PRESENT_BELOW, photoreceptor_rates
from pixelid.errors import InputError
from pixelid.simulate.laws import Rules
from pixelid.stimuli.stimulus import Stimulus

WORK = 1 << 24  # pixel steps per block


@dataclass(frozen=True)
class Block:
    """Consecutive gaps between frames.

    t: (m + 1,) s, increasing;  frames: (m + 1, pixels), or (m + 1, 1) full-field, radiance > 0 before dark current
    parts: (m,) int64 steps per gap;  before, after: s, lengths of the steps next to the block (0: none)
    first: number of steps before the block
    """

    t: np.ndarray
    frames: np.ndarray
    parts: np.ndarray
    before: float
    after: float
    first: int

    @property
    def last(self) -> bool:
        """Whether the stimulus ends with this block."""
        return self.after == 0


def noise_step(rules: Rules, radiance: float | np.ndarray) -> float | np.ndarray:
    """The longest step [s] that resolves shot noise at a radiance (any shape): 1/10 of the photoreceptor's 1/ωn.

    Linear interpolation lowers the spectrum by sinc⁴(f Δt).  Behind two poles that costs of the order of (ωn Δt)² of
    the variance; behind a single pole ω, where the tail counts, 0.47 ω Δt, hence 1/50 there.  Without photoreceptor
    the slowest pole that follows takes its place.
    """
    a, b2 = photoreceptor_rates(rules.dynamics, radiance)
    if rules.circuit.photoreceptor == "second_order":
        return 0.1 / np.sqrt(a)
    if rules.circuit.photoreceptor == "one_pole":
        return 0.02 * b2 / a
    w1, w2, _, wd = rules.chain[:4]
    return 0.02 / min(w for w in (w1, w2, wd) if w < PRESENT_BELOW)


def _parts(t, frames, rules: Rules) -> np.ndarray:
    """(m,) into how many steps each gap is cut."""
    circuit = rules.circuit
    longest = np.full(len(t) - 1, np.inf)
    flicker_steps = 64
    if circuit.flicker_modulation != 0:
        longest[:] = 1.0 / (flicker_steps * circuit.flicker_hz)
    if rules.slewing:
        noisy = circuit.shot_density > 0
        per = slew.STEPS_PER_TIME_CONSTANT_UNDER_NOISE if noisy else slew.STEPS_PER_TIME_CONSTANT
        longest = np.minimum(longest, slew.longest_step(rules.chain[:4], float(t[-1] - t[0]), per))
    if circuit.shot_density > 0:
        bright = frames.max(axis=1) * (1 + abs(circuit.flicker_modulation)) + circuit.dark
        longest = np.minimum(longest, noise_step(rules, np.maximum(bright[1:], bright[:-1]).astype(np.float64)))
    parts = np.maximum(np.ceil(np.diff(t) / longest - 1e-9), 1)
    most_steps = 500_000_000
    if parts.sum() > most_steps:
        raise InputError(f"{parts.sum():.3g} steps are needed to resolve noise or slewing: shorten the stimulus")
    return parts.astype(np.int64)


def blocks(source: Stimulus | Iterable, rules: Rules, pixels: int) -> Iterator[Block]:
    """The light of a stimulus, or of an iterable of (t, radiance of any one shape), on so many pixels, in blocks.

    Raises InputError for radiance that is not positive and finite, frames that change shape, times that do not
    increase, and fewer than two frames.
    """
    before, first = 0.0, 0
    pending: Block | None = None
    most_gaps = 8192  # per block: a tile copies its pixels' light
    for t, frames in _runs(source, min(max(1, WORK // pixels), most_gaps)):
        parts = _parts(t, frames, rules)
        for begin, end in _cuts(parts, pixels):
            some = slice(begin, end)
            if pending is not None:
                after = float(t[begin + 1] - t[begin]) / parts[begin]
                yield Block(pending.t, pending.frames, pending.parts, pending.before, after, pending.first)
            pending = Block(t[begin : end + 1], frames[begin : end + 1], parts[some], before, 0.0, first)
            before = float(t[end] - t[end - 1]) / parts[end - 1]
            first += int(parts[some].sum())
    if pending is None:
        raise InputError("stimulus: expected at least two frames")
    yield pending


def _cuts(parts: np.ndarray, pixels: int) -> Iterator[tuple[int, int]]:
    """Ranges of gaps of about `WORK` pixel steps each."""
    done = np.cumsum(parts) * pixels
    begin, spent = 0, 0
    while begin < len(parts):
        end = max(begin + 1, int(np.searchsorted(done, spent + WORK, side="right")))
        yield begin, end
        begin, spent = end, int(done[end - 1])


def _runs(source, size: int):
    """(t (m + 1,), frames (m + 1, pixels)), m ≤ size, of successive runs that share their end frames."""
    if isinstance(source, Stimulus):
        t = np.ascontiguousarray(source.t)
        frames = np.ascontiguousarray(source.radiance).reshape(len(t), -1)
        for k in range(0, len(frames) - 1, size):
            yield t[k : k + size + 1], frames[k : k + size + 1]
        return
    stream = iter(source)
    head = list(islice(stream, 1))
    while True:
        run = head + list(islice(stream, size))
        if len(run) < 2:
            return
        shapes = {np.shape(frame) for _, frame in run}
        if len(shapes) != 1:
            raise InputError(f"stimulus: frames must have one shape, found {sorted(shapes)}")
        t, radiance = np.array([time for time, _ in run]), np.stack([np.ravel(frame) for _, frame in run])
        valid = Stimulus.from_arrays(t, radiance[:, None, :])
        yield valid.t, valid.radiance[:, 0, :]
        head = run[-1:]
