"""Currents that the bias settings of a jAER header stand for.

DAVIS (coarse-fine generators): I = coarse current · fine / 255.  The coarse currents are libcaer's table, 11 pA to
24.8 µA in factors of about 8, which jAER's files count from the other end: their BitValueCoarse is 7 − libcaer's.
jAER itself computes 389 nA · 8^(2 − coarse) · fine / 256 (`AddressedIPotCF`), the same within 8 %.

DVS128 (24-bit current splitters): I = I_m · value / (2²⁴ − 1), the master current I_m as jAER's `Masterbias` has it,

    I_m = U_T ln M / R + 2 (1 − 1/√M)² / (β R²),    M = 45, β = 2 · 170 µA/V², U_T = 26 mV · 298/300,

the sum of those of weak and of strong inversion (Delbrück & van Schaik 2005, Analog Integr. Circuits Signal Process.
43, 247): 75 µA with 8.2 kΩ.  It cancels in thresholds, which are all that these currents are used for.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pixelid.errors import InputError, shown

COARSE_A = (24.8e-6, 3.1e-6, 387.5e-9, 48.437e-9, 6.054e-9, 756e-12, 94e-12, 11e-12)  # by jAER's BitValueCoarse
MOST_SPLIT = (1 << 24) - 1


@dataclass(frozen=True)
class Chip:
    """How a family of chips names its biases.

    Attributes:
        family: what the name of a chip begins with.
        settings: role in the pixel → name of the bias.
        coarse_fine: whether a bias is a coarse and a fine value, else one of 24 bits.
        gain: of the differencing amplifier, C1/C2 in jAER's formula for the thresholds.
        capacitances: whether jAER knows the capacitors that dead time and source follower charge.
    """

    family: str
    settings: Mapping[str, str]
    coarse_fine: bool
    gain: float
    capacitances: bool


_DAVIS = {
    "photoreceptor": "PrBp", "follower": "PrSFBp", "differencing": "DiffBn", "on": "OnBn", "off": "OffBn",
    "refractory": "RefrBp",
}  # fmt: skip
_DVS128 = {
    "photoreceptor": "Pr", "follower": "foll", "differencing": "diff", "on": "diffOn", "off": "diffOff",
    "refractory": "refr",
}  # fmt: skip
CHIPS = (
    Chip("DAVIS240", _DAVIS, True, 20.0, True),
    Chip("DAVIS346", _DAVIS, True, 20.0, True),
    Chip("DVS128", _DVS128, False, 22.0, False),
)


@dataclass(frozen=True)
class Current:
    """One bias: its name in the header, what it is set to, and its nominal current; `off`: switched off."""

    setting: str
    bits: Mapping[str, int]
    ampere: float
    off: bool = False

    @property
    def none(self) -> str:
        """Why it is no current, in words; empty where it is one."""
        if self.off:
            return f"{self.setting} is switched off"
        return "" if self.ampere > 0 else f"{self.setting} is set to no current"

    def as_dict(self) -> dict[str, Any]:
        """The entry in fit.json and inspect.json."""
        return {"setting": self.setting, "bits": dict(self.bits), "ampere": 0.0 if self.off else self.ampere}


@dataclass(frozen=True)
class Currents:
    """The currents of a pixel's biases.

    Attributes:
        chip: what the recording calls it.
        of: its family.
        roles: "photoreceptor", "follower", "differencing", "on", "off", "refractory" → current; those in the header.
    """

    chip: str
    of: Chip
    roles: Mapping[str, Current]


def has_jaer_biases(sensor: str, biases: object) -> bool:
    """Whether these are settings that `currents_of` was made for: jAER's, of a chip that it knows."""
    chip = _chip(sensor)
    return chip is not None and isinstance(biases, Mapping) and any(_prefix(chip) in str(key) for key in biases)


