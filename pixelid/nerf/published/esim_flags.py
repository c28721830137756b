"""The file of flags that the improved ESIM of Deblur e-NeRF ran with: thresholds and circuit in units of intensity.

Flags as of github.com/wengflow/rpg_esim at 839166d, with that program's defaults for what a file leaves out.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from pixelid.documents import read_text
from pixelid.errors import InputError

DEFAULTS = {
    "contrast_threshold_pos": 1.0, "contrast_threshold_neg": 1.0, "refractory_period_ns": 0.0,
    "I_p_to_intensity_ratio_fa": math.inf, "dark_current_fa": 0.0, "amplifier_gain": math.inf, "back_gate_coeff": 0.7,
    "thermal_voltage_mv": 25.0, "photodiode_cap_ff": 0.0, "miller_cap_ff": 0.0, "output_time_const_us": 0.0,
    "lower_cutoff_freq_hz": 0.0, "sf_cutoff_freq_hz": math.inf, "diff_amp_cutoff_freq_hz": math.inf, "log_eps": 1e-3,
    "blender_interm_color_space": 0.0,
}  # fmt: skip
CIRCUIT = ("I_p_to_intensity_ratio_fa", "photodiode_cap_ff", "sf_cutoff_freq_hz", "diff_amp_cutoff_freq_hz")
COLOUR_SPACES = ("display", "linear")
BLENDER = 4  # renderer_type whose images have a colour space
FF_MV = 1e-3  # fF · mV in fA · s: 1e-15 F · 1e-3 V = 1e-18 C


def read_flags(file: Path) -> dict[str, str]:
    """Flag → value of lines `--flag=value`, `--flag` (true) and `--noflag` (false).

    Raises:
        InputError: the file cannot be read, or a number that is needed is none.
    """
    flags = {}
    for line in read_text(file, "CSV").splitlines():
        words = line.strip()
        if words.startswith("-"):
            name, is_given, value = words.lstrip("-").partition("=")
            name, value = name.strip(), value.strip().strip("\"'")
            flags[name] = value if is_given else "true"
    return flags


def pixel_of(file: Path, flags: dict[str, str]) -> dict[str, Any]:
    """The keys of `camera_calibration.npz` that flags tell: those of the circuit only where the file has any of them.

    Raises:
        InputError: a flag that is no number.
    """
    value = {name: _number(file, flags, name) for name in DEFAULTS}
    pixel: dict[str, Any] = {
        "pos_contrast_threshold": value["contrast_threshold_pos"],
        "neg_contrast_threshold": value["contrast_threshold_neg"],
        "refractory_period": value["refractory_period_ns"],
        "bayer_pattern": "RGGB" if colour_events(flags) else "",
    }
    if not set(CIRCUIT) & set(flags):
        return pixel
    ratio = value["I_p_to_intensity_ratio_fa"]
    charge = FF_MV * value["thermal_voltage_mv"]
    return pixel | {
        "input_time_const_eff_it_prod": value["photodiode_cap_ff"] * charge / ratio,
        "miller_time_const_eff_it_prod": value["miller_cap_ff"] * charge / ratio,
        "black_level": np.full(3 if colour_events(flags) else 1, value["dark_current_fa"] / ratio),
        "amplifier_gain": value["amplifier_gain"],
        "closed_loop_gain": 1 / value["back_gate_coeff"],
        "output_time_const": 1e-6 * value["output_time_const_us"],
        "lower_cutoff_freq": value["lower_cutoff_freq_hz"],
        "sf_cutoff_freq": value["sf_cutoff_freq_hz"],
        "diff_amp_cutoff_freq": value["diff_amp_cutoff_freq_hz"],
    }


def renderer_of(file: Path, flags: dict[str, str]) -> dict[str, Any] | None:
    """The content of `renderer_params.npz`; None where the images were not rendered with a colour space."""
    if flags.get("renderer_type", str(BLENDER)) != str(BLENDER):
        return None
    space = _number(file, flags, "blender_interm_color_space")
    if space not in (0, 1):
        raise InputError(f"{file}: --blender_interm_color_space: expected 0 or 1, found {space:g}")
    return {"interm_color_space": COLOUR_SPACES[int(space)], "log_eps": _number(file, flags, "log_eps")}


def colour_events(flags: dict[str, str]) -> bool:
    """Whether the sensor is behind a colour filter array."""
    return flags.get("simulate_color_events", "false").lower() in ("true", "1", "yes")


def _number(file: Path, flags: dict[str, str], name: str) -> float:
    try:
        value = float(flags.get(name, DEFAULTS[name]))
    except ValueError:
        value = math.nan
    if math.isnan(value) or value < 0 or (name in ("back_gate_coeff", "I_p_to_intensity_ratio_fa") and value == 0):
        raise InputError(f"{file}: --{name}: expected a number, found {flags[name]!r}")
    return value
