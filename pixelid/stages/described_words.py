"""Descriptions in words, with their numbers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pixelid.stages.described import Described, cell
from pixelid.stages.modulation import THRESHOLDS

SUBJECT = {
    "on_threshold": "threshold of ON events",
    "off_threshold": "threshold of OFF events",
    "threshold": "thresholds of both polarities",
    "dead_time": "dead time",
    "light": "light at the pixel",
    "response": "light that the pixel responds to",
    "rate": "bandwidth of the photoreceptor",
}


def in_words(own: Described, values: Mapping[str, float]) -> str:
    """A description as a phrase; values: by the part of a parameter's name after the last dot.

    >>> from pixelid.stages.described import cell
    >>> in_words(cell("on_threshold", "previous_polarity", "constant"), {"strength": -0.04})
    'threshold of ON events 4 % lower after an ON event, 4 % higher after an OFF event'
    """
    s = values["strength"]
    if own.quantity == "leak":
        rate = f"{s:.3g} Hz" + (" per unit of radiance" if own.covariate == "radiance" else "")
        return f"the change drifts upwards: ON events in constant light at {rate}"
    if own.quantity == "low_pass":
        return f"the signal lags behind, as through one more low-pass of {1e6 * s:.3g} µs"
    if own.quantity == "high_pass":
        return f"slow changes fade, as through a high-pass of {s:.3g} Hz"
    subject = SUBJECT[own.quantity]
    if own.covariate == "none":
        return f"{subject} {_amount(own, s)} than the model's"
    if own.covariate == "previous_polarity":
        first, second = (
            ("after an event of the same polarity", "after one of the other polarity")
            if own.quantity == "threshold"
            else ("after an ON event", "after an OFF event")
        )
        return f"{subject} {_amount(own, s)} {first}, {_amount(own, -s)} {second}"
    # Of a power's exponent.  Over a decade it is a line in the logarithm but for a seventh of what it adds; its
    # strength says little (a power of 0.06 comes with 70 %, and the rest of the quantity takes that back).
    nearly_a_logarithm = 0.25
    if own.form == "power" and abs(values["exponent"]) < nearly_a_logarithm:
        return f"{subject} {_amount(own, _per_tenfold(own, values))} with every tenfold {_covariate(own)}{_before(own)}"
    return f"{subject} {_amount(own, s)} {_where(own, values)}"


def _per_tenfold(own: Described, values: Mapping[str, float]) -> float:
    """By how much a power changes a quantity between a covariate of √10 times less and √10 times more than its
    reference: relative, a dead time in seconds."""
    low, high = (values["strength"] * 10.0 ** (0.5 * sign * values["exponent"]) for sign in (-1.0, 1.0))
    return high - low if own.quantity == "dead_time" else (1.0 + high) / (1.0 + low) - 1.0


def words_of_entry(entry: Mapping[str, Any]) -> str:
    """The same of an entry of gap.json."""
    own = cell(entry["quantity"], entry["covariate"], entry["form"])
    return in_words(own, {name: found["value"] for name, found in entry["parameters"].items()})


def _amount(own: Described, strength: float) -> str:
    if own.quantity == "dead_time":
        return f"{1e6 * abs(strength):.3g} µs {'longer' if strength > 0 else 'shorter'}"
    if own.quantity in (*THRESHOLDS, "rate", "light", "response"):
        return f"{100 * abs(strength):.3g} % {'higher' if strength > 0 else 'lower'}"
    raise AssertionError(own.quantity)


def _where(own: Described, values: Mapping[str, float]) -> str:
    if own.covariate == "time_since_event":
        return f"just after an event, the difference fading within {_seconds(values['scale'])} (to 1/e)"
    if own.covariate == "time_in_recording":
        return {
            "linear": lambda: "with every second of a recording",
            "relaxation": lambda: f"when a recording begins, fading within {_seconds(values['scale'])} (to 1/e)",
            "step": lambda: f"from {_seconds(values['edge'])} of a recording on",
        }[own.form]()
    name, before = _covariate(own), _before(own)
    unit, least = ("", "in the dark") if own.covariate == "radiance" else (" per second", "in constant light")
    return {
        "power": lambda: (
            f"at a {name} of {values['reference']:.3g}{unit}{before}, as its power {values['exponent']:.3g} elsewhere"
        ),
        "relaxation": lambda: f"{least}, fading with {name}{before}, to 1/e at {values['scale']:.3g}{unit}",
        "step": lambda: f"where {name}{before} exceeds {values['edge']:.3g}{unit}",
    }[own.form]()


def _before(own: Described) -> str:
    return " at the event before" if own.quantity in THRESHOLDS or own.quantity == "dead_time" else ""


def _covariate(own: Described) -> str:
    return "radiance" if own.covariate == "radiance" else "speed |d ln L/dt|"


def _seconds(value: float) -> str:
    return f"{value:.3g} s" if value >= 1.0 else f"{1e3 * value:.3g} ms"
