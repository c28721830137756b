"""Intervals of parameters on one logarithmic axis, each relative to a reference: text, and lines that scale."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup

from pixelid.report.format import interval, number
from pixelid.report.quantities import STAGES, Quantity, quantity

APART, EDGE = 14.0, 3.0  # per cent of the axis between labels, and to its ends: a label is 25 px, an axis 180 in print
HEIGHT, MIDDLE = 26, 13  # of a row, in pixels


@dataclass(frozen=True)
class Row:
    """One parameter of a forest.

    reference: what it is relative to;  start, truth: relative to that, None where there is none
    at, low, high: value and interval relative to the reference; None where they have no logarithm
    """

    quantity: Quantity
    reference: float
    at: float
    low: float | None
    high: float | None
    start: float | None
    truth: float | None
    added: bool


@dataclass(frozen=True)
class Forest:
    """rows: with their tracks as SVG;  axis: the ticks as SVG;  truths: whether any row has one."""

    rows: list[tuple[Row, Markup]]
    axis: Markup
    truths: bool
    starts: bool


def forest(
    parameters: Mapping[str, Mapping[str, Any]],
    start: Mapping[str, float],
    truth: Mapping[str, float],
    added: Collection[str] = (),
    *,
    stages_only: bool = True,
) -> Forest:
    """The forest of a result's free parameters that are positive.

    Args:
        parameters: as a result's JSON has them.
        start: values of the start model by parameter; parameters without one are relative to their own estimate.
        truth: true values by parameter, where they are known.
        added: effects that the start model lacked.
        stages_only: parameters of the pixel's stages, in the order of the signal path; else all, in their own.
    """
    rows = [_row(quantity(name, p), p, start.get(name), truth.get(name), added) for name, p in parameters.items()]
    drawn = [row for row in rows if row is not None and (row.quantity.stage or not stages_only)]
    if stages_only:
        drawn.sort(key=lambda row: list(STAGES).index(row.quantity.stage))
    low, high = _range(drawn)
    ticks = _ticks(low, high)
    return Forest(
        [(row, _track(row, low, high, ticks)) for row in drawn],
        _axis(low, high, ticks),
        any(row.truth is not None for row in drawn),
        any(row.start is not None for row in drawn),
    )


def _row(
    q: Quantity, entry: Mapping[str, Any], start: float | None, truth: float | None, added: Collection[str]
) -> Row | None:
    estimate = entry["value"]
    if q.fixed or not estimate or estimate <= 0 or not math.isfinite(estimate):
        return None
    reference = start if start is not None and start > 0 else estimate
    ends = entry.get("interval_95") or (None, None)
    low, high = (None if end is None or end < 0 else end / reference for end in ends)
    return Row(
        q,
        reference,
        estimate / reference,
        low,
        high,
        1.0 if reference == start else None,
        truth / reference if truth is not None and truth > 0 else None,
        q.effect in added,
    )


def _range(rows: Sequence[Row]) -> tuple[float, float]:
    """Decades from the reference that the axis spans: all values, and the intervals of what is identified."""
    every = [value for r in rows for value in (r.start, r.truth) if value]
    every += [value for r in rows if r.quantity.identified for value in (r.at, r.low, r.high) if value]
    logs = [math.log10(value) for value in every] or [0.0]
    widest = 1.5  # decades on either side of the reference, beyond which an interval ends in an arrow
    low, high = max(min(logs), -widest), min(max(logs), widest)
    margin = 0.04 * (high - low) + 0.01
    narrowest = 0.06  # decades on either side: an axis of less would magnify what nobody can use
    return min(low - margin, -narrowest), max(high + margin, narrowest)


def _ticks(low: float, high: float) -> list[float]:
    """Round ratios within a range of decades, as many as fit."""
    chosen = [1.0]
    most_ticks = 7  # that stand apart on a phone
    for steps in ((1.0,), (1.0, 3.0), (1.0, 2.0, 5.0), (1.0, 1.5, 2.0, 3.0, 5.0, 7.0)):
        ticks = [m * 10.0**k for k in range(-4, 5) for m in steps]
        inside = [t for t in ticks if low <= math.log10(t) <= high]
        if len(inside) > most_ticks:
            return chosen
        chosen = inside or chosen
    for width in (0.2, 0.1, 0.05):
        inside = [1.0 + width * k for k in range(-20, 60) if 1.0 + width * k > 0]
        inside = [round(t, 3) for t in inside if low <= math.log10(t) <= high]
        if len(inside) > most_ticks:
            return chosen
        chosen = inside if len(inside) > len(chosen) else chosen
    return chosen


def _percent(value: float, low: float, high: float) -> float:
    """Where a ratio stands on the axis, in per cent of its width."""
    return 100.0 * (math.log10(value) - low) / (high - low)


def _track(row: Row, low: float, high: float, ticks: Sequence[float]) -> Markup:
    """The line of a row: ticks, interval, start, estimate and truth, placed in per cent of its width."""
    parts = [_upright("one" if tick == 1.0 else "grid", _percent(tick, low, high), 0) for tick in ticks]
    if row.low is not None or row.high is not None:
        parts += _interval(
            _percent(row.low, low, high) if row.low else -1.0, _percent(row.high, low, high) if row.high else 101.0
        )
    if row.start is not None:
        parts.append(_upright("start", _percent(row.start, low, high), 4))
    at = _percent(row.at, low, high)
    if 0 <= at <= 100:
        parts.append(Markup('<circle class="at" cx="{:.2f}%" cy="{}" r="3.5"/>').format(at, MIDDLE))
    if row.truth is not None and 0 <= (x := _percent(row.truth, low, high)) <= 100:
        parts.append(_shape("truth", x, "M-5 -5 5 5M5 -5-5 5"))
    kind = "added" if row.added else "" if row.quantity.identified else "open"
    return Markup(
        '<svg class="track {}" width="100%" height="{}" role="img" aria-label="{}"><title>{}</title>{}</svg>'
    ).format(kind, HEIGHT, _in_words(row), _in_words(row), Markup("").join(parts))


def _interval(left: float, right: float) -> list[Markup]:
    """A line between two places, which ends in an arrow where it goes on beyond the axis."""
    ends = [min(max(end, 0.0), 100.0) for end in (left, right)]
    line = '<line class="interval" x1="{:.2f}%" x2="{:.2f}%" y1="{m}" y2="{m}"/>'
    parts = [Markup(line).format(*ends, m=MIDDLE)]
    if left < 0:
        parts.append(_shape("end", 0.0, "M6 -4 0 0 6 4"))
    if right > 100:
        parts.append(_shape("end", 100.0, "M-6 -4 0 0 -6 4"))
    return parts


def _upright(kind: str, x: float, margin: int) -> Markup:
    line = '<line class="{}" x1="{x:.2f}%" x2="{x:.2f}%" y1="{}" y2="{}"/>'
    return Markup(line).format(kind, margin, HEIGHT - margin, x=x)


def _shape(kind: str, x: float, path: str) -> Markup:
    """A path of fixed size about a place."""
    inner = '<svg x="{:.2f}%" y="{}" overflow="visible" aria-label="{}"><path class="{}" d="{}"/></svg>'
    return Markup(inner).format(x, MIDDLE, kind, kind, path)


def _in_words(row: Row) -> str:
    known = f" ({interval((row.low, row.high))})" if row.low is not None and row.high is not None else ""
    truth = "" if row.truth is None else f"; truth {number(row.truth, 3)}"
    return f"{row.quantity.label}: {number(row.at, 3)} times the reference{known}{truth}"


def _axis(low: float, high: float, ticks: Sequence[float]) -> Markup:
    labelled: list[float] = []
    for tick in sorted(ticks, key=lambda tick: abs(math.log10(tick))):  # the reference first, then outwards
        at = _percent(tick, low, high)
        if tick == 1.0 or (
            EDGE <= at <= 100.0 - EDGE and all(abs(at - _percent(t, low, high)) >= APART for t in labelled)
        ):
            labelled.append(tick)
    labels = Markup("").join(
        Markup('<text x="{:.2f}%" y="14">{}</text>').format(_percent(tick, low, high), f"×{tick:g}")
        for tick in sorted(labelled)
    )
    return Markup('<svg class="axis" width="100%" height="18" role="img" aria-label="ratio axis">{}</svg>').format(
        labels
    )
