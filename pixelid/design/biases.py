"""Which setting of a bias meets what is wanted of bandwidth, noise and events, and how surely.

Every wish has a margin at every setting: the distance of ln predicted from ln wanted, on the wished side, in
half-widths of the prediction's 95 % interval.  From 1 on the whole interval meets the wish, from 0 on the prediction
does.  The recommended setting has the largest least margin, counted up to 1; of several the slowest, because
bandwidth costs noise. Settings beyond those fitted are looked at where none within them meets the wishes.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pixelid.design.bias_fits import BiasFit
from pixelid.errors import InputError
from pixelid.status import Status
from pixelid.tables.latency.settings import BEYOND
from pixelid.tables.rates.bias_law import MOST_MV

OPEN = np.log(1e3)  # half of an interval in ln: a factor of a thousand either way predicts nothing
QUANTITIES = {"bandwidth": "Hz", "noise": "events/s", "rate": "events/s"}


@dataclass(frozen=True)
class Prediction:
    """ln of a quantity at settings (n,), and half-widths of its 95 % intervals on either side."""

    middle: np.ndarray
    low: np.ndarray
    high: np.ndarray

    def margin(self, wanted: float, at_least: bool) -> np.ndarray:
        """(n,) margins of a wish."""
        if at_least:
            return (self.middle - np.log(wanted)) / np.maximum(self.middle - self.low, 1e-9)
        return (np.log(wanted) - self.middle) / np.maximum(self.high - self.middle, 1e-9)


def recommend_setting(
    fit: BiasFit, wanted: Mapping[str, float], frequency_hz: float | None = None, seed: int = 0
) -> dict[str, Any]:
    """The content of design.json for a bias, but for provenance.

    Args:
        fit: of `read_bias_fit`.
        wanted: at least so much "bandwidth" [Hz], at most so much "noise" and "rate" [events/s per pixel]; any of them.
        frequency_hz: of the table's blinking light, that "rate" is of; the wanted bandwidth by default.
        seed: of the draws behind the events.

    Raises:
        InputError: nothing wanted, or a quantity of which nothing fitted says how it goes with the bias.
    """
    began = time.perf_counter()
    unknown = [name for name in wanted if name not in QUANTITIES]
    if unknown or not wanted:
        raise InputError(
            f"expected one or more wishes of {', '.join(QUANTITIES)}, found {', '.join(unknown) or 'none'}"
        )
    if "noise" in wanted and fit.noise is None:
        raise InputError(
            f"{fit.source}: fewer than 3 settings fix their noise: nothing fitted says how it goes with the bias"
        )
    frequency = frequency_hz if frequency_hz is not None else wanted.get("bandwidth")
    if "rate" in wanted and frequency is None:
        raise InputError("--rate: events of a light that blinks how fast? expected --frequency or --bandwidth with it")
    low, high = fit.range_mv
    reach = BEYOND * (high - low)
    lowest, highest = max(low - reach, 0.0), min(high + reach, MOST_MV)
    points = 201  # settings looked at within the fitted range, and as many beyond either end where biases can be
    inside = np.linspace(low, high, points)
    bias = np.concatenate([np.linspace(lowest, low, points)[:-1], inside, np.linspace(high, highest, points)[1:]])
    within = (bias >= low) & (bias <= high)
    said = predictions(fit, bias, frequency if "rate" in wanted else None, seed)
    margins = {name: said[name].margin(value, name == "bandwidth") for name, value in wanted.items()}
    least = np.min(list(margins.values()), axis=0)
    k = _best(least, within, said["bandwidth"].middle)
    if least[k] < 0.0:
        other = _best(least, ~within, said["bandwidth"].middle)
        k = other if least[other] >= 0.0 else k
    binding = min(margins, key=lambda name: float(margins[name][k]))
    extrapolated, met = not within[k], bool(least[k] >= 0.0)
    wishes = {name: _wish(name, value, said[name], margins[name], k) for name, value in wanted.items()}
    left_open = [
        name
        for name in wanted
        if max(said[name].middle[k] - said[name].low[k], said[name].high[k] - said[name].middle[k]) > OPEN
    ]
    status = Status.at_bound if not met else Status.not_identified if extrapolated or left_open else Status.converged
    sure = within & (least >= 1.0)
    content = {
        "status": status,
        "bias": fit.name,
        "fitted_range_mv": [low, high],
        "frequency_hz": frequency if "rate" in wanted else None,
        "recommended": {
            "bias_mv": float(bias[k]), "extrapolated": extrapolated, "met": met, "surely": bool(least[k] >= 1.0),
            "predicted": {name: _at(one, k) for name, one in said.items()},
        },
        "binding": binding,
        "wishes": wishes,
        "meets_surely_mv": [float(bias[sure].min()), float(bias[sure].max())] if sure.any() else None,
        "measured_settings": _measured(fit, wanted),
        "curve": {"bias_mv": bias, **{name: _curve(one) for name, one in said.items()}},
        "seconds": time.perf_counter() - began,
    }  # fmt: skip
    sentences = _sentences(content)
    own = _advice(content, left_open)
    advice = f"{fit.source.name}: {fit.advice or fit.status.advice}" if fit.status is not Status.converged else ""
    return content | {
        "status": Status.worst((status, fit.status)),
        "advice": " ".join(filter(None, (advice, own))),
        "why": " ".join(sentences),
    }


def predictions(fit: BiasFit, bias: np.ndarray, frequency_hz: float | None, seed: int = 0) -> dict[str, Prediction]:
    """Quantity → prediction at biases (n,) mV; noise where it is known, the rate where a frequency is given."""
    found = {}
    for name, line in (("bandwidth", fit.cutoff), ("noise", fit.noise)):
        if line is not None:
            middle, sd = line.at(bias)
            found[name] = Prediction(middle, middle - line.reach * sd, middle + line.reach * sd)
    rate_points = 61  # of them, for events: between them straight in the logarithm
    if frequency_hz is not None:
        coarse = np.linspace(bias.min(), bias.max(), rate_points)
        drawn = fit.log_rates(coarse, frequency_hz, np.random.default_rng(seed))
        low, middle, high = (np.interp(bias, coarse, q) for q in np.percentile(drawn, [2.5, 50.0, 97.5], axis=0))
        found["rate"] = Prediction(middle, low, high)
    return found


def _best(least: np.ndarray, allowed: np.ndarray, log_cutoff: np.ndarray) -> int:
    """The slowest of the allowed settings with the largest margin, counted up to 1."""
    score = np.where(allowed, np.minimum(least, 1.0), -np.inf)
    ties = np.flatnonzero(score >= score.max() - 1e-9)
    return int(ties[np.argmin(log_cutoff[ties])])


def _wish(name: str, wanted: float, said: Prediction, margin: np.ndarray, k: int) -> dict[str, Any]:
    miss = float(np.exp(abs(said.middle[k] - np.log(wanted))))
    met = bool(margin[k] >= 0.0)
    return {
        "wanted": wanted, "at": "least" if name == "bandwidth" else "most", "unit": QUANTITIES[name], "met": met,
        "surely": bool(margin[k] >= 1.0), "margin": float(margin[k]), "missed_by_factor": None if met else miss,
    }  # fmt: skip


def _at(said: Prediction, k: int) -> dict[str, Any]:
    value, low, high = (float(np.exp(np.clip(x[k], -690.0, 690.0))) for x in (said.middle, said.low, said.high))
    return {"value": value, "interval_95": [low, high]}


def _curve(said: Prediction) -> dict[str, np.ndarray]:
    return {name: np.exp(np.clip(getattr(said, name), -690.0, 690.0)) for name in ("middle", "low", "high")}


def _measured(fit: BiasFit, wanted: Mapping[str, float]) -> list[dict[str, Any]]:
    """Every setting with rates of its own: what they say, and whether that meets the wishes (None: left open)."""
    rows = []
    for column, bias in sorted(fit.column_mv.items(), key=lambda item: item[1]):
        row: dict[str, Any] = {"column": column, "bias_mv": bias}
        for name in ("bandwidth", "noise"):
            own = fit.own[column].get(name)
            row[name] = {"value": own[0], "interval_95": [own[1], own[2]]} if own else None
            if name in wanted:
                meets = own and (own[0] >= wanted[name] if name == "bandwidth" else own[0] <= wanted[name])
                row[f"meets_{name}"] = bool(meets) if own else None
        rows.append(row)
    return rows


def _sentences(content: Mapping[str, Any]) -> list[str]:
    best, binding = content["recommended"], content["binding"]
    low, high = content["fitted_range_mv"]
    name = f"{content['bias'] or 'the bias'} {best['bias_mv']:.0f} mV"
    met = (
        "meets every wish with its whole 95 % interval"
        if best["surely"]
        else "meets every wish, not with its whole interval"
    )
    said = [f"{name} {met}." if best["met"] else f"No setting meets every wish; {name} comes closest."]
    for wish, one in content["wishes"].items():
        predicted = best["predicted"][wish]
        a, b = predicted["interval_95"]
        line = f"{wish}: {predicted['value']:.3g} {one['unit']} ({a:.3g} to {b:.3g}), "
        line += f"wanted at {one['at']} {one['wanted']:g}"
        said.append(f"{line}{'' if one['met'] else ', missed by a factor ' + format(one['missed_by_factor'], '.3g')}.")
    said.append(f"{binding.capitalize()} is the wish that binds.")
    if best["extrapolated"]:
        said.append(f"It lies outside the fitted settings, {low:g} to {high:g} mV: an extrapolation.")
    return said


def _advice(content: Mapping[str, Any], left_open: Sequence[str]) -> str:
    best = content["recommended"]
    if left_open and best["met"]:
        names = " and ".join(left_open)
        return f"the fitted settings leave {names} open: record rates at {best['bias_mv']:.0f} mV and at more settings"
    if not best["met"]:
        short = [
            f"{name} by a factor {one['missed_by_factor']:.3g}"
            for name, one in content["wishes"].items()
            if not one["met"]
        ]
        return f"no setting meets {' and '.join(short)}: ask for less, or move another bias"
    if best["extrapolated"]:
        return f"record rates at {best['bias_mv']:.0f} mV and fit again before relying on it"
    return "" if best["surely"] else f"the interval reaches past the wish: record rates at {best['bias_mv']:.0f} mV"
