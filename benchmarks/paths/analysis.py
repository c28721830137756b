"""Analyses of sessions simulated here: a fit, a posterior, a search for the gap, maps of a sensor."""

from __future__ import annotations

import time
from collections.abc import Iterator
from functools import lru_cache

from gap_certification import camera
from gap_certification import session as small_session

from paths.sizes import Sizes
from paths.timing import Target, Task, compared, row
from pixelid.demo.demo import calibration_session, hidden_camera
from pixelid.fit import fit
from pixelid.gap.gap import gap
from pixelid.model.model import Model
from pixelid.model.shipped import find_model
from pixelid.sample import sample
from pixelid.sensors import fit_sensor
from pixelid.simulate import simulate
from pixelid.stimuli.shapes import chirp, steps

SEED = 1
FIT_S, POSTERIOR_S, GAP_S, SENSOR_S = 3.0, 25.0, 60.0, 300.0
CORES = 2  # of the target for whole sensors


def tasks(sizes: Sizes) -> Iterator[Task]:
    """The rows; all seeded, so that every run does the same."""
    yield Task("analysis", "fit", lambda: _fit(sizes))
    yield Task("analysis", "sensor", lambda: _sensor(sizes))
    if sizes.gap:
        yield Task("analysis", "gap", lambda: _gap(sizes))
    yield Task("analysis", "posterior", lambda: _posterior(sizes))  # the longest last


def _model(sizes: Sizes) -> Model:
    """What is fitted: with noise of the thresholds, which the likelihood needs."""
    model = find_model(sizes.model)
    return model if "threshold_noise" in model.effects else model.with_effect("threshold_noise")


@lru_cache(maxsize=1)
def _recordings(sizes: Sizes):
    """The demo's session (five recordings, nine pixels), or for another model one recording of its own."""
    if sizes.model == "dvs128":
        return calibration_session(hidden_camera(SEED), SEED)
    return (simulate(_model(sizes), steps(24.0, duration_s=0.2), width=2, height=2, seed=SEED),)


def _size(recordings) -> str:
    events, pixels = sum(len(r.events) for r in recordings), recordings[0].events.width * recordings[0].events.height
    return f"{len(recordings)} recordings, {pixels} pixels, {events} events"


def _fit(sizes: Sizes) -> dict:
    recordings = _recordings(sizes)
    return compared(
        lambda: fit(recordings, _model(sizes), starts=sizes.fit_starts, seed=SEED),
        None,
        sizes.runs,
        size=_size(recordings),
        item="event",
        items=sum(len(r.events) for r in recordings),
        target=Target("seconds", FIT_S),
        words="evaluations of the likelihood with its gradient and information; the optimiser's own work is small",
    )


def _posterior(sizes: Sizes) -> dict:
    """CPU time of 1000 effective samples of the parameter that has fewest, with the proposal's shaping."""
    recordings = _recordings(sizes)
    result = fit(recordings, _model(sizes), starts=sizes.fit_starts, seed=SEED)
    times, effective = [], []
    for seed in range(sizes.long_runs):
        begun = time.process_time()
        posterior = sample(result, recordings, seed=seed, wanted=sizes.effective)
        spent = time.process_time() - begun
        effective.append(float(posterior.convergence.effective.min()))
        times.append(spent * 1000.0 / effective[-1])
    return row(
        times,
        size=_size(recordings),
        item="effective sample",
        items=1000,
        target=Target("seconds", POSTERIOR_S),
        words="exact evaluations of the likelihood",
        note=f"seconds per 1000 effective samples of the slowest parameter; {sizes.long_runs} runs",
        extra={"effective": effective},
    )


def _gap(sizes: Sizes) -> dict:
    recordings = small_session(camera(1000), 1000)
    times, verdicts = [], []
    for _ in range(sizes.long_runs):
        begun = time.process_time()
        verdicts.append(gap(recordings, find_model("dvs128"), seed=1000, recommend=False).verdict)
        times.append(time.process_time() - begun)
    return row(
        times,
        size=_size(recordings),
        item="event",
        items=sum(len(r.events) for r in recordings),
        target=Target("seconds", GAP_S),
        words="fits of the base and of every candidate, simulations for the free run",
        note=f"a session that lacks nothing; {sizes.long_runs} runs",
        extra={"verdicts": verdicts},
    )


def _sensor(sizes: Sizes) -> dict:
    side = sizes.sensor_side
    recording = simulate(find_model("dvs128"), chirp(400.0), width=side, height=side, seed=SEED)
    width, height = sizes.whole_sensor
    found = compared(
        lambda: fit_sensor([recording], find_model("dvs128"), tile=8, seed=SEED),
        None,
        sizes.runs,
        size=_size([recording]),
        item="pixel",
        items=side * side,
        words="scans of the bandwidth, pixel by pixel",
    )
    seconds = sorted(found["ours_s"])[len(found["ours_s"]) // 2] / (side * side) * width * height / CORES
    target = Target("seconds", SENSOR_S)
    return found | {
        "target": {"of": "seconds", "value": SENSOR_S, "measured": seconds, "met": target.met(seconds)},
        "note": f"extrapolated to {width} × {height} pixels on {CORES} cores: {seconds:.0f} s",
    }
