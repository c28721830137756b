"""The health of a recording in words: rows of a table for the terminal and for the page."""

from __future__ import annotations

from functools import partial
from typing import Any

from pixelid.errors import printable
from pixelid.figures.words import seconds
from pixelid.inspection.health import Health

LINES_SHOWN = 5
PIXELS_SHOWN = 3
_seconds = partial(seconds, digits=4)


def health_table(health: Health):
    """A rich Table: one row per finding, in plain words."""
    from rich import box
    from rich.table import Table

    table = Table(title=printable(health.name), box=box.SIMPLE, show_header=False, title_justify="left")
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")
    for name, text in rows_of_result(health.to_dict()):
        table.add_row(name, text)
    return table


def rows_of_result(result: dict[str, Any]) -> list[tuple[str, str]]:
    """(what, in words) of everything in the content of inspect.json."""
    pooled = ", pixels pooled" if result["pooled"] else f", {result['active_pixels']} pixels active"
    rate = result["rate_hz"]
    rows = [
        ("sensor", f"{result['sensor'] or 'not stated'}, {result['width']} × {result['height']}{pooled}"),
        ("events", f"{result['events']} in {result['duration_s']:g} s"),
    ]
    if rate["mean"] is not None and rate["peak"] is not None:
        window = rate["peak_window_s"] * 1e3
        rows.append(
            ("rate", f"{in_events(rate['mean'])} on average, {in_events(rate['peak'])} in the fastest {window:g} ms")
        )
    if result["on_fraction"] is not None:
        rows.append(("ON / OFF", f"{result['on_fraction']:.1%} / {1 - result['on_fraction']:.1%}"))
    if result["duplicates"]:
        rows.append(("duplicates", f"{result['duplicates']} events repeat an earlier one"))
    rows += [
        ("dead time", _dead_time(result["dead_time_s"])),
        ("timestamp tick", _tick(result["tick"])),
        ("periodic lines", _lines(result["lines"])),
    ]
    if not result["pooled"]:
        rows += [
            ("hot pixels", _hot_pixels(result["hot_pixels"], result["hot_pixel_count"])),
            ("readout ceiling", _ceiling(result["ceiling"])),
        ]
    if "bursts" in result:
        rows.append(("bursts", _bursts(result["bursts"])))
    if result.get("source", {}).get("line"):
        rows.insert(1, ("read as", result["source"]["line"]))
    rows += [("check", doubt) for doubt in result.get("doubts", ())]
    if "biases" in result:
        rows.append(("biases imply", _biases(result["biases"])))
    return rows


def _biases(biases: dict[str, Any]) -> str:
    lines = []
    for name, value in biases["values"].items():
        low, high = value["interval_95"]
        unit = {"log radiance": ""}.get(value["unit"], f" {value['unit']}")
        lines.append(f"{name} {value['value']:.3g}{unit} ({low:.2g} to {high:.2g})")
    return "\n".join([*lines, *(f"{name}: nothing, {why}" for name, why in biases["without"].items())])


def _bursts(bursts: dict[str, Any]) -> str:
    if bursts["pixels"] is None:
        return bursts["reason"]
    text = (
        f"{bursts['full_bursts']} of exactly {bursts['pixels']} events in {_seconds(bursts['burst_s'])}: so many pixels"
    )
    if bursts["row_pixels"] is not None:
        text += f", read out in rows of {bursts['row_pixels']}"
    if bursts["dead_time_at_most_s"] is not None:
        text += f"; dead time ≤ {_seconds(bursts['dead_time_at_most_s'])}, as no pixel fires twice within it"
    if bursts["shared_silence_s"] is not None:
        text += (
            f"; after half of them have fired the others are silent too, for {_seconds(bursts['shared_silence_s'])} "
            "and more: pixels wait for a shared readout, which in full bursts looks like a dead time"
        )
    return text


def _dead_time(dead: dict[str, Any]) -> str:
    if dead["interval_95"] is None:
        return f"not visible: {dead['reason']}"
    low, high = dead["interval_95"]
    below = f"; {dead['below']} of {dead['intervals']} intervals are shorter" if dead["below"] else ""
    if dead["kind"] == "upper_bound" or dead["value"] is None:
        return f"≤ {_seconds(high)}, shortest interval{below} ({dead['reason']})"
    return f"{_seconds(dead['value'])} (95 %: {_seconds(low)} to {_seconds(high)}){below}"


def _tick(tick: dict[str, Any]) -> str:
    if tick["clock_s"] is None:
        return "too few events"
    clock = _seconds(tick["clock_s"])
    if tick["scan_s"] is None:
        return clock
    return f"scan of {_seconds(tick['scan_s'])} (jitter {_seconds(tick['scan_jitter_s'] or 0.0)}), clock {clock}"


def _lines(lines: list[dict[str, Any]]) -> str:
    shown = [
        f"{line['frequency_hz']:.2f} Hz (± {line['uncertainty_hz']:.2g}, modulation {line['modulation']:.2g}"
        + (f", {len(line['harmonics_hz'])} harmonics)" if line["harmonics_hz"] else ")")
        for line in lines[:LINES_SHOWN]
    ]
    more = len(lines) - len(shown)
    return "\n".join(shown + ([f"and {more} more"] if more else [])) or "none"


def _hot_pixels(pixels: list[dict[str, Any]], count: int) -> str:
    shown = [f"({pixel['x']}, {pixel['y']}) at {in_events(pixel['rate_hz'])}" for pixel in pixels[:PIXELS_SHOWN]]
    return f"{count}: {', '.join(shown)}" if shown else "none"


def _ceiling(ceiling: dict[str, Any] | None) -> str:
    if ceiling is None:
        return "too few events"
    if not ceiling["saturated"]:
        return "not reached"
    words = "" if ceiling["grouping"] == "event" else f" ({ceiling['groups_hz']:.3g} {ceiling['grouping']} words/s)"
    return f"saturated {ceiling['time_fraction']:.0%} of the time at {in_events(ceiling['rate_hz'])}{words}"


def in_events(value: float) -> str:
    """A rate of events.

    >>> in_events(2.49e7), in_events(12.0)
    ('24.9 Mev/s', '12 ev/s')
    """
    for scale, unit in ((1e6, "Mev/s"), (1e3, "kev/s")):
        if value >= scale:
            return f"{value / scale:.3g} {unit}"
    return f"{value:.3g} ev/s"
