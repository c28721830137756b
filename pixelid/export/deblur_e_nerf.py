r"""Deblur e-NeRF (Low & Lee, ECCV 2024): what `camera_calibration.npz` says of the pixel.

Read from github.com/wengflow/deblur-e-nerf at 0925cb1.  Intensity 0 … 1 of rendered views; time constants ×
intensity in seconds, so that q [fA·s] is divided by the
photocurrent of intensity 1; closed-loop gain A_amp/A_loop; dead time in ns.
"""

from __future__ import annotations

import math

from pixelid.export.circuit_values import circuit_values
from pixelid.export.esim import lost
from pixelid.export.exported import Entry, Exported
from pixelid.export.light import Light
from pixelid.export.losses import known_as
from pixelid.model.model import Model

ALL_CHANGE = "the reconstruction takes all change for a change of the light."
OTHERWISE = {  # lost in another way than by ESIM
    "threshold_mismatch": "one ON and one OFF threshold for all pixels.",
    "leak": ALL_CHANGE,
    "parasitic_photocurrent": ALL_CHANGE,
    "lower_cutoff": "the file has it, and the pixel model of the reconstruction leaves it out.",
}


def export(model: Model, light: Light) -> Exported:
    """The pixel's part of the calibration for a circuit."""
    circuit = model.circuit()
    values = circuit_values(model)
    ratio = math.inf if values is None else values.physical.radiance_scale * light.white
    q_in, q_mil, gain, closed, tau_out = 0.0, 0.0, math.inf, 1.0, 0.0
    source = "no bandwidth limit"
    if values is not None:
        p, source = values.physical, f"by {values.chosen_by}"
        q_in, q_mil, gain, closed, tau_out = p.q_in / ratio, p.q_mil / ratio, p.A_amp, p.A_amp / p.A_loop, p.tau_out
    entries = (
        Entry("pos_contrast_threshold", circuit.on_threshold, "ln", "on_threshold"),
        Entry("neg_contrast_threshold", circuit.off_threshold, "ln", "off_threshold"),
        Entry("refractory_period", round(1e9 * circuit.refractory), "ns", "refractory_s"),
        Entry("input_time_const_eff_it_prod", q_in, "s × intensity", f"q_in over white, {source}"),
        Entry("miller_time_const_eff_it_prod", q_mil, "s × intensity", f"q_mil over white, {source}"),
        Entry("black_level", circuit.dark / light.white, "intensity", "dark_current.radiance over white"),
        Entry("amplifier_gain", gain, "", f"A_amp, {source}"),
        Entry("closed_loop_gain", closed, "", f"A_amp/A_loop, {source}"),
        Entry("output_time_const", tau_out, "s", f"tau_out, {source}"),
        Entry("lower_cutoff_freq", circuit.lower_cutoff / (2 * math.pi), "Hz", "lower_cutoff.cutoff_hz"),
        Entry("sf_cutoff_freq", circuit.follower / (2 * math.pi), "Hz", "sf_cutoff_hz"),
        Entry("diff_amp_cutoff_freq", circuit.differencing / (2 * math.pi), "Hz", "diff_cutoff_hz"),
    )
    return Exported(
        "deblur-e-nerf", "Deblur e-NeRF (github.com/wengflow/deblur-e-nerf at 0925cb1)", model.name, light, entries,
        tuple(_lost(model)), tuple(_usage(light)),
    )  # fmt: skip


def _lost(model: Model) -> list[str]:
    told = {name: OTHERWISE[known] for name, known in known_as(model).items() if known in OTHERWISE}
    sentences = [sentence for sentence in lost(model) if not sentence.startswith(tuple(told))]
    sentences += [f"{name}: {words}" for name, words in told.items()]
    if model.photoreceptor != "second_order":
        sentences.append(
            f"a {model.photoreceptor.replace('_', '-')} photoreceptor: the reconstruction divides by tau_out, "
            "so that it wants a small positive one."
        )
    return sentences


def _usage(light: Light) -> list[str]:
    return [
        "copy these arrays into the dataset's camera_calibration.npz, with its geometry (intrinsics, "
        "distortion_params, distortion_model, img_height, img_width, bayer_pattern), which a circuit does not have.",
        f"intensity of a view = radiance / {light.white:g} {light.unit}.",
    ]
