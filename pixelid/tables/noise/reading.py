"""Noise rates against light: a table of a CSV file, or recordings of still scenes reduced to the same rows.

CSV: one row per light; a column of light (lux, illuminance, irradiance, radiance, …) and columns of ON and OFF events
per pixel and second, recognised by their names; `#` lines are remarks.  A recording counts when its light is constant.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from pixelid.documents import words_of
from pixelid.errors import InputError, shown
from pixelid.recordings.kept import kept_of, seconds_looked_at
from pixelid.recordings.recording import Recording
from pixelid.tables.noise.measured_intervals import MeasuredIntervals, count_intervals
from pixelid.tables.reading import TextTable, read_text_table

LIGHT = re.compile(r"lux|lx|illuminance|irradiance|radiance|photocurrent|w m2")
# words of other units than those that `_unit` knows, and than events per second
SCALED = re.compile(
    r"\b((p|n|u|m|k|pico|nano|micro|milli|kilo)(w|watts?|lux|lx|a|amps?|amperes?)|[cmu]m2?|fc|foot|(foot)?candles?|cd|nits?"
    r"|lm|lumens?|flux|log(10)?|ln|db|x?10+|x?1e\d+)\b|\bphotocurrent\b.*\ba\b"
)
SCALED_RATE = re.compile(
    r"\b(k|m|kilo|mega)(ev|eps|hz|events?)\b|\b(ms|us|ns|min|minutes?|h|hours?|counts?|totals?|log(10)?|ln)\b"
)
POLARITY = {"ON": re.compile(r"\b(on|pos)\b"), "OFF": re.compile(r"\b(off|neg)\b")}
RATE = re.compile(r"event|rate|hz|per s|\bs\b")
_PLAIN = str.maketrans("²µμ⁻·", "2uu  ")
DARKEST, BRIGHTEST = 1e-15, 1e15  # of any unit: beyond lies no light that a sensor has seen
STILL = 1e-3  # relative change of the light of a still scene: 10⁻³ of a threshold of 1 would be 1 % of a rate


@dataclass(frozen=True)
class NoiseTable:
    """Rates of noise events, one row per light and polarity.

    Attributes:
        light: (rows,) illuminance, radiance, … in `unit`.
        on: (rows,) whether the row counts ON events.
        rate_hz: (rows,) events per pixel and second.
        relative_error: (rows,) what is known of the rate's own error.
        last_digit: (rows,) the smallest rate that the row's table can write, or its recording see, events/s.
        group: (rows,) number of the file, or 0 for all recordings.
        columns: what identifies a row in the result.
        unit: of `light`.
        pixels: that recordings averaged over; 0 for tables.
        sources: the files.
        intervals: between events, one for each recording; empty for tables.
        pairs, pair_error: (lights, 2) of recordings, see `tables.model.Rows`: an ON event by noise is followed by an
            OFF event, so that both counts of a pixel are too large together.
    """

    light: np.ndarray
    on: np.ndarray
    rate_hz: np.ndarray
    relative_error: np.ndarray
    last_digit: np.ndarray
    group: np.ndarray
    columns: dict[str, list[Any]] = field(default_factory=dict)
    unit: str = "lux"
    pixels: int = 0
    sources: tuple[Path, ...] = ()
    intervals: tuple[MeasuredIntervals, ...] = ()
    pairs: np.ndarray = field(default_factory=lambda: np.empty((0, 2), int))
    pair_error: np.ndarray = field(default_factory=lambda: np.empty((0, 2)))


def read_noise_tables(paths: Sequence[Path]) -> NoiseTable:
    """The rows of one or several CSV files.

    Raises:
        InputError: naming file, row and cell; and for files whose light is in different units.
    """
    parts = [_read(Path(path), k) for k, path in enumerate(paths)]
    units = {part.unit for part in parts}
    if len(units) > 1:
        raise InputError(f"noise: expected tables of one unit of light, found {', '.join(sorted(units))}")
    return joined(parts)


def joined(parts: Sequence[NoiseTable]) -> NoiseTable:
    """The rows of several tables as one."""
    names = list(dict.fromkeys(name for part in parts for name in part.columns))
    light, on, rate, error, digit, group = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("light", "on", "rate_hz", "relative_error", "last_digit", "group")
    )
    return NoiseTable(
        light, on, rate, error, digit, group,
        {n: [v for part in parts for v in part.columns.get(n, [None] * len(part.light))] for n in names},
        parts[0].unit,
        min(part.pixels for part in parts),
        tuple(source for part in parts for source in part.sources),
    )  # fmt: skip


def _read(path: Path, group: int) -> NoiseTable:
    text = read_text_table(path, first="", expected="lux,ON_events_per_s_per_px,OFF_events_per_s_per_px")
    light_name = _light_column(text)
    light = text.numbers(light_name)
    text.check(light_name, light > 0, "light above 0")
    text.check(light_name, (light > DARKEST) & (light < BRIGHTEST), f"light of {DARKEST:g} to {BRIGHTEST:g}")
    rows: dict[str, list[Any]] = {"light": [], "on": [], "rate": [], "digit": []}
    columns: dict[str, list[Any]] = {"file": [], light_name: [], "polarity": []}
    for polarity in POLARITY:
        name = _rate_column(text, polarity)
        if name is None:
            continue
        rates = text.numbers(name)
        text.check(name, ~(rates < 0), "a rate of at least 0")
        digit = text.last_digit((name,))
        for k in np.flatnonzero(np.isfinite(rates)):
            rows["light"].append(light[k])
            rows["on"].append(polarity == "ON")
            rows["rate"].append(rates[k])
            rows["digit"].append(digit)
            columns["file"].append(path.name)
            columns[light_name].append(float(light[k]))
            columns["polarity"].append(polarity)
    if len(rows["rate"]) < 2:
        raise InputError(f"{path}: expected at least two measured rates, found {len(rows['rate'])}")
    count = len(rows["rate"])
    return NoiseTable(
        np.array(rows["light"]), np.array(rows["on"]), np.array(rows["rate"]), np.zeros(count),
        np.array(rows["digit"], float), np.full(count, group), columns, _unit(light_name), 0, (path,),
    )  # fmt: skip


def _light_column(text: TextTable) -> str:
    found = [name for name in text.names if LIGHT.search(_words(name))]
    if not found:
        raise InputError(
            f"{text.path}: expected a column of light (lux, illuminance, irradiance, radiance), "
            f"found {shown(', '.join(text.names), 200)}"
        )
    if len(found) > 1 or SCALED.search(_words(found[0])):
        raise InputError(
            f"{text.path}: expected one column of light, in lux, W/m2 or fA, found {shown(', '.join(found), 200)}"
        )
    return found[0]


def _rate_column(text: TextTable, polarity: str) -> str | None:
    """The column of one polarity's rates: its name says the polarity, and a rate where several do."""
    found = [name for name in text.names if POLARITY[polarity].search(_words(name))]
    rates = [name for name in found if RATE.search(_words(name))]
    if len(rates) > 1 or (not rates and len(found) > 1):
        raise InputError(f"{text.path}: several columns may hold {polarity} rates: {', '.join(rates or found)}")
    if not found and polarity == "ON":
        raise InputError(
            f"{text.path}: expected a column of ON events per pixel and second (ON_events_per_s_per_px), "
            f"found {shown(', '.join(text.names), 200)}"
        )
    chosen = (rates or found or [None])[0]
    if chosen is not None and SCALED_RATE.search(_words(chosen)):
        raise InputError(f"{text.path}: expected {polarity} events per pixel and second, found {shown(chosen)}")
    return chosen


