"""How thresholds differ between pixels: by the same amount at every setting (additive), or in proportion (relative).

With additive deviations α of standard deviation A, relative ones ρ of R, and errors of the map N, a pixel's threshold
at a setting of mean θ is θ (1 + ρ) + α + error:

    sd² = A² + R² θ² + N²,        covariance of two settings = A² + R² θ₁ θ₂

The comparator's offset is additive, a mismatch of capacitors relative.  Spreads of a table give A² + N² and R² by
regression of sd² on θ²; maps of two settings give all three.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pixelid.arrays import load_arrays
from pixelid.errors import InputError
from pixelid.statistics import SD_PER_MEDIAN, Z95
from pixelid.tables.biases.reading import BiasTable

LEAST_APART = 1.2  # ratio of two settings' thresholds; nearer, the two kinds do not part
NAME = re.compile(r"^(on|off)_(.+)$", re.IGNORECASE)


def of_spreads(table: BiasTable) -> dict[str, Any] | None:
    """A and R from the spreads of a table's settings; None where it has none, or too few."""
    kept = np.isfinite(table.spread) & (table.spread > 0.0) if len(table.spread) else np.zeros(0, bool)
    theta, sd = table.measured[kept], table.spread[kept]
    least_rows = 4
    if len(sd) < least_rows or theta.max() < LEAST_APART * theta.min():
        return None
    weight = sd.mean() ** 2 / sd**2  # relative errors are alike
    X = np.column_stack([np.ones(len(sd)), theta**2])
    squares, *_ = np.linalg.lstsq(X * weight[:, None], sd**2 * weight, rcond=None)
    rest = (sd**2 - X @ squares) * weight
    covariance = np.linalg.inv((X * weight[:, None] ** 2).T @ X) * float(rest @ rest) / max(len(sd) - 2, 1)
    return _parts(squares, np.sqrt(np.diag(covariance)), float(np.median(theta)), table.unit) | {
        "from": "spreads", "quantity": table.name, "settings": len(sd)
    }  # fmt: skip


def of_maps(path: Path) -> list[dict[str, Any]]:
    """A, R and N from maps of one polarity at two settings, of an .npz with arrays named POLARITY_SETTING.

    Raises:
        InputError: arrays of other names or shapes.
    """
    maps: dict[str, dict[str, np.ndarray]] = {}
    arrays = load_arrays(path)
    for name, array in arrays.items():
        match = NAME.match(name)
        if match is None or array.ndim != 2 or array.dtype.kind not in "fiu":
            raise InputError(f"{path}: {name}: expected maps (height, width) named as on_SETTING or off_SETTING")
        maps.setdefault(match[1].lower(), {})[match[2]] = np.abs(array.astype(float))
    return [
        entry
        for edge, of_edge in maps.items()
        for one, other in itertools.combinations(of_edge, 2)
        if (entry := _of_pair(path, edge, {name: of_edge[name] for name in (one, other)})) is not None
    ]


def _of_pair(path: Path, edge: str, pair: Mapping[str, np.ndarray]) -> dict[str, Any] | None:
    a, b = pair.values()
    if a.shape != b.shape:
        raise InputError(f"{path}: {edge}: expected maps of one shape, found {a.shape} and {b.shape}")
    a, b = a.ravel(), b.ravel()
    kept = np.isfinite(a) & np.isfinite(b)
    most_sd = 5.0  # robust standard deviations: pixels beyond are defects
    for x in (a, b):
        middle = float(np.median(x[kept]))
        kept &= np.abs(x - middle) < most_sd * SD_PER_MEDIAN * np.median(np.abs(x[kept] - middle))
    blocks = 20  # of pixels, left out in turn for the errors: neighbours may share their deviations
    if kept.sum() < 10 * blocks:
        return None
    a, b = a[kept], b[kept]
    if max(a.mean(), b.mean()) < LEAST_APART * min(a.mean(), b.mean()):
        return None
    every = np.stack([_moments(np.delete(a, part), np.delete(b, part))
                      for part in np.array_split(np.arange(len(a)), blocks)])  # fmt: skip
    error = np.sqrt((blocks - 1) * every.var(0))  # jackknife
    squares = _moments(a, b)
    theta = 0.5 * float(a.mean() + b.mean())
    return _parts(squares[:2], error[:2], theta, "log radiance") | {
        "from": "maps", "quantity": f"{edge}_threshold", "settings": list(pair), "pixels": len(a),
        "error": math.sqrt(max(float(squares[2]), 0.0)), "correlation": float(np.corrcoef(a, b)[0, 1]),
    }  # fmt: skip


def _moments(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(A², R², N²) of two maps."""
    relative = float((a.var() - b.var()) / (a.mean() ** 2 - b.mean() ** 2))
    additive = float(np.cov(a, b)[0, 1]) - relative * float(a.mean() * b.mean())
    return np.array([additive, relative, a.var() - additive - relative * a.mean() ** 2])


def _parts(squares: np.ndarray, errors: np.ndarray, theta: float, unit: str) -> dict[str, Any]:
    """Both parts with intervals, and which the data support."""
    ends = [[math.sqrt(max(float(s + side * Z95 * e), 0.0)) for side in (-1.0, 1.0)]
            for s, e in zip(squares, errors, strict=True)]  # fmt: skip
    additive, relative = (ends[0][0] > 0.0, ends[1][0] > 0.0)
    words = {(True, True): "both", (True, False): "additive", (False, True): "relative"}
    return {
        "kind": words.get((additive, relative), "not identified"),
        "additive": {"value": math.sqrt(max(float(squares[0]), 0.0)), "unit": unit, "interval_95": ends[0]},
        "relative": {"value": math.sqrt(max(float(squares[1]), 0.0)), "unit": "1", "interval_95": ends[1]},
        "threshold": theta,
    }  # fmt: skip


def mismatch_sentences(entries: Iterable[Mapping[str, Any]]) -> list[str]:
    """What the spreads support, in words."""
    sentences = []
    for one in entries:
        a, r = one["additive"], one["relative"]
        sentences.append(
            f"{one['quantity']}: mismatch between pixels from {one['from']}: {one['kind']}; additive {a['value']:.3g} "
            f"({a['interval_95'][0]:.3g} to {a['interval_95'][1]:.3g}) {a['unit']}, relative {100 * r['value']:.2g} % "
            f"({100 * r['interval_95'][0]:.2g} to {100 * r['interval_95'][1]:.2g})"
        )
    return sentences
