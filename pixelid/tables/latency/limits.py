"""Which stage limits a camera's latency at which irradiance: how much sooner events would come without it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from pixelid.stages.circuit import Circuit
from pixelid.tables.latency.camera import Camera, predict
from pixelid.tables.latency.model import default_setting
from pixelid.tables.latency.reading import PIXELS
from pixelid.tables.latency.spread import Spread

STAGES = ("photoreceptor", "source follower", "differencing amplifier", "comparator and readout")


def limits(camera: Camera, irradiance: np.ndarray) -> list[dict[str, Any]]:
    """Per edge and irradiance: the median latency, and the share of it that goes with each stage.

    Args:
        camera: at its default setting.
        irradiance: (n,) W/m².
    """
    settings = camera.settings
    middle = settings[default_setting(settings)] if settings else None
    circuit = camera.model.circuit()
    found = []
    for on in (True, False):
        if middle is None:
            threshold, delay = camera.threshold_and_delay("-", math.nan, on)
        else:
            threshold, delay = middle.threshold(on), middle.delay(on)
        times = _medians(camera, circuit, irradiance, on, threshold, delay)
        without = [_medians(camera, less, irradiance, on, threshold, wait) for less, wait in _without(circuit, delay)]
        for k, light in enumerate(irradiance):
            shares = {
                stage: float(np.clip(1.0 - t[k] / times[k], 0.0, 1.0)) for stage, t in zip(STAGES, without, strict=True)
            }
            found.append({
                "camera": camera.name, "edge": "on" if on else "off", "irradiance_W_m2": float(light),
                "setting": middle.name if middle else "-", "median_s": float(times[k]),
                "stage": max(shares, key=shares.__getitem__), "shares": shares,
            })  # fmt: skip
    return found


def _without(circuit: Circuit, delay: float) -> list[tuple[Circuit, float]]:
    """(circuit, delay) with each of `STAGES` infinitely fast."""
    return [
        (replace(circuit, photoreceptor="unlimited"), delay),
        (replace(circuit, follower=math.inf), delay),
        (replace(circuit, differencing=math.inf), delay),
        (circuit, 0.0),
    ]


def _medians(camera: Camera, circuit: Circuit, irradiance, on: bool, threshold: float, delay: float) -> np.ndarray:
    ones = np.ones(len(irradiance))
    quiet = Spread(0.0, 0.0, 0.0, 0.0)  # shares of the typical pixel
    found = predict(
        replace(circuit, shot_density=0.0), camera.led_off_fraction, quiet, irradiance, ones == on, threshold * ones,
        delay * ones, PIXELS * ones,
    )  # fmt: skip
    return found["median"]


def limit_sentences(found: list[dict[str, Any]]) -> list[str]:
    """One sentence per camera and edge."""
    said = []
    for camera, edge in dict.fromkeys((entry["camera"], entry["edge"]) for entry in found):
        entries = [e for e in found if (e["camera"], e["edge"]) == (camera, edge)]
        runs: list[list[dict[str, Any]]] = []
        for entry in sorted(entries, key=lambda e: e["irradiance_W_m2"]):
            if runs and runs[-1][-1]["stage"] == entry["stage"]:
                runs[-1].append(entry)
            else:
                runs.append([entry])
        parts = [
            f"the {run[0]['stage']} at {_span([e['irradiance_W_m2'] for e in run])} W/m² "
            f"({100 * min(e['shares'][e['stage']] for e in run):.0f} % of the latency or more)"
            for run in runs
        ]
        said.append(f"{camera}, light {edge}, setting {entries[0]['setting']}: limited by {', then by '.join(parts)}")
    return said


def _span(values: list[float]) -> str:
    return f"{values[0]:g}" if len(values) == 1 else f"{values[0]:g} to {values[-1]:g}"
