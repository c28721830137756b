r"""v2e (Hu, Liu & Delbruck, CVPRW 2021, arXiv 2006.07722): options of `v2e.py`.

Read from github.com/SensorsINI/v2e at cac6384.  Images of DN = 0 … 255 grey levels; ln DN above DN 20 and a line
through 0 below it; a first-order low-pass of corner cutoff_hz × (DN + 20)/275, stepped from frame to frame;
thresholds of each pixel drawn once; a dead time that keeps the reference of the last event.
"""

from __future__ import annotations

import math

from pixelid.export.exported import Entry, Exported
from pixelid.export.lag import lag_of
from pixelid.export.light import GREY_LEVELS, Light
from pixelid.export.losses import losses
from pixelid.export.noise_rates import NoiseRates, leak_rate, noise_unexpressed, shot_noise_rates
from pixelid.model.model import Model
from pixelid.stages.circuit import Circuit

OFFSET = 20.0  # grey levels, added to those that set the corner; also the end of the linear part
SLOPE = math.log(OFFSET)  # there, of the logarithm's: the line goes through the origin
FALL = 0.75  # of the shot noise rate, from none to full light: the rate is × (1 − FALL (DN + OFFSET)/275)
DIM = 1.0  # grey level at which the noise of "the darkest parts" is taken: below it there is no light left
STEPS = 0.3  # of the corner's time constant: what one frame may be long before v2e warns

CARRIED = {
    "linear_log": "",
    "bandwidth_floor": "",
    "source_follower_pole": "merged into one pole with the photoreceptor: its part should not change with light.",
    "extra_pole": "merged into one pole with the photoreceptor: its part should not change with light.",
    "differencing_pole": "merged into one pole with the photoreceptor; it should delay each event after a reset.",
    "threshold_mismatch": "",
    "refractory_period": "silent for as long, but the reference stays that of the last event instead of being taken at "
    "the end, so that no contrast is lost; events due in the meantime come late, or in one frame.",
    "dead_time_without_reset": "",
    "leak": "",
    "parasitic_photocurrent": "a constant leak, as at the level; it should follow the light.",
    "shot_noise": "Poisson events at a rate that falls to a quarter from dark to white; ON and OFF do not alternate.",
}


def export(model: Model, light: Light) -> Exported:
    """The options of v2e for a circuit."""
    circuit = model.circuit()
    on, off = circuit.on_threshold, circuit.off_threshold
    noise = shot_noise_rates(model, DIM * light.per_grey)
    entries = (
        Entry("pos_thres", on, "ln", "on_threshold"),
        Entry("neg_thres", off, "ln", "off_threshold"),
        Entry("sigma_thres", circuit.mismatch * math.sqrt((on * on + off * off) / 2), "ln",
              "threshold_mismatch.sigma × rms of the two thresholds"),
        Entry("cutoff_hz", cutoff_hz(model, light), "Hz",
              "single-pole cutoff with the same delay as all stages together, at the level (0: no limit)"),
        Entry("leak_rate_hz", leak_rate(model, light.level), "Hz", "leak, and parasitic photocurrent at the level"),
        Entry("leak_jitter_fraction", 0.0, "", "the leak is a steady drift"),
        Entry("noise_rate_cov_decades", 0.0, "", "and the same in all pixels"),
        Entry("shot_noise_rate_hz", noise.hz / (1 - FALL * (DIM + OFFSET) / (GREY_LEVELS + OFFSET)), "Hz",
              f"ON and OFF noise events at one grey level: {noise.words}"),
        Entry("refractory_period", max(circuit.refractory, circuit.silent), "s", _dead_time(circuit)),
    )  # fmt: skip
    return Exported(
        "v2e", "v2e (github.com/SensorsINI/v2e at cac6384)", model.name, light, entries,
        tuple(_lost(model, light, noise)), tuple(_usage(model, light)),
    )  # fmt: skip


def lines(exported: Exported) -> list[str]:
    """Options, one a line."""
    from pixelid.export.exported import spelt

    return [f"--{entry.name}={spelt(entry.value)}" for entry in exported.entries]


def cutoff_hz(model: Model, light: Light) -> float:
    """v2e's cutoff: its corner at the level delays as long as the whole pixel does there; 0 for no limit."""
    circuit = model.circuit()
    delay = lag_of(circuit).total(light.level + circuit.dark)
    if delay == 0:
        return 0.0
    return (GREY_LEVELS + OFFSET) / (light.grey + OFFSET) / (2 * math.pi * delay)


def corner_hz(cutoff: float, grey: float) -> float:
    """The corner that v2e gives a pixel of so many grey levels."""
    return cutoff * (grey + OFFSET) / (GREY_LEVELS + OFFSET)


def _dead_time(circuit: Circuit) -> str:
    return "dead_time_without_reset.s" if circuit.silent > circuit.refractory else "refractory_s"


def _lost(model: Model, light: Light, noise: NoiseRates) -> list[str]:
    circuit, lag = model.circuit(), lag_of(model.circuit())
    carried = dict(CARRIED)
    floor = circuit.bandwidth_floor / light.per_grey
    if circuit.silent > circuit.refractory:
        carried["refractory_period"] = "the reference is taken at the event, not at the end of the reset."
    if circuit.bandwidth_floor and not math.isclose(floor, OFFSET, rel_tol=1e-3):
        carried["bandwidth_floor"] = f"always {OFFSET:g} grey levels; the model has {floor:.3g}."
    knee, slope = circuit.knee / light.per_grey, circuit.knee_slope
    if not (math.isclose(knee, OFFSET, rel_tol=1e-3) and math.isclose(slope, SLOPE, rel_tol=1e-3)):
        carried["linear_log"] = (
            f"always below {OFFSET:g} grey levels, by a line of slope {SLOPE:.4g} of the logarithm's; the model has "
            f"{knee:.3g} and {slope:.4g}."
        )
    sentences = []
    if lag.total(light.level) > 0:
        cutoff, grey = cutoff_hz(model, light), 0.1 * light.grey
        ours = 1 / (2 * math.pi * lag.total(grey * light.per_grey + circuit.dark))
        sentences.append(
            f"bandwidth away from the level: v2e's corner is {corner_hz(cutoff, grey):.4g} Hz at a tenth of it, where "
            f"the circuit is as late as a pole of {ours:.4g} Hz."
        )
        if model.photoreceptor == "second_order":
            sentences.append("the photoreceptor's second pole: v2e has one, so that steps neither start flat nor ring.")
    if not model.has("linear_log"):
        sentences.append(f"contrast below {OFFSET:g} grey levels: v2e takes light there as linear, not logarithmic.")
    sentences += losses(model, carried)
    if not math.isclose(circuit.on_threshold, circuit.off_threshold) and circuit.mismatch > 0:
        sentences.append("mismatch in proportion to each threshold: v2e has one standard deviation for both.")
    sentences += noise_unexpressed(model, noise)
    sentences.append(
        "time between frames: events of a frame are stamped at its end, or spread over it where a pixel has several."
    )
    return sentences


def _usage(model: Model, light: Light) -> list[str]:
    said = [
        "v2e.py $(grep -v '^#' FILE) …, without --dvs_params, which replaces these values.",
        f"grey level of a frame = 255 × radiance / {light.white:g}; use frames of floating point or --hdr where 8 bits "
        "are too coarse for the thresholds.",
    ]
    cutoff = cutoff_hz(model, light)
    if cutoff > 0:
        said.append(
            f"frames at most {STEPS / (2 * math.pi * cutoff):.2g} s apart (0.3 of the time constant at white), or the "
            "low-pass is wrong."
        )
    return said
