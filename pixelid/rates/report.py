"""Fitted rate tables on disk: numbers as JSON, curves and residuals as pictures, disagreements in words."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pixelid.outputs import write_json
from pixelid.provenance import provenance
from pixelid.rates.fit import SUSPECT, Regression
from pixelid.rates.pixel import PixelFit, fit_pixel
from pixelid.rates.pool import PoolFit, fit_pool
from pixelid.status import Status


def pixel_result(fit: PixelFit) -> dict:
    """The content of rates.json for one pixel's table."""
    r, table = fit.regression, fit.table
    together = fit_pixel(table, ("swing", "dead")).regression
    cells = [
        {
            "frequency_hz": float(table.frequency_hz[i]),
            "column": table.columns[k],
            "measured_hz": float(fit.observed[j]),
            "fitted_hz": float(r.predicted[j]),
            "ratio": float((fit.observed[j] + table.resolution_hz) / (r.predicted[j] + table.resolution_hz)),
            "residual": float(r.residual[j]),
            "weight": float(r.weight[j]),
            "suspect": bool(abs(r.residual[j]) > SUSPECT),
        }
        for j, (i, k) in enumerate(zip(fit.row, fit.column, strict=True))
    ]
    return {
        **_head(r, "pixel", table.frequency_hz),
        "cells": cells,
        "one_dead_time": {"log_likelihood": together.log_likelihood, "parameters": together.as_dict()},
        "disagreements": _pixel_sentences(fit, together, cells),
        **provenance(*([table.source] if table.source else [])),
    }


def _head(r: Regression, model: str, frequency_hz: np.ndarray) -> dict:
    parameters = r.as_dict()
    for name, entry in parameters.items():
        if "cutoff_hz" in name and not 0.3 * frequency_hz.min() < entry["value"] < 3.0 * frequency_hz.max():
            entry |= {"identified": False, "std": None}  # an extrapolation beyond every frequency measured
    return {
        "status": Status.converged if r.converged else Status.not_converged,
        "advice": "" if r.converged else "the regression did not settle: drop columns with few cells",
        "model": model,
        "observation": "pooled_rate",
        "parameters": parameters,
        "unidentified": [
            f"{name}: the table leaves it between {v['interval_95'][0]:.3g} and {v['interval_95'][1]:.3g} {v['unit']}"
            for name, v in parameters.items()
            if not v["identified"]
        ],
        "relative_scatter": r.scale,
        "log_likelihood": r.log_likelihood,
        "cells_fitted": len(r.residual),
    }


def _pixel_sentences(fit: PixelFit, together: Regression, cells: list[dict]) -> list[str]:
    found = []
    for c in sorted(cells, key=lambda c: -abs(c["residual"])):
        if c["suspect"]:
            found.append(
                f"{c['column']} at {c['frequency_hz']:g} Hz: measured {c['measured_hz']:.4g} events/s, the fit says "
                f"{c['fitted_hz']:.4g} ({c['ratio']:.3g} times, {c['residual']:+.0f} scales; kept, at weight "
                f"{c['weight']:.2g})"
            )
            if 8 < c["ratio"] < 12.5 or 0.08 < c["ratio"] < 0.125:
                found[-1] += "; a factor near 10: a decimal point may have slipped"
    parameters = fit.regression.as_dict()
    dead = {n: v for n, v in parameters.items() if n.startswith("dead_time_s[") and v["identified"]}
    if len(dead) > 1:
        values = [v["value"] for v in dead.values()]
        if max(values) > 2 * min(values):
            text = ", ".join(f"{n[12:-1]} {1e6 * v['value']:.2g} µs" for n, v in dead.items())
            found.append(
                f"dead time should not depend on the setting, but comes out as {text}: the largest and smallest absorb "
                "something else that the model lacks"
            )
    apart = fit.regression.log_likelihood - together.log_likelihood
    found.append(
        f"one dead time for all settings costs {apart:.1f} nats for "
        f"{len(fit.regression.x) - len(together.x)} parameters "
        f"fewer (it would be {1e6 * together.as_dict()['dead_time_s']['value']:.2g} µs)"
    )
    return found


