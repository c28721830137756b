"""A fit as a table for the terminal."""

from __future__ import annotations

from collections.abc import Mapping

from pixelid.fit.result import FitResult


def number(value: float | None) -> str:
    """Four significant digits, or a dash."""
    return "–" if value is None else f"{value:.4g}"


def fit_table(result: FitResult, truth: Mapping[str, float] | None = None):
    """A rich table: value, 95 % interval, whether it is identified; and the truth when it is known."""
    from rich.table import Table

    table = Table(title=f"{result.model.name}: {result.events} events, {result.pixels} pixels, {result.observation}")
    for heading in ("parameter", "value", "95 % interval", "unit", "known?", *(("truth",) if truth else ())):
        table.add_column(heading, justify="left" if heading in ("parameter", "unit", "known?") else "right")
    for name, estimate in result.estimates.items():
        interval = estimate.interval_95
        row = [
            name,
            number(estimate.value),
            f"{number(interval[0])} … {number(interval[1])}" if interval else "–",
            estimate.unit,
            "fixed" if estimate.fixed else ("yes" if estimate.identified else "NO"),
        ]
        if truth:
            row.append(number(truth.get(name)))
        table.add_row(*row)
    return table
