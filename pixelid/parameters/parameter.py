"""One parameter of a circuit: value, unit, bounds, transform, prior, and whether a fit may move it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, overload

from pixelid.errors import InputError

OPEN_SD = 0.5  # a log coordinate known no better than a factor e^±0.5 (a standard deviation) is not identified
RATE_UNIT = "s/s"  # of what two clocks part by in a second


@dataclass(frozen=True)
class Prior:
    """A prior in the parameter's fitting coordinate (the log for "log" parameters): Gaussian, or Student's t.

    mean, sd: location and scale;  df: degrees of freedom, infinite for a Gaussian.  With few of them, a value that the
    data put many scales away costs the logarithm of its distance only (O'Hagan 1979, JRSS B 41, 358): the statement
    gives way, where a Gaussian would bend everything else.
    """

    mean: float
    sd: float
    df: float = math.inf

    def __post_init__(self) -> None:
        if not (self.sd > 0 and math.isfinite(self.mean)):
            raise InputError(f"prior: expected finite mean and sd > 0, found mean {self.mean}, sd {self.sd}")
        # Of a prior: beyond, its square leaves nothing of the likelihood in double precision
        least_sd, most_mean = 1e-15, 1e9
        if self.sd < least_sd or abs(self.mean) > most_mean:
            raise InputError(
                f"prior: expected sd of at least {least_sd:g} (hold what is known better: free = false) and a mean of "
                f"at most {most_mean:g}, found mean {self.mean:g}, sd {self.sd:g}"
            )

    def as_dict(self) -> dict[str, float]:
        """As files hold it; a Gaussian has no `df`."""
        return {"mean": self.mean, "sd": self.sd, **({} if math.isinf(self.df) else {"df": self.df})}

    def log_density(self, coordinate: Any, log: Callable[[Any], Any] = math.log) -> Any:
        """ln of the density at a fitting coordinate, up to a constant: of a number, a symbol or a tensor.

        log: the logarithm of such numbers
        """
        square = ((coordinate - self.mean) / self.sd) ** 2
        return -0.5 * square if math.isinf(self.df) else -0.5 * (self.df + 1.0) * log(1.0 + square / self.df)

    def slope_and_information(self, coordinate: float) -> tuple[float, float]:
        """Derivative of `log_density`, and its slope over its distance: a curvature that is positive everywhere.

        The second derivative of Student's t is positive in its tails; the weight (df + 1)/(df + z²) of iteratively
        reweighted least squares is what stands for it there (Lange, Little & Taylor 1989, JASA 84, 881).
        """
        z = (coordinate - self.mean) / self.sd
        weight = 1.0 if math.isinf(self.df) else (self.df + 1.0) / (self.df + z * z)
        return -weight * z / self.sd, weight / self.sd**2


@dataclass(frozen=True)
class Parameter:
    """A named value with everything a fit needs to know about it.

    unit: in words ("1/s²/radiance", "Hz", …);  lower, upper: bounds in that unit;
    transform: fitting coordinate, "log" (value > 0) or "linear";
    free: whether a fit moves it by default;  source: where the number comes from.

    Raises InputError for bounds that do not contain the value and for a log parameter that can reach 0.
    """

    name: str
    value: float
    unit: str = "1"
    lower: float = -math.inf
    upper: float = math.inf
    transform: str = "linear"
    prior: Prior | None = None
    free: bool = True
    source: str = ""

    def __post_init__(self) -> None:
        if self.transform not in ("log", "linear"):
            raise InputError(f"{self.name}: transform must be 'log' or 'linear', found {self.transform!r}")
        if not math.isfinite(self.value):
            raise InputError(f"{self.name}: the value must be finite, found {self.value}")
        if self.transform == "log" and not self.lower > 0:
            raise InputError(f"{self.name}: a log parameter needs a lower bound above 0, found {self.lower}")
        if not self.lower <= self.value <= self.upper:
            raise InputError(f"{self.name}: {self.value:g} lies outside its bounds {self.lower:g}..{self.upper:g}")

    @property
    def radiance_power(self) -> int:
        """n where the value is multiplied by k^n as the numbers of the light are multiplied by k; read off the unit of
        a parameter of the library, which says "radiance".

        >>> Parameter("alpha", 1.0, "1/s²/radiance").radiance_power, Parameter("on", 0.2, "log radiance").radiance_power
        (-1, 0)
        """
        numerator, *denominators = self.unit.split("/")
        return -1 if "radiance" in denominators else int(numerator == "radiance")

    def in_light(self, factor: float, power: int) -> Parameter:
        """The same parameter where the numbers of the light are `factor` times as large: value, bounds and prior.

        power: its `radiance_power`
        """
        if power == 0 or factor == 1.0:
            return self
        by, prior = factor**power, self.prior
        if prior is not None:
            log = self.transform == "log"
            prior = replace(
                prior, mean=prior.mean + math.log(by) if log else prior.mean * by, sd=prior.sd if log else prior.sd * by
            )
        return replace(self, value=self.value * by, lower=self.lower * by, upper=self.upper * by, prior=prior)

    def to_coordinate(self, value: float) -> float:
        """`value` in the fitting coordinate."""
        return math.log(value) if self.transform == "log" else value

    @overload
    def from_coordinate(self, coordinate: float) -> float: ...
    @overload
    def from_coordinate(self, coordinate: complex) -> complex: ...
    def from_coordinate(self, coordinate):
        """The value at a fitting coordinate; accepts complex steps."""
        if self.transform == "linear":
            return coordinate
        if isinstance(coordinate, complex):
            scale = math.exp(coordinate.real)
            return complex(scale * math.cos(coordinate.imag), scale * math.sin(coordinate.imag))
        return math.exp(coordinate)

    def coordinate_bounds(self) -> tuple[float, float]:
        """(lower, upper) in the fitting coordinate."""
        if self.transform == "log":
            return math.log(self.lower), (math.log(self.upper) if math.isfinite(self.upper) else math.inf)
        return self.lower, self.upper

    def at(self, value: float) -> Parameter:
        """The same parameter at another value, of which nothing is stated where it comes from."""
        return self if value == self.value else replace(self, value=float(value), source="")

    def within(self, value: float) -> float:
        """`value`, or the bound that it lies beyond."""
        return min(max(value, self.lower), self.upper)

    def fixed(self) -> Parameter:
        """The same parameter, not to be moved by fits."""
        return replace(self, free=False)

    def freed(self) -> Parameter:
        """The same parameter, to be moved by fits."""
        return replace(self, free=True)


def log_prior(parameters: Sequence[Parameter], x: Any) -> float:
    """ln of the density of all priors at coordinates (n,), up to a constant."""
    return sum(p.prior.log_density(c) for p, c in zip(parameters, x, strict=True) if p.prior is not None)


def precision_in_words(interval_95: tuple[float | None, float | None], parameter: Parameter) -> str:
    """How well a value of an interval is known; a side that is None, or at the parameter's bound, is open.

    >>> cutoff = Parameter("cutoff_hz", 300.0, "Hz", 1.0, 1e6, "log")
    >>> precision_in_words((100.0, 900.0), cutoff)
    'known to a factor of 3'
    >>> precision_in_words((1.0, 900.0), cutoff)
    'only an upper limit'
    """
    low, high = interval_95
    low = None if low is not None and low <= parameter.lower else low
    high = None if high is not None and high >= parameter.upper else high
    if low is None and high is None:
        return "not identified"
    if low is None:
        return "only an upper limit"
    if high is None:
        return "only a lower limit"
    if parameter.transform != "log":
        return f"known within {0.5 * (high - low):.2g} {parameter.unit}".rstrip()
    factor = math.sqrt(high / low)
    if factor < 1.3:
        return f"known within {100 * (factor - 1.0):.2g} %"
    return f"known to a factor of {factor:.2g}"
