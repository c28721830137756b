"""The way out of every table: status, parameters, what is open, rows, provenance; a result with its figures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pixelid.figures.style import save_figure
from pixelid.results import ContentResult, Table, interval, number
from pixelid.status import STOPPED
from pixelid.tables.fit import TableFit

HEADINGS = ("parameter", "value", "95 % interval", "unit", "identified?")


@dataclass(frozen=True, repr=False)
class TableResult(ContentResult):
    """What a table of measurements shows of a circuit: fitted, or predicted.

    content: of the JSON (docs/formats.md);  figures: by name, functions that draw and return axes
    companions: writes what belongs next to the JSON into a folder, as models and chains
    """

    figures: Mapping[str, Callable[[], Any]]
    companions: Callable[[Path], None] = lambda folder: None

    @property
    def headline(self) -> str:
        """What was fitted, and how it ended."""
        scatter = self.content.get("relative_scatter")
        words = f", scatter {scatter:.1%}" if isinstance(scatter, float) else ""
        return f"{self.FILE.removesuffix('.json')}: {self.status}{words}"

    def tables(self) -> list[Table]:
        """The parameters."""
        rows = tuple(
            (name, number(p["value"]), interval(p["interval_95"]), p["unit"], self._known(name, p))
            for name, p in self.content["parameters"].items()
        )
        return [Table("", HEADINGS, rows, frozenset({"parameter", "unit", "identified?"}))]

    def _known(self, name: str, parameter: Mapping[str, Any]) -> str:
        """How well a parameter is known, in words."""
        precision = self.content.get("precision", {}).get(name, "")
        return precision or ("fixed" if parameter.get("fixed") else "yes" if parameter["identified"] else "no")

    def records(self) -> list[dict[str, Any]]:
        """One row per parameter."""
        return [{"parameter": name, **entry} for name, entry in self.content["parameters"].items()]

    def sentences(self) -> list[str]:
        """Advice, and where table and model disagree."""
        return [self.content["advice"], *self.content["disagreements"]]

    def write_companions(self, folder: Path) -> None:
        """Write the figures, and what else belongs to the result."""
        self.companions(folder)
        for name, draw in self.figures.items():
            save_figure(draw(), folder / f"{name}.svg")


def table_result(fit: TableFit, name: str, observation: str) -> dict[str, Any]:
    """The keys that every fitted table of values has in common.

    Args:
        fit: the finished fit.
        name: of the observation model.
        observation: kind of the table, as `fit.json` calls kinds of likelihood.
    """
    status, advice = fit.judge()
    parameters = fit.as_dict()
    return {
        "status": status,
        "advice": advice,
        "model": name,
        "observation": observation,
        "parameters": parameters,
        "unidentified": open_sentences(parameters, at_rest=fit.converged),
        "relative_scatter": fit.scale,
        "log_likelihood": fit.log_likelihood,
        "cells_fitted": len(fit.residual),
        "rows": fit.as_rows(),
    }


def open_sentences(parameters: Mapping[str, dict[str, Any]], *, at_rest: bool = True) -> list[str]:
    """One sentence per parameter that the table leaves open; one of all where the regression did not come to rest."""
    if not at_rest:
        return [STOPPED]
    return [
        f"{name}: not identified, 95 % interval {v['interval_95'][0]:.3g} to {v['interval_95'][1]:.3g} {v['unit']}"
        for name, v in parameters.items()
        if not v["identified"]
    ]
