"""Figures of the low-light analysis."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from pixelid.figures.style import IMPROVED, INK, MUTED, SERIES, legend_above, new_axes, save_figure, styled
from pixelid.lowlight import poles, radii, response
from pixelid.stages.circuit import Circuit

STYLES = {"exact": (INK, "-"), "one_pole": (SERIES[1], "--"), "at_dark": (SERIES[4], ":")}
MOST_ERROR = 105.0  # per cent, that are drawn
LABELS = {"exact": "exact", "one_pole": "one pole (α/β) L", "at_dark": "tangent in the dark"}


def write_figures(result: dict, circuit: Circuit, folder: Path) -> None:
    """Write poles, errors, bode, steps, with recordings measured and with latencies latency_poles, into `folder`."""
    kinds = kinds_of(circuit)
    drawn = {
        "poles": draw_poles(result, circuit, kinds),
        "errors": draw_errors(result, circuit, kinds[1:]),
        "bode": draw_bode(result, circuit, kinds),
        "steps": draw_steps(result, circuit, kinds),
    }
    if any(entry.get("curve") and len(entry["curve"]["x"]) for entry in result["measured"]):
        drawn["measured"] = draw_measured(result)
    if result.get("latency"):
        drawn["latency_poles"] = draw_latency_poles(result["latency"])
    for name, axes in drawn.items():
        save_figure(axes, folder / f"{name}.svg")


def kinds_of(circuit: Circuit) -> list[str]:
    """What is drawn: the tangent in the dark is the same line as one pole when there is no dark current."""
    return ["exact", "one_pole"] + (["at_dark"] if circuit.dark > 0 else [])


def _shade(axis, result: dict) -> None:
    """The complex range in grey."""
    critical = result["regimes"]["critical"]
    left, right = axis.get_xlim()
    if critical:
        axis.axvspan(max(critical[0], left), min(critical[1], right), color=MUTED, alpha=0.15, linewidth=0)
        axis.set_xlim(left, right)


@styled
def draw_poles(result: dict, circuit: Circuit, kinds: list[str], axes: Any = None) -> Any:
    """Poles, −3 dB frequency and step time over radiance, with bands and measured points."""
    curves, bands = result["curves"], result["bands"]
    if axes is None:
        axes = new_axes(1, 3, 3.6, 3.0)
    for axis, name, label in zip(
        axes[0],
        ("slow_pole", "bandwidth_hz", "step_time_s"),
        ("pole magnitude (rad/s)", "−3 dB frequency of the pixel (Hz)", "time to 63 % of the pixel (s)"),
        strict=True,
    ):
        if bands:
            axis.fill_between(bands["radiance"], *bands["curves"][name], color=MUTED, alpha=0.4, linewidth=0)
        for kind in kinds:
            colour, line = STYLES[kind]
            axis.plot(curves["radiance"], curves[kind][name], color=colour, linestyle=line, label=LABELS[kind])
        for entry in result["measured"]:
            if entry["quantity"] == name and entry["value"] is not None:
                low, high = entry["interval_95"] or (entry["value"], entry["value"])
                axis.plot([entry["radiance"]] * 2, [low, high], color=IMPROVED, linewidth=3)
                axis.plot(entry["radiance"], entry["value"], "o", color=IMPROVED, markersize=4)
                if entry["model"]["same_light"]:
                    axis.plot(entry["radiance"], entry["model"]["same_light"], "x", color=INK, markersize=5)
        axis.set(xscale="log", yscale="log", xlabel=f"radiance ({result['radiance_unit']})", ylabel=label)
    axes[0, 0].plot(curves["radiance"], curves["exact"]["fast_pole"], color=INK, alpha=0.4, label="second pole")
    for name, colour in zip(poles.stages(circuit), SERIES[2:], strict=False):
        words = name.replace("_", " ")
        axes[0, 0].plot(curves["radiance"], curves["exact"][name], color=colour, alpha=0.8, label=words)
    for axis in axes[0]:
        _shade(axis, result)
    legend_above(axes, 3)
    return axes


def _mark_exits(axis, x: np.ndarray, y: np.ndarray, colour: str) -> None:
    """Triangles where a curve leaves the axis of errors."""
    for side, marker in ((1, "^"), (-1, "v")):
        beyond = side * y > MOST_ERROR
        out = np.flatnonzero(beyond[1:] != beyond[:-1])
        if len(out):  # nothing to draw, not clipped, has no place in a layout
            axis.plot(x[out], np.full(len(out), side * MOST_ERROR), marker, color=colour, clip_on=False)


@styled
def draw_errors(result: dict, circuit: Circuit, kinds: list[str], axes: Any = None) -> Any:
    """Signed relative errors of the approximations over radiance."""
    if axes is None:
        axes = new_axes(1, 3, 3.6, 3.0)
    radiance = result["curves"]["radiance"]
    for axis, name in zip(axes[0], radii.QUANTITIES, strict=True):
        for kind in kinds:
            for scope in result["errors"][kind][name]:
                error = 100 * radii.error_function(circuit, kind, name, scope)(radiance)
                _mark_exits(axis, radiance, error, STYLES[kind][0])
                axis.plot(
                    radiance,
                    error,
                    color=STYLES[kind][0],
                    linestyle="-" if scope == "photoreceptor" else "--",
                    label=f"{LABELS[kind]}, of the {scope}",
                )
        for level in radii.LEVELS:
            for sign in (-100, 100):
                axis.axhline(sign * level, color=MUTED, linewidth=0.5)
        axis.axhline(0.0, color=INK, linewidth=0.8)
        axis.set(xscale="log", ylim=(-MOST_ERROR, MOST_ERROR), xlabel=f"radiance ({result['radiance_unit']})")
        axis.set(ylabel=f"error of the {name.replace('_', ' ')} (%)")
        _shade(axis, result)
    legend_above(axes, 2)
    return axes


def _chain(circuit: Circuit, radiance: float, kind: str) -> np.ndarray:
    if kind == "exact":
        return poles.exact(circuit, radiance, "pixel")
    return poles.approximate(circuit, radiance, "pixel", kind)


@styled
def draw_bode(result: dict, circuit: Circuit, kinds: list[str], axes: Any = None) -> Any:
    """Gain and phase of the whole pixel at several radiance levels."""
    levels = [entry["radiance"] for entry in result["regimes"]["levels"]]
    if axes is None:
        axes = new_axes(2, len(levels), 2.8, 2.4)
    cutoffs = [radii.quantity("bandwidth", _chain(circuit, radiance, "exact")) for radiance in levels]
    f = np.geomspace(min(cutoffs) / 30, max(cutoffs) * 30, 300)  # levels are compared: one range
    for column, radiance in enumerate(levels):
        for kind in kinds:
            colour, line = STYLES[kind]
            H = response.gain(_chain(circuit, radiance, kind), f)
            axes[0, column].plot(f, 20 * np.log10(np.abs(H)), color=colour, linestyle=line, label=LABELS[kind])
            axes[1, column].plot(f, np.degrees(np.unwrap(np.angle(H))), color=colour, linestyle=line)
        axes[0, column].axhline(-3.01, color=MUTED, linewidth=0.5)
        axes[0, column].set(xscale="log", ylim=(-60, 12), title=f"{radiance:.3g} {result['radiance_unit']}")
        axes[1, column].set(xscale="log", xlabel="frequency (Hz)")
    axes[0, 0].set_ylabel("gain (dB)")
    axes[1, 0].set_ylabel("phase (°)")
    low = min(axis.get_ylim()[0] for axis in axes[1])
    for axis in axes[1]:
        axis.set_ylim(low, 10.0)
    legend_above(axes)
    return axes


@styled
def draw_steps(result: dict, circuit: Circuit, kinds: list[str], axes: Any = None) -> Any:
    """Response of the whole pixel to a small step of ln L at several radiance levels."""
    levels = [entry["radiance"] for entry in result["regimes"]["levels"]]
    if axes is None:
        axes = new_axes(1, len(levels), 2.8, 2.6)
    for axis, radiance in zip(axes[0], levels, strict=True):
        t = np.linspace(0, 8 * radii.quantity("step_time", _chain(circuit, radiance, "exact")), 161)
        for kind in kinds:
            colour, line = STYLES[kind]
            y = response.step_response(_chain(circuit, radiance, kind), t)
            axis.plot(1e3 * t, y, color=colour, linestyle=line, label=LABELS[kind])
        axis.axhline(response.LEVEL, color=MUTED, linewidth=0.5)
        axis.set(xlabel="time after the step (ms)", title=f"{radiance:.3g} {result['radiance_unit']}")
    axes[0, 0].set_ylabel("response")
    top = max(axis.get_ylim()[1] for axis in axes[0])
    for axis in axes[0]:  # levels are compared: one range
        axis.set_ylim(-0.05, top)
    legend_above(axes)
    return axes


@styled
def draw_measured(result: dict, axes: Any = None) -> Any:
    """Gain over frequency and response over time, of the recordings and of the model under the same light."""
    entries = [e for e in result["measured"] if e.get("curve") and len(e["curve"]["x"])]
    columns = min(4, len(entries))
    if axes is None:
        axes = new_axes(-(-len(entries) // columns), columns, 3.2, 2.6)
    for axis, entry in zip(axes.flat, entries, strict=False):
        sweep = entry["kind"] == "sweep"
        scale = 1.0 if sweep else 1e3
        axis.plot(scale * np.asarray(entry["curve"]["x"]), entry["curve"]["y"], "o-" if sweep else "-",
                  color=IMPROVED, markersize=3, label="recording")  # fmt: skip
        beside = (entry["model"] or {}).get("curve")
        if beside and len(beside["x"]):
            axis.plot(scale * np.asarray(beside["x"]), beside["y"], color=INK, label="model, same light")
        axis.axhline(np.sqrt(0.5) if sweep else response.LEVEL, color=MUTED, linewidth=0.5)
        axis.set_title(f"{entry['recording']} ({entry['radiance']:.3g} {result['radiance_unit']})")
        axis.set_xlabel("frequency (Hz)" if sweep else "time after the edge (ms)")
        if sweep:
            axis.set_xscale("log")
    for axis in axes.flat[len(entries) :]:
        axis.set_axis_off()
    legend_above(axes)
    return axes


@styled
def draw_latency_poles(latency: dict, axes: Any = None) -> Any:
    """Dominant pole in every light of a table of latencies, and of the model with its band; one panel per edge."""
    if axes is None:
        axes = new_axes(1, 2, 4.0, 3.2)
    for axis, edge in zip(axes[0], ("on", "off"), strict=True):
        here = sorted((e for e in latency["levels"] if e["edge"] == edge), key=lambda e: e["light_W_m2"])
        light = np.array([e["light_W_m2"] for e in here])
        for name, colour, line, label in (
            ("model", INK, "-", "model"), ("one_law", SERIES[1], "--", "one circuit fitted to this table")
        ):  # fmt: skip
            axis.plot(light, [e[name]["pole_rad_s"] for e in here], line, color=colour, label=label)
            if here and here[0][name]["interval_95"]:
                low, high = np.array([[np.inf if v is None else v for v in e[name]["interval_95"]] for e in here]).T
                axis.fill_between(light, low, high, color=colour, alpha=0.15, linewidth=0)
        for known, mark in ((True, "o"), (False, "^")):
            some = [e for e in here if e["identified"] == known]
            for e in some:
                low, high = e["interval_95"]
                top = high if known and high is not None else 3.0 * low
                axis.plot([e["light_W_m2"]] * 2, [low, top], color=IMPROVED, linewidth=1.5)
            x, y = [e["light_W_m2"] for e in some], [e["pole_rad_s" if known else "interval_95"] for e in some]
            label = "measured" if known else "measured: above"
            axis.plot(x, y if known else [low for low, _ in y], mark, color=IMPROVED, markersize=4, label=label)
        axis.set(xscale="log", yscale="log", xlabel="light after the step (W/m²)", title=f"light {edge}")
    axes[0, 0].set_ylabel("dominant pole (rad/s)")
    legend_above(axes)
    return axes
