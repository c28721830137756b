"""One evaluation of the event-time likelihood beside the plain way of doing the same.

The plain way: the scan one step at a time by the scalar kernel, the state at every event by the scalar kernel, the
density in NumPy (`tests/oracles`).
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

import numpy as np

from paths.counting import step_flops
from paths.sizes import Sizes
from paths.timing import Counts, Other, Target, Task, compared
from pixelid.dynamics import vectorised
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.shipped import find_model
from pixelid.simulate import simulate
from pixelid.stimuli.stimulus import Stimulus

TESTS = Path(__file__).resolve().parents[2] / "tests"
PLAIN = "scalar kernels, NumPy density"


def tasks(sizes: Sizes) -> Iterator[Task]:
    """The value, and the value with its gradient by what the circuit does to the light."""
    for path, with_gradient, limit in (("value", False, 0.020), ("value and gradient", True, 0.040)):
        yield Task("likelihood", f"likelihood, {path}", lambda g=with_gradient, s=limit: measured(g, s, sizes))


@lru_cache(maxsize=1)
def evaluated(samples: int, seconds: float, pixels: tuple[int, int]):
    """(likelihood, circuit, function of changes), of one recording."""
    t = np.linspace(0.0, seconds, samples)
    log_light = np.log(200.0) + np.sin(2 * np.pi * 6 * t) + 0.3 * np.sin(2 * np.pi * 31 * t)
    recording = simulate(
        find_model("dvs128"), Stimulus(t, np.exp(log_light), "fA"), width=pixels[0], height=pixels[1], seed=1
    )
    likelihood = EventTimes([recording])
    circuit = find_model("dvs128").circuit()
    evaluate, layout = likelihood.evaluators[0], likelihood.layout

    def changes():
        evaluate.forget()  # the trajectory is part of an evaluation
        vector = np.empty(layout.size)
        extremes = evaluate.fill(circuit, True, *layout.per_section(vector)[0])  # in this thread
        return layout.stacked(vector, (extremes,))

    return likelihood, circuit, changes


def measured(with_gradient: bool, limit: float, sizes: Sizes) -> dict:
    """A row; one thread."""
    samples = sizes.likelihood_samples
    likelihood, circuit, changes = evaluated(samples, sizes.likelihood_seconds, sizes.likelihood_pixels)
    sys.path.insert(0, str(TESTS))
    event_time_density = importlib.import_module("oracles.event_time_density")

    def ours():
        terms = likelihood.terms(circuit, changes())
        return terms.gradient() if with_gradient else terms.total

    def plain():
        applicable, vectorised.applicable = vectorised.applicable, lambda dynamics: False
        try:
            return event_time_density.terms(likelihood, circuit, changes().vector).total
        finally:
            vectorised.applicable = applicable

    assert np.isclose(likelihood.terms(circuit, changes()).total, plain(), rtol=1e-9)
    events = likelihood.events
    steps = samples + events  # a step to every sample, and one to every event
    # to a sample √ and one exp (steps of one length share the others); to an event's release and to itself √ and three
    # exp each, then what is left of the reset, and a log in the density
    exponentials = (2 * samples + 10 * events) / steps
    return compared(
        ours,
        Other(PLAIN, f"numpy {np.__version__}", plain),
        sizes.runs,
        size=f"{events} events, {samples} samples",
        item="step",
        items=steps,
        target=Target("seconds", limit),
        counts=Counts(bytes=8.0 * (2 * 6 + 3), flops=step_flops(), exponentials=exponentials),
        words="the scan over the samples, the state at every event, the search for extremes between events",
        note="the plain way makes the value only" if with_gradient else "",
    )
