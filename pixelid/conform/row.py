"""One line of the table: an effect or a quantity of the signal path, and whether these recordings have it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from pixelid.gap.result import Limits
from pixelid.results import interval, number

PRESENT, ABSENT, NOT_DECIDABLE, NOT_TESTED = VERDICTS = ("present", "absent", "not_decidable", "not_tested")
STAGES = ("photocurrent", "photoreceptor", "source_follower", "differencing", "comparator", "readout")

Strength = tuple[float, Limits]


@dataclass(frozen=True)
class Row:
    """One effect of the library, or a quantity that every pixel has.

    Attributes:
        effect: Its name.
        stage: One of `STAGES`.
        verdict: One of `VERDICTS`.
        why: In words.
        parameters: Name → (value, 95 % interval), where it is present.
        p_value: Of its gain, adjusted for what was tried with it; None where no gain was taken.
        gain_nats, heldout_gain_nats: On pixels fitted, and on pixels that no fit has seen.
        shows_nats: By how much it would show at its typical strength.
        limit: (parameter, strength from which on it would have shown), where it is absent.
    """

    effect: str
    stage: str
    verdict: str
    why: str
    parameters: Mapping[str, Strength] = field(default_factory=dict)
    p_value: float | None = None
    gain_nats: float | None = None
    heldout_gain_nats: float | None = None
    shows_nats: float | None = None
    limit: tuple[str, float] | None = None

    def as_dict(self) -> dict[str, Any]:
        """Its entry in conform.json."""
        limit = {"parameter": self.limit[0], "value": self.limit[1]} if self.limit else None
        return {
            "effect": self.effect,
            "stage": self.stage,
            "verdict": self.verdict,
            "parameters": {k: {"value": v, "interval_95": i} for k, (v, i) in self.parameters.items()},
            "evidence": {
                "why": self.why,
                "p_value": self.p_value,
                "gain_nats": self.gain_nats,
                "heldout_gain_nats": self.heldout_gain_nats,
                "shows_at_typical_strength_nats": self.shows_nats,
                "detection_limit": limit,
            },
        }


def strengths_in_words(entry: Mapping[str, Any]) -> str:
    """The strengths of a row of conform.json with their intervals, or from which on it would have shown."""
    limit = entry["evidence"]["detection_limit"]
    if limit:
        return f"limit: {limit['parameter']} {number(limit['value'])}"
    return "; ".join(
        f"{name} {number(each['value'])}" + (f" ({interval(each['interval_95'])})" if each["interval_95"] else "")
        for name, each in entry["parameters"].items()
    )
