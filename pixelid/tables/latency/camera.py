"""A camera as latencies know it: a circuit in W/m², thresholds and delays per setting, and what the set-up adds.

In a model file this is the model and a table `[latency]` next to it, which other commands pass over:

    [latency]            camera, led_off_fraction, delay_sigma, edge_jitter_s, relative_scatter
    [latency.lens]       lens → how much of the stated irradiance reaches a pixel, relative to the first
    [[latency.setting]]  name, bias_on, bias_off, on_threshold, off_threshold, on_delay_s, off_delay_s
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from pixelid.documents import is_number, read_toml
from pixelid.errors import InputError, shown
from pixelid.model.files import from_document, to_document
from pixelid.model.model import Model
from pixelid.stages.circuit import Circuit
from pixelid.tables.latency.reading import LatencyTable
from pixelid.tables.latency.settings import BEYOND, between
from pixelid.tables.latency.spread import Regions, Spread, statistics
from pixelid.tables.latency.steps import changes, noise_level

UNIT = "W/m2"  # as stimuli write it
OFF_FRACTION = 0.2  # of a light that is "off", where nobody says: lamps glow, rooms are lit; the prior of fits
SCATTER = 0.05  # of a table about its model, where no fit says: latencies of a region repeat within 1 to 13 %
DELAY_SIGMA = 0.2  # subthreshold currents of a Vth that varies by 5 to 10 mV


@dataclass(frozen=True)
class Setting:
    """One threshold setting: its name, biases (NaN where unknown), and what an ON and an OFF event wait for."""

    name: str
    bias_on: float
    bias_off: float
    on_threshold: float
    off_threshold: float
    on_delay_s: float
    off_delay_s: float

    def threshold(self, on: bool) -> float:
        """In log radiance."""
        return self.on_threshold if on else self.off_threshold

    def delay(self, on: bool) -> float:
        """From crossing to time stamp [s]."""
        return self.on_delay_s if on else self.off_delay_s

    def bias(self, on: bool) -> float:
        """Of the threshold that fires."""
        return self.bias_on if on else self.bias_off


@dataclass(frozen=True)
class Camera:
    """model: the circuit, radiance in W/m²;  lens: factor by name;  settings: as measured; the rest see `Spread`."""

    name: str
    model: Model
    settings: tuple[Setting, ...]
    lens: dict[str, float] = field(default_factory=dict)
    led_off_fraction: float = OFF_FRACTION
    delay_sigma: float = DELAY_SIGMA
    edge_jitter_s: float = 0.0
    relative_scatter: float = SCATTER

    def threshold_and_delay(self, setting: str, bias: float, on: bool) -> tuple[float, float]:
        """(threshold, delay) of a setting: as measured, or between the neighbours of its bias.

        Raises:
            InputError: for a setting that was not measured and whose bias is unknown.
        """
        for known in self.settings:
            same = math.isnan(bias) or math.isnan(known.bias(on)) or math.isclose(known.bias(on), bias, abs_tol=1e-9)
            if known.name == setting and same:
                return known.threshold(on), known.delay(on)
        if not self.settings:
            parameters = self.model.values
            return parameters["on_threshold" if on else "off_threshold"], max(parameters["delay_s"], 0.0)
        biases = {known.bias(on): known for known in self.settings if not math.isnan(known.bias(on))}
        if math.isnan(bias) or not biases:
            raise InputError(
                f"camera {self.name} has no setting {setting!r} and its bias is not known; it has "
                f"{', '.join(known.name for known in self.settings)}. Give bias_on and bias_off as columns"
            )
        reach = BEYOND * (max(biases) - min(biases))
        if len(biases) > 1 and not min(biases) - reach <= bias <= max(biases) + reach:
            raise InputError(
                f"setting {setting!r}: camera {self.name} was measured at biases {min(biases):g} … {max(biases):g}; "
                f"{bias:g} is too far from them to be extrapolated"
            )
        thresholds = {b: known.threshold(on) for b, known in biases.items()}
        delays = {b: known.delay(on) for b, known in biases.items()}
        return between(thresholds, bias, logarithmic=False), between(delays, bias, logarithmic=True)

    def predict(self, table: LatencyTable) -> dict[str, np.ndarray]:
        """Statistic → (rows,) seconds, of the table's irradiances, settings and edges.

        Raises:
            InputError: for a model whose radiance is not in W/m², and for a setting without a threshold.
        """
        if self.model.radiance_unit not in (UNIT, "W/m²"):
            found = self.model.radiance_unit
            raise InputError(f"model {self.model.name}: expected radiance in {UNIT}, as irradiances are, found {found}")
        pairs = [
            self.threshold_and_delay(str(setting), float(bias), bool(on))
            for setting, bias, on in zip(table.setting, table.bias, table.on, strict=True)
        ]
        threshold, delay = np.array(pairs).reshape(-1, 2).T
        factor = np.array([self.lens.get(str(lens), 1.0) for lens in table.lens])
        return predict(
            self.model.circuit(), self.led_off_fraction, Spread(*self._spread, self.edge_jitter_s),
            factor * table.irradiance, table.on, threshold, delay, table.pixels,
        )  # fmt: skip

    @property
    def _spread(self) -> tuple[float, float, float]:
        circuit = self.model.circuit()
        return circuit.mismatch, circuit.noise, self.delay_sigma


def predict(
    circuit: Circuit,
    off_fraction: float,
    spread: Spread,
    irradiance,
    on,
    threshold,
    delay,
    pixels,
    speed: np.ndarray | float = 1.0,
) -> dict[str, np.ndarray]:
    """Statistic → (rows,) seconds; the arguments behind `spread` are (rows,) arrays.

    irradiance: of the lit LED;  speed: factor of the photoreceptor's α after the step, scalar or (rows,)
    """
    factor = np.broadcast_to(speed, np.shape(irradiance))
    lights, step = np.unique(np.stack([irradiance, np.where(on, 1.0, 0.0), factor]), axis=1, return_inverse=True)
    step = step.ravel()
    bright, rises = lights[0], lights[1] == 1.0
    dim = off_fraction * bright
    before, after = np.where(rises, dim, bright), np.where(rises, bright, dim)
    # noise of the level at the reset, and of that at the crossing: half of either, since the new one builds up with
    # the response itself
    shot = np.sqrt(0.5 * (noise_level(circuit, before) ** 2 + noise_level(circuit, after, lights[2]) ** 2))
    regions = Regions(step, threshold, delay, shot[step], pixels)
    return statistics(changes(circuit, before, after, lights[2]), regions, spread)


def save_camera(camera: Camera, path: Path) -> None:
    """Write a model file with its `[latency]` table."""
    document = to_document(camera.model)
    document["latency"] = {
        "camera": camera.name,
        "led_off_fraction": camera.led_off_fraction,
        "delay_sigma": camera.delay_sigma,
        "edge_jitter_s": camera.edge_jitter_s,
        "relative_scatter": camera.relative_scatter,
        "lens": dict(camera.lens),
        "setting": [
            {key: value for key, value in vars(setting).items() if not isinstance(value, float) or math.isfinite(value)}
            for setting in camera.settings
        ],
    }
    Path(path).write_bytes(tomli_w.dumps(document).encode())


def load_camera(path: Path) -> Camera:
    """The camera of a model file; without a `[latency]` table it has the model's thresholds at every setting.

    Raises:
        InputError: naming file and key.
    """
    document = read_toml(path)
    try:
        model = from_document(document)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    table = document.get("latency", {})
    if not isinstance(table, dict):
        raise InputError(f"{path}: [latency]: expected a table, found {shown(table)}")
    defaults = {"led_off_fraction": OFF_FRACTION, "delay_sigma": DELAY_SIGMA, "edge_jitter_s": 0.0,
                "relative_scatter": SCATTER}  # fmt: skip
    numbers = {key: _number(table.get(key, default), path, key) for key, default in defaults.items()}
    lens = table.get("lens", {})
    settings = table.get("setting", [])
    if not isinstance(lens, dict) or not isinstance(settings, list):
        raise InputError(f"{path}: [latency]: expected a table 'lens' and a list of tables 'setting'")
    return Camera(
        str(table.get("camera", model.name)),
        model,
        tuple(_setting(entry, path) for entry in settings),
        {str(key): _number(value, path, f"lens.{key}") for key, value in lens.items()},
        **numbers,
    )


def load_cameras(path: Path) -> tuple[Camera, ...]:
    """The camera of a model file, or those of a result folder (its own model.toml, or one per folder in it)."""
    path = Path(path)
    if not path.is_dir():
        return (load_camera(path),)
    files = [path / "model.toml"] if (path / "model.toml").is_file() else sorted(path.glob("*/model.toml"))
    if not files:
        raise InputError(f"{path}: no model.toml in it; expected the result of a fit")
    return tuple(load_camera(file) for file in files)


def camera_for(cameras: Sequence[Camera], name: str, lenses: Sequence[str]) -> Camera:
    """The camera of a table's label, knowing all lenses that it was used with.

    A single camera replaces one that was never fitted.  The factor of a lens that it was not used with is that of
    the camera most like it.

    Raises:
        InputError: for a label that none of several cameras has.
    """
    found = [camera for camera in cameras if camera.name == name]
    if not found and len(cameras) > 1:
        raise InputError(f"no camera {name!r} in the model; it has {', '.join(camera.name for camera in cameras)}")
    camera = found[0] if found else cameras[0]
    factors = dict(camera.lens)
    for lens in lenses:
        others = [other for other in cameras if lens in other.lens]
        if lens not in factors and others:
            factors[lens] = min(others, key=lambda other: _unlikeness(other, camera)).lens[lens]
    return replace(camera, lens=factors)


def _unlikeness(a: Camera, b: Camera) -> float:
    """How far two cameras are apart: what each would predict for one light, in logs."""
    shared = {s.name for s in a.settings} & {s.name for s in b.settings}
    light = np.array([0.05])
    logs = []
    for camera in (a, b):
        settings = [s for s in camera.settings if s.name in shared] or list(camera.settings)
        threshold = np.array([s.on_threshold for s in settings])
        delay = np.array([s.on_delay_s for s in settings])
        size = np.ones(len(settings))
        spread = Spread(*camera._spread, 0.0)
        found = predict(
            camera.model.circuit(), camera.led_off_fraction, spread, light * size, size > 0, threshold, delay, size
        )
        logs.append(np.median(np.log(found["median"])))
    return abs(float(logs[0] - logs[1]))


def _setting(entry: Any, path: Path) -> Setting:
    keys = ("on_threshold", "off_threshold", "on_delay_s", "off_delay_s")
    if not isinstance(entry, dict) or not isinstance(entry.get("name"), str):
        raise InputError(f"{path}: [[latency.setting]]: expected a table with a name, found {shown(entry)}")
    for key in keys:
        if key not in entry:
            raise InputError(f"{path}: [[latency.setting]] {entry['name']}: {key} is missing")
    biases = [_number(entry[key], path, key) if key in entry else math.nan for key in ("bias_on", "bias_off")]
    return Setting(entry["name"], *biases, *(_number(entry[key], path, key, positive=True) for key in keys))


def _number(value: Any, path: Path, key: str, *, positive: bool = False) -> float:
    if not is_number(value) or not math.isfinite(value):
        raise InputError(f"{path}: [latency] {key}: expected a number, found {shown(value)}")
    if positive and not value > 0:
        raise InputError(f"{path}: [latency] {key}: expected a number above 0, found {value:g}")
    return float(value)
