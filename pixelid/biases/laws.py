"""How a pixel's quantity goes with the code of one bias or two: forms, each derived from what a bias does, and laws.

A bias generator turns a code into a current I, either exponentially (the code sets the gate voltage of a transistor
below threshold: ln I is linear in it; Delbrück et al. 2010, IEEE ISCAS) or linearly (the code counts unit currents, the
first of which is the code of no current).  A dead time is the charging of a capacitor, C V / I and a part that no bias
moves.  A cutoff goes as I, up to another pole.  A threshold is the difference of two comparator voltages over the gain
of the amplifier before it; voltages are linear in codes, and the gain falls with the amplifier's own bias.

Codes are centred, and scaled to ±1 over the larger measured range, so that coordinates are of one size; `natural`
gives the same numbers per code.  Coordinates of a magnitude are logarithms, slopes are linear.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pixelid.errors import InputError, did_you_mean, shown

Coordinates = Sequence[np.ndarray]  # one array per parameter, of shape (draws, 1) or (1,)


@dataclass(frozen=True)
class Form:
    """An equation of a quantity q over codes.

    Attributes:
        name: in the field's words;  why: what in the circuit has this form.
        equation: with the names of `parameters`, x for the first code and d for the second.
        parameters: names;  those in `LINEAR` are fitted as they are, the others as logarithms.
        value: (coordinates, v (n, codes), sign) → q;  not positive, or not finite, beyond the law's end.
        codes: 1 or 2.
        power: of the current in q, None where it is a parameter.
    """

    name: str
    why: str
    equation: str
    parameters: tuple[str, ...]
    value: Callable[[Coordinates, np.ndarray, int], np.ndarray]
    codes: int = 1
    power: float | None = None

    @property
    def kinds(self) -> tuple[str, ...]:
        """ "log" or "linear" of each coordinate."""
        return tuple("linear" if name.partition(".")[0] in LINEAR else "log" for name in self.parameters)

    @property
    def signed(self) -> bool:
        """Whether it has a code of no current, below the measured ones or above."""
        return "zero_current_code" in self.parameters


LINEAR = {"slope", "log_slope", "log_gain", "step", "exponent"}  # .x and .d: of the first and second code
REFERENCE, ZERO = "value_at_reference", "zero_current_code"


def _current(p: Coordinates, v: np.ndarray, sign: int, exponent: Any) -> np.ndarray:
    """(current over that at the reference)^exponent; −1 from the code of no current on."""
    return _power((1.0 + np.exp(p[1]) + sign * v[..., 0]) / (1.0 + np.exp(p[1])), exponent)


def _power(base: np.ndarray, exponent: Any) -> np.ndarray:
    return np.where(base > 0.0, np.maximum(base, 1e-300) ** exponent, -1.0)


def _sum(p: Coordinates, v: np.ndarray) -> np.ndarray:
    """A voltage linear in both codes, over that at the reference."""
    return 1.0 + p[1] * v[..., 0] + p[2] * v[..., 1]


CHARGED = "a capacitor charged by a current that is linear in the code"
FORMS = (
    Form(
        "exponential", "subthreshold: the logarithm of a bias current is linear in its code",
        "q = value_at_reference · exp(log_slope.x · (x − reference))", (REFERENCE, "log_slope.x"),
        lambda p, v, sign: np.exp(p[0] + p[1] * v[..., 0]),
    ),
    Form(
        "exponential with a floor", "subthreshold, and a part that no bias moves",
        "q = value_at_reference · exp(log_slope.x · (x − reference)) + floor", (REFERENCE, "log_slope.x", "floor"),
        lambda p, v, sign: np.exp(p[0] + p[1] * v[..., 0]) + np.exp(p[2]),
    ),
    Form(
        "linear", "a voltage, or a rate of a current, that is linear in the code",
        "q = value_at_reference + slope.x · (x − reference)", (REFERENCE, "slope.x"),
        lambda p, v, sign: np.exp(p[0]) * (1.0 + p[1] * v[..., 0]),
    ),
    Form(
        "inverse of a linear current", CHARGED, "q = scale / |x − zero_current_code|", ("scale", ZERO),
        lambda p, v, sign: np.exp(p[0]) * _current(p, v, sign, -1.0), power=-1.0,
    ),
    Form(
        "inverse of a linear current with a floor", f"{CHARGED}, and a part that no bias moves",
        "q = scale / |x − zero_current_code| + floor", ("scale", ZERO, "floor"),
        lambda p, v, sign: _floored(np.exp(p[0]) * _current(p, v, sign, -1.0), p[2], -1.0), power=-1.0,
    ),
    Form(
        "saturating linear current", "a rate that goes as a current linear in the code, up to that of another pole",
        "1/q = 1/(scale · |x − zero_current_code|) + 1/ceiling", ("scale", ZERO, "ceiling"),
        lambda p, v, sign: 1.0 / _floored(np.exp(-p[0]) * _current(p, v, sign, -1.0), -p[2], np.inf), power=1.0,
    ),
    Form(
        "power of a linear current", "transistors between weak and strong inversion",
        "q = scale · |x − zero_current_code|^exponent", ("scale", ZERO, "exponent"),
        lambda p, v, sign: np.exp(p[0]) * _current(p, v, sign, p[2]),
    ),
    Form(
        "difference of codes", "a threshold: the difference of two voltages that are linear in their codes",
        "q = value_at_reference + slope.x · ((x − reference) − (d − reference))", (REFERENCE, "slope.x"),
        lambda p, v, sign: np.exp(p[0]) * (1.0 + p[1] * (v[..., 0] - v[..., 1])), 2,
    ),
    Form(
        "linear in both codes", "a difference of two voltages with unlike steps per code",
        "q = value_at_reference + slope.x · (x − reference) + slope.d · (d − reference)",
        (REFERENCE, "slope.x", "slope.d"), lambda p, v, sign: np.exp(p[0]) * _sum(p, v), 2,
    ),
    Form(
        "difference over a gain",
        "a difference of voltages over the gain of the amplifier, which falls exponentially with its bias",
        "q = exp(log_gain.d · (d − reference)) · (value_at_reference + slope.x · (x − reference) "
        "+ slope.d · (d − reference))",
        (REFERENCE, "slope.x", "slope.d", "log_gain.d"),
        lambda p, v, sign: np.exp(p[0] + p[3] * v[..., 1]) * _sum(p, v), 2,
    ),
    Form(
        "exponential in both codes", "subthreshold in both codes",
        "q = value_at_reference · exp(log_slope.x · (x − reference) + log_slope.d · (d − reference))",
        (REFERENCE, "log_slope.x", "log_slope.d"), lambda p, v, sign: np.exp(p[0] + _sum(p, v) - 1.0), 2,
    ),
    Form(
        "power of a difference", "a difference of voltages through transistors between weak and strong inversion",
        "q = value_at_reference · (1 + step.x · (x − reference) + step.d · (d − reference))^exponent",
        (REFERENCE, "step.x", "step.d", "exponent"),
        lambda p, v, sign: np.exp(p[0]) * _power(_sum(p, v), p[3]), 2,
    ),
)  # fmt: skip
BY_NAME = {form.name: form for form in FORMS}


def _floored(q: np.ndarray, floor: np.ndarray, beyond: float) -> np.ndarray:
    return np.where(q > 0.0, q + np.exp(floor), beyond)


@dataclass(frozen=True)
class Law:
    """A form with numbers, for one quantity.

    Attributes:
        form: its equation.
        codes: names of the biases.
        low, high: (codes,) ends of the measured codes.
        sign: +1 where the current grows with the first code, −1 where it falls.
        x: (parameters,) coordinates;  covariance: theirs.
        scatter: relative scatter of settings about the law, the scale of Student's t;  freedom: rows that it rests on.
        weight: of this form among its rivals.
    """

    form: Form
    codes: tuple[str, ...]
    low: np.ndarray
    high: np.ndarray
    sign: int
    x: np.ndarray
    covariance: np.ndarray
    scatter: float = 0.0
    freedom: float = 1.0
    weight: float = 1.0

    @property
    def centre(self) -> np.ndarray:
        """(codes,) the reference."""
        return 0.5 * (self.low + self.high)

    @property
    def half(self) -> np.ndarray:
        """(codes,) half of the larger measured range, for all codes."""
        return np.full(len(self.low), 0.5 * float((self.high - self.low).max()))

    def log_value(self, codes: np.ndarray, x: np.ndarray | None = None) -> np.ndarray:
        """ln q at codes (n, codes), NaN beyond the law's end.

        Args:
            codes: where.
            x: coordinates (parameters,), or draws of them (draws, parameters) for an answer (draws, n).
        """
        at = np.moveaxis(np.asarray(self.x if x is None else x, float), -1, 0)
        p = [column[..., None] for column in at]
        v = (np.asarray(codes, float) - self.centre) / self.half
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
            q = self.form.value(p, v, self.sign)
            return np.where((q > 0.0) & np.isfinite(q), np.log(np.where(q > 0.0, q, 1.0)), np.nan)

    def natural(self, x: np.ndarray) -> dict[str, np.ndarray]:
        """Parameter of the equation → its value per code, of coordinates (…, parameters)."""
        value, reach = np.exp(x[..., 0]), (1.0 + np.exp(x[..., 1])) * self.half[0]
        power = x[..., 2] if self.form.power is None and self.form.signed else self.form.power
        values = {}
        for k, name in enumerate(self.form.parameters):
            kind, _, code = name.partition(".")
            half = self.half[int(code == "d")]
            values[name] = {
                "slope": value * x[..., k] / half, "log_slope": x[..., k] / half, "log_gain": x[..., k] / half,
                "step": x[..., k] / half, "exponent": x[..., k], ZERO: self.centre[0] - self.sign * reach,
                "scale": value / reach ** (power or 0.0),
            }.get(kind, np.exp(x[..., k]))  # fmt: skip
        return values

    def unit_of(self, name: str, unit: str) -> str:
        """Of a parameter of the equation, for a quantity of this unit."""
        scale = {-1.0: f"{unit}·code", 1.0: f"{unit}/code"}.get(self.form.power or 0.0, f"{unit}/code^exponent")
        units = {"slope": f"{unit}/code", ZERO: "code", "scale": scale, "exponent": "1"}
        return units.get(name.partition(".")[0], "1/code" if name.partition(".")[0] in LINEAR else unit)

    def distances(self, codes: np.ndarray, settings: np.ndarray) -> np.ndarray:
        """(n,) from codes (n, codes) to the nearest of settings (m, codes), in halves of each code's measured range."""
        return 2.0 * np.linalg.norm((codes[:, None] - settings) / (self.high - self.low), axis=-1).min(1)

    def draw(self, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """((count, parameters) coordinates, (count,) scatters): normal ones, of a scatter that few rows fix loosely."""
        wider = np.sqrt(self.freedom / rng.chisquare(self.freedom, count))
        away = rng.multivariate_normal(np.zeros(len(self.x)), self.covariance, count, check_valid="ignore")
        return self.x + wider[:, None] * away, self.scatter * wider

    def as_dict(self) -> dict[str, Any]:
        """What brings it back (`Law.of`)."""
        return {
            "form": self.form.name, "codes": list(self.codes), "low": self.low.tolist(), "high": self.high.tolist(),
            "sign": self.sign, "x": self.x.tolist(), "covariance": self.covariance.tolist(), "scatter": self.scatter,
            "freedom": self.freedom,             "weight": self.weight,
        }  # fmt: skip

    @staticmethod
    def of(content: Mapping[str, Any]) -> Law:
        """The law of a saved dictionary.  Raises LookupError, TypeError or ValueError for another."""
        form = BY_NAME[content["form"]]
        numbers = [np.array(content[key], float) for key in ("low", "high", "x", "covariance")]
        n, k = len(form.kinds), form.codes
        shapes = [(k,), (k,), (n,), (n, n)]
        if [a.shape for a in numbers] != shapes or len(content["codes"]) != k or not np.isfinite(numbers[2]).all():
            raise ValueError(f"law {form.name!r}: expected {n} coordinates of {k} codes")
        low, high, x, covariance = numbers
        rest = {key: float(content[key]) for key in ("scatter", "freedom", "weight")}
        positive = rest["scatter"] >= 0.0 < rest["freedom"] and 0.0 < rest["weight"] <= 1.0
        if not (positive and (high > low).all() and np.isfinite(covariance).all() and content["sign"] in (1, -1)):
            raise ValueError(f"law {form.name!r}: expected ranges, a covariance, and a weight up to 1")
        return Law(form, tuple(map(str, content["codes"])), low, high, int(content["sign"]), x, covariance, **rest)


def stated_codes(words: Sequence[str], known: Sequence[str], option: str) -> dict[str, float]:
    """Codes of a setting from "NAME=CODE[,NAME=CODE…]"; "bias_" before a name may be left out.

    Raises:
        InputError: no number, or a name that no law has.

    Example:
        >>> stated_codes(["refr=10"], ["bias_refr"], "--at")
        {'bias_refr': 10.0}
    """
    values: dict[str, float] = {}
    for word in ",".join(words).split(","):
        name, _, text = (part.strip() for part in word.partition("="))
        full = name if name in known else f"bias_{name}"
        if full not in known:
            raise InputError(
                f"{option}: no law of {name or 'nothing'!r}; known: {', '.join(known)}{did_you_mean(full, known)}"
            )
        try:
            values[full] = float(text)
        except ValueError:
            values[full] = np.nan
        if not abs(values[full]) < 1e9:
            raise InputError(f"{option}: {full}: expected a number, found {shown(text)}")
    return values