def currents_of(sensor: str, biases: object) -> Currents:
    """The currents of the biases that make a pixel's parameters.

    Args:
        sensor: name of the chip, as `Recording.sensor` has it ("DAVIS240C").
        biases: setting → value, as `Recording.attributes["biases"]` ("AddressedIPotCF.OnBn.BitValueFine" → "255").

    Returns:
        Nominal currents [A].

    Raises:
        InputError: another chip, no settings of jAER, a value that no register holds.

    Example:
        >>> biases = {"AddressedIPotCF.OnBn.BitValueCoarse": "2", "AddressedIPotCF.OnBn.BitValueFine": "255"}
        >>> f"{currents_of('DAVIS240C', biases).roles['on'].ampere:.4g} A"
        '3.875e-07 A'
    """
    chip = _chip(sensor)
    if chip is None:
        known = ", ".join(chip.family for chip in CHIPS)
        raise InputError(f"biases: sensor: expected one of {known}, found {shown(sensor) if sensor else 'nothing'}")
    if not isinstance(biases, Mapping) or not has_jaer_biases(sensor, biases):
        raise InputError(f"biases: expected settings as jAER's headers have them, such as {_prefix(chip)}…; found none")
    read = _coarse_fine if chip.coarse_fine else _split
    found = {role: read(name, biases) for role, name in chip.settings.items()}
    return Currents(sensor, chip, {role: current for role, current in found.items() if current is not None})


def master_current_a(biases: Mapping[str, Any]) -> float:
    """The DVS128's master current [A], from the resistors in the header or jAER's own 8.2 kΩ."""
    external_ohm, internal_ohm = 8.2e3, 46e3  # where the header does not say; only the external one is in use then
    ohm = _ohm(biases, "Masterbias.rx", external_ohm)
    if str(biases.get("Masterbias.internalResistorUsed", "false")).lower() == "true":
        ohm += _ohm(biases, "Masterbias.rint", internal_ohm)
    mirror, beta_a_per_v2, thermal_v = 45.0, 2.0 * 170e-6, 26e-3 * 298.0 / 300.0  # of the DVS128's master bias
    weak = thermal_v * math.log(mirror) / ohm
    return weak + 2.0 * (1.0 - 1.0 / math.sqrt(mirror)) ** 2 / (beta_a_per_v2 * ohm**2)


def _chip(sensor: str) -> Chip | None:
    return next((chip for chip in CHIPS if str(sensor).upper().startswith(chip.family)), None)


def _prefix(chip: Chip) -> str:
    return "AddressedIPotCF." if chip.coarse_fine else "IPot."


def _coarse_fine(name: str, biases: Mapping[str, Any]) -> Current | None:
    start = f"AddressedIPotCF.{name}"
    keys = [f"{start}.BitValueCoarse", f"{start}.BitValueFine"]
    if any(key not in biases for key in keys):
        return None
    most_fine = 255
    coarse, fine = _whole(biases, keys[0], len(COARSE_A) - 1), _whole(biases, keys[1], most_fine)
    off = str(biases.get(f"{start}.Enabled", "true")).lower() != "true"
    return Current(name, {"coarse": coarse, "fine": fine}, COARSE_A[coarse] * fine / most_fine, off)


def _split(name: str, biases: Mapping[str, Any]) -> Current | None:
    key = f"IPot.{name}"
    if key not in biases:
        return None
    value = _whole(biases, key, MOST_SPLIT)
    return Current(name, {"value": value}, master_current_a(biases) * value / MOST_SPLIT)


def _whole(biases: Mapping[str, Any], key: str, most: int) -> int:
    text = str(biases[key])
    if not re.fullmatch(r"[0-9]{1,8}", text) or int(text) > most:
        raise InputError(f"biases: {key}: expected a whole number from 0 to {most}, found {shown(text)}")
    return int(text)


def _ohm(biases: Mapping[str, Any], key: str, default: float) -> float:
    try:
        ohm = float(biases.get(key, default))
    except (TypeError, ValueError):
        ohm = math.nan
    if not 1.0 <= ohm <= 1e9:
        raise InputError(f"biases: {key}: expected a resistance in Ω, found {shown(biases[key])}")
    return ohm
