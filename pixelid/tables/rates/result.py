"""What a fitted rate table says: the numbers of rates.json, and its disagreements in words."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import ClassVar

import numpy as np

from pixelid.provenance import provenance
from pixelid.status import Status
from pixelid.tables.fit import SUSPECT_SCALES, TableFit
from pixelid.tables.rates.bias_law import NO_LAW, bias_law, describes, law_sentences
from pixelid.tables.rates.figures import draw_pixel, draw_pool
from pixelid.tables.rates.pixel import PixelFit, fit_pixel
from pixelid.tables.rates.pool import PoolFit, fit_pool
from pixelid.tables.result import TableResult, open_sentences, table_result


@dataclass(frozen=True, repr=False)
class RateResult(TableResult):
    """Event rates against the frequency of a light, fitted."""

    FILE: ClassVar[str] = "rates.json"

    def sentences(self) -> list[str]:
        """Advice, the law of bias where one was asked for, and cells that disagree."""
        advice, *others = super().sentences()
        return [advice, *self.content.get("bias_law", {}).get("sentences", []), *others]


def pixel_result(fit: PixelFit, by_bias: bool = False) -> dict:
    """The content of rates.json for one pixel's table; by_bias: with the law of its cutoffs over biases."""
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
            "suspect": bool(abs(r.residual[j]) > SUSPECT_SCALES),
        }
        for j, (i, k) in enumerate(zip(fit.row, fit.column, strict=True))
    ]
    law, head = bias_law(fit) if by_bias else None, _head(r, "pixel", table.frequency_hz)
    if law and head["status"] == Status.converged:
        if not law["mv_per_efold"]["identified"]:
            head |= {"status": Status.not_identified, "advice": NO_LAW}
        elif not describes(law):
            head |= {"status": Status.misfit, "advice": "cutoffs depart from the law by more than it explains"}
    return {
        **head,
        **({"bias_law": {**law, "sentences": law_sentences(law)}} if law else {}),
        "cells": cells,
        "one_dead_time": {"log_likelihood": together.log_likelihood, "parameters": together.as_dict()},
        "disagreements": _pixel_sentences(fit, together, cells),
        **provenance(*([table.source] if table.source else [])),
    }


def _head(r: TableFit, model: str, frequency_hz: np.ndarray) -> dict:
    result = table_result(r, model, "pooled_rate")
    for name, entry in result["parameters"].items():
        if "cutoff_hz" in name and not 0.3 * frequency_hz.min() < entry["value"] < 3.0 * frequency_hz.max():
            entry |= {"identified": False, "std": None}  # an extrapolation beyond every frequency measured
    precision = {
        name: words
        if result["parameters"][name]["identified"] or not words.startswith("known")
        else f"not identified: {words}"
        for name, words in r.precision().items()
    }
    return result | {"precision": precision, "unidentified": open_sentences(result["parameters"], at_rest=r.converged)}


def _pixel_sentences(fit: PixelFit, together: TableFit, cells: list[dict]) -> list[str]:
    sentences = []
    for c in sorted(cells, key=lambda c: -abs(c["residual"])):
        if c["suspect"]:
            sentences.append(
                f"{c['column']} at {c['frequency_hz']:g} Hz: measured {c['measured_hz']:.4g} events/s, the fit says "
                f"{c['fitted_hz']:.4g} ({c['ratio']:.3g} times, {c['residual']:+.0f} σ off; down-weighted "
                f"to {100 * c['weight']:.2g} %)"
            )
            if 8 < c["ratio"] < 12.5 or 0.08 < c["ratio"] < 0.125:
                sentences[-1] += "; a factor near 10: a decimal point may have slipped"
    parameters = fit.regression.as_dict()
    dead = {n: v for n, v in parameters.items() if n.startswith("dead_time_s[") and v["identified"]}
    if len(dead) > 1:
        values = [v["value"] for v in dead.values()]
        if max(values) > 2 * min(values):
            text = ", ".join(f"{n[12:-1]} {1e6 * v['value']:.2g} µs" for n, v in dead.items())
            sentences.append(
                f"dead time should not depend on the setting, but comes out as {text}: the largest and smallest absorb "
                "something else that the model lacks"
            )
    fewer = len(fit.regression.x) - len(together.x)
    apart = fit.regression.log_likelihood - together.log_likelihood
    sentences.append(
        f"one dead time for all settings ({1e6 * together.as_dict()['dead_time_s']['value']:.2g} µs) is worse by "
        f"{apart:.1f} nats with {fewer} parameter{'s' * (fewer != 1)} fewer"
    )
    return sentences


def _median_error(fit: PoolFit) -> float:
    """Median |ln(measured / predicted)| of events per cycle, with the resolution that the fit adds to both."""
    digit, measured = fit.model.rows.last_digit, fit.table.per_cycle[fit.row, fit.column]
    return float(np.median(np.abs(np.log((measured + digit) / (fit.regression.predicted + digit)))))


def pool_result(fit: PoolFit, alike: PoolFit) -> dict:
    """The content of rates.json for a pool table; `alike`: the same with identical pixels."""
    r, table = fit.regression, fit.table
    ratio = np.full(table.per_cycle.shape, np.nan)
    ratio[fit.row, fit.column] = table.per_cycle[fit.row, fit.column] / r.predicted
    with np.errstate(divide="ignore"):  # cells without events
        away = np.abs(np.log(ratio))
        middle = np.abs(np.log([np.nanmedian(row) if np.isfinite(row).any() else 1.0 for row in ratio]))
    worst = [
        f"{table.frequency_hz[i]:g} Hz: events per cycle are {np.nanmedian(ratio[i]):.2f} times the fit (median over "
        f"conditions; {np.nanmin(ratio[i]):.2f} to {np.nanmax(ratio[i]):.2f})"
        for i in range(len(ratio))
        if middle[i] > 0.1 or np.nan_to_num(away[i], posinf=np.inf).max() > 0.5
    ]
    error, error_alike = _median_error(fit), _median_error(alike)
    nats_worse = r.log_likelihood - alike.regression.log_likelihood
    worse = (
        f"pixels that are all alike miss the table by {100 * error_alike:.0f} % (median), pixels whose bandwidths are "
        f"spread as a power law by {100 * error:.0f} %"
    )
    min_lead_nats = 5.0  # a likelihood ratio of e⁵ = 150, "very strong" (Kass & Raftery 1995, JASA 90, 773)
    if nats_worse > min_lead_nats and error < error_alike:
        worse += ": the fall with frequency is the image shrinking, not one pixel's roll-off"
    return {
        **_head(r, "pool", table.frequency_hz),
        "median_error": error,
        "identical_pixels": {
            "median_error": error_alike,
            "nats_worse": nats_worse,
            "cutoff_exponent": "infinite",
        },
        "disagreements": [
            worse,
            *worst,
        ],
        "ratio": ratio,
        "frequency_hz": table.frequency_hz,
        "conditions": list(table.conditions),
    }


def of_pixel(fit: PixelFit, by_bias: bool = False) -> RateResult:
    """The result of one pixel's table."""
    return RateResult(pixel_result(fit, by_bias), {"rates": partial(draw_pixel, fit)})


def of_pool(fit: PoolFit, *inputs: Path) -> RateResult:
    """The result of a light's whole image."""
    alike = fit_pool(fit.table, identical=True)
    return RateResult({**pool_result(fit, alike), **provenance(*inputs)}, {"rates": partial(draw_pool, fit, alike)})
