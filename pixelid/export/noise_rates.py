"""Rates of noise events under constant light, for simulators that take them as parameters: the circuit simulated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pixelid.model.model import Model
from pixelid.stages.differencing import leaked

SIDE = 8  # pixels across
DURATION_S = 10.0  # 640 pixel·seconds: a rate of 1 Hz to 4 %, and one event at 1.6 mHz
DRIFTS = ("leak", "parasitic_photocurrent", "threshold_drift", "mains_flicker", "hot_pixels", "timestamp_jitter",
          "timestamp_quantisation", "readout_latency")  # fmt: skip


@dataclass(frozen=True)
class NoiseRates:
    """Noise events per pixel and second;  pixel_seconds: simulated, 0 where there was nothing to simulate."""

    on_hz: float
    off_hz: float
    pixel_seconds: float

    @property
    def hz(self) -> float:
        """Of both polarities."""
        return self.on_hz + self.off_hz

    @property
    def words(self) -> str:
        """Where the rates come from."""
        if self.pixel_seconds == 0:
            return "no shot noise in the model"
        return f"counted over {self.pixel_seconds:g} pixel·s of constant light simulated by pixelid"


def shot_noise_rates(model: Model, radiance: float, seed: int) -> NoiseRates:
    """Of shot noise alone, what drifts left out."""
    if not model.has("shot_noise"):
        return NoiseRates(0.0, 0.0, 0.0)
    from pixelid.simulate.simulator import simulate
    from pixelid.stimuli.stimulus import Stimulus

    still = model
    for name in DRIFTS:
        still = still.without_effect(name)
    light = Stimulus.from_arrays(np.linspace(0.0, DURATION_S, 101), np.full(101, radiance), "relative")
    events = simulate(still, light, width=SIDE, height=SIDE, seed=seed).events
    seconds = SIDE * SIDE * DURATION_S
    on = float(np.count_nonzero(events.p == 1)) / seconds
    return NoiseRates(on, float(len(events)) / seconds - on, seconds)


def leak_rate(model: Model, radiance: float) -> float:
    """ON events per second of the drift under constant light, steady part and the part of the light."""
    circuit = model.circuit()
    return float(leaked(circuit, 1.0, radiance + circuit.dark))
