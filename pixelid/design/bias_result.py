"""The result of a search for a setting of a bias."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from pixelid.design.bias_fits import read_bias_fit
from pixelid.design.biases import OPEN, QUANTITIES, recommend_setting
from pixelid.provenance import provenance
from pixelid.results import ContentResult, Table, interval, number

WISH_HEADINGS = ("quantity", "predicted", "95 %", "wanted", "unit", "met")
MEASURED_HEADINGS = ("setting", "bias [mV]", "bandwidth [Hz]", "95 %", "noise [1/s]", "95 % ", "meets")


@dataclass(frozen=True, repr=False)
class BiasReport(ContentResult):
    """A recommended setting of a bias.

    content: of design.json (docs/howto/design.md)
    """

    FILE: ClassVar[str] = "design.json"

    @property
    def headline(self) -> str:
        """Bias, setting and status."""
        best = self.content["recommended"]
        return f"set {self.content['bias'] or 'the bias'} to {best['bias_mv']:.0f} mV; {self.status}"

    def tables(self) -> list[Table]:
        """What the setting gives and what is wanted; what the fitted settings gave."""
        content = dict(self.content)
        wishes = tuple(tuple(row) for row in wish_rows(content))
        measured = tuple(tuple(row) for row in measured_rows(content))
        return [
            Table("", WISH_HEADINGS, wishes, frozenset({"quantity", "unit", "met"})),
            Table("settings that were measured", MEASURED_HEADINGS, measured, frozenset({"setting", "meets"})),
        ]

    def records(self) -> list[dict[str, Any]]:
        """One row per quantity predicted."""
        wishes = self.content["wishes"]
        return [
            {"quantity": name, "value": said["value"], "low": said["interval_95"][0], "high": said["interval_95"][1],
             "wanted": wishes[name]["wanted"] if name in wishes else None}
            for name, said in self.content["recommended"]["predicted"].items()
        ]  # fmt: skip

    def sentences(self) -> list[str]:
        """Why, and advice."""
        return [text for text in (self.content["why"], self.content["advice"]) if text]

    def write_companions(self, folder: Path) -> None:
        """Draw what was measured and predicted."""
        from pixelid.design.figures import write_bias_figure

        write_bias_figure(dict(self.content), folder)


def bias_report(
    folder: Path,
    wanted: Mapping[str, float],
    *,
    bias: str | None = None,
    frequency_hz: float | None = None,
    seed: int = 0,
) -> BiasReport:
    """The whole search, with provenance.

    Args:
        folder: of `pixelid rates --bias-law`.
        wanted: at least so much "bandwidth" [Hz], at most so much "noise" and "rate" [events/s]; any of them.
        bias: the name of the bias asked for.
        frequency_hz: of the blinking light that "rate" is of; the wanted bandwidth by default.
        seed: of the draws behind the events.

    Raises:
        InputError: nothing fitted says anything about the bias or a quantity that is wanted.

    Example:
        >>> bias_report(Path("rates"), {"bandwidth": 1000.0}).content["recommended"]  # doctest: +SKIP
    """
    fit = read_bias_fit(folder, bias)
    content = recommend_setting(fit, wanted, frequency_hz, seed)
    return BiasReport({**content, "model": str(folder), "seed": seed, **provenance(fit.source)})


def wish_rows(content: Mapping[str, Any]) -> list[list[str]]:
    """One row per quantity predicted at the recommended setting."""
    rows = []
    for name, said in content["recommended"]["predicted"].items():
        wish = content["wishes"].get(name)
        rows.append([
            name, number(said["value"]), "open" if _is_open(said["interval_95"]) else interval(said["interval_95"]),
            f"at {wish['at']} {wish['wanted']:g}" if wish else "–", QUANTITIES[name],
            ("surely" if wish["surely"] else "probably" if wish["met"] else "no") if wish else "",
        ])  # fmt: skip
    return rows


def _is_open(ends: Sequence[float]) -> bool:
    """Whether an interval reaches further than anything is known to that is called known."""
    low, high = ends
    return low <= 0.0 or math.log(high / low) > 2.0 * OPEN


def measured_rows(content: Mapping[str, Any]) -> list[list[str]]:
    """One row per setting of the table."""
    rows = []
    for one in content["measured_settings"]:
        cells = [one["column"], f"{one['bias_mv']:g}"]
        for name in ("bandwidth", "noise"):
            cells += [number(one[name]["value"]), interval(one[name]["interval_95"])] if one[name] else ["open", "–"]
        verdicts = {key.removeprefix("meets_"): value for key, value in one.items() if key.startswith("meets_")}
        words = {True: "yes", False: "no", None: "open"}
        cells.append(", ".join(f"{name}: {words[value]}" for name, value in verdicts.items()))
        rows.append(cells)
    return rows
