"""What calibrations of sessions with a known truth come to: see `bench_sessions.py`."""

from __future__ import annotations

import math
from collections import Counter
from statistics import median
from typing import Any

# Circuit parameter → power of the light's unit in it, target of the relative error (None: counted without one).
CIRCUIT: dict[str, tuple[int, float | None]] = {
    "alpha": (-1, 0.03), "beta": (0, 0.03), "gamma": (-1, 0.08), "sf_cutoff_hz": (0, None),
    "diff_cutoff_hz": (0, None), "on_threshold": (0, 0.03), "off_threshold": (0, 0.03), "refractory_s": (0, None),
}  # fmt: skip
# Planted effect → its name, parameter, and power of the light's unit in that.
EFFECTS: dict[str, tuple[str, str, int]] = {
    "leak": ("leak", "leak.rate_hz", 0),
    "I_dark": ("dark_current", "dark_current.radiance", 1),
    "par_leak": ("parasitic_photocurrent", "parasitic_photocurrent.rate_hz_per_radiance", -1),
    "shot": ("shot_noise", "shot_noise.density", 1),
    "jitter": ("timestamp_jitter", "timestamp_jitter.sigma_s", 0),
}
# From where on an effect must be named.  Standard errors of fits with the effect and every statement true, in sessions
# of 25 pixels: 0.01 Hz, 0.005 fA, 3.5e-5 Hz/fA; 3.3e-7 fA/Hz and 0.03 µs, ten times that where both noises act.  Trace
# noise, an uneven field and a level of its own for each recording cost a factor of a few; limits are 2.5 or more of
# the largest of these, the first three the least that sessions have.
LIMITS = {
    "leak": 0.3,  # Hz
    "I_dark": 0.8,  # fA
    "par_leak": 0.002,  # Hz/fA
    "shot": 1e-5,  # fA/Hz
    "jitter": 4e-6,  # s
}
# A wrong statement → the statements that are right to report it.
REPORTS = {
    "level": ("level",), "light": ("light",), "polarity": ("polarity",), "edge": ("delay", "clock_rate", "edge"),
}  # fmt: skip


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Counts over the runs of `bench_sessions.py`."""
    faults, doubts = {name: Counter() for name in REPORTS}, []
    for row in rows:
        found, unfounded = judge_bench(row)
        doubts += unfounded
        if row["truth"]["fault"]:
            faults[row["truth"]["fault"]]["found" if found else "missed"] += 1
    nulls = [row for row in rows if not row["truth"]["effects"]]
    cpu = [row["cpu_seconds"] for row in rows]
    return {
        "sessions": len(rows),
        "status": dict(Counter(row["calibration"].get("status", f"exit {row['exit']}") for row in rows)),
        "parameters": {name: judge_parameter(rows, name) for name in CIRCUIT},
        "effects": {name: judge_effect(rows, planted) for planted, (name, *_) in EFFECTS.items()} | _others(rows),
        "described": sum(bool(row["calibration"].get("described")) for row in rows),
        "nulls": [sum(row["calibration"].get("verdict") == "none" for row in nulls), len(nulls)],
        "faults": {name: {key: counts[key] for key in ("found", "missed")} for name, counts in faults.items()},
        "doubted_without_cause": doubts,
        "cpu_seconds_median_and_largest": [median(cpu), max(cpu)],
    }


def judge_parameter(rows: list[dict[str, Any]], name: str) -> dict[str, Any]:
    """How often a circuit parameter's interval holds the truth, and how far off the value is, in fA."""
    power, target = CIRCUIT[name]
    errors, held = [], []
    for row in rows:
        reported = row["calibration"].get("parameters", {}).get(name)
        if reported is None or reported.get("value") is None:
            continue
        truth = row["truth"][name] * row["truth"].get("unit_factor", 1.0) ** power
        errors.append(abs(reported["value"] / truth - 1.0))
        if reported.get("interval_95"):
            held.append(_holds(reported["interval_95"], truth))
    return {
        "reported": len(errors),
        "with_interval": len(held),
        "covered": sum(held),
        "median_error": median(errors) if errors else None,
        "largest_error": max(errors, default=None),
        "within_target": None if target is None else sum(error <= target for error in errors),
    }


def judge_effect(rows: list[dict[str, Any]], planted: str) -> dict[str, Any]:
    """How often an effect is named, by whether it is planted, and how often its interval holds the truth."""
    name, parameter, power = EFFECTS[planted]
    above, below, wrong, held = [0, 0], [0, 0], 0, [0, 0]
    for row in rows:
        by_name = {effect["name"]: effect for effect in row["calibration"].get("effects", [])}
        strength = row["truth"]["effects"].get(planted)
        if strength is None:
            wrong += name in by_name
            continue
        counts = above if strength >= LIMITS[planted] else below
        counts[0] += name in by_name
        counts[1] += 1
        interval = _interval(row["calibration"], by_name.get(name, {}), parameter)
        if interval:
            held[0] += _holds(interval, strength * row["truth"].get("unit_factor", 1.0) ** power)
            held[1] += 1
    return {"above_limit": above, "below_limit": below, "wrongly_named": wrong, "covered": held}


def judge_bench(row: dict[str, Any]) -> tuple[bool, list[str]]:
    """(whether the wrong statement is reported, statements reported without a cause)."""
    truth, found, doubts = row["truth"], False, []
    names, fault = truth.get("fault_recordings"), truth["fault"]
    for one in row["calibration"].get("bench", []):
        statement, recording = one["statement"], one.get("recording")
        if statement in REPORTS.get(fault, ()) and (names is None or recording is None or recording in names):
            found = True
        elif not _has_cause(one, truth):
            doubts.append(statement)
    return found, doubts


def _has_cause(one: dict[str, Any], truth: dict[str, Any]) -> bool:
    """Whether a statement may be doubted though it is not the session's fault.

    So are a clock rate whose interval holds the true one, a unit other than fA, and a zero of the light where a dark
    current is: both add to the light.
    """
    if one["statement"] == "clock_rate" and one.get("interval_95"):
        return _holds(one["interval_95"], _clock_rate(one, truth["clock_ppm"]))
    if one["statement"] == "unit":
        return truth.get("unit", "radiance_fA") != "radiance_fA"
    return one["statement"] == "offset" and "I_dark" in truth["effects"]


def _clock_rate(one: dict[str, Any], ppm: float) -> float:
    """The true rate as the row states it: parts per million, a relative difference, or a ratio near 1."""
    size = max(map(abs, one["interval_95"]))
    return ppm if size > 2 else 1 + 1e-6 * ppm if size > 0.5 else 1e-6 * ppm


def _others(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Effects named that no session plants."""
    known = {name for name, *_ in EFFECTS.values()}
    named = Counter(effect["name"] for row in rows for effect in row["calibration"].get("effects", []))
    nothing = {"above_limit": [0, 0], "below_limit": [0, 0], "covered": [0, 0]}
    return {name: nothing | {"wrongly_named": count} for name, count in named.items() if name not in known}


def _interval(calibration: dict[str, Any], effect: dict[str, Any], parameter: str) -> list[float] | None:
    """Of the joint fit where it has the parameter, else of the search."""
    for place in (calibration.get("parameters", {}), effect.get("parameters", {})):
        if effect and place.get(parameter, {}).get("interval_95"):
            return place[parameter]["interval_95"]
    return None


def _holds(interval: list[float | None], value: float) -> bool:
    low, high = interval
    return (-math.inf if low is None else low) <= value <= (math.inf if high is None else high)
