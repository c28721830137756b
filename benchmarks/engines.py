"""Every engine on one small session: value, gradient, Hessian and a whole search, in CPU seconds, and how they agree.

python benchmarks/engines.py [RECORDINGS…]
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

from pixelid.fit.coordinates import Coordinates
from pixelid.fit.engines import engine
from pixelid.fit.event_times import EventTimesObjective
from pixelid.fit.newton import maximise
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.shipped import find_model
from pixelid.recordings import open_recordings
from pixelid.simulate import simulate
from pixelid.stimuli.shapes import chirp, steps

ENGINES = (("scipy", {}), ("casadi", {"evaluation": "compiled"}), ("torch", {"evaluation": "compiled"}))


def session():
    """Two recordings of 16 pixels."""
    light = [chirp(20.0, stop_hz=200.0, duration_s=0.4, dt=1e-4), steps(400.0, duration_s=0.4, dt=1e-4)]
    return [simulate(find_model("dvs128"), s, width=4, height=4, seed=i, as_sampled=True) for i, s in enumerate(light)]


def timed(function):
    """(result, CPU seconds), after one call to compile."""
    function()
    start = time.process_time()
    return function(), time.process_time() - start


def main(paths: list[str]) -> None:
    recordings = open_recordings([Path(p) for p in paths]) if paths else session()
    objective = EventTimesObjective(EventTimes(recordings), Coordinates.of(find_model("dvs128")))
    best = maximise(objective, objective.coordinates.start, tolerance=1e-9)
    sd = np.sqrt(np.diag(np.linalg.inv(best.local.information)))
    size = sum(len(r.stimulus.t) for r in recordings if r.stimulus is not None)
    print(f"{objective.likelihood.events} events, {size} stimulus samples, {len(sd)} free parameters")
    expected = objective.value(best.x)
    for name in ("scipy", "casadi", "torch"):
        made = engine(name)
        value, seconds = timed(lambda made=made: made.value(objective, best.x))
        gradient, slower = timed(lambda made=made: made.gradient(objective, best.x + 0.01))
        print(
            f"{name:8s} value {seconds:7.3f} s (relative difference {abs(value / expected - 1):.1e}), "
            f"gradient {slower:7.3f} s ({np.abs(gradient).max():.3e})"
        )
    start = best.x + 0.1 * np.cos(np.arange(len(sd)))
    for name, options in ENGINES:
        maximum, seconds = timed(lambda n=name, o=options: engine(n, **o).maximise(objective, start, tolerance=1e-8))
        away = np.abs((maximum.x - best.x) / sd).max()
        print(f"{name:8s} search {seconds:7.2f} s, {maximum.steps} steps, {away:.1e} standard errors from the optimum")


if __name__ == "__main__":
    main(sys.argv[1:])
