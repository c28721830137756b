r"""The improved ESIM of Deblur e-NeRF (Low & Lee, ECCV 2024): a file of flags.

Read from github.com/wengflow/rpg_esim at 839166d.  Images of intensity 0 … 1; photocurrent I = ratio ×
intensity + dark; second-order photoreceptor, first-order lower cutoff, follower and amplifier, a reset with
exponential return; thresholds of each pixel drawn once; a leak of the mean ON threshold.
Charges: Q = C V_T, so that q of 1 fA·s at 25 mV is 40 fF.
"""

from __future__ import annotations

import math

from pixelid.export.circuit_values import CircuitValues, circuit_values
from pixelid.export.exported import Entry, Exported, spelt
from pixelid.export.light import Light
from pixelid.export.losses import losses
from pixelid.export.noise_rates import leak_rate
from pixelid.model.model import Model

THERMAL_VOLTAGE_MV = 25.0

CARRIED = {
    "second_order_photoreceptor": "",
    "dark_current": "",
    "lower_cutoff": "",
    "source_follower_pole": "",
    "differencing_pole": "",
    "threshold_mismatch": "",
    "refractory_period": "",
    "leak": "",
    "parasitic_photocurrent": "a constant leak, as at the level; it should follow the light.",
}


def export(model: Model, light: Light) -> Exported:
    """The flags of the improved ESIM for a circuit."""
    circuit = model.circuit()
    values = circuit_values(model)
    # Of intensity, added to images that have no dark current: a black pixel must not be ln 0.  A 2500th of a grey
    # level.
    no_black = 1e-6
    entries = (
        Entry("contrast_threshold_pos", circuit.on_threshold, "ln", "on_threshold"),
        Entry("contrast_threshold_neg", circuit.off_threshold, "ln", "off_threshold"),
        Entry("contrast_threshold_sigma_pos", circuit.mismatch * circuit.on_threshold, "ln",
              "threshold_mismatch.sigma × on_threshold"),
        Entry("contrast_threshold_sigma_neg", circuit.mismatch * circuit.off_threshold, "ln",
              "threshold_mismatch.sigma × off_threshold"),
        Entry("refractory_period_ns", round(1e9 * circuit.refractory), "ns", "refractory_s"),
        Entry("leak_rate_hz", leak_rate(model, light.level), "Hz", "leak, and parasitic photocurrent at the level"),
        *_photoreceptor(model, light, values),
        *_cutoffs(model),
        Entry("use_log_image", 1, "", "images show radiance, not its logarithm"),
        Entry("log_eps", 0.0 if circuit.dark > 0 else no_black, "", "of intensity; keeps black pixels from ln 0"),
    )  # fmt: skip
    return Exported(
        "esim", "improved ESIM (github.com/wengflow/rpg_esim at 839166d)", model.name, light, entries,
        tuple(lost(model)), tuple(_usage(light, values)),
    )  # fmt: skip


def lines(exported: Exported) -> list[str]:
    """Flags, one a line; what is infinite is left to its default, which is that."""
    return [f"--{e.name}={spelt(e.value)}" for e in exported.entries if e.value != math.inf]


def lost(model: Model) -> list[str]:
    """What the improved ESIM, and the calibration of Deblur e-NeRF, cannot express."""
    return losses(model, CARRIED)


def charge_per_capacitance() -> float:
    """fA·s per fF."""
    return THERMAL_VOLTAGE_MV * 1e-3


def _photoreceptor(model: Model, light: Light, values: CircuitValues | None) -> tuple[Entry, ...]:
    """Without a bandwidth limit, of capacitances 0 as by default, only what makes the dark current."""
    dark = model.circuit().dark
    scale = 1.0 if values is None else values.physical.radiance_scale
    currents = (
        Entry("I_p_to_intensity_ratio_fa", scale * light.white, "fA", "photocurrent of a white pixel"),
        Entry("dark_current_fa", scale * dark, "fA", "dark_current.radiance"),
    )
    if values is None:
        return currents if dark > 0 else ()
    p, source = values.physical, f"by {values.chosen_by}"
    return (
        *currents,
        Entry("amplifier_gain", p.A_amp, "", source),
        Entry("back_gate_coeff", p.A_loop / p.A_amp, "", f"A_loop/A_amp, {source}"),
        Entry("thermal_voltage_mv", THERMAL_VOLTAGE_MV, "mV", "room temperature; only its product with C counts"),
        Entry("photodiode_cap_ff", p.q_in / charge_per_capacitance(), "fF", f"q_in/V_T, {source}"),
        Entry("miller_cap_ff", p.q_mil / charge_per_capacitance(), "fF", f"q_mil/V_T, {source}"),
        Entry("output_time_const_us", 1e6 * p.tau_out, "µs", source),
    )


def _cutoffs(model: Model) -> tuple[Entry, ...]:
    circuit = model.circuit()
    return (
        Entry("lower_cutoff_freq_hz", circuit.lower_cutoff / (2 * math.pi), "Hz", "lower_cutoff.cutoff_hz"),
        Entry("sf_cutoff_freq_hz", circuit.follower / (2 * math.pi), "Hz", "sf_cutoff_hz"),
        Entry("diff_amp_cutoff_freq_hz", circuit.differencing / (2 * math.pi), "Hz", "diff_cutoff_hz"),
    )


def _usage(light: Light, values: CircuitValues | None) -> list[str]:
    said = [
        "roslaunch esim_ros esim.launch config:=FILE, with the flags of a renderer and a trajectory added.",
        f"image intensity = radiance / {light.white:g} {light.unit}.",
        "frames close enough that the light is nearly linear in between: ESIM filters from frame to frame.",
    ]
    if values is not None:
        said.append(f"circuit values are chosen by {values.chosen_by}; every choice makes the same events.")
    return said
