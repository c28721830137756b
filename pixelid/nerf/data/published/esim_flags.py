"""The file of flags that the improved ESIM of Deblur e-NeRF ran with: thresholds and circuit in units of intensity.

Flags as of github.com/wengflow/rpg_esim at 839166d, with that program's defaults for what a file leaves out.  Its leak
is of ON thresholds per second, and its sigmas are those of each pixel's own thresholds, drawn once.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from pixelid.documents import read_text
from pixelid.errors import InputError

DEFAULTS = {
    "contrast_threshold_pos": 1.0, "contrast_threshold_neg": 1.0, "contrast_threshold_sigma_pos": 0.021,
    "contrast_threshold_sigma_neg": 0.021, "refractory_period_ns": 0.0, "leak_rate_hz": 0.0,
    "I_p_to_intensity_ratio_fa": math.inf, "dark_current_fa": 0.0, "amplifier_gain": math.inf, "back_gate_coeff": 0.7,
    "thermal_voltage_mv": 25.0, "photodiode_cap_ff": 0.0, "miller_cap_ff": 0.0, "output_time_const_us": 0.0,
    "lower_cutoff_freq_hz": 0.0, "sf_cutoff_freq_hz": math.inf, "diff_amp_cutoff_freq_hz": math.inf, "log_eps": 1e-3,
    "blender_interm_color_space": 0.0,
}  # fmt: skip
ABOVE_0 = (
    "contrast_threshold_pos", "contrast_threshold_neg", "I_p_to_intensity_ratio_fa", "amplifier_gain",
    "back_gate_coeff", "sf_cutoff_freq_hz", "diff_amp_cutoff_freq_hz",
)  # fmt: skip
SWITCHES = {"simulate_color_events": False, "use_log_image": True}
ON_WORDS, OFF_WORDS = ("1", "t", "true", "y", "yes"), ("0", "f", "false", "n", "no")  # as gflags reads them
CIRCUIT = (
    "I_p_to_intensity_ratio_fa", "photodiode_cap_ff", "lower_cutoff_freq_hz", "sf_cutoff_freq_hz",
    "diff_amp_cutoff_freq_hz",
)  # fmt: skip
COLOUR_SPACES = ("display", "linear")


def read_flags(file: Path) -> dict[str, str]:
    """Flag → value of lines `--flag=value`, `--flag` (true) and, of `SWITCHES`, `--noflag` (false); the last counts.

    Raises:
        InputError: the file cannot be read.
    """
    flags = {}
    for line in read_text(file, "CSV").splitlines():
        words = line.strip()
        if words.startswith("-"):
            name, is_given, value = words.lstrip("-").partition("=")
            name, value = name.strip(), value.strip().strip("\"'")
            if name.removeprefix("no") in SWITCHES and name not in SWITCHES:
                flags[name.removeprefix("no")] = "false"
            else:
                flags[name] = value if is_given else "true"
    return flags


def pixel_of(file: Path, flags: dict[str, str]) -> dict[str, Any]:
    """The keys of `camera_calibration.npz` that flags state: those of the circuit only where the file has any of them.

    Raises:
        InputError: a flag that is no number, or events of images that are not turned into logarithms.
    """
    if not _switch(file, flags, "use_log_image"):
        raise InputError(
            f"{file}: --use_log_image: expected true, found {flags['use_log_image']!r}: events of changes of the "
            "images' values themselves, where a pixel takes their logarithm"
        )
    colour = _switch(file, flags, "simulate_color_events")
    value = {name: _number(file, flags, name) for name in DEFAULTS}
    pixel: dict[str, Any] = {
        "pos_contrast_threshold": value["contrast_threshold_pos"],
        "neg_contrast_threshold": value["contrast_threshold_neg"],
        "refractory_period": value["refractory_period_ns"],
        "bayer_pattern": "RGGB" if colour else "",
    }
    if not set(CIRCUIT) & set(flags):
        return pixel
    ratio = value["I_p_to_intensity_ratio_fa"]
    ff_mv = 1e-3  # fF · mV in fA · s: 1e-15 F · 1e-3 V = 1e-18 C
    charge = ff_mv * value["thermal_voltage_mv"]
    return pixel | {
        "input_time_const_eff_it_prod": value["photodiode_cap_ff"] * charge / ratio,
        "miller_time_const_eff_it_prod": value["miller_cap_ff"] * charge / ratio,
        "black_level": np.full(3 if colour else 1, value["dark_current_fa"] / ratio),
        "amplifier_gain": value["amplifier_gain"],
        "closed_loop_gain": 1 / value["back_gate_coeff"],
        "output_time_const": 1e-6 * value["output_time_const_us"],
        "lower_cutoff_freq": value["lower_cutoff_freq_hz"],
        "sf_cutoff_freq": value["sf_cutoff_freq_hz"],
        "diff_amp_cutoff_freq": value["diff_amp_cutoff_freq_hz"],
    }


def renderer_of(file: Path, flags: dict[str, str]) -> dict[str, Any] | None:
    """The content of `renderer_params.npz`; None where the images were not rendered with a colour space."""
    blender = 4  # renderer_type whose images have a colour space
    if flags.get("renderer_type", str(blender)) != str(blender):
        return None
    space = _number(file, flags, "blender_interm_color_space")
    if space not in (0, 1):
        raise InputError(f"{file}: --blender_interm_color_space: expected 0 or 1, found {space:g}")
    return {"interm_color_space": COLOUR_SPACES[int(space)], "log_eps": _number(file, flags, "log_eps")}


def notes_of(file: Path, flags: dict[str, str]) -> tuple[str, ...]:
    """What acted in the simulator and has no place in `camera_calibration.npz`, with what a reconstruction can do.

    Raises:
        InputError: a flag that is no number.
    """
    names = ("contrast_threshold_sigma_pos", "contrast_threshold_sigma_neg")
    leak, *sigmas = (_number(file, flags, name) for name in ("leak_rate_hz", *names))
    notes = []
    if leak > 0:
        notes.append(
            f"leak of {leak:g} ON thresholds a second (--leak_rate_hz), which the dataset cannot say: pixelid "
            "reconstruct needs --train leak, --gap, or --fit with a model that has leak"
        )
    if any(sigmas):
        by_default = "" if set(names) <= set(flags) else " by default"
        notes.append(
            f"pixels differ{by_default} by {sigmas[0]:g} in their ON and {sigmas[1]:g} in their OFF thresholds "
            "(--contrast_threshold_sigma_pos, --contrast_threshold_sigma_neg), which the dataset cannot say: pixelid "
            "reconstruct needs --gap, or --fit with a model that has threshold_mismatch"
        )
    return tuple(notes)


def _switch(file: Path, flags: dict[str, str], name: str) -> bool:
    """A flag that is true or false."""
    word = flags.get(name, str(SWITCHES[name])).lower()
    if word not in (*ON_WORDS, *OFF_WORDS):
        raise InputError(f"{file}: --{name}: expected true or false, found {flags[name]!r}")
    return word in ON_WORDS


def _number(file: Path, flags: dict[str, str], name: str) -> float:
    """A flag in its range; infinite where that is the default, which leaves something out."""
    try:
        value = float(flags.get(name, DEFAULTS[name]))
    except ValueError:
        value = math.nan
    low, high = (value > 0 if name in ABOVE_0 else value >= 0), (value < math.inf or DEFAULTS[name] == math.inf)
    if not (low and high):
        wanted = f"{'above' if name in ABOVE_0 else 'of at least'} 0{'' if DEFAULTS[name] == math.inf else ', finite'}"
        raise InputError(f"{file}: --{name}: expected a number {wanted}, found {flags[name]!r}")
    return value
