"""Coverage: how often do 95 % intervals hold the truth?

Each session is simulated with its own hidden circuit (every free parameter of dvs128 drawn log-normally about its
nominal value), 9 pixels, 6 short recordings at 3 radiance levels, threshold noise and mismatch on, the pixels'
thresholds the same in all recordings.  It is fitted without priors; the 95 % intervals are those that the fit states
(sessions kept by earlier versions have none: theirs come from the Hessian and `fit/uncertainty/small_sample.py`).  Fits
that say they did not converge are left out.
Target: 92 to 98 % for every parameter.  Finished sessions are kept, a second call continues.

    python benchmarks/interval_coverage.py --sessions 200 --processes 2
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pixelid.fit import fit
from pixelid.fit.result import FitResult
from pixelid.fit.uncertainty.small_sample import intervals
from pixelid.model.model import Model
from pixelid.model.shipped import find_model
from pixelid.recordings.events import Events
from pixelid.recordings.recording import Recording
from pixelid.simulate import simulate
from pixelid.stimuli.shapes import chirp, steps
from pixelid.stimuli.stimulus import Stimulus

SPREAD = 0.2  # standard deviation of the hidden circuits' log parameters
SIDE = 3
LEVELS = (5.0, 40.0, 300.0)


def hidden_circuit(seed: int) -> Model:
    """dvs128 with every free parameter moved by a factor e^(SPREAD ξ)."""
    model = find_model("dvs128")
    rng = np.random.default_rng([seed, 1])
    return model.set({name: model.values[name] * float(np.exp(SPREAD * rng.normal())) for name in model.free})


def stimuli(seed: int, levels: Sequence[float] = LEVELS, duration_s: float = 0.3) -> dict[str, Stimulus]:
    """A chirp and random steps at each level."""
    by_name = {}
    for k, level in enumerate(levels):
        stop = 40.0 * np.sqrt(level)
        by_name[f"chirp_{level:g}"] = chirp(level, modulation=0.6, stop_hz=stop, duration_s=duration_s, dt=1e-4)
        by_name[f"steps_{level:g}"] = steps(level, duration_s=duration_s, dt=1e-4, seed=seed + k)
    return by_name


def session(truth: Model, seed: int, shown: dict[str, Stimulus] | None = None, side: int = SIDE) -> list[Recording]:
    """Recordings of the same side × side pixels, whose thresholds are drawn once and kept."""
    rng = np.random.default_rng([seed, 2])
    spread = truth.values["threshold_mismatch.sigma"]
    pixels = side * side
    factors = 1.0 + spread * rng.normal(size=(pixels, 2))
    plain = truth.without_effect("threshold_mismatch")
    recordings = []
    for name, stimulus in (shown or stimuli(seed)).items():
        columns = []
        for i in range(pixels):
            pixel = plain.set(
                {
                    "on_threshold": truth.values["on_threshold"] * factors[i, 0],
                    "off_threshold": truth.values["off_threshold"] * factors[i, 1],
                }
            )
            events = simulate(pixel, stimulus, seed=int(rng.integers(2**31)), threads=1).events
            columns.append((events.t, np.full(len(events), i % side), np.full(len(events), i // side), events.p))
        t, x, y, p = (np.concatenate(parts) for parts in zip(*columns, strict=True))
        order = np.argsort(t, kind="stable")
        together = Events.from_columns(t[order], x[order], y[order], p[order], side, side)
        recordings.append(Recording(together, stimulus, sensor="simulated", condition=name))
    return recordings


def one(seed: int) -> dict:
    """Truth, estimate and interval of every free parameter of one session, in fitting coordinates."""
    begun = time.perf_counter()
    truth = hidden_circuit(seed)
    recordings = session(truth, seed)
    return outcome(truth, fit(recordings, find_model("dvs128"), starts=0, between="linear", seed=seed), seed, begun)


def outcome(truth: Model, result: FitResult, seed: int, begun: float) -> dict:
    """Truth, estimate and interval of every free parameter of a fit begun at `begun` (s)."""
    sd = np.sqrt(np.diag(result.covariance))
    return {
        "seed": seed,
        "status": result.status,
        "events": result.events,
        "pixels": result.pixels,
        "seconds": time.perf_counter() - begun,
        "parameters": {
            p.name: {
                "truth": p.to_coordinate(truth.values[p.name]),
                "estimate": float(x),
                "sd": float(s),
                "limits": [None if end is None else p.to_coordinate(end) for end in _interval(result, p.name)],
                "identified": result.estimates[p.name].identified,
            }
            for p, x, s in zip(result.coordinates.parameters, result.x, sd, strict=True)
        },
    }


def _interval(result: FitResult, name: str) -> tuple[float | None, float | None]:
    """The 95 % interval that a fit states, None where a side is open."""
    return result.estimates[name].interval_95 or (None, None)


def limits(row: dict, name: str) -> tuple[float, float]:
    """(low, high) of a session's parameter, in fitting coordinates."""
    if "limits" in row["parameters"][name]:
        low, high = row["parameters"][name]["limits"]
        return -np.inf if low is None else low, np.inf if high is None else high
    names = list(row["parameters"])
    x, sd = (np.array([row["parameters"][n][key] for n in names]) for key in ("estimate", "sd"))
    lows, highs = intervals(names, x, sd, row.get("pixels", SIDE * SIDE))
    return float(lows[names.index(name)]), float(highs[names.index(name)])


