"""Rates of noise events under constant light, for simulators that take them as parameters."""

from __future__ import annotations

from dataclasses import dataclass

from pixelid.errors import InputError
from pixelid.model.model import Model
from pixelid.stages.differencing import leaked


@dataclass(frozen=True)
class NoiseRates:
    """Noise events per pixel and second;  words: where the rates come from."""

    on_hz: float
    off_hz: float
    words: str

    @property
    def hz(self) -> float:
        """Of both polarities."""
        return self.on_hz + self.off_hz


def shot_noise_rates(model: Model, radiance: float) -> NoiseRates:
    """Of shot noise alone, without leak and drift: `docs/methods/noise.md`, averaged over the thresholds' mismatch.

    A lower cutoff, far below the band of the noise, is left out.  Noise through fewer than three poles has no rate;
    then both are 0, and the words say why.

    Args:
        model: the circuit.
        radiance: of the scene [the model's unit], without dark current.
    """
    if not model.has("shot_noise"):
        return NoiseRates(0.0, 0.0, "no shot noise in the model")
    from pixelid.tables.noise.first_passage import mean_rates

    circuit = model.circuit().with_(lower_cutoff=0.0, leak_hz=0.0, leak_hz_per_radiance=0.0)
    try:
        return NoiseRates(*mean_rates(circuit, radiance), f"of the circuit under constant light of {radiance:g}")
    except InputError as error:
        return NoiseRates(0.0, 0.0, str(error))


def noise_unexpressed(model: Model, noise: NoiseRates) -> list[str]:
    """What is stated of shot noise that makes no events."""
    if not model.has("shot_noise") or noise.hz > 0:
        return []
    return [f"shot noise: no events ({noise.words})."]


def leak_rate(model: Model, radiance: float) -> float:
    """ON events per second of the drift under constant light, steady part and the part of the light."""
    circuit = model.circuit()
    return float(leaked(circuit, 1.0, radiance + circuit.dark))
