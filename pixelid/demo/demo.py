"""Calibrate the bench session that comes with the package, and compare the result with what was hidden in it.

The session was made by `benchmarks/make_demo_bench.py`, whose simulator shares no code with the package: 16 pixels,
chirps, steps and slow light at two levels, raw events and a photodiode's traces on clocks 40 ppm apart, a leak that the
start model lacks.  Calibration does not read truth.json.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from pixelid.bench.calibrate import calibrate
from pixelid.bench.result import Calibration
from pixelid.documents import read_json
from pixelid.fit.result import Estimate
from pixelid.model.model import CLOCK_RATE
from pixelid.outputs import write_json
from pixelid.report.html import write_report
from pixelid.results import Table, number

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


BENCH = Path(__file__).parent / "bench"
TRUTH = "truth.json"


@dataclass(frozen=True)
class Demo:
    """What was hidden, and what was found.

    result: the calibration;  values: hidden ones with their estimates;  hidden, named: missing effects
    """

    result: Calibration
    values: tuple[HiddenValue, ...]
    hidden: tuple[str, ...]
    named: tuple[str, ...]

    @property
    def sentence(self) -> str:
        """The answer."""
        return sentence(self.values, self.hidden, self.named)

    def as_dict(self) -> dict[str, Any]:
        """The content of demo.json."""
        return {
            "status": self.result.status,
            "sentence": self.sentence,
            "hidden_and_found": [value.as_dict() for value in self.values],
            "effects_hidden": list(self.hidden),
            "effects_named": list(self.named),
        }

    def table(self) -> Table:
        """Hidden and found, one row per value."""
        headings = ("parameter", "hidden", "found", "95 % interval", "truth is")
        rows = tuple(value.row() for value in self.values)
        return Table("hidden and found", headings, rows, frozenset({"parameter", "95 % interval", "truth is"}))


def copy_bench(folder: Path) -> None:
    """Copy the session into an existing folder."""
    for file in sorted(BENCH.iterdir()):
        shutil.copyfile(file, folder / file.name)


def run_demo(folder: Path, seed: int, progress: Callable[[str, float], None], resume: Path | None = None) -> Demo:
    """Calibrate the session, and write result, truth, comparison, figures and page into an existing folder.

    Args:
        folder: Of the result.
        seed: Of every choice.
        progress: Called with what is done and the fraction.
        resume: As of `calibrate`.
    """
    result = calibrate(BENCH, seed=seed, resume=resume, progress=progress)
    truth = read_json(BENCH / TRUTH)
    named = () if result.gap is None else tuple(effect.name for effect in result.gap.effects)
    values = tuple(hidden_and_found(truth, result.fit.estimates))
    demo = Demo(result, values, tuple(truth["effects"]), named)
    result.write(folder)
    write_json(folder / "demo.json", demo.as_dict())
    shutil.copyfile(BENCH / TRUTH, folder / TRUTH)
    result.write_figures(folder)
    write_report(folder)
    return demo
