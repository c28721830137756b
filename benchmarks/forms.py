"""Both forms of the likelihood by every engine on one real-sized chirp: CPU seconds, and how far they end apart.

python benchmarks/forms.py [RECORDINGS…]        without recordings: 9 pixels of dvs128 under the built-in chirp
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

from pixelid.fit.coordinates import Coordinates
from pixelid.fit.engines import ENGINES, engine
from pixelid.fit.event_times import EventTimesObjective
from pixelid.fit.newton import maximise
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.shipped import find_model
from pixelid.recordings import open_recordings
from pixelid.simulate import simulate
from pixelid.stimuli.resample import resampled
from pixelid.stimuli.shapes import chirp

TOLERANCE = 1e-4


def main(paths: list[str]) -> None:
    model = find_model("dvs128")
    recordings = open_recordings([Path(p) for p in paths]) if paths else [simulate(model, chirp(), width=3, height=3)]
    finer = [r.with_stimulus(resampled(r.stimulus, "smooth")) for r in recordings if r.stimulus is not None]
    objective = EventTimesObjective(EventTimes(finer), Coordinates.of(model))
    best = maximise(objective, objective.coordinates.start)
    sd = np.sqrt(np.diag(np.linalg.inv(best.local.information)))
    samples = sum(len(r.stimulus.t) for r in finer if r.stimulus is not None)
    print(f"{objective.likelihood.events} events, {samples} stimulus samples, {len(sd)} free parameters")
    print("| engine | form | CPU s | log-likelihood difference | largest shift, standard errors |")
    print("|---|---|---|---|---|")
    start = best.x + 0.5 * sd * np.cos(np.arange(len(sd)))
    for name in ENGINES:
        made = engine(name)
        for form in ("discrete", "continuous"):
            begun = time.process_time()
            if form == "discrete":
                end = made.maximise(objective, start, tolerance=TOLERANCE)
            else:
                end = maximise(made.continuous(objective, best.x), best.x, tolerance=TOLERANCE, max_steps=20)
            seconds = time.process_time() - begun
            shift = np.abs((end.x - best.x) / sd).max()
            print(
                f"| {name} | {form} | {seconds:.1f} | {end.local.value - best.local.value:+.4f} | {shift:.3f} |",
                flush=True,
            )


if __name__ == "__main__":
    main(sys.argv[1:])
