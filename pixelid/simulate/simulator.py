"""Events of a circuit under a stimulus.

Light enters as one trajectory shared by all pixels (`full_field.py`), or by those of a group, or one per
pixel (`tiles.py`: video, and shot noise, which is each pixel's own).  Comparators turn it into events; hot pixels add
theirs; the readout stamps them.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor

import numpy as np

from pixelid import __version__
from pixelid.errors import InputError
from pixelid.model.model import Model
from pixelid.recordings.events import MOST_PIXELS, MOST_SIDE, Events
from pixelid.recordings.recording import Recording
from pixelid.simulate import light, random
from pixelid.simulate.full_field import FullField, Twins, reads_together
from pixelid.simulate.hot_pixels import HotPixels
from pixelid.simulate.laws import Rules, rules_of
from pixelid.simulate.ordering import Ordering
from pixelid.simulate.readout import Readout
from pixelid.simulate.tiles import Tiles
from pixelid.stages.circuit import Circuit
from pixelid.stages.modulation import OF_LIGHT
from pixelid.stimuli.pixel_lights import MOST_VALUES, Light, PixelLights
from pixelid.stimuli.resample import resampled, without_long_steps
from pixelid.stimuli.stimulus import Stimulus


def simulate(
    model: Model | Circuit,
    stimulus: Light,
    *,
    width: int | None = None,
    height: int | None = None,
    seed: int = 0,
    sensor_seed: int | None = None,
    synchronous: bool = False,
    as_sampled: bool = False,
    twins: Twins | None = None,
    threads: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> Recording:
    """The recording of a sensor whose pixels are all `model`.

    Event times are exact to 1 ns for the steps of the stimulus, log radiance being linear in between.

    Args:
        model: the circuit.
        stimulus: full-field light, light of groups of pixels, or a video.
        width: of the sensor; a video's own by default.
        height: likewise.
        seed: of everything that differs from recording to recording.
        sensor_seed: of what belongs to the sensor (its pixels' thresholds, its hot pixels), by default `seed`.
            Recordings of one camera share it.
        synchronous: every pixel takes its first reference at the first sample.  Otherwise each starts part of the way
            to its next event (see `comparator.start`), so that pixels are out of step.
        as_sampled: the photoreceptor is linearised once per step of the stimulus as it is sampled.  Otherwise steps
            are split until each changes log radiance by at most 0.02 (`resample.resampled`), as fits read a recording.
            The frames of a video are always taken as sampled.
        twins: thresholds and first resets that the pixels take over from measured ones (full-field light, or groups).
        threads: one per core by default; the events do not depend on it.
        progress: called with the fraction done.

    Returns:
        Events up to the last stimulus sample (readout latency and jitter may carry a few past it), with the stimulus.

    Raises:
        InputError: a stimulus of unit "shape", a sensor size that does not fit the video, an empty sensor, a circuit
            that cannot be simulated (see `laws.rules_of`).
    """
    sensor_seed = seed if sensor_seed is None else sensor_seed
    seeds = random.both_seeds(seed, sensor_seed)
    start, duration = stimulus.start_s, stimulus.duration_s
    chunks = []
    for until_s, chunk in _chunks(model, stimulus, width, height, seeds, synchronous, as_sampled, threads, twins):
        chunks.append(chunk)
        if progress is not None:
            progress((until_s - start) / duration)
    first = chunks[0]
    t, x, y, p = (np.concatenate([getattr(chunk, name) for chunk in chunks]) for name in "txyp")
    events = Events(t, x, y, p, first.width, first.height, first.tick_ns)
    attributes: dict = {"simulator": f"pixelid {__version__}", "seed": seed, "sensor_seed": sensor_seed}
    attributes["synchronous"] = synchronous
    if isinstance(model, Model):
        attributes |= {"model": model.name, "effects": list(model.effects), "parameters": model.values}
    return Recording(events, stimulus, sensor=f"simulated camera {sensor_seed}", attributes=attributes)


def simulate_stream(
    model: Model | Circuit,
    stimulus: Light | Iterable[tuple[float, np.ndarray]],
    *,
    width: int | None = None,
    height: int | None = None,
    seed: int = 0,
    sensor_seed: int | None = None,
    synchronous: bool = False,
    as_sampled: bool = False,
    threads: int | None = None,
) -> Iterator[Events]:
    """The same events in consecutive chunks, in order of time; memory does not grow with the stimulus.

    Args:
        stimulus: as of `simulate`, or an iterable of frames (t in s, radiance (height, width)), log radiance linear in
            between.
        model, width, height, seed, sensor_seed, synchronous, as_sampled, threads: as of `simulate`.

    Yields:
        The events of each block of work.

    Raises:
        InputError: as `simulate`, and for invalid frames when they are reached.
    """
    seeds = random.both_seeds(seed, seed if sensor_seed is None else sensor_seed)
    for _, chunk in _chunks(model, stimulus, width, height, seeds, synchronous, as_sampled, threads):
        yield chunk


def _chunks(
    model, stimulus, width, height, seed, synchronous, as_sampled, threads, twins: Twins | None = None
) -> Iterator[tuple[float, Events]]:
    """(time up to which all is done, sorted events) after each block of work."""
    circuit = model.circuit() if isinstance(model, Model) else model
    if circuit.light_gain != 1.0:
        if not isinstance(stimulus, Stimulus | PixelLights):
            raise InputError("light_gain of a recording: needs light in memory")
        stimulus = stimulus.brighter_by(circuit.light_gain)
        circuit = circuit.with_(light_gain=1.0)
    if circuit.light_spread > 0:
        stimulus = spread_light(stimulus, circuit.light_spread, (width or 1, height or 1), seed)
    if isinstance(stimulus, PixelLights) and circuit.shot_density > 0:
        stimulus = stimulus.as_video()
    if not isinstance(stimulus, Stimulus | PixelLights):
        stream = iter(stimulus)
        head = next(stream, None)
        if head is None:
            raise InputError("stimulus: expected at least two frames")
        start, shape = float(head[0]), np.shape(head[1])
        stimulus = _again(head, stream)
    else:
        if stimulus.unit == "shape":
            raise InputError('stimulus: unit "shape" is known only up to offset and gain; give radiance to simulate')
        start, shape = stimulus.start_s, (stimulus.size or ())[::-1]
        stimulus = stimulus if as_sampled else resampled(stimulus)
    width, height = _size(shape, width, height)
    known = isinstance(stimulus, Stimulus | PixelLights)
    rules = rules_of(circuit, seed, synchronous, stimulus.end_s if known else start)
    pixels = width * height
    shared = isinstance(stimulus, PixelLights) or (known and stimulus.full_field)
    if twins is not None and (not shared or circuit.shot_density > 0 or len(twins.on) != pixels):
        raise InputError("twins: expected full-field light or groups, no shot noise, and a threshold for each pixel")
    if any(m.quantity in OF_LIGHT for m in circuit.described):
        if not isinstance(stimulus, Stimulus | PixelLights) or not shared or circuit.shot_density > 0:
            raise InputError("described light, response or rate: needs full-field light or groups, and no shot noise")
        stimulus = without_long_steps(stimulus)
    alike = isinstance(stimulus, Stimulus) and stimulus.full_field and circuit.shot_density == 0
    if reads_together(circuit) and not alike:
        raise InputError("shared_readout: needs light that all pixels share, and no shot noise or light_spread")
    hot = HotPixels(circuit, pixels, seed, start)
    ordering, readout = Ordering(width, height, circuit.delay), Readout(circuit, seed)
    with ThreadPoolExecutor(threads or os.cpu_count() or 1) as pool:
        if isinstance(stimulus, PixelLights):
            work = Grouped(stimulus, rules, twins).run(pool)
        elif isinstance(stimulus, Stimulus) and alike:
            work = FullField(stimulus, rules, pixels, twins).run(pool)
        else:
            work = _tiled(stimulus, rules, pixels, pool)
        for parts, until_s, last in work:
            events = ordering.merge([*parts, hot.until(until_s)], until_s, last)
            yield until_s, readout(events, round((until_s + circuit.delay) * 1e9), last)


def _tiled(stimulus, rules: Rules, pixels: int, pool):
    """(event lists, time up to which they are complete, whether that is all), block by block."""
    held = isinstance(stimulus, Stimulus) and stimulus.interpolation == "previous"
    tiles = Tiles(rules, pixels, held)
    for block in light.blocks(stimulus, rules, pixels):
        parts = pool.map(lambda first, block=block: tiles.events(first, block), tiles.firsts)
        yield parts, float(block.t[-1]), block.last


def _again(head, stream):
    yield head
    yield from stream


def _size(shape: tuple, width: int | None, height: int | None) -> tuple[int, int]:
    """(width, height) of the sensor."""
    if len(shape) == 2:
        if (width or shape[1], height or shape[0]) != (shape[1], shape[0]):
            raise InputError(f"sensor: the video has {shape[1]} x {shape[0]} pixels, found {width} x {height}")
        width, height = shape[1], shape[0]
    elif len(shape) != 0:
        raise InputError(f"stimulus: expected frames of shape (height, width), found {shape}")
    width, height = 1 if width is None else width, 1 if height is None else height
    if not (1 <= width <= MOST_SIDE and 1 <= height <= MOST_SIDE and width * height <= MOST_PIXELS):
        raise InputError(
            f"sensor: expected 1..{MOST_SIDE} pixels a side and {MOST_PIXELS} in all, found {width} x {height}"
        )
    return width, height


class Grouped:
    """The sensor's pixels, light by light; pixels whose light is not known stay silent."""

    def __init__(self, stimulus: PixelLights, rules: Rules, twins: Twins | None = None) -> None:
        self._stimulus, self._rules, self._twins = stimulus, rules, twins
        self._of_pixel = stimulus.of_pixel.ravel()

    def run(self, pool: Executor):
        """(event lists of lights, the end, that that is all): in one delivery, since steps differ between lights."""
        yield list(pool.map(self._events, np.unique(self._of_pixel[self._of_pixel >= 0]))), self._stimulus.end_s, True

    def _events(self, light: int):
        places = np.flatnonzero(self._of_pixel == light)
        twins = None if self._twins is None else self._twins.only(places)
        pixels = FullField(self._stimulus.lights[light], self._rules, len(places), twins, places)
        return pixels.all_events()


SPREAD = 9  # stream of random numbers, after those of `random.py` and `readout.py`


def spread_light(stimulus: object, sigma: float, size: tuple[int, int], seed: int) -> Light:
    """The stimulus times e^{σ ξ} in each pixel.

    Args:
        stimulus: Full-field.
        sigma: Standard deviation of log radiance over the pixels.
        size: (width, height) of the sensor.
        seed: Of the factors.

    Raises:
        InputError: For another stimulus, or lights that do not fit into memory.
    """
    if not isinstance(stimulus, Stimulus) or not stimulus.full_field:
        raise InputError("light_spread: needs a full-field stimulus, whose light it spreads over the pixels")
    pixels = size[0] * size[1]
    if pixels * len(stimulus.t) > MOST_VALUES:
        raise InputError(
            f"light_spread: {pixels} pixels with {len(stimulus.t)} samples of light each; at most {MOST_VALUES} in all"
        )
    draws = np.empty(pixels)
    random.fill_normals(seed, SPREAD, 0, draws)
    lights = [
        Stimulus(stimulus.t, float(factor) * stimulus.radiance, stimulus.unit, stimulus.interpolation)
        for factor in np.exp(sigma * draws)
    ]
    return PixelLights.of_groups(lights, np.arange(pixels).reshape(size[1], size[0]))
