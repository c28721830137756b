"""Circuits as uncertain as a fit left them: draws from the normal distribution around its optimum."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from pixelid.documents import read_json
from pixelid.errors import InputError, shown
from pixelid.model.model import Model
from pixelid.results import check_parameters, number_or_none
from pixelid.statistics import Z95

WIDEST = 1.0  # standard deviation, in fitting coordinates, beyond which an open direction is not followed


def read_fit(folder: Path) -> dict[str, Any] | None:
    """The fit.json of a fit folder, or None when `folder` is no folder or holds no fit.

    Raises InputError when the file is not a fit's.
    """
    path = Path(folder) / "fit.json"
    if not path.is_file():
        return None
    document = read_json(path)
    check_parameters(document, path)
    _check_covariance(document.get("covariance"), path)
    pixels = document.get("pixels")
    if pixels is not None and (not isinstance(pixels, int) or isinstance(pixels, bool) or pixels < 1):
        raise InputError(f"{path}: pixels: expected a positive whole number, found {shown(pixels)}")
    return document


def _check_covariance(listed: object, path: Path) -> None:
    """Refuse anything but names and a square matrix of as many rows, entries null where unknown."""
    if not listed:
        return
    names = listed.get("names") if isinstance(listed, dict) else None
    if not isinstance(listed, dict) or not isinstance(names, list) or not all(isinstance(n, str) for n in names):
        raise InputError(f"{path}: covariance.names: expected the names of parameters, found {shown(names)}")
    matrix = listed.get("matrix")
    n = len(names)
    rows: list[Any] = matrix if isinstance(matrix, list) and len(matrix) == n else [None]
    if not all(isinstance(row, list) and len(row) == n and all(map(number_or_none, row)) for row in rows):
        raise InputError(f"{path}: covariance.matrix: expected {n} rows of as many numbers, found {shown(matrix)}")
    largest = max((abs(value) for row in rows for value in row if value is not None), default=0.0)
    most_variance = 1e100  # larger ones overflow when they are factored
    if largest > most_variance or len(set(names)) < n:
        raise InputError(
            f"{path}: covariance: expected each name once and numbers of at most {most_variance:g}, found "
            f"{shown(names)} and {largest:g}"
        )


def uncertainty(fit: dict, model: Model) -> tuple[list[str], np.ndarray]:
    """(names, covariance (n, n) in their fitting coordinates) of the model's parameters that the fit left free.

    From the covariance in fit.json; where that is missing, from the intervals, as if they were independent.
    """
    listed = fit.get("covariance")
    if listed:
        matrix = np.array(listed["matrix"], dtype=float)
        keep = [i for i, name in enumerate(listed["names"]) if name in model.parameters]
        if np.isfinite(matrix).all():
            return [listed["names"][i] for i in keep], matrix[np.ix_(keep, keep)]
    names, variances = [], []
    for name, entry in fit["parameters"].items():
        if name in model.parameters and entry.get("interval_95") and not entry.get("fixed"):
            parameter = model.parameters[name]
            low, high = entry["interval_95"]  # None where a side is open: to the bound
            low = parameter.to_coordinate(parameter.lower if low is None else parameter.within(low))
            high = parameter.to_coordinate(parameter.upper if high is None else parameter.within(high))
            names.append(name)
            variances.append(((high - low) / (2 * Z95)) ** 2)
    return names, np.diag(variances)


def drawn(model: Model, names: list[str], covariance: np.ndarray, count: int, rng: np.random.Generator) -> list[Model]:
    """`count` models drawn around `model`; values stay inside their bounds, open directions within `WIDEST`."""
    if not names:
        return [model] * count
    eigenvalues, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.clip(eigenvalues, 0.0, WIDEST**2))
    centre = np.array([model.parameters[name].to_coordinate(model.parameters[name].value) for name in names])
    points = centre + rng.standard_normal((count, len(names))) @ root.T
    return [model.set(_inside(model, names, point)) for point in points]


def _inside(model: Model, names: list[str], point: np.ndarray) -> dict[str, float]:
    values = {}
    for name, coordinate in zip(names, point, strict=True):
        parameter = model.parameters[name]
        value = parameter.from_coordinate(float(coordinate))
        values[name] = min(max(value, parameter.lower), parameter.upper)
    return values