def _words(name: str) -> str:
    """A column's name as words of small letters and digits: irradiance [mW/m²] → irradiance mw m2."""
    return " ".join(words_of(name.translate(_PLAIN)))


def _unit(name: str) -> str:
    words = _words(name)
    if "lux" in words or "lx" in words or "illuminance" in words:
        return "lux"
    if "w m2" in words or "irradiance" in words:
        return "W/m2"
    return "fA" if "photocurrent" in words or words.endswith("fa") else "radiance"


def reduced_recordings(recordings: Sequence[Recording]) -> NoiseTable:
    """Rates of recordings of still scenes, with errors from how pixels differ.

    Counts of a pixel scatter more than Poisson's law (events come in pairs, pixels differ in their thresholds): the
    error of a mean rate is the scatter of the pixels' own counts over the root of their number, and no less than
    Poisson's.  Of a recording that was cut, the pixels and the seconds are those that were kept.

    Raises:
        InputError: without light, with light that changes, pooled, or without a single event in any recording.
    """
    rows, columns = [], {"file": [], "radiance": [], "polarity": [], "events": []}
    sizes, units, intervals, pairs, pair_errors = [], [], [], [], []
    # Of a recording, left out: where it begins, references are not yet those that the noise leaves (in simulations
    # they are anywhere between the thresholds, and the nearest fire at once)
    settling = 0.1
    for recording in recordings:
        radiance, begin, end = _still(recording)
        events = recording.events
        pixels = kept_of(recording).count
        if pixels < 1:
            raise InputError(f"{recording.source or recording.name}: attribute crop: expected pixels, found none kept")
        sizes.append(pixels)
        units.append(recording.stimulus.unit if recording.stimulus else "radiance")
        duration = (1.0 - settling) * (end - begin)
        time_s = events.t * 1e-9
        steady = time_s > end - duration
        intervals.append(
            count_intervals(recording.name, radiance, time_s[steady], events.pixel[steady], events.p[steady], duration)
        )
        size = int(events.pixel.max(initial=-1)) + 1
        of_both = []
        for polarity, p in (("ON", 1), ("OFF", 0)):
            counts = np.bincount(events.pixel[steady & (events.p == p)], minlength=size)
            of_both.append(counts)
            total = int(counts.sum())
            error = np.sqrt(max(_scatter(counts, pixels), total, 1.0)) / max(total, 1)
            rows.append((radiance, p == 1, total / (pixels * duration), min(error, 1.0), 1.0 / (pixels * duration)))
            columns["file"].append(recording.name)
            columns["radiance"].append(radiance)
            columns["polarity"].append(polarity)
            columns["events"].append(total)
        on_counts, off_counts = of_both
        if on_counts.any() and off_counts.any():
            pairs.append((len(rows) - 2, len(rows) - 1))
            pair_errors.append(_errors_together(on_counts, off_counts, pixels))
    if not any(columns["events"]):
        raise InputError("noise: the recordings hold no events")
    if len(set(units)) > 1:
        raise InputError(f"noise: expected recordings of one unit of light, found {', '.join(sorted(set(units)))}")
    light, on, rate, error, digit = (np.array(c) for c in zip(*rows, strict=True))
    # less than one event is what a recording cannot see; half of it, so that single events keep their weight
    return NoiseTable(
        light, on.astype(bool), rate, error, 0.5 * digit, np.zeros(len(rows), int), columns,
        units[0], min(sizes),
        tuple(r.source for r in recordings if r.source is not None), tuple(intervals),
        np.array(pairs, int).reshape(-1, 2), np.array(pair_errors).reshape(-1, 2),
    )  # fmt: skip


