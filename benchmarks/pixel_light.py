"""Light that differs from pixel to pixel: coverage of fits, verdicts of the gap search, and the time of a large fit.

A sensor films a grating that moves ever faster and a disk that turns ever faster, each at two radiance levels.
Events are simulated at frames SUBFRAMES times as many as the fit is given.  Each session has its own hidden circuit,
as in `interval_coverage.py`.  Finished sessions are kept, a second call continues.  Target: intervals cover as under
full-field light; of clean sessions nothing is named, of leaking ones the leak; a fit of a million events within three
minutes on two cores.

    python benchmarks/pixel_light.py coverage --sessions 30 --side 5
    python benchmarks/pixel_light.py gap
    python benchmarks/pixel_light.py time --side 20 --seconds 3
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np
from interval_coverage import hidden_circuit, outcome, summary

from pixelid.fit import fit
from pixelid.gap.gap import gap
from pixelid.model.model import Model
from pixelid.model.shipped import find_model
from pixelid.parallel import thread_count
from pixelid.recordings.recording import Recording
from pixelid.simulate import simulate
from pixelid.stimuli.stimulus import Stimulus

LEVELS = (10.0, 300.0)
START_HZ = 4.0
FRAME_S = 1e-4  # of the frames that the fit is given
# Simulated per such frame.  The simulator linearises once per frame of a video: with 16 log radiance changes by no more
# than `resample.LARGEST_CHANGE`, as in fits; with 4, alpha was off by 3e-4, as much as its standard error.
SUBFRAMES, SUBFRAMES_TIMED = 16, 4


def turns(stop_hz: float, t: np.ndarray) -> np.ndarray:
    """Cycles until each time, at a frequency that grows exponentially from START_HZ to `stop_hz`."""
    growth = np.log(stop_hz / START_HZ) / t[-1]
    return START_HZ * np.expm1(growth * t) / growth


def grating(level: float, side: int, t: np.ndarray) -> Stimulus:
    """Vertical stripes, a sine of log radiance, that move to the right, in the end faster than the pixel follows."""
    phase = 2 * np.pi * (turns(40.0 * np.sqrt(level), t)[:, None] - np.arange(side) / 6.3)
    columns = level * np.exp(0.7 * np.sin(phase))
    return Stimulus(t, np.repeat(columns[:, None, :], side, axis=1))


def disk(level: float, side: int, t: np.ndarray) -> Stimulus:
    """A disk of two bright and two dark sectors with soft edges that turns ever faster about a point inside."""
    y, x = np.mgrid[:side, :side] - 0.5 * side + 0.3
    angle = 2 * np.arctan2(y, x + 0.17) - 2 * np.pi * turns(10.0 * np.sqrt(level), t)[:, None, None]
    return Stimulus(t, level * np.exp(0.6 * np.tanh(3.0 * np.sin(angle))))


def session(truth: Model, seed: int, side: int, seconds: float = 0.5, subframes: int = SUBFRAMES) -> list[Recording]:
    """One sensor under both, at each level, with every `subframes`-th frame beside the events."""
    t = np.arange(round(subframes * seconds / FRAME_S) + 1) * FRAME_S / subframes
    recordings = []
    for k, (film, level) in enumerate((film, level) for film in (grating, disk) for level in LEVELS):
        light = film(level, side, t)
        made = simulate(truth, light, seed=4 * seed + k, sensor_seed=seed)
        shown = Stimulus(t[::subframes], light.radiance[::subframes])
        name = f"{film.__name__}_{level:g}"
        recordings.append(Recording(made.events, shown, condition=name, sensor=f"simulated {seed}"))
    return recordings


def one(seed: int, side: int) -> dict:
    """Truth, estimate and interval of every free parameter of one session, and the CPU time of its fit."""
    truth = hidden_circuit(seed)
    recordings = session(truth, seed, side)
    begun, used = time.perf_counter(), time.process_time()
    result = fit(recordings, find_model("dvs128"), starts=0, seed=seed)
    return outcome(truth, result, seed, begun) | {"side": side, "cpu_seconds": time.process_time() - used}


def coverage(count: int, side: int, path: Path | None, first: int = 0) -> dict:
    """Do sessions of side × side pixels that `path` does not hold yet; returns its summary of that size."""
    done = json.loads(path.read_text())["sessions"] if path is not None and path.exists() else []
    had = {(s["side"], s["seed"]) for s in done}
    for seed in range(first, first + count):
        if (side, seed) in had:
            continue
        done.append(one(seed, side))
        s = done[-1]
        print(f"session {seed}: {s['status']}, {s['events']} events, {s['cpu_seconds']:.1f} s of CPU", flush=True)
        if path is not None:
            done.sort(key=lambda s: (s["side"], s["seed"]))
            temporary = path.with_suffix(".tmp")
            temporary.write_text(json.dumps({"summary": by_pixels(done), "sessions": done}))
            temporary.replace(path)
    return by_pixels(done)[str(side**2)]


def by_pixels(sessions: list[dict]) -> dict:
    """By number of pixels: sessions, how they ended, events, CPU seconds of a fit, and `summary` by parameter."""
    table = {}
    for side in sorted({s["side"] for s in sessions}):
        some = [s for s in sessions if s["side"] == side]
        table[str(side**2)] = {
            "sessions": len(some),
            "statuses": {str(k): sum(s["status"] == k for s in some) for k in sorted({s["status"] for s in some})},
            "median_events": float(np.median([s["events"] for s in some])),
            "median_cpu_s": float(np.median([s["cpu_seconds"] for s in some])),
            "parameters": summary(some),
        }
    return table


def verdict(seed: int, side: int, leak_hz: float) -> tuple[str, list[str]]:
    """What a search says of a session with the nominal circuit, and a leak."""
    model = find_model("dvs128")
    truth = model.with_effect("leak", {"rate_hz": leak_hz}) if leak_hz else model
    report = gap(session(truth, seed, side), model, seed=seed, recommend=False)
    return report.verdict, [effect.name for effect in report.effects]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("coverage", "gap", "time"))
    parser.add_argument("--sessions", type=int, default=20)
    parser.add_argument("--side", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=3.0)
    parser.add_argument("--out", type=Path, default=Path(__file__).with_name("pixel_light.json"))
    arguments = parser.parse_args()
    if arguments.what == "coverage":
        table = coverage(arguments.sessions, arguments.side, arguments.out)
        for name, row in table["parameters"].items():
            print(f"{name:26s} {row['covered']}/{row['sessions']}, errors {row['mean_error_sd']:+.2f} sd")
    elif arguments.what == "gap":
        for seed in range(arguments.sessions):
            for leak_hz in (0.0, 2.0):
                print(f"session {seed}, leak {leak_hz:g} Hz:", *verdict(seed, arguments.side, leak_hz), flush=True)
    else:
        recordings = session(find_model("dvs128"), 0, arguments.side, arguments.seconds, SUBFRAMES_TIMED)
        events, begun, before = sum(len(r.events) for r in recordings), time.perf_counter(), time.process_time()
        result = fit(recordings, find_model("dvs128"), starts=0, seed=0)
        took, used = time.perf_counter() - begun, time.process_time() - before
        print(f"{events} events: {result.status} in {took:.0f} s on {thread_count()} threads, {used:.0f} s of CPU")


if __name__ == "__main__":
    main()
