"""Latency tables by brute force: every event of every pixel simulated, and the first after each edge counted."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from pixelid.model.model import Model, expected_parameters
from pixelid.simulate.simulator import simulate
from pixelid.stimuli.stimulus import Stimulus

EFFECTS = ("source_follower_pole", "differencing_pole", "threshold_mismatch", "threshold_noise")
TRUE = {
    "alpha": 2e5 * 1e5, "beta": 1e5, "gamma": 0.034 * 2e5, "sf_cutoff_hz": 2000.0, "diff_cutoff_hz": 5e4,
    "threshold_mismatch.sigma": 0.06, "threshold_sigma": 0.05,
}  # fmt: skip
OFF_FRACTION = 0.2
DELAY_S = 2e-5  # from crossing to time stamp, which the simulator does not have
SETTINGS = {"0.50MIN": (0.3, 0.25), "0": (0.45, 0.4), "0.50MAX": (0.6, 0.55)}
IRRADIANCES = (0.006, 0.046, 0.3)
SIDE = 10


def latencies(model: Model, irradiance: float, on: bool, edge: int) -> np.ndarray:
    """Seconds from one edge of the light to the first event of each pixel that fires (10 × 10 of the same sensor)."""
    bright, dim = irradiance, OFF_FRACTION * irradiance
    wait, hold = 0.001, 0.05
    light = np.array([dim, bright, bright] if on else [bright, dim, dim])
    stimulus = Stimulus(np.array([0.0, wait, wait + hold]), light, interpolation="previous")
    recording = simulate(
        model, stimulus, width=SIDE, height=SIDE, seed=1 + edge, sensor_seed=1, synchronous=True, threads=1
    )
    events = recording.events
    mine = (events.p == (1 if on else 0)) & (events.t >= round(wait * 1e9))
    _, first = np.unique(events.pixel[mine], return_index=True)  # events are in order of time
    return events.t[mine][first] * 1e-9 - wait + DELAY_S


def write_table(path: Path, irradiances=IRRADIANCES, edges: int = 5, true=TRUE) -> Path:
    """A CSV of every setting, edge and irradiance."""
    base = Model("true", "second_order", EFFECTS, expected_parameters("second_order", EFFECTS), radiance_unit="W/m2")
    with path.open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(
            ["camera", "lens", "polarity", "irradiance_W_m2", "bias_config", "min", "median", "max", "stdev", "pixels"]
        )
        for name, (on_threshold, off_threshold) in SETTINGS.items():
            model = base.set({**true, "on_threshold": on_threshold, "off_threshold": off_threshold})
            for irradiance in irradiances:
                for on in (True, False):
                    runs = [1e6 * latencies(model, irradiance, on, edge) for edge in range(edges)]
                    row = [
                        np.mean([run.min() for run in runs]),
                        np.mean([np.median(run) for run in runs]),
                        np.mean([run.max() for run in runs]),
                        np.std([run.mean() for run in runs]),
                        np.mean([len(run) for run in runs]),
                    ]
                    table.writerow(["SIM", "lens", int(on), irradiance, name, *(f"{value:.5g}" for value in row)])
    return path
