"""How well latencies of conditions that were not fitted are predicted: one irradiance, or one setting, left out.

    python benchmarks/latency_holdout.py [TABLE.csv] [--camera CAM3] [--out latency_holdout.json]

Per camera: rms of ln(predicted / measured) of the cells' medians, fitted and left out, without the cells that the full
fit disbelieves or that their own figure does not resolve; what the fit without them says that it will miss them by
(its normal approximation, the table's scatter and the cells' own errors; not in it is how far settings lie off the rule
between their neighbours); what the fit would miss with one delay for all settings and edges, and how much of that
misfit delays of their own close (of sums of squares; 95 % by settings drawn again).
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from pixelid.tables.fit import SUSPECT_SCALES, covariance_at
from pixelid.tables.latency.cells import UNRESOLVED, gather
from pixelid.tables.latency.fit import CameraFit, fit_camera
from pixelid.tables.latency.reading import LatencyTable, read_tables
from pixelid.tables.latency.result import REPEATABLE

STEP = 0.02  # of ln, for slopes
DRAWS = 4000
TABLE = Path(__file__).resolve().parents[1] / "fits" / "nist_latency" / "nist_latency_by_roi.csv"


def rms(values: np.ndarray) -> float:
    """Root mean square, NaN of none."""
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")


def logs(fit: CameraFit, cells: LatencyTable) -> np.ndarray:
    """(cells,) ln(predicted / measured) of medians."""
    return np.log(fit.camera.predict(cells)["median"] / cells.latency_s["median"])


def expected(fit: CameraFit, cells: LatencyTable, error: np.ndarray) -> float:
    """Rms that a fit says its ln(predicted / measured) of medians will have in cells that it has not seen."""
    regression = fit.regression
    lower, upper = np.array([p.coordinate_bounds() for p in regression.parameters]).T
    values, vectors = np.linalg.eigh(covariance_at(regression))

    def median_at(x: np.ndarray) -> np.ndarray:
        camera = fit.model.camera_at(np.clip(x, lower, upper), regression.scale)
        return np.log(camera.predict(cells)["median"])

    here = median_at(regression.x)
    steps = vectors * np.minimum(STEP, np.sqrt(np.maximum(values, 0.0)))
    slopes = [(median_at(regression.x + step) - here) / max(np.linalg.norm(step), 1e-12) for step in steps.T]
    variance = np.maximum(values, 0.0) @ np.square(slopes)
    return float(np.sqrt(np.mean(variance + regression.scale**2 + error**2)))


def closed(with_delays: np.ndarray, without: np.ndarray, setting: np.ndarray) -> dict:
    """Share of the sum of squares of the cells' errors that delays of settings and edges take away, 95 %."""
    rng = np.random.default_rng(0)
    cells = {name: np.flatnonzero(setting == name) for name in np.unique(setting)}
    names = list(cells)

    def share(some: np.ndarray) -> float:
        return 1.0 - float(np.sum(with_delays[some] ** 2) / np.sum(without[some] ** 2))

    drawn = [share(np.concatenate([cells[names[k]] for k in rng.integers(len(names), size=len(names))]))
             for _ in range(DRAWS)]  # fmt: skip
    return {"value": share(np.arange(len(setting))), "interval_95": np.percentile(drawn, [2.5, 97.5]).tolist()}


def hold_out(name: str, table: LatencyTable) -> dict:
    """One camera's errors."""
    full = fit_camera(name, gather(table))
    gathered = gather(table)
    cells, error = gathered.table, gathered.error["median"]
    everything = logs(full, cells)
    scale = np.hypot(max(full.regression.scale, REPEATABLE), error)
    clean = (np.abs(everything) < SUSPECT_SCALES * scale) & (error < UNRESOLVED)
    one_delay = logs(fit_camera(name, gather(table), one_delay=True), cells)[clean]
    found = {
        "cells": len(clean),
        "spoiled": int((~clean).sum()),
        "fitted": rms(everything[clean]),
        "one_delay": rms(one_delay),
        "closed": closed(everything[clean], one_delay, cells.setting[clean]),
    }
    for kind, column, own in (
        ("irradiance", table.irradiance, cells.irradiance), ("setting", table.setting, cells.setting)
    ):  # fmt: skip
        left = {}
        for value in np.unique(own):
            fit = fit_camera(name, gather(table.select(column != value)), start=full.camera)
            here = (own == value) & clean
            missed = rms(logs(fit, cells.select(own == value))[clean[own == value]])
            fitted, said = rms(everything[here]), expected(fit, cells.select(here), error[here])
            left[str(value)] = {"left_out": missed, "fitted": fitted, "said": said, "ratio": missed / fitted}
            print(name, kind, value, {key: round(number, 3) for key, number in left[str(value)].items()}, flush=True)
        found[kind] = left
    return found


def main() -> None:
    """Every camera of the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("table", nargs="?", type=Path, default=TABLE)
    parser.add_argument("--camera")
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    table = read_tables([arguments.table])
    names = [arguments.camera] if arguments.camera else list(dict.fromkeys(table.camera.tolist()))
    found = {name: hold_out(name, table.select(table.camera == name)) for name in names}
    for name, one in found.items():
        low, high = one["closed"]["interval_95"]
        print(f"{name}: fitted {one['fitted']:.3f}, with one delay {one['one_delay']:.3f}, "
              f"closed {one['closed']['value']:.3f} ({low:.3f} to {high:.3f})")  # fmt: skip
    if arguments.out:
        arguments.out.write_text(json.dumps(found, indent=2) + "\n")


if __name__ == "__main__":
    main()
