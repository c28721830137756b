"""What was hidden in the session of the demo, and what its calibration found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from pixelid.fit.result import Estimate
from pixelid.model.model import CLOCK_RATE
from pixelid.results import number

# Names of truth.json → of the model's parameters, where they differ.
PARAMETERS = {"threshold_mismatch": "threshold_mismatch.sigma"}
SAME = (
    "alpha", "beta", "gamma", "sf_cutoff_hz", "diff_cutoff_hz", "on_threshold", "off_threshold", "threshold_sigma",
    "refractory_s",
)  # fmt: skip
EFFECTS = {"leak": "leak.rate_hz"}  # effect → the parameter that is its strength
PPM = 1e-6


@dataclass(frozen=True)
class HiddenValue:
    """A value of the hidden camera or its bench, and its estimate.

    name, unit: of the parameter;  hidden: the truth;  found, interval_95: the estimate, None where nothing estimates it
    inside: whether the interval holds the truth, None without an interval
    """

    name: str
    unit: str
    hidden: float
    found: float | None
    interval_95: tuple[float | None, float | None] | None
    inside: bool | None

    def as_dict(self) -> dict[str, Any]:
        """The entry in demo.json."""
        return asdict(self)

    def row(self) -> tuple[str, str, str, str, str]:
        """Parameter, truth, estimate, interval, and whether that holds the truth."""
        low, high = self.interval_95 or (None, None)
        interval = "–" if self.interval_95 is None else f"{number(low)} to {number(high)}"
        inside = {True: "inside", False: "outside", None: "not estimated"}[self.inside]
        return self.name, number(self.hidden), number(self.found), interval, inside


def hidden_values(truth: Mapping[str, Any]) -> dict[str, float]:
    """Parameter → value, of everything in truth.json that a calibration can estimate."""
    circuit = {name: float(truth[name]) for name in SAME}
    spread = {ours: float(truth[name]) for name, ours in PARAMETERS.items()}
    effects = {EFFECTS[name]: float(strength) for name, strength in truth["effects"].items()}
    return circuit | spread | effects | {CLOCK_RATE.name: PPM * truth["clock_ppm"]}


def hidden_and_found(truth: Mapping[str, Any], estimates: Mapping[str, Estimate]) -> list[HiddenValue]:
    """Each hidden value with its estimate.

    Args:
        truth: The content of truth.json.
        estimates: Of a calibration's fit.
    """
    compared = []
    for name, value in hidden_values(truth).items():
        estimate = estimates.get(name)
        if estimate is None:
            compared.append(HiddenValue(name, "", value, None, None, None))
            continue
        interval = estimate.interval_95
        compared.append(
            HiddenValue(name, estimate.unit, value, estimate.value, interval, interval and _holds(interval, value))
        )
    return compared


def sentence(values: Sequence[HiddenValue], hidden: Sequence[str], named: Sequence[str]) -> str:
    """The answer in one sentence.

    Args:
        values: As `hidden_and_found` gives them.
        hidden, named: Effects that the start model lacks, and those that the calibration named.
    """
    inside = sum(value.inside is True for value in values)
    found = [name for name in hidden if name in named]
    missed, wrong = [n for n in hidden if n not in named], [n for n in named if n not in hidden]
    parts = [f"{inside} of {len(values)} hidden values lie in their 95 % intervals"]
    parts += [f"the missing effect was found: {_words(found)}"] if found else []
    parts += [f"missed: {_words(missed)}"] if missed else []
    parts += [f"named, and not there: {_words(wrong)}"] if wrong else []
    return "; ".join(parts)


def _holds(interval: tuple[float | None, float | None], value: float) -> bool:
    low, high = interval
    return (low is None or low <= value) and (high is None or value <= high)


def _words(names: Sequence[str]) -> str:
    return ", ".join(name.replace("_", " ") for name in names)
