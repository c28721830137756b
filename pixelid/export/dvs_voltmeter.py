r"""DVS-Voltmeter (Lin et al., ECCV 2022): its six parameters k1 … k6.

Read from github.com/Lynn0306/DVS-Voltmeter at 9d86353.  Images of 0 … 255 grey levels L, times in µs.  Between frames
the voltage is a Brownian motion, in thresholds, with ON and OFF at ±1:

    drift  μ = k1 (ΔL/Δt)/(L + k2) + k4 + k5 L         [1/µs]
    spread σ = k3 √L/(L + k2) + k6                     [1/√µs]

From the circuit without bandwidth: d ln(L + L_dark)/dt over the threshold C gives k1 = 1/C and k2 = L_dark; the leak's
drift rate × C_on/C gives k4, and k5 where the leak follows the light.  Of a motion without drift between ±1 the mean
time to leave is 1/σ², so that noise events come at σ² a µs in all: k3 is set so that this is the circuit's rate at the
level.
One threshold for both polarities: with 1/C the mean of 1/C_on and 1/C_off, light that returns to where it was makes as
many events.
"""

from __future__ import annotations

import math

from pixelid.export.exported import Entry, Exported, spelt
from pixelid.export.light import Light
from pixelid.export.losses import losses
from pixelid.export.noise_rates import NoiseRates, leak_rate, noise_unexpressed, shot_noise_rates
from pixelid.model.model import Model

# Of σ, where the model has no noise: the simulator divides by σ².  A noise event in 12 days.
LEAST_SPREAD = 1e-6
PER_US = 1e-6

CARRIED = {
    "dark_current": "",
    "leak": "",
    "parasitic_photocurrent": "",
    "shot_noise": "a Brownian motion whose variance grows without end, not noise that the photoreceptor filters; its "
    "rate is right at the level only.",
}


def export(model: Model, light: Light) -> Exported:
    """k1 … k6 for a circuit."""
    circuit = model.circuit()
    threshold = mean_threshold(circuit.on_threshold, circuit.off_threshold)
    noise = shot_noise_rates(model, light.level)
    dark = circuit.dark / light.per_grey
    drift = PER_US * circuit.on_threshold / threshold
    k5 = drift * circuit.leak_hz_per_radiance * light.per_grey
    entries = (
        Entry("k1", 1.0 / threshold, "1/ln", "the mean of 1/on_threshold and 1/off_threshold"),
        Entry("k2", dark, "grey levels", "dark_current.radiance"),
        Entry("k3", math.sqrt(PER_US * noise.hz) * (light.grey + dark) / math.sqrt(light.grey), "√(grey level/µs)",
              f"noise events at the level, σ² = rate: {noise.words}"),
        Entry("k4", drift * (leak_rate(model, 0.0)), "1/µs", "leak, and parasitic photocurrent of the dark current"),
        Entry("k5", k5, "1/µs/grey level", "parasitic_photocurrent.rate_hz_per_radiance"),
        Entry("k6", LEAST_SPREAD, "1/√µs", "not 0, by which the simulator would divide"),
    )  # fmt: skip
    return Exported(
        "dvs-voltmeter", "DVS-Voltmeter (github.com/Lynn0306/DVS-Voltmeter at 9d86353)", model.name, light, entries,
        tuple(_lost(model, noise)), tuple(_usage(light, [e.value for e in entries])),
    )  # fmt: skip


def mean_threshold(on: float, off: float) -> float:
    """The one threshold that makes as many events of light that returns to where it was."""
    return 2.0 / (1.0 / on + 1.0 / off)


def lines(exported: Exported) -> list[str]:
    """The option that holds all six."""
    return ["--model_para " + " ".join(spelt(entry.value) for entry in exported.entries)]


def _lost(model: Model, noise: NoiseRates) -> list[str]:
    circuit, sentences = model.circuit(), []
    if model.photoreceptor != "unlimited":
        sentences.append(
            "bandwidth: the voltage follows the light at once; nothing is slower in the dark, and no latency depends "
            "on light except through noise."
        )
    if not math.isclose(circuit.on_threshold, circuit.off_threshold):
        sentences.append(
            f"unequal thresholds ({circuit.on_threshold:.4g} ON, {circuit.off_threshold:.4g} OFF): one stands for both."
        )
    sentences += losses(model, CARRIED)
    sentences += noise_unexpressed(model, noise)
    sentences.append(
        "the remainder of a crossing: between frames the motion is drawn from its end points, and stamps are whole µs."
    )
    return sentences


def _usage(light: Light, values: list[object]) -> list[str]:
    return [
        "python main.py $(grep -v '^#' FILE) …, or cfg.SENSOR.K = [k1, …, k6].",
        f"grey level of a frame = 255 × radiance / {light.white:g}.",
    ]
