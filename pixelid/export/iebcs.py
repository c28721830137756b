r"""IEBCS (Joubert et al., Frontiers in Neuroscience 2021): arguments of `DvsSensor.initCamera`.

Read from github.com/neuromorphicsystems/IEBCS at 8fdab5c.  Images V of radiometric values; ln(V + 1); a first-order
response of time constant 1000 tau/(V + 1) µs; every event late by lat ± jit µs; the reference taken ref µs after the
event's stamp; thresholds drawn independently for every event; background events of fixed periods that take the
reference too.

An interval on a ramp of slope m is C/m + lat + ref there, and C/m + 1/ωd + refractory_s here, where what delays the
light (follower, constant part of the photoreceptor) delays the reference as well.  So the first event's delay and the
intervals are both right with

    lat = delays of all stages that do not depend on light      ref = refractory_s − those before the amplifier
"""

from __future__ import annotations

import math

from pixelid.export.exported import Entry, Exported
from pixelid.export.lag import lag_of
from pixelid.export.light import Light
from pixelid.export.losses import losses
from pixelid.export.noise_rates import NoiseRates, leak_rate, noise_unexpressed, shot_noise_rates
from pixelid.model.model import Model
from pixelid.stages.circuit import Circuit

NEVER_HZ = 1e-6  # of background events: their period is 1e6/rate µs, so that 0 is an error; one in eleven days

CARRIED = {
    "dark_current": "",
    "source_follower_pole": "a constant delay instead of a pole: fast signals keep their contrast.",
    "extra_pole": "a constant delay instead of a pole: fast signals keep their contrast.",
    "differencing_pole": "a constant delay of each event instead of a pole.",
    "threshold_noise": "one standard deviation for ON and OFF; the simulator adds its effect on the time again.",
    "refractory_period": "",
    "leak": "events of a fixed period that reset the reference, instead of a drift that adds to the light's.",
    "parasitic_photocurrent": "events of a fixed period, as at the level, instead of a drift that follows the light.",
    "shot_noise": "events of fixed periods, ON and OFF for themselves, as at the level.",
    "timestamp_jitter": "moves the reference with the stamp.",
}  # fmt: skip


def export(model: Model, light: Light) -> Exported:
    """The arguments of IEBCS for a circuit."""
    circuit, lag = model.circuit(), lag_of(model.circuit())
    unit = image_unit(circuit, light)
    late = lag.photoreceptor + lag.follower
    noise = shot_noise_rates(model, light.level)
    rates = (leak_rate(model, light.level) + noise.on_hz, noise.off_hz)
    entries = (
        Entry("lat", 1e6 * (late + lag.differencing + max(circuit.delay, 0.0)), "µs",
              "γ/α + 1/ωsf + 1/ωd and delay_s: the delay that no light shortens"),
        Entry("jit", 1e6 * circuit.jitter, "µs", "timestamp_jitter.sigma_s"),
        Entry("ref", 1e6 * max(circuit.refractory - late, 0.0), "µs",
              "refractory_s less γ/α + 1/ωsf, by which the reference is late"),
        Entry("tau", tau_us(circuit, light), "µs", "the photoreceptor's delay that light shortens × (V + 1)/1000"),
        Entry("th_pos", circuit.on_threshold, "ln", "on_threshold"),
        Entry("th_neg", circuit.off_threshold, "ln", "off_threshold"),
        Entry("th_noise", circuit.noise * math.sqrt((circuit.on_threshold**2 + circuit.off_threshold**2) / 2), "ln",
              "threshold_sigma × rms of the two thresholds"),
        Entry("bgnp", max(rates[0], NEVER_HZ), "Hz", f"leak and shot noise, ON, at the level: {noise.words}"),
        Entry("bgnn", max(rates[1], NEVER_HZ), "Hz", "shot noise, OFF, at the level"),
    )  # fmt: skip
    return Exported(
        "iebcs", "IEBCS (github.com/neuromorphicsystems/IEBCS at 8fdab5c)", model.name, light, entries,
        tuple(_lost(model, light, late, noise)), tuple(_usage(unit, light)),
    )  # fmt: skip


def image_unit(circuit: Circuit, light: Light) -> float:
    """Radiance of an image value of 1: the dark current if there is one, since IEBCS adds 1 to every value."""
    return circuit.dark if circuit.dark > 0 else light.per_grey


def tau_us(circuit: Circuit, light: Light) -> float:
    """The time constant at V = 999, so that 1000 tau/(V + 1) is the photoreceptor's delay at the level."""
    lag = lag_of(circuit)
    value = light.level / image_unit(circuit, light)
    changing = lag.of_photoreceptor(light.level + circuit.dark) - lag.photoreceptor
    return 1e6 * changing * (value + 1.0) / 1000.0


def _lost(model: Model, light: Light, late: float, noise: NoiseRates) -> list[str]:
    circuit, sentences = model.circuit(), []
    carried = dict(CARRIED)
    if model.photoreceptor == "second_order":
        sentences.append(
            "the photoreceptor's second pole: its delay is right at every light, but steps neither start flat nor ring."
        )
    if model.photoreceptor == "unlimited":
        sentences.append("unlimited bandwidth: tau = 0 divides by zero in IEBCS; give it 1e-6 and no less.")
    if circuit.refractory + lag_of(circuit).differencing < 1e-6:
        sentences.append("delays below 1 µs: IEBCS counts whole µs, and loops without end where lat + ref are less.")
    if circuit.bandwidth_floor > 0:
        carried["bandwidth_floor"] = "the time constant is right at the level; IEBCS adds one image unit instead."
    if circuit.dark == 0:
        sentences.append("contrast near one image unit: IEBCS takes ln(V + 1), as a dark current of one unit.")
    if circuit.refractory < late:
        sentences.append(
            f"dead time: refractory_s of {circuit.refractory:.3g} s is shorter than the delay of {late:.3g} s that the "
            "reference should have; intervals are longer by the difference."
        )
    sentences += losses(model, carried)
    sentences += noise_unexpressed(model, noise)
    sentences.append(f"no background events: {NEVER_HZ:g} Hz stands for none, since a rate of 0 is an error.")
    return sentences


def _usage(unit: float, light: Light) -> list[str]:
    return [
        "DvsSensor(…).initCamera(x, y, **parameters), with the values of this file by name.",
        f"image value V = radiance / {unit:.6g} {light.unit}.",
        "one sensor is one pixel law: differences between pixels come from thresholds drawn for every event.",
    ]
