"""What differs from pixel to pixel: thresholds and bandwidth of a mapped sensor, and pixels that are hot.

Without a map a pixel's thresholds are known to the camera's mismatch only.  They are then trained with the scene, each
under that prior: a pixel whose ON threshold is 10 % too low implies a light that brightens on and on, and a scene
that has to explain it is blurred and full of grain.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pixelid import stages
from pixelid.errors import InputError
from pixelid.inspection.hot_pixels import ROBUST_SIGMAS, hot_of_counts, median_around
from pixelid.model.model import Model
from pixelid.nerf.data.camera import Camera
from pixelid.nerf.effects.ignored import NO_EFFECTS, acting_fields
from pixelid.stages.circuit import Circuit
from pixelid.statistics import SD_PER_MEDIAN

# Maps that act on a number of `Dynamics`, by its position there.  One pole: α scales its corner (`Dynamics.low_light`).
COLUMNS = {
    "alpha": 0, "alpha_over_beta": 0, "beta": 1, "gamma": 2, "sf_cutoff_hz": 3, "extra_pole.cutoff_hz": 4,
    "diff_cutoff_hz": 6,
}  # fmt: skip
THRESHOLDS = ("on_threshold", "off_threshold")

# Hot by ON events that no OFF events answer: 6 robust standard deviations of neighbours' differences, as for rates
# (`inspection.hot_pixels`), and 6 more of what a 10 % mismatch, twice a usual sensor's, does to a pixel's counts.
MISMATCH = 0.1


@dataclass(frozen=True)
class PixelMaps:
    """Departures of the pixels from their circuit, pixels in row-major order.

    threshold: (pixels, 2) expected ln of a pixel's ON and OFF threshold over the circuit's;  threshold_sd: (pixels, 2)
    its uncertainty, 0 where it is known;  bandwidth: (pixels, 8) factors of the numbers of `Dynamics`, None where all
    are alike;  filters: names of the maps in it;  unused: of those that have no place in a reconstruction, and effects
    of their model that the circuit lacks;  hot: (k,) pixels left out;  hot_hz: mean rate of their events beyond those
    of the pixels about them
    """

    threshold: np.ndarray
    threshold_sd: np.ndarray
    bandwidth: np.ndarray | None = None
    hot: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    unused: tuple[str, ...] = ()
    hot_hz: float = 0.0
    filters: tuple[str, ...] = ()


def maps_of_circuit(circuit: Circuit, pixels: int) -> PixelMaps:
    """Thresholds unknown to the circuit's mismatch, everything else alike."""
    return PixelMaps(np.zeros((pixels, 2)), np.full((pixels, 2), float(circuit.mismatch)))


def maps_of_sensor(folder: Path, circuit: Circuit, camera: Camera) -> PixelMaps:
    """The maps of `pixelid sensor`.

    Args:
        folder: that it wrote.
        circuit: in use; its thresholds are what the map's are taken relative to.
        camera: of the dataset.

    Returns:
        Thresholds with what the map leaves uncertain; bandwidth relative to the model of the map, since the radiance
        units may differ; pixels that fired far more than others under the map's light; by name, maps of what the
        circuit does not have, and effects without a map that the map's model has and the circuit has not.

    Raises:
        InputError: no maps there, or of another sensor size.
    """
    from pixelid.sensors import SensorFit

    fitted = SensorFit.load(folder)
    shape = camera.height, camera.width
    if fitted.events.shape != shape:
        height, width = fitted.events.shape
        raise InputError(
            f"{Path(folder) / SensorFit.FILE}: width, height: expected {camera.width} × {camera.height} as in the "
            f"dataset, found {width} × {height}"
        )
    nominal = circuit.on_threshold, circuit.off_threshold
    known = maps_of_circuit(circuit, camera.width * camera.height)
    mean, sd = known.threshold.copy(), known.threshold_sd.copy()
    bandwidth, unused, filters = np.ones((len(mean), 8)), [], []
    for name, of_map in fitted.maps.items():
        if name in THRESHOLDS:
            k = THRESHOLDS.index(name)
            log, error = of_map.log.ravel(), of_map.sd.ravel()
            told = np.isfinite(log) & np.isfinite(error)
            mean[told, k], sd[told, k] = log[told] - np.log(nominal[k]), error[told]
        elif name in COLUMNS and name in fitted.model.values and _has(circuit, COLUMNS[name]):
            factor = np.exp(of_map.log - np.log(fitted.model.values[name]))
            whole = np.repeat(np.repeat(factor, fitted.block, axis=0), fitted.block, axis=1)[: shape[0], : shape[1]]
            bandwidth[:, COLUMNS[name]] = np.where(np.isfinite(whole), whole, 1.0).ravel()
            filters.append(f"map of {name}")
        else:
            unused.append(f"map of {name}")
    unused += [f"{name} of the maps' model" for name in _lacking(circuit, fitted.model, [*fitted.maps])]
    hot = np.array([p.y * camera.width + p.x for p in hot_of_counts(fitted.events, 1.0)], np.int64)
    alike = (bandwidth == 1.0).all()
    return PixelMaps(mean, sd, None if alike else bandwidth, hot, tuple(unused), filters=tuple(filters))


