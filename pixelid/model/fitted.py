"""What a fitted model says of itself: the fit and interval of each fitted value, and circuit values that follow.

A model that keeps the sources, summary and [physical] values of the circuit it was started from would pass measured
numbers off as published ones.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Mapping
from dataclasses import replace
from datetime import date

from pixelid.errors import InputError
from pixelid.model.model import Model
from pixelid.parameters.invariants import INVARIANTS, Physical

NO_CIRCUIT = "the model has no second-order photoreceptor with [physical] values"

Limits = tuple[float | None, float | None] | None  # of a 95 % interval; None for a side that is open


def today() -> str:
    """The date, as results carry it."""
    return date.today().isoformat()


def fit_hash(kind: str, model: Model, made_of: object) -> str:
    """A short name of one fit: of its values, and of what it was made of.

    Args:
        kind: of the result, as "fit".
        model: with the fitted values.
        made_of: what else distinguishes it from other fits, as JSON.
    """
    content = json.dumps([kind, model.name, model.values, made_of], sort_keys=True, default=str)
    hash_digits = 12  # of SHA-256: two of a million fits share one with a chance of 2e-3
    return hashlib.sha256(content.encode()).hexdigest()[:hash_digits]


def fitted_source(fit: str, day: str, limits: Limits, identified: bool = True) -> str:
    """Where a fitted value comes from.

    >>> fitted_source("3f2a", "2026-11-30", (0.2465, 0.2489))
    'fitted: 3f2a, 2026-11-30, 95 % interval 0.2465..0.2489'
    """
    low, high = ("" if end is None else f"{end:.4g}" for end in limits or (None, None))
    parts = [f"fitted: {fit}", day, f"95 % interval {low}..{high}" if low or high else ""]
    return ", ".join([part for part in parts if part] + ([] if identified else ["not identified"]))


def implied_physical(model: Model) -> tuple[Physical | None, str]:
    """The circuit values that α, β and γ imply under the model's gauge, or None and why there are none."""
    if model.physical is None or model.photoreceptor != "second_order":
        return None, NO_CIRCUIT
    alpha, beta, gamma = (model.values[name] for name in INVARIANTS)
    try:
        return model.gauge.physical(alpha, beta, gamma, model.physical), ""
    except InputError as error:
        return None, str(error)


def as_fitted(
    model: Model,
    *,
    fit: str,
    day: str,
    to: str,
    fitted: Collection[str],
    limits: Mapping[str, Limits],
    unidentified: Collection[str] = (),
    physical: tuple[Physical | None, str] | None = None,
) -> Model:
    """The model with sources, summary and circuit values of its fit; values that were held keep their source.

    Args:
        model: with the fitted values.
        fit: its hash.
        day: when it was fitted, as ISO date; empty where that is not known.
        to: what it was fitted to, in words.
        fitted: names of the fitted parameters.
        limits: name → 95 % interval, where there is one.
        unidentified: names of the parameters that the data leave open.
        physical: circuit values, or None with the reason; what the gauge implies by default.

    Returns:
        The model; unchanged where it says so already, as one that comes back from a file.
    """
    if any(model.parameters[name].source.startswith(f"fitted: {fit},") for name in fitted if name in model.parameters):
        return model
    circuit, why = implied_physical(model) if physical is None else physical
    parameters = {
        name: replace(p, source=fitted_source(fit, day, limits.get(name), name not in unidentified))
        if name in fitted
        else p
        for name, p in model.parameters.items()
    }
    summary = f"{model.name} fitted to {to} (fit {fit}{f', {day}' if day else ''})."
    if circuit is None and why and why != NO_CIRCUIT:
        summary += f" No [physical] values: {why}."
    statements = ", ".join(f"{name} = {value}" for name, value in model.gauge.statements().items())
    source = f"fitted: {fit}, as {', '.join(INVARIANTS)} imply with {statements}" if circuit else ""
    return replace(model, parameters=parameters, summary=summary, physical=circuit, physical_source=source)