def summary(sessions: list[dict]) -> dict:
    """Per parameter: sessions n, intervals that hold the truth k, the share with its 95 % interval (Clopper-Pearson);
    the mean and standard deviation of the standardised errors, which should be 0 and 1."""
    from scipy.stats import binomtest

    table = {}
    sessions = [s for s in sessions if s["status"] in ("converged", "at_bound")]
    for name in sessions[0]["parameters"] if sessions else ():
        errors, held = [], []
        for s in sessions:
            found = s["parameters"][name]
            if not found["identified"]:
                continue
            low, high = limits(s, name)
            held.append(low <= found["truth"] <= high)
            errors.append((found["estimate"] - found["truth"]) / found["sd"])
        k, n, errors = int(np.sum(held)), len(held), np.array(errors)
        if n == 0:
            continue
        interval = binomtest(k, n).proportion_ci()
        table[name] = {
            "covered": k,
            "sessions": n,
            "share": k / n,
            "share_interval_95": [interval.low, interval.high],
            "mean_error_sd": float(errors.mean()),
            "sd_error_sd": float(errors.std(ddof=1)) if n > 1 else None,
        }
    return table


def run(count: int, processes: int, path: Path) -> dict:
    """Fit sessions 0 … count − 1 that `path` does not hold yet; returns the summary."""
    done = json.loads(path.read_text())["sessions"] if path.exists() else []
    missing = sorted(set(range(count)) - {s["seed"] for s in done})
    os.environ["OMP_NUM_THREADS"] = "1"  # of the processes to come: their matrices are small
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        for k, outcome in enumerate(pool.imap_unordered(one, missing)):
            done.append(outcome)
            if k % 10 == 9 or k == len(missing) - 1:
                _write(path, done)
    _write(path, done)
    return summary(done)


def _write(path: Path, done: list[dict]) -> None:
    temporary = path.with_suffix(".tmp")
    temporary.write_text(json.dumps({"summary": summary(done), "sessions": sorted(done, key=lambda s: s["seed"])}))
    temporary.replace(path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sessions", type=int, default=200)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path(__file__).with_name("interval_coverage.json"))
    arguments = parser.parse_args()
    for name, row in run(arguments.sessions, arguments.processes, arguments.out).items():
        low, high = row["share_interval_95"]
        print(
            f"{name:26s} {row['covered']}/{row['sessions']} = {100 * row['share']:.1f} % "
            f"({100 * low:.1f} … {100 * high:.1f}), "
            f"errors {row['mean_error_sd']:+.2f} ± {row['sd_error_sd'] or 0:.2f} sd"
        )


if __name__ == "__main__":
    main()