def _lacking(circuit: Circuit, model: Model, mapped: Sequence[str]) -> list[str]:
    """Effects that act in a model and not in a circuit, but for those that maps hold: of pixels that are hot, and of
    thresholds that differ where these are mapped."""
    held, names = {*NO_EFFECTS, "hot_count", "hot_hz"}, []
    if set(THRESHOLDS) & {*mapped}:
        held.add("mismatch")
    for name in model.effects:
        effect = stages.effect(name)
        if {parameter.name for parameter in effect.parameters} & {*mapped}:
            continue
        acting = acting_fields(effect.apply(Circuit(), model.values)) - held
        if acting and not acting & acting_fields(circuit):
            names.append(name)
    return names


def _has(circuit: Circuit, column: int) -> bool:
    """Whether a number of `Dynamics` is of a stage that the circuit has; of one pole α alone scales its corner."""
    cutoffs = {3: circuit.follower, 4: circuit.extra_pole, 6: circuit.differencing}
    if column in cutoffs:
        return math.isfinite(cutoffs[column])
    return circuit.photoreceptor == "second_order" or (circuit.photoreceptor == "one_pole" and column == 0)


def rate_of_hot(hot: np.ndarray, x, y, camera: Camera, duration_s: float, kept: np.ndarray | None = None) -> float:
    """Events per second of pixels (k,) beyond those of the pixels about them, mean; arguments as of `find_hot`."""
    counts = np.bincount(y * camera.width + x, minlength=camera.width * camera.height).astype(float)
    beyond = counts - median_around(counts.reshape(camera.height, camera.width), kept)
    return float(beyond[hot].mean()) / duration_s if duration_s > 0 else 0.0


def find_hot(
    x, y, on, camera: Camera, circuit: Circuit, duration_s: float, kept: np.ndarray | None = None
) -> np.ndarray:
    """(k,) pixels whose events no light explains: far more of them than around, or ON without OFF.

    x, y, on: (N,) of all events;  kept: (pixels,) bool, whose events these are, None for all.  Light that goes up
    comes down, and neighbours see the same: a pixel's ON thresholds less its OFF thresholds are those of the pixels
    about it, but for mismatch.
    """
    pixel, pixels = y * camera.width + x, camera.width * camera.height
    up, down = (np.bincount(pixel[some], minlength=pixels).astype(float) for some in (on, ~on))
    image = (up + down).reshape(camera.height, camera.width)
    fast = np.array([p.y * camera.width + p.x for p in hot_of_counts(image, duration_s, kept)], np.int64)
    mean = 0.5 * (circuit.on_threshold + circuit.off_threshold)
    net = (up * circuit.on_threshold - down * circuit.off_threshold) / mean
    beyond = net - median_around(net.reshape(image.shape), kept)
    seen = (up + down) > 0
    spread = SD_PER_MEDIAN * float(np.median(np.abs(beyond[seen]))) if seen.any() else 0.0
    allowed = ROBUST_SIGMAS * (max(spread, 1.0) + max(MISMATCH, circuit.mismatch) * np.hypot(up, down))
    return np.union1d(fast, np.flatnonzero(beyond > allowed))
