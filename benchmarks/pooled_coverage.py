"""Intervals of pooled fits: how many of them hold the truth, over pools that another simulator made.

    python -m benchmarks.pooled_coverage [sessions] [first seed] [seconds]

Prints a line per session (status, CPU seconds, dead time, what misses) and the share of intervals that hold the truth.
"""

from __future__ import annotations

import sys
import time

import numpy as np

from pixelid.errors import InputError
from pixelid.fit.fit import fit
from pixelid.model.shipped import find_model
from pixelid.recordings.events import Events
from pixelid.recordings.recording import Recording
from pixelid.stimuli.stimulus import Stimulus
from tests.oracles.pooled_sessions import Session, session


def recording_of(made: Session, name: str = "pool") -> Recording:
    """The session as a pooled recording."""
    zeros = np.zeros(len(made.t_ns), np.uint16)
    events = Events(t=made.t_ns, x=zeros, y=zeros, p=made.p, width=1, height=1)
    light = Stimulus(made.light_t, made.light, "relative", "previous")
    return Recording(events, light, condition=name, pooled=True)


def main(sessions: int = 10, first: int = 0, seconds: float = 0.5) -> None:
    """Fit that many sessions and count."""
    held, given, converged = 0, 0, 0
    for seed in range(first, first + sessions):
        made, begin = session(seed, seconds), time.process_time()
        try:
            end = fit([recording_of(made)], find_model("dvs128"))
        except InputError as error:
            print(f"{seed}: {error}", flush=True)
            continue
        cpu_s = time.process_time() - begin
        within = {
            name: made.truth[name]
            for name, e in end.estimates.items()
            if name in made.truth and e.interval_95 is not None
        }
        missed = [
            f"{name} {end.estimates[name].value:.4g} for {true:.4g}"
            for name, true in within.items()
            if not end.estimates[name].interval_95[0] <= true <= end.estimates[name].interval_95[1]
        ]
        pairs = {name: (end.estimates[name].value, made.truth[name]) for name in ("pooled.pixels", "refractory_s")}
        of_truth = ", ".join(f"{name} {value:.4g} of {true:.4g}" for name, (value, true) in pairs.items())
        dispersion = end.details["dispersion"]
        print(f"{seed}: {end.status}, {len(made.t_ns)} events, {cpu_s:.0f} s, dispersion {dispersion:.2f}, {of_truth}")
        print(f"    missed: {', '.join(missed) or '-'}", flush=True)
        if str(end.status) == "converged":
            converged, held, given = converged + 1, held + len(within) - len(missed), given + len(within)
    share = held / given if given else float("nan")
    print(f"{converged} of {sessions} converged; {held} of {given} intervals hold the truth: {100 * share:.0f} %")


if __name__ == "__main__":
    arguments = sys.argv[1:]
    main(*map(int, arguments[:2]), *map(float, arguments[2:3]))