def pool_result(fit: PoolFit, alike: PoolFit) -> dict:
    """The content of rates.json for a pool table; `alike`: the same with identical pixels."""
    r, table = fit.regression, fit.table
    ratio = np.full(table.per_cycle.shape, np.nan)
    ratio[fit.row, fit.column] = table.per_cycle[fit.row, fit.column] / r.predicted
    worst = [
        f"{table.frequency_hz[i]:g} Hz: events per cycle are {np.nanmedian(ratio[i]):.2f} times the fit (median over "
        f"conditions; {np.nanmin(ratio[i]):.2f} to {np.nanmax(ratio[i]):.2f})"
        for i in range(len(ratio))
        if abs(np.log(np.nanmedian(ratio[i]))) > 0.1 or np.nanmax(np.abs(np.log(ratio[i]))) > 0.5
    ]
    error, error_alike = (float(np.median(np.abs(np.log(f.table.per_cycle[f.row, f.column] / f.regression.predicted))))
                          for f in (fit, alike))  # fmt: skip
    return {
        **_head(r, "pool", table.frequency_hz),
        "median_error": error,
        "identical_pixels": {
            "median_error": error_alike,
            "nats_worse": r.log_likelihood - alike.regression.log_likelihood,
            "cutoff_exponent": "infinite",
        },
        "disagreements": [
            f"pixels that are all alike miss the table by {100 * error_alike:.0f} % (median), pixels whose "
            f"bandwidths are "
            f"spread as a power law by {100 * error:.0f} %: the fall with frequency is the image shrinking, not one "
            "pixel's roll-off",
            *worst,
        ],
        "ratio": ratio,
        "frequency_hz": table.frequency_hz,
        "conditions": list(table.conditions),
    }


def save_pixel(fit: PixelFit, folder: Path) -> dict:
    """Write rates.json and rates.png into an existing folder; returns the JSON."""
    found = pixel_result(fit)
    write_json(folder / "rates.json", found)
    plt = _pyplot()
    figure, (top, bottom) = plt.subplots(2, 1, figsize=(8, 8), sharex=True, layout="constrained", height_ratios=(2, 1))
    f = np.geomspace(fit.table.frequency_hz.min(), fit.table.frequency_hz.max(), 300)
    for k, name in enumerate(fit.table.columns):
        here = fit.column == k
        x = fit.table.frequency_hz[fit.row[here]]
        shown = np.maximum(fit.observed[here], 0.3 * fit.table.resolution_hz)
        top.loglog(x, shown, "o", color=f"C{k}", label=name)
        top.loglog(f, np.maximum(fit.curve(k, f), 0.3 * fit.table.resolution_hz), color=f"C{k}", lw=1)
        bottom.semilogx(x, np.clip(fit.regression.residual[here], -12, 12), "o", color=f"C{k}")
    top.set_ylabel("events/s (below the last digit: drawn at 0.3 of it)")
    top.legend()
    bottom.axhspan(-SUSPECT, SUSPECT, color="0.93")
    bottom.set(xlabel="frequency of the light [Hz]", ylabel="residual [scales, clipped at ±12]")
    figure.savefig(folder / "rates.png", dpi=110)
    plt.close(figure)
    return found


def save_pool(fit: PoolFit, folder: Path, *inputs: Path) -> dict:
    """Write rates.json and rates.png into an existing folder; returns the JSON."""
    alike = fit_pool(fit.table, identical=True)
    found = {**pool_result(fit, alike), **provenance(*inputs)}
    write_json(folder / "rates.json", found)
    plt = _pyplot()
    figure, (top, bottom) = plt.subplots(2, 1, figsize=(8, 8), sharex=True, layout="constrained", height_ratios=(2, 1))
    for k in range(len(fit.table.conditions)):
        here = fit.column == k
        x, y = fit.table.frequency_hz[fit.row[here]], fit.table.per_cycle[fit.row[here], k]
        colour = plt.get_cmap("viridis")(k / max(len(fit.table.conditions) - 1, 1))
        top.loglog(x, y, "o", ms=3, color=colour)
        top.loglog(x, fit.regression.predicted[here], color=colour, lw=0.8)
        bottom.semilogx(x, y / fit.regression.predicted[here] - 1, "o", ms=3, color=colour)
        bottom.semilogx(x, y / alike.regression.predicted[here] - 1, "x", ms=3, color="0.7", zorder=0)
    top.set_ylabel("events per cycle")
    bottom.set(xlabel="frequency of the light [Hz]", ylabel="measured/fit − 1 (grey: identical pixels)", ylim=(-1, 2))
    figure.savefig(folder / "rates.png", dpi=110)
    plt.close(figure)
    return found


def _pyplot():
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    return plt
