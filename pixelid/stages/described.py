"""Described effects: what no effect of the library is, written as an equation all the same.

`CELLS` is the grammar: quantity × covariate × form, restricted to what simulator and event-time likelihood both do
exactly (`modulation.py` says how).  A cell is an effect like any other, by the name described.QUANTITY.COVARIATE.FORM.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache

import numpy as np

from pixelid.errors import InputError, did_you_mean
from pixelid.parameters.parameter import Parameter
from pixelid.stages.circuit import Circuit
from pixelid.stages.effect import Effect
from pixelid.stages.modulation import SINCE_EVENT, THRESHOLDS, Modulation

PREFIX = "described."
STAGE_OF = {
    "light": "photocurrent",
    "response": "photocurrent",
    "rate": "photoreceptor",
    "low_pass": "source_follower",
    "high_pass": "source_follower",
    "leak": "differencing",
    **dict.fromkeys(THRESHOLDS, "comparator"),
    "dead_time": "comparator",
}
_THRESHOLD = {
    "previous_polarity": ("constant",),
    "time_in_recording": ("linear", "relaxation", "step"),
    "radiance": ("power", "relaxation", "step"),
    "speed": ("power", "relaxation", "step"),
    SINCE_EVENT: ("relaxation",),
}
CELLS: dict[str, dict[str, tuple[str, ...]]] = {
    "light": {"radiance": ("power", "relaxation"), "time_in_recording": ("linear", "relaxation", "step")},
    "response": {"radiance": ("power", "relaxation")},
    "rate": {"radiance": ("power", "relaxation"), "time_in_recording": ("linear", "relaxation", "step")},
    "low_pass": {"none": ("constant",)},
    "high_pass": {"none": ("constant",)},
    "leak": {"none": ("constant",), "radiance": ("linear",)},
    **dict.fromkeys(THRESHOLDS, _THRESHOLD),
    "dead_time": {
        "none": ("constant",),
        "previous_polarity": ("constant",),
        "time_in_recording": ("linear", "step"),
        "radiance": ("power", "step"),
        "speed": ("power", "relaxation", "step"),
    },
}
TWINS = {  # effects of the library that have the same equation
    "leak.none": "leak",
    "leak.radiance": "parasitic_photocurrent",
    "low_pass.none": "extra_pole",
    "high_pass.none": "lower_cutoff",
}
UNIT_OF = {"none": "", "previous_polarity": "", "time_in_recording": "s", "radiance": "radiance", "speed": "1/s",
           SINCE_EVENT: "s"}  # fmt: skip
SYMBOL = {
    "light": "L", "rate": "photoreceptor rate", "leak": "leak", "dead_time": "dead time", "threshold": "C_i",
    "on_threshold": "C_i,on", "off_threshold": "C_i,off",
}  # fmt: skip
IN_WORDS = {
    "light": "The light that reaches the pixel",
    "response": "What the pixel takes for the logarithm of the light",
    "rate": "The photoreceptor's bandwidth",
    "low_pass": "The lag of the signal",
    "high_pass": "The fading of slow changes",
    "leak": "The drift of the differencing amplifier",
    "on_threshold": "The threshold of ON events",
    "off_threshold": "The threshold of OFF events",
    "threshold": "The thresholds of both polarities",
    "dead_time": "The dead time after an event",
}
DEPENDS_ON = {
    "none": "is another one than the model has",
    "previous_polarity": "depends on the polarity of the pixel's previous event",
    "time_in_recording": "changes in the course of a recording",
    "radiance": "depends on the radiance",
    "speed": "depends on how fast the light changes",
    SINCE_EVENT: "depends on the time since the pixel's last event",
}


class Described(Effect):
    """One cell of the grammar.

    Args:
        quantity, covariate, form: See `CELLS`.
    """

    source = "fitted: an equation that closes part of a gap, not a mechanism"
    on_boundary = False

    def __init__(self, quantity: str, covariate: str, form: str) -> None:
        self.quantity, self.covariate, self.form = quantity, covariate, form
        self.name = f"{PREFIX}{quantity}.{covariate}.{form}"
        self.stage = STAGE_OF[quantity]
        depends = DEPENDS_ON[covariate]
        if quantity == "threshold":
            depends = depends.replace("depends", "depend", 1).replace("changes in", "change in", 1)
        self.sentence = f"{IN_WORDS[quantity]} {depends}."
        self.equation = equation(quantity, covariate, form, {})
        self.parameters = tuple(_parameters(self.name, quantity, covariate, form))
        self.photoreceptors = ("second_order", "one_pole") if quantity == "rate" else Effect.photoreceptors

    @property
    def twin(self) -> str | None:
        """The effect of the library that has the same equation; None where none does."""
        return TWINS.get(f"{self.quantity}.{self.covariate}")

    def own(self, values: Mapping[str, float]) -> dict[str, float]:
        """Its values among those of a model, by the last part of their names."""
        return {p.name.removeprefix(self.name + "."): values[p.name] for p in self.parameters}

    def apply(self, circuit: Circuit, values: Mapping[str, float]) -> Circuit:
        own = self.own(values)
        strength = own["strength"]
        if self.quantity == "low_pass":
            if math.isfinite(np.real(circuit.extra_pole)):
                raise InputError(f"{self.name}: the model has extra_pole, which is the same")
            return circuit.with_(extra_pole=1.0 / strength if strength != 0.0 else math.inf)
        if self.quantity == "high_pass":
            if circuit.lower_cutoff != 0.0:
                raise InputError(f"{self.name}: the model has lower_cutoff, which is the same")
            return circuit.with_(lower_cutoff=2.0 * math.pi * strength)
        if self.quantity == "leak" and self.covariate == "none":
            return circuit.with_(leak_hz=circuit.leak_hz + strength)
        if self.quantity == "leak":
            return circuit.with_(leak_hz_per_radiance=circuit.leak_hz_per_radiance + strength)
        if self.covariate == SINCE_EVENT and any(m.covariate == SINCE_EVENT for m in circuit.described):
            raise InputError("described: only one quantity can depend on the time since the last event")
        shape = next((own[key] for key in ("exponent", "scale", "edge") if key in own), 1.0)
        new = Modulation(self.quantity, self.covariate, self.form, strength, shape, own.get("reference", 1.0))
        return circuit.with_(described=(*circuit.described, new))


def _parameters(name: str, quantity: str, covariate: str, form: str):
    unit = UNIT_OF[covariate]
    if quantity == "dead_time":
        own = "1" if form == "linear" else "s"
        yield Parameter(f"{name}.strength", 0.0, own, -1.0, 1.0, "linear")
    elif quantity == "low_pass":
        yield Parameter(f"{name}.strength", 0.0, "s", 0.0, 10.0, "linear")
    elif quantity == "high_pass":
        yield Parameter(f"{name}.strength", 0.0, "Hz", 0.0, 1e4, "linear")
    elif quantity == "leak":
        yield Parameter(f"{name}.strength", 0.0, "Hz/radiance" if form == "linear" else "Hz", 0.0, 1e4, "linear")
    else:
        upper = 10.0 if quantity in THRESHOLDS else 1e3
        yield Parameter(f"{name}.strength", 0.0, f"1/{unit}" if form == "linear" else "1", -0.9, upper, "linear")
    if form == "power":
        # a speed may be zero
        yield Parameter(f"{name}.exponent", 1.0, "1", 0.1 if covariate == "speed" else -4.0, 4.0, "linear")
        yield Parameter(f"{name}.reference", 100.0, unit, 1e-9, 1e9, "log", free=False)
    elif form == "relaxation":
        yield Parameter(f"{name}.scale", 1.0, unit, 1e-6, 1e9, "log")
    elif form == "step":
        yield Parameter(f"{name}.edge", 1.0, unit, free=False)


def equation(quantity: str, covariate: str, form: str, values: Mapping[str, float]) -> str:
    """The equation of a cell; values: by the part of a parameter's name after the last dot, {}: by name."""

    def shown(key: str) -> str:
        return f"{values[key]:.4g}" if key in values else key

    v = _symbol(quantity, covariate)
    g = {
        "constant": shown("strength") + (f" · {v}" if v else ""),
        "linear": f"{shown('strength')} · {v}",
        "power": f"{shown('strength')} · ({v} / {shown('reference')})^{shown('exponent')}",
        "relaxation": f"{shown('strength')} · exp(−{v} / {shown('scale')})",
        "step": f"{shown('strength')} · [{v} > {shown('edge')}]",
    }[form]
    if quantity == "leak":
        return f"change += C_on ∫ {g} dt"
    if quantity == "low_pass":
        return f"d ye/dt = (ysf − ye) / {g}"
    if quantity == "high_pass":
        return f"dz/dt = 2π {g} (ysf − z), output ysf − z"
    if quantity == "dead_time":
        return f"dead time → dead time + {g}"
    if quantity == "response":
        return f"ln L → ln L + ln(1 + {g})"
    if quantity in THRESHOLDS:
        return (
            f"{SYMBOL[quantity]} → {SYMBOL[quantity]} + C{SYMBOL[quantity].removeprefix('C_i').replace(',', '_')} · {g}"
        )
    return f"{SYMBOL[quantity]} → {SYMBOL[quantity]} (1 + {g})"


