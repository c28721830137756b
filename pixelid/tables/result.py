"""The way out of every table: status, parameters, what is open, rows, provenance; a folder with JSON and figures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from pixelid.figures.style import save_figure
from pixelid.outputs import write_json
from pixelid.status import STOPPED
from pixelid.tables.fit import TableFit


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


def write_result(
    result: dict[str, Any], file: str, figures: Mapping[str, Callable[[], Any]], folder: Path
) -> dict[str, Any]:
    """Write the JSON of a table and its figures into an existing folder; returns the JSON.

    Args:
        result: its content.
        file: its name, as `rates.json`.
        figures: by name, functions that draw and return axes.
        folder: where to.
    """
    write_json(folder / file, result)
    for name, draw in figures.items():
        save_figure(draw(), folder / f"{name}.svg")
    return result
