"""What a fit must not claim: the limits of the stimuli, put to the test where curvature alone would mislead."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pixelid.fit.event_times import EventTimesObjective
from pixelid.fit.newton import maximise
from pixelid.fit.objective import Objective
from pixelid.fit.uncertainty.profiles import at_fixed
from pixelid.fit.uncertainty.stimulus_design import caveats, design_of, exchanged_poles
from pixelid.recordings.recording import Recording
from pixelid.statistics import DROP_NATS

DISTANCE = 0.5  # of a log coordinate: a parameter that may move so far is not identified
KINETIC = ("alpha", "beta", "gamma", "alpha_over_beta", "sf_cutoff_hz", "extra_pole.cutoff_hz", "diff_cutoff_hz")


def challenged(
    objective: Objective, x: np.ndarray, identified: np.ndarray, recordings: Sequence[Recording]
) -> tuple[np.ndarray, list[str]]:
    """(identified (d,), sentences): the reading of the curvature, corrected by what the stimuli can identify.

    A poor design (one level, or one frequency) is distrusted: every bandwidth that curvature calls identified is moved
    by a factor e^±0.5 with all else fitted again, and where two poles could have changed places the other assignment
    is tried.  What then falls by less than 1.92 nats (95 %) is not identified.
    """
    design = design_of(recordings)
    coordinates = objective.coordinates
    sentences = caveats(design, coordinates.values(x), coordinates.names)
    identified = identified.copy()
    if not design.poor or not isinstance(objective, EventTimesObjective):
        return identified, sentences
    lower, upper = coordinates.bounds()
    top = objective.value(x)
    for i, name in enumerate(coordinates.names):
        if name not in KINETIC or not identified[i]:
            continue
        for sign in (-1, 1):
            moved = x.copy()
            moved[i] = np.clip(x[i] + sign * DISTANCE, lower[i], upper[i])
            if top - at_fixed(objective, moved, i, top - DROP_NATS)[0] < DROP_NATS:
                identified[i] = False
                sentences.append(f"{name} × {np.exp(sign * DISTANCE):.2g} fits equally well after refitting the others")
                break
    if design.one_level:
        names = ("alpha", "beta", "gamma", "sf_cutoff_hz")
        values = coordinates.values(x)
        level = float(np.exp(np.mean(np.log(design.levels))))
        index = {name: i for i, name in enumerate(coordinates.names)}
        if all(name in index for name in names):
            for other in exchanged_poles(values, level):
                moved = x.copy()
                for name in names:
                    moved[index[name]] = np.log(other[name])
                moved = np.clip(moved, lower, upper)
                end = maximise(objective, moved, tolerance=1e-2, max_steps=25, wanted=top - DROP_NATS)
                if top - end.local.value < DROP_NATS and np.abs(end.x - x)[[index[n] for n in names]].max() > 0.1:
                    exchanged = coordinates.values(end.x)
                    for name in names:
                        identified[index[name]] = False
                    sentences.append(
                        "exchanged poles fit as well: " + ", ".join(f"{name} {exchanged[name]:.4g}" for name in names)
                    )
    return identified, sentences