def _symbol(quantity: str, covariate: str) -> str:
    now = quantity in ("light", "response", "rate", "leak")
    return {
        "none": "",
        "previous_polarity": "p · p_before" if quantity == "threshold" else "p_before",
        "time_in_recording": "t" if now else "t_before",
        "radiance": "L" if now else "L(t_before)",
        "speed": "|d ln L/dt|(t_before)",
        SINCE_EVENT: "(t − t_before)",
    }[covariate]


def power_of_radiance(name: str) -> int:
    """With which power of the unit of radiance the parameter of a described effect goes; 0 for others.

    >>> power_of_radiance("described.threshold.radiance.step.edge"), power_of_radiance("alpha")
    (1, 0)
    """
    parts = name.split(".")
    if parts[0] != PREFIX.rstrip(".") or "radiance" not in parts:
        return 0
    return {"scale": 1, "edge": 1, "reference": 1, "strength": -1 if "linear" in parts else 0}.get(parts[-1], 0)


@cache
def described(name: str) -> Described:
    """The effect of a name that begins with `PREFIX`.  Raises InputError listing what the grammar has."""
    parts = name.removeprefix(PREFIX).split(".")
    if len(parts) != 3:
        raise InputError(f"{name!r}: expected described.QUANTITY.COVARIATE.FORM")
    return cell(*parts)


def cell(quantity: str, covariate: str, form: str) -> Described:
    """The effect of a cell.  Raises InputError listing what the grammar has in its place."""
    for what, found, known in (
        ("quantity", quantity, CELLS),
        (f"covariate of {quantity}", covariate, CELLS.get(quantity, {})),
        (f"form of {quantity} by {covariate}", form, CELLS.get(quantity, {}).get(covariate, ())),
    ):
        if found not in known:
            raise InputError(
                f"described: unknown {what} {found!r}; known: {', '.join(known)}{did_you_mean(found, known)}"
            )
    return Described(quantity, covariate, form)


def all_cells() -> list[Described]:
    """Every cell of the grammar, in signal order."""
    return [
        described(f"{PREFIX}{quantity}.{covariate}.{form}")
        for quantity, covariates in CELLS.items()
        for covariate, forms in covariates.items()
        for form in forms
    ]
