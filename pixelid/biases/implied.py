"""What bias currents imply of a pixel: thresholds, dead time, cutoff of the source follower; and how well.

The formulas and nominal constants are those that jAER shows with its sliders (`DavisConfig`, `DVS128`):

    θ_on  = κn/κp² · C2/C1 · ln(I_on / I_d),   θ_off = κn/κp² · C2/C1 · ln(I_d / I_off)
            (Nozaki & Delbruck 2017, IEEE Trans. Electron Devices 64, 3239);  κ = 0.7, C1/C2 = 20 (DVS128: 22)
    dead time = C V / I_refr,                  C = 20 fF, V = 0.8 V
    cutoff = I_sf / (2π U_T C1),               C1 = 131.167 fF, U_T = 25 mV;  where I_sf < I_pr / 2

Standard deviations are of logarithms; every source of error is counted once per parameter and listed by name:

    bias current     0.25  of each splitter: 20 to 30 % measured in weak inversion, where these currents are (Delbrück &
                           Lichtsteiner 2006, IEEE ISCAS); and a leakage of 1 pA, libcaer's smallest current
    master current   0.2   cancels in thresholds.  jAER says 389 nA, its U_T ln M / R is 358 nA (M = 4, 100 kΩ): 8 %;
                           it goes with temperature, 298 to 330 K: 10 %; 5 mV between its transistors, of the 36 mV
                           across the resistor: 14 %
    kappa            0.22  κn and κp each 0.7 ± 10 % (0.57 to 0.85 at 95 %): √(1² + 2²) · 0.1 in κn/κp²
    capacitor ratio  0.2   jAER's own C1 = 131.167 fF and C2 = 5.458 fF give 24.0, its formula has 20: ln 1.2 = 0.18
    reset capacitor  0.4   an NMOS capacitor of 3 × 1.8 µm² at 4.2 nm of oxide has 44 fF in inversion; jAER guesses 20:
                           ln 2.2 = 0.79 is the 95 % half-width
    reset swing      0.2   0.54 to 1.2 V at 95 %: thresholds of a transistor, within a supply of 1.8 V
    load capacitor   0.2   C1 as drawn, parasitic ones aside
    transconductance 0.2   of the follower: between κ I / U_T and I / U_T, ln(1/0.7) = 0.36 is the 95 % half-width
    temperature      0.07  25 mV is 290 K; chips at work have 300 to 330 K, up to 28 mV
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pixelid.biases.currents import Current, Currents
from pixelid.statistics import Z95

RESET_FARAD, RESET_VOLT = 20e-15, 0.8
LOAD_FARAD, THERMAL_VOLT = 131.167e-15, 25e-3
SPLITTER_SD, LEAKAGE_A, MASTER_SD = 0.25, 1e-12, 0.2
KAPPA_SD, GAIN_SD = 0.1, 0.2
RESET_CAPACITOR_SD, RESET_SWING_SD = 0.4, 0.2
LOAD_SD, TRANSCONDUCTANCE_SD, TEMPERATURE_SD = 0.2, 0.2, 0.07
UNITS = {"on_threshold": "log radiance", "off_threshold": "log radiance", "refractory_s": "s", "sf_cutoff_hz": "Hz"}


@dataclass(frozen=True)
class Value:
    """A parameter as its biases imply it.

    Attributes:
        value: in `unit`.
        formula: with the names of the biases.
        errors: source of error → its standard deviation in ln value.
    """

    value: float
    unit: str
    formula: str
    errors: Mapping[str, float]

    @property
    def sd(self) -> float:
        """Standard deviation of ln value, from all sources."""
        return math.sqrt(sum(error**2 for error in self.errors.values()))

    @property
    def interval_95(self) -> tuple[float, float]:
        """In `unit`."""
        return self.value * math.exp(-Z95 * self.sd), self.value * math.exp(Z95 * self.sd)

    def as_dict(self) -> dict[str, Any]:
        """The entry in fit.json and inspect.json."""
        return {
            "value": self.value, "unit": self.unit, "interval_95": list(self.interval_95), "formula": self.formula,
            "errors": dict(self.errors),
        }  # fmt: skip


@dataclass(frozen=True)
class Implied:
    """What the biases of a recording imply.

    Attributes:
        currents: of the biases.
        values: parameter → value.
        without: parameter → why its biases say nothing, in words.
    """

    currents: Currents
    values: Mapping[str, Value]
    without: Mapping[str, str]

    def as_dict(self) -> dict[str, Any]:
        """The entry in fit.json and inspect.json."""
        return {
            "chip": self.currents.chip,
            "currents": {role: current.as_dict() for role, current in self.currents.roles.items()},
            "values": {name: value.as_dict() for name, value in self.values.items()},
            "without": dict(self.without),
        }


def implied_by(currents: Currents) -> Implied:
    """What currents imply of on_threshold, off_threshold, refractory_s and sf_cutoff_hz.

    Example:
        >>> from pixelid.biases.currents import currents_of
        >>> biases = {"IPot.diff": "1000", "IPot.diffOn": "20000", "IPot.diffOff": "0"}
        >>> implied = implied_by(currents_of("DVS128", biases))
        >>> round(implied.values["on_threshold"].value, 4)  # 1 / 0.7 / 22 · ln 20
        0.1945
        >>> implied.without["off_threshold"]
        'diffOff is set to no current'
    """
    found: dict[str, Value | str] = {
        "on_threshold": _threshold(currents, "on", 1.0),
        "off_threshold": _threshold(currents, "off", -1.0),
        "refractory_s": _dead_time(currents),
        "sf_cutoff_hz": _cutoff(currents),
    }
    values = {name: value for name, value in found.items() if isinstance(value, Value)}
    return Implied(currents, values, {name: why for name, why in found.items() if isinstance(why, str)})


def _threshold(currents: Currents, role: str, sign: float) -> Value | str:
    missing = _missing(currents, role, "differencing")
    if missing:
        return missing
    own, reference = currents.roles[role], currents.roles["differencing"]
    names = (own.setting, reference.setting) if sign > 0 else (reference.setting, own.setting)
    log_ratio = sign * math.log(own.ampere / reference.ampere)
    spreads = {current.setting: _spread(current) for current in (own, reference)}
    if log_ratio <= Z95 * math.hypot(*spreads.values()):
        return (
            f"{names[0]} is {math.exp(log_ratio):.3g} × {names[1]}: within the errors of both currents the comparator "
            "has no threshold"
        )
    errors = {"kappa": math.sqrt(5.0) * KAPPA_SD, "capacitor ratio": GAIN_SD}
    errors |= {setting: spread / log_ratio for setting, spread in spreads.items()}
    kappa = 0.7  # of NMOS and PMOS
    formula = f"κn/κp² · C2/C1 · ln(I_{names[0]} / I_{names[1]}), κ = {kappa:g}, C1/C2 = {currents.of.gain:g}"
    return Value(log_ratio / (kappa * currents.of.gain), UNITS[f"{role}_threshold"], formula, errors)


def _dead_time(currents: Currents) -> Value | str:
    if not currents.of.capacitances:
        return f"no capacitance is known for the {currents.of.family}'s reset"
    missing = _missing(currents, "refractory")
    if missing:
        return missing
    current = currents.roles["refractory"]
    errors = {
        current.setting: _spread(current), "master current": MASTER_SD, "reset capacitor": RESET_CAPACITOR_SD,
        "reset swing": RESET_SWING_SD,
    }  # fmt: skip
    formula = f"C V / I_{current.setting}, C = {RESET_FARAD * 1e15:g} fF, V = {RESET_VOLT:g} V"
    return Value(RESET_FARAD * RESET_VOLT / current.ampere, UNITS["refractory_s"], formula, errors)


def _cutoff(currents: Currents) -> Value | str:
    if not currents.of.capacitances:
        return f"no capacitance is known for the {currents.of.family}'s source follower"
    missing = _missing(currents, "follower", "photoreceptor")
    if missing:
        return missing
    current, before = currents.roles["follower"], currents.roles["photoreceptor"]
    limited_by_follower = 0.5  # of the photoreceptor's current: beyond, the follower alone does not make the cutoff
    if current.ampere >= limited_by_follower * before.ampere:
        return (
            f"{current.setting} is {current.ampere / before.ampere:.3g} × {before.setting}, half of it or more: "
            "the source follower does not make the cutoff alone"
        )
    errors = {
        current.setting: _spread(current), "master current": MASTER_SD, "load capacitor": LOAD_SD,
        "transconductance": TRANSCONDUCTANCE_SD, "temperature": TEMPERATURE_SD,
    }  # fmt: skip
    formula = f"I_{current.setting} / (2π U_T C1), U_T = {THERMAL_VOLT * 1e3:g} mV, C1 = {LOAD_FARAD * 1e15:g} fF"
    cutoff = current.ampere / (2.0 * math.pi * THERMAL_VOLT * LOAD_FARAD)
    return Value(cutoff, UNITS["sf_cutoff_hz"], formula, errors)


def _missing(currents: Currents, *roles: str) -> str:
    """Which of the currents is none, in words; empty where all are."""
    for role in roles:
        if role not in currents.roles:
            return f"the header has no {currents.of.settings[role]}"
        if currents.roles[role].none:
            return currents.roles[role].none
    return ""


def _spread(current: Current) -> float:
    """Standard deviation of ln I: of the splitter, and of what leaks with it."""
    return math.hypot(SPLITTER_SD, math.log1p(LEAKAGE_A / current.ampere))
