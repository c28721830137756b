"""From a dataset to what training needs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pixelid.errors import InputError
from pixelid.nerf.data.calibration import Calibration
from pixelid.nerf.data.dataset import Dataset
from pixelid.nerf.effects.additions import tilts
from pixelid.nerf.events.gauge import CLOSE_PIXELS, crossing_time, gauge_of, scene_box
from pixelid.nerf.events.image_speed import crossing_times
from pixelid.nerf.events.intervals import Intervals, intervals, split
from pixelid.nerf.events.quiet import LONG, quiet_intervals
from pixelid.nerf.events.stretches import NOISE
from pixelid.nerf.options import Options
from pixelid.nerf.pixel.maps import PixelMaps, find_hot, maps_of_circuit, rate_of_hot
from pixelid.nerf.training.state import Problem
from pixelid.stages.circuit import Circuit

# Times the crossing time of the box's image as a whole: where a camera hardly moves, events come from a pixel that lags
# or leaks, and each tells its own time.
MOST_UNEVEN = 10.0
FASTEST = 0.01  # share of the events at which the image may move faster than the past of the pixel is sampled for
HELD_OUT = 0.03  # share of pixels whose events are kept from training


def problem_of(
    dataset: Dataset,
    calibration: Calibration | None = None,
    *,
    options: Options | None = None,
    trained: Sequence[str] = (),
    maps: PixelMaps | None = None,
    held_out: float = HELD_OUT,
    cells: int = 0,
    close: float = CLOSE_PIXELS,
) -> Problem:
    """The problem of a dataset under its own calibration or another one (a fit's).

    A dead time longer than intervals between events is shortened to them.

    Args:
        dataset: as read.
        calibration: of the camera and its pixel; the dataset's own by default.
        options: background, scale, box, near and seed count here.
        trained: of the pixel, what is trained with the scene (`Bandwidth.moving`).
        maps: how single pixels depart from the circuit; by default unknown to its mismatch.
        held_out: share of the pixels that training does not see.
        cells: of the field per side in the end; 0 where they are smaller than pixels.
        close: events are merged while the image moves by less than that, in pixels or in cells, whichever are larger.

    Returns:
        What training works on.

    Raises:
        InputError: no pixel has two events, or the box has no inside.
    """
    calibration = dataset.calibration if calibration is None else calibration
    options = Options() if options is None else options
    camera, gauge = calibration.camera, gauge_of(dataset, options.background, options.scale)
    if options.box is None:
        low, high = scene_box(dataset.trajectory, camera.half_angle)
    else:
        low, high = np.array(options.box).reshape(2, 3)
    if not (high > low).all():
        raise InputError(f"--box: expected low corner below high corner, found {[*low.tolist(), *high.tolist()]}")
    circuit = calibration.circuit
    maps = maps_of_circuit(circuit, camera.width * camera.height) if maps is None else maps
    t, x, y, on = dataset.t, dataset.x, dataset.y, dataset.on
    duration_s = float(t[-1] - t[0])
    hot = np.union1d(maps.hot, find_hot(x, y, on, camera, circuit, duration_s, calibration.kept))
    if len(hot):
        hot_hz = rate_of_hot(hot, x, y, camera, duration_s, calibration.kept)
        is_hot = np.zeros(camera.width * camera.height, bool)
        is_hot[hot] = True
        kept = ~is_hot[y * camera.width + x]
        maps, (t, x, y, on) = replace(maps, hot=hot, hot_hz=hot_hz), (column[kept] for column in (t, x, y, on))
    lengths = interval_lengths(t, y * camera.width + x)
    # Share of intervals shorter than the dead time that stamps and noise may make; where more are, the pixel is
    # faster than told, and the dead time is that short.
    too_short = 1e-3
    if len(lengths) and (possible := float(np.quantile(lengths, too_short))) < circuit.refractory:
        circuit = circuit.with_(refractory=possible)
    least_s = float(lengths.min()) if len(lengths) else 0.0
    del lengths  # as large as the times
    size = float((high - low).max()) / cells if cells else 0.0
    crossed_s = crossing_time(dataset.trajectory, camera, low, high)
    shortest = crossing_times(
        dataset.trajectory, camera, low, high, t, y * camera.width + x, cell=size, within=crossed_s,
        most=MOST_UNEVEN * crossed_s, near=options.near,
    )  # fmt: skip
    fastest_s = float(np.quantile(shortest[:: max(len(shortest) // 100_000, 1)], FASTEST)) if len(shortest) else 0.0
    shortest *= np.float32(close)  # in place: four bytes for each of all events

    def cut(of: Circuit) -> Intervals:
        return intervals(
            t, x, y, on, camera.width, dead=of.refractory, lag=1 / of.differencing, shortest=shortest,
            noise=math.hypot(of.noise, of.mismatch) or NOISE, drift=of.threshold_drift, memory=of.polarity_memory,
        )  # fmt: skip

    every = cut(circuit)
    if len(every.starts) == 0:
        raise InputError(f"{dataset.path}: raw_events.npz: timestamp: no pixel has two events, nothing to learn from")
    training, held = split(every, held_out, np.random.default_rng([options.seed, 77]))
    if len(training.starts) == 0:
        training, held = every, every.of(np.zeros(len(every.starts), bool))
    held_pixels = np.unique(held.stretches.pixel[held.starts])
    quiet = quiet_intervals(
        t, y * camera.width + x, camera.width, camera.height, least=LONG * close * crossed_s, dead=circuit.refractory,
        left_out=np.union1d(hot, held_pixels), kept=calibration.kept,
    )  # fmt: skip
    row, column = np.divmod(np.arange(camera.width * camera.height), camera.width)
    return Problem(
        training, held, dataset.trajectory, camera, calibration.channel_of(column, row), calibration.dark,
        circuit, gauge, low, high, maps, tilts(cut, circuit, trained),
        least_s, quiet, options.near, fastest_s,
    )  # fmt: skip


def interval_lengths(t: np.ndarray, pixel: np.ndarray) -> np.ndarray:
    """Seconds between every two events (N,) of one pixel that follow each other."""
    order = np.argsort(pixel, kind="stable")
    t, pixel = t[order], pixel[order]
    return np.diff(t)[pixel[1:] == pixel[:-1]]
