"""Calibrate the bench session that comes with the package, and compare the result with what was hidden in it.

The session was made by `benchmarks/make_demo_bench.py`, whose simulator shares no code with the package: 16 pixels,
chirps, steps and slow light at two levels, raw events and a photodiode's traces on clocks 40 ppm apart, a leak that the
start model lacks.  Calibration does not read truth.json.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pixelid.bench.calibrate import calibrate
from pixelid.bench.result import Calibration
from pixelid.demo.hidden import HiddenValue, hidden_and_found, sentence
from pixelid.documents import read_json
from pixelid.outputs import write_json
from pixelid.report.html import write_report
from pixelid.results import Table

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
