"""A waveform to play to a camera: the light at a generator's rate, with the trigger edges that mark its ends.

    light       rest at the first value, then the stimulus, then rest at the last value
    trigger     low; rises at the stimulus's first sample (t = 0) and again at its last

`--align trigger` takes the first rise as the light's first sample and the second for the rate between the clocks.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pixelid.design.menu import Candidate, brightest_level, default_menu
from pixelid.documents import read_toml
from pixelid.errors import InputError, did_you_mean
from pixelid.lowlight.poles import exact, later_poles
from pixelid.lowlight.response import bandwidth_hz
from pixelid.model.model import Model
from pixelid.stimuli.files import load_stimulus, shape, shape_parameters
from pixelid.stimuli.shapes import MOST_SAMPLES, SHAPES
from pixelid.stimuli.stimulus import Stimulus

if TYPE_CHECKING:
    from jaxtyping import Bool, Float64

RATE_HZ = 48_000.0  # of any sound card
REST_S = 1.0  # before the light: the pixel must be at steady state at its first sample (docs/tutorial.md)
START_HZ = 3.0  # of a chirp; a tenth of its end where that is slower


@dataclass(frozen=True)
class Waveform:
    """Light for a generator.

    name: of the shape or file;  stimulus: the light, full-field, samples at the generator's rate, t = 0 at the first;
    rate_hz: samples per second;  rest_s: seconds at the first value before t = 0

    Example:
        >>> import pixelid as px
        >>> wave = px.stimulus("chirp", level=400, model="dvs128")
        >>> wave.save("chirp.wav")  # doctest: +SKIP
    """

    name: str
    stimulus: Stimulus
    rate_hz: float = RATE_HZ
    rest_s: float = REST_S

    @property
    def t(self) -> Float64[np.ndarray, " samples"]:
        """Seconds of every sample to play, t = 0 at the light's first."""
        before, after = self._rests
        return np.arange(-before, len(self.stimulus.t) + after) / self.rate_hz

    @property
    def light(self) -> Float64[np.ndarray, " samples"]:
        """What to play, in the stimulus's unit."""
        return np.pad(self.stimulus.radiance.astype(np.float64), self._rests, mode="edge")

    @property
    def trigger(self) -> Bool[np.ndarray, " samples"]:
        """Whether the trigger is high."""
        before, _ = self._rests
        pulse_s = 2e-3  # of the trigger: many ticks of any camera's clock, and short against any stimulus
        pulse = max(min(round(pulse_s * self.rate_hz), len(self.stimulus.t) // 2), 1)
        high = np.zeros(len(self.t), bool)
        for edge in (before, before + len(self.stimulus.t) - 1):
            high[edge : edge + pulse] = True
        return high

    @property
    def _rests(self) -> tuple[int, int]:
        """Samples before and after the light: one at least, for the trigger to rise from and to fall to."""
        tail_s = 0.05  # after the last sample, so that a player's end is not the light's
        return max(round(self.rest_s * self.rate_hz), 1), max(round(tail_s * self.rate_hz), 2)

    def save(self, path: str | Path, *, bits: int = 16, overwrite: bool = False) -> Path:
        """Write a .wav or .csv for a generator, and the light's expected trace next to it, NAME_light.csv.

        Args:
            path: ending in .wav (left: light, right: trigger) or .csv (t_s, light, trigger).
            bits: of a sample of a .wav, 16 or 24.
            overwrite: whether files of these names are replaced.

        Returns:
            The path of the expected trace.

        Raises:
            InputError: another ending, files that exist.
        """
        from pixelid.design.waveform_files import write

        return write(self, Path(path), bits=bits, overwrite=overwrite)

    def __repr__(self) -> str:
        return f"waveform {self.name}: {self.rest_s:g} s of rest, {self.stimulus!r}, {self.rate_hz:g} samples/s"


def waveform(
    source: str | Path,
    *,
    model: Model | None = None,
    parameters: Mapping[str, float] | None = None,
    rate_hz: float = RATE_HZ,
    rest_s: float = REST_S,
    unit: str | None = None,
) -> Waveform:
    """The waveform of a built-in shape, of an entry of a model's menu, of a stimulus file or of a design's folder.

    Args:
        source: name, .toml file, recording or table of light, or the folder of `pixelid design`.
        model: the circuit that a chirp is to reach the bandwidth of; its menu and its unit.
        parameters: of the shape, in place of its own.
        rate_hz: samples per second.
        rest_s: seconds at the first value before the light.
        unit: of the light, where the shape's numbers are in one.

    Raises:
        InputError: an unknown name or parameter, light of each pixel's own, a chirp too fast for the rate.
    """
    if not (1.0 <= rate_hz <= 1e9 and math.isfinite(rate_hz)):
        raise InputError(f"rate_hz: expected 1 to 1e9 samples per second, found {rate_hz:g}")
    if not 0.0 <= rest_s <= MOST_SAMPLES / rate_hz:
        raise InputError(f"rest_s: expected 0 to {MOST_SAMPLES / rate_hz:g} s, found {rest_s:g}")
    name, kind, own = _look_up(source, model)
    asked = dict(parameters or {})
    if kind is None:
        if asked:
            raise InputError(f"{source}: its light is sampled; only built-in shapes have a {next(iter(asked))}")
        light = load_stimulus(source)
    else:
        light = shape(kind, _completed(kind, own, asked, model, rate_hz))
    if not isinstance(light, Stimulus) or not light.full_field:
        raise InputError(f"{name}: expected full-field light, found light that differs from pixel to pixel")
    if unit is None and model is not None and kind is not None:
        unit = model.radiance_unit
    light = _sampled(light, rate_hz)
    if unit is not None:
        light = Stimulus.from_arrays(light.t, light.radiance, unit, light.interpolation, where=name)
    return Waveform(name, light, rate_hz, rest_s)


def top_frequency_hz(model: Model, level: float, rate_hz: float = RATE_HZ) -> float:
    """Where a chirp at this level should end: the pixel's −3 dB frequency there, in two digits, as the rate allows.

    A chirp that ends far below it says nothing of the poles; far above it the pixel no longer follows and is silent.
    """
    circuit = model.circuit()
    poles = exact(circuit, level, "pixel") if circuit.photoreceptor != "unlimited" else later_poles(circuit)
    least_top_hz, most_top_hz = 1.0, 20_000.0  # of a chirp whose end a model chooses; LED drivers end above
    reached = bandwidth_hz(poles) if len(poles) else most_top_hz
    samples_per_period = 10  # of a chirp whose end a model chooses: the held samples then differ from a sine by 10 %
    highest = min(most_top_hz, rate_hz / samples_per_period)
    return float(f"{min(max(reached, least_top_hz), highest):.2g}")


def _look_up(source: str | Path, model: Model | None) -> tuple[str, str | None, dict[str, float]]:
    """(name, built-in kind or None, its parameters) of what was asked for."""
    text = str(source)
    if text in SHAPES:
        return text, text, {}
    path = Path(source)
    if path.is_dir() and (path / "next.toml").is_file():
        path = path / "next.toml"
    if path.suffix.lower() == ".toml" and path.is_file():
        table = read_toml(path).get("stimulus")
        if isinstance(table, dict) and table.get("kind") in SHAPES:
            own = {key: value for key, value in table.items() if key not in ("kind", "start_s")}
            return path.stem, str(table["kind"]), own
    menu: dict[str, Candidate] = {} if model is None else {entry.name: entry for entry in default_menu(model)}
    if text in menu:
        return text, menu[text].kind, menu[text].parameters
    if not path.exists():
        names = (*SHAPES, *menu)
        raise InputError(
            f"no stimulus {text!r}: expected a file, the folder of a design, or one of {', '.join(names)}"
            f"{did_you_mean(text, names)}"
        )
    return path.stem, None, {}


def _completed(
    kind: str, own: Mapping[str, float], asked: Mapping[str, float], model: Model | None, rate_hz: float
) -> dict[str, float]:
    """Parameters of a shape: those of its file, the model's for what neither says, those asked for."""
    known = shape_parameters(kind)
    values = {**own, **asked}
    if model is not None and "level" not in values and "level" in known:
        values["level"] = brightest_level(model)
    # Of the fastest part of a chirp; twice the Nyquist rate, where a converter's filter ends
    least_samples_per_period = 4
    if kind == "chirp":
        if model is not None and "stop_hz" not in asked and "stop_hz" not in own:
            values["stop_hz"] = top_frequency_hz(model, values["level"], rate_hz)
        stop = values.get("stop_hz", known["stop_hz"])
        if isinstance(stop, int | float) and stop > rate_hz / least_samples_per_period:
            most = rate_hz / least_samples_per_period
            raise InputError(f"top_hz: expected at most {most:g} Hz at {rate_hz:g} samples/s, found {stop:g}")
        if "start_hz" not in values and isinstance(stop, int | float) and stop <= 2 * START_HZ:
            values["start_hz"] = stop / 10
    if "dt" in known:
        values["dt"] = 1.0 / rate_hz
    return values


def _sampled(light: Stimulus, rate_hz: float) -> Stimulus:
    """The light at the generator's samples, t = 0 at its first; log radiance is linear between its own."""
    seconds = light.duration_s
    if seconds * rate_hz > MOST_SAMPLES:
        raise InputError(f"stimulus: {seconds:g} s at {rate_hz:g} samples/s are more than {MOST_SAMPLES} samples")
    t = np.arange(math.floor(seconds * rate_hz + 1e-6) + 1) / rate_hz
    if len(t) < 2:
        raise InputError(f"stimulus: {seconds:g} s are less than two samples at {rate_hz:g} samples/s")
    own = light.t - light.t[0]
    if light.interpolation == "previous":
        radiance = light.radiance[np.searchsorted(own, t * (1 + 1e-12), side="right") - 1]
    elif light.radiance.min() > 0:
        radiance = np.exp(np.interp(t, own, np.log(light.radiance)))
    else:
        radiance = np.interp(t, own, light.radiance)
    return replace(light, t=t, radiance=radiance)