def _scatter(counts: np.ndarray, pixels: int) -> float:
    """Variance of the sum of counts of all pixels, as they differ; those beyond (counts,) have none."""
    return (float(counts @ counts) * pixels - float(counts.sum()) ** 2) / (pixels - 1) if pixels > 1 else 0.0


def _errors_together(on: np.ndarray, off: np.ndarray, pixels: int) -> tuple[float, float]:
    """Relative errors of the sum and of the difference of ln rates, each over √2.

    Of the sum no less than of Poisson events, of the difference no less than of one event: where thresholds are alike
    ON and OFF events take turns, and a pixel's counts differ by one at most.
    """
    a, b = on / on.sum(), off / off.sum()
    poisson, one = 1.0 / on.sum() + 1.0 / off.sum(), 1.0 / min(on.sum(), off.sum())
    together, apart = _scatter(a + b, pixels), _scatter(a - b, pixels)
    return min(np.sqrt(max(together, poisson) / 2.0), 1.0), min(np.sqrt(max(apart, one**2) / 2.0), 1.0)


def _still(recording: Recording) -> tuple[float, float, float]:
    """(radiance, begin, end in s) of a still scene."""
    where = recording.source or recording.name
    if recording.stimulus is None:
        raise InputError(
            f"{where}: no stimulus: noise needs to know the light; add it with `pixelid convert --stimulus`"
        )
    if recording.pooled:
        raise InputError(f"{where}: pooled events have no pixels; noise needs each pixel's events")
    radiance = np.asarray(recording.stimulus.arrays["radiance"], float)
    mean = float(radiance.mean())
    if np.ptp(radiance) > STILL * mean:
        raise InputError(
            f"{where}: expected constant light, found {radiance.min():g} to {radiance.max():g}: noise events are "
            "those of a still scene"
        )
    begin, end = seconds_looked_at(recording)
    if not end > begin:
        raise InputError(f"{where}: expected a recording that lasts, found {end - begin:g} s")
    return mean, begin, end
