"""One evaluation of the event-time likelihood, single-threaded, beside the plain way of doing the same.

Session: one recording, 500 000 stimulus samples, about 200 000 events.  The plain way: the scan one step at a time by
the scalar kernel, the state at every event by the scalar kernel, the density in NumPy (`tests/oracles`).  Times are CPU
seconds of the thread; their ratio is what a busy machine leaves comparable.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

from pixelid.dynamics import vectorised
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.shipped import find_model
from pixelid.simulate import simulate
from pixelid.stimuli.stimulus import Stimulus

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from oracles import event_time_density

SAMPLES, SECONDS = 500_000, 20.0


def session():
    """About 200 000 events of 88 pixels."""
    t = np.linspace(0.0, SECONDS, SAMPLES)
    log_light = np.log(200.0) + np.sin(2 * np.pi * 6 * t) + 0.3 * np.sin(2 * np.pi * 31 * t)
    return simulate(find_model("dvs128"), Stimulus(t, np.exp(log_light), "fA"), width=11, height=8, seed=1)


def best_of(function, repeats: int = 20) -> float:
    """Least CPU milliseconds of this thread over some calls, the first left out (it compiles)."""
    function()
    times = []
    for _ in range(repeats):
        start = time.thread_time()
        function()
        times.append(time.thread_time() - start)
    return 1e3 * min(times)


def main() -> None:
    likelihood = EventTimes([session()])
    circuit = find_model("dvs128").circuit()
    evaluate, layout = likelihood.evaluators[0], likelihood.layout

    def changes(extremes=True):
        evaluate.forget()  # the trajectory is part of an evaluation
        vector = np.empty(layout.size)
        extremes = evaluate.fill(circuit, extremes, *layout.per_section(vector)[0])  # in this thread
        return layout.stacked(vector, (extremes,))

    known = changes()
    full = best_of(lambda: likelihood.terms(circuit, changes()).total)
    with_gradient = best_of(lambda: likelihood.terms(circuit, changes()).gradient())
    frozen = best_of(lambda: likelihood.terms(circuit, changes(known.extremes[0])).gradient())
    alone = best_of(lambda: likelihood.terms(circuit, known).total)
    alone_with_gradient = best_of(lambda: likelihood.terms(circuit, known).gradient())
    applicable, vectorised.applicable = vectorised.applicable, lambda dynamics: False
    plain = best_of(lambda: event_time_density.terms(likelihood, circuit, changes().vector).total, 2)
    vectorised.applicable = applicable
    print(f"{likelihood.events} events, {SAMPLES} samples")
    print(f"likelihood                                {full:8.1f} ms   (target 40 ms)")
    print(f"  its sums alone                          {alone:8.1f} ms")
    print(f"likelihood with its gradient by changes   {with_gradient:8.1f} ms")
    print(f"  with extremes where they were           {frozen:8.1f} ms")
    print(f"  its sums alone                          {alone_with_gradient:8.1f} ms")
    print(f"plain: scalar kernels, NumPy density      {plain:8.1f} ms   ({plain / full:.1f} times)")


if __name__ == "__main__":
    main()
