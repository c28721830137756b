"""The health of a recording as a table for the terminal."""

from __future__ import annotations

from pixelid.inspection.health import Health

LINES_SHOWN = 5
PIXELS_SHOWN = 3


def health_table(health: Health):
    """A rich Table: one row per finding, in plain words."""
    from rich import box
    from rich.table import Table

    table = Table(title=health.name, box=box.SIMPLE, show_header=False, title_justify="left")
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")
    for name, text in _rows(health):
        table.add_row(name, text)
    return table


def _rows(health: Health) -> list[tuple[str, str]]:
    counts = health.counts
    pooled = ", pixels pooled" if health.pooled else f", {counts.active_pixels} pixels active"
    rows = [
        ("sensor", f"{health.sensor or 'not stated'}, {health.width} × {health.height}{pooled}"),
        ("events", f"{counts.events} in {counts.duration_s:g} s"),
    ]
    if counts.mean_hz is not None and counts.peak_hz is not None:
        window = counts.peak_window_s * 1e3
        rows.append(("rate", f"{_hz(counts.mean_hz)} on average, {_hz(counts.peak_hz)} in the fastest {window:g} ms"))
    if counts.on_fraction is not None:
        rows.append(("ON / OFF", f"{counts.on_fraction:.1%} / {1 - counts.on_fraction:.1%}"))
    if counts.duplicates:
        rows.append(("duplicates", f"{counts.duplicates} events repeat an earlier one"))
    rows += [("dead time", _dead_time(health)), ("timestamp tick", _tick(health)), ("periodic lines", _lines(health))]
    if not health.pooled:
        rows += [("hot pixels", _hot_pixels(health)), ("readout ceiling", _ceiling(health))]
    return rows


def _dead_time(health: Health) -> str:
    dead = health.dead_time
    if dead.interval_95_s is None:
        return f"not visible: {dead.reason}"
    low, high = dead.interval_95_s
    below = f"; {dead.below} of {dead.intervals} intervals are shorter" if dead.below else ""
    if dead.kind == "upper_bound" or dead.value_s is None:
        return f"≤ {_seconds(high)}, shortest interval{below} ({dead.reason})"
    return f"{_seconds(dead.value_s)} (95 %: {_seconds(low)} to {_seconds(high)}){below}"


def _tick(health: Health) -> str:
    tick = health.tick
    if tick.clock_s is None:
        return "too few events to tell"
    clock = f"clock of {_seconds(tick.clock_s)}"
    if tick.scan_s is None:
        return clock
    return f"scan of {_seconds(tick.scan_s)} (jitter {_seconds(tick.scan_jitter_s or 0.0)}), {clock}"


def _lines(health: Health) -> str:
    shown = [
        f"{line.frequency_hz:.2f} Hz (± {line.uncertainty_hz:.2g}, modulation {line.modulation:.2g}"
        + (f", {len(line.harmonics_hz)} harmonics)" if line.harmonics_hz else ")")
        for line in health.lines[:LINES_SHOWN]
    ]
    more = len(health.lines) - len(shown)
    return "\n".join(shown + ([f"and {more} more"] if more else [])) or "none"


def _hot_pixels(health: Health) -> str:
    shown = [f"({pixel.x}, {pixel.y}) at {_hz(pixel.rate_hz)}" for pixel in health.hot_pixels[:PIXELS_SHOWN]]
    return f"{len(health.hot_pixels)}: {', '.join(shown)}" if shown else "none"


def _ceiling(health: Health) -> str:
    ceiling = health.ceiling
    if ceiling is None:
        return "too few events to tell"
    if not ceiling.saturated:
        return "not reached"
    words = "" if ceiling.grouping == "event" else f" ({_hz(ceiling.groups_hz)} {ceiling.grouping} words)"
    return f"saturated {ceiling.time_fraction:.0%} of the time at {_hz(ceiling.rate_hz)}{words}"


def _hz(value: float) -> str:
    for scale, unit in ((1e6, "MHz"), (1e3, "kHz")):
        if value >= scale:
            return f"{value / scale:.3g} {unit}"
    return f"{value:.3g} Hz"


def _seconds(value: float) -> str:
    for scale, unit in ((1.0, "s"), (1e-3, "ms"), (1e-6, "µs")):
        if abs(value) >= scale:
            return f"{value / scale:.4g} {unit}"
    return f"{value * 1e9:.4g} ns"
