"""Measured numbers and the model's: of each recording, and of the model under the same light."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from pixelid.errors import InputError
from pixelid.lowlight import poles, radii
from pixelid.lowlight.measured import Measured, measure
from pixelid.lowlight.stimulus import Sweep, read_stimulus
from pixelid.model.model import Model
from pixelid.recordings.recording import Recording
from pixelid.stimuli.stimulus import Stimulus


def compare(
    recordings: Sequence[Recording], model: Model, seed: int, progress: Callable[[float], None] | None = None
) -> list[dict]:
    """One entry of lowlight.json's "measured" per recording; see docs/schemas/lowlight.json."""
    entries = []
    for i, recording in enumerate(recordings):
        entries.append(_entry(recording, model, seed))
        if progress is not None:
            progress((i + 1) / len(recordings))
    return entries


def _entry(recording: Recording, model: Model, seed: int) -> dict:
    entry: dict = {
        "recording": recording.name,
        "kind": "none",
        "quantity": None,
        "radiance": None,
        "value": None,
        "interval_95": None,
        "why": "",
        "events": len(recording.events),
        "pixels": len(np.unique(recording.events.pixel)),
        "model": None,
    }
    stimulus = recording.stimulus
    if stimulus is None:
        return entry | {"why": "no stimulus"}
    if recording.pooled:
        return entry | {"why": "pooled events: the number of pixels is unknown"}
    if stimulus.unit == "shape":
        return entry | {"why": "the light is known only in shape, not in radiance"}
    if not isinstance(stimulus, Stimulus) or not stimulus.full_field:
        return entry | {"why": "the light differs from pixel to pixel"}
    circuit = model.circuit()
    light = read_stimulus(replace(stimulus, radiance=stimulus.radiance + circuit.dark))
    if isinstance(light, str):
        return entry | {"why": light}
    light = replace(light, radiance=light.radiance - circuit.dark)
    thresholds = circuit.on_threshold, circuit.off_threshold, circuit.refractory + 1.0 / circuit.differencing
    estimate = measure(recording.events, light, *thresholds)
    entry |= {
        "kind": "sweep" if isinstance(light, Sweep) else "steps",
        "radiance": light.radiance,
        "quantity": estimate.quantity,
        "value": estimate.value,
        "interval_95": estimate.interval_95,
        "why": estimate.why,
        "curve": {"x": estimate.x, "y": estimate.y},
    }
    name = "bandwidth" if isinstance(light, Sweep) else "step_time"
    most_pixels = 64  # simulated beside a recording
    pixels = min(max(entry["pixels"], 1), most_pixels)
    same, one_pole = (_simulated(m, stimulus, pixels, seed, light, thresholds) for m in (model, _one_pole(model)))
    entry["model"] = {
        "same_light": same and same.value,
        "same_light_interval_95": same and same.interval_95,
        "same_light_one_pole": one_pole and one_pole.value,
        "small_signal": radii.quantity(name, poles.exact(circuit, light.radiance, "pixel")),
        "small_signal_one_pole": radii.quantity(name, poles.approximate(circuit, light.radiance, "pixel", "one_pole")),
    }
    if same is not None:
        entry["model"]["curve"] = {"x": same.x, "y": same.y}
    return entry


def _one_pole(model: Model) -> Model:
    return model.without_effect("second_order_photoreceptor")


def _simulated(model: Model, stimulus, pixels: int, seed: int, light, thresholds) -> Measured | None:
    """The same statistic of the model's own events, or None where the model cannot be simulated."""
    from pixelid.simulate import simulate

    try:
        events = simulate(model, stimulus, width=pixels, height=1, seed=seed).events
    except InputError:
        return None
    return measure(events, light, *thresholds)
