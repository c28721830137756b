"""A calibration session of a camera nobody has seen, simulated, fitted and compared with its truth.

Five recordings, nine pixels: chirps at three light levels, random steps, a slow sine.  The hidden camera differs from
the shipped `dvs128` by factors up to e^±0.4 in every parameter; the fit starts from the shipped values.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from pixelid.figures.style import IMPROVED, INK, MUTED, new_axis, save_figure, styled
from pixelid.fit import FitResult, fit
from pixelid.fit.figures import write_figures
from pixelid.model.model import Model
from pixelid.model.shipped import find_model
from pixelid.outputs import write_json
from pixelid.recordings import Recording, write_recording
from pixelid.report.html import write_report
from pixelid.simulate import simulate
from pixelid.stimuli.shapes import chirp, slow, steps

HIDDEN = ("alpha", "beta", "gamma", "sf_cutoff_hz", "diff_cutoff_hz", "on_threshold", "off_threshold", "refractory_s")
SIDE = 3


@dataclass(frozen=True)
class Demo:
    """What the demo made: the hidden camera, its recordings, and the fit."""

    truth: Model
    recordings: tuple[Recording, ...]
    result: FitResult


def hidden_camera(seed: int) -> Model:
    """The shipped circuit with every parameter moved by a random factor."""
    model = find_model("dvs128")
    rng = np.random.default_rng(seed)
    moved = {name: model.values[name] * float(np.exp(rng.uniform(-0.4, 0.4))) for name in HIDDEN}
    return replace(model.set(moved), name="hidden_camera")


def calibration_session(model: Model, seed: int) -> tuple[Recording, ...]:
    """The five recordings of the demo's session."""
    stimuli = {
        "chirp_3": chirp(level=3.0),
        "chirp_24": chirp(level=24.0),
        "chirp_400": chirp(level=400.0),
        "steps_24": steps(level=24.0, seed=seed),
        "slow_24": slow(level=24.0, seed=seed),
    }
    return tuple(
        replace(
            simulate(model, stimulus, width=SIDE, height=SIDE, seed=seed + i, sensor_seed=seed),
            condition=name,
        )
        for i, (name, stimulus) in enumerate(stimuli.items())
    )


def run_demo(folder: Path, seed: int, progress: Callable[[str, float], None]) -> Demo:
    """Simulate, fit, and write recordings, result, figures and report into an existing folder."""
    progress("simulating", 0.0)
    truth = hidden_camera(seed)
    recordings = calibration_session(truth, seed)
    (folder / "recordings").mkdir()
    for i, recording in enumerate(recordings):
        write_recording(recording, folder / "recordings" / f"{recording.condition}.h5")
        progress("simulating", 0.15 * (i + 1) / len(recordings))
    named = tuple(replace(r, source=folder / "recordings" / f"{r.condition}.h5") for r in recordings)
    result = fit(
        named, find_model("dvs128"), seed=seed, progress=lambda what, share: progress(what, 0.15 + 0.7 * share)
    )
    progress("drawing", 0.85)
    result.write(folder)
    write_json(folder / "truth.json", truth.values)
    write_figures(result, named, folder)
    save_figure(draw_truth(result, truth), folder / "truth.svg")
    write_report(folder)
    progress("done", 1.0)
    return Demo(truth, named, result)


@styled
def draw_truth(result: FitResult, truth: Model, axis: Any = None) -> Any:
    """Estimate and 95 % interval of every free parameter, relative to the truth, beside where the fit started."""
    free = [e for e in result.estimates.values() if not e.fixed and e.interval_95]
    start = find_model("dvs128").values
    axis = axis if axis is not None else new_axis(7.5, 0.3 * len(free) + 0.8)
    for row, estimate in enumerate(reversed(free)):
        true = truth.values[estimate.name]
        low, high = estimate.interval_95 or (np.nan, np.nan)
        low = estimate.value if low is None else low  # an open side has no end to draw
        high = estimate.value if high is None else high
        axis.plot([low / true, high / true], [row, row], color=IMPROVED, linewidth=3, solid_capstyle="butt")
        axis.plot(estimate.value / true, row, "o", color=IMPROVED, label=None if row else "fit, 95 % interval")
        axis.plot(start[estimate.name] / true, row, "x", color=MUTED, label=None if row else "start")
    axis.set_yticks(range(len(free)), [e.name for e in reversed(free)])
    axis.axvline(1.0, color=INK, linewidth=0.8)
    axis.set(xscale="log", xlabel="value relative to the truth")
    axis.legend()
    return axis
