"""Search for the gap in sessions of the practice protocol that another simulator made.

The simulator is `tests/oracles/whole_pixel.py`, written from the equations and sharing no code with the package.  Each
session has 25 pixels, twelve recordings of four lights at three levels, and a camera of its own.  It lacks

- nothing: wanted is `none`;
- a mains flicker whose phase is another in each recording: wanted is its name, and its depth within 2 %;
- a jitter of 1.5 dead times: wanted is its name, and its size within 5 %;
- something that the library has no name for (`ODDITIES`): wanted is a description of the right stage and quantity that
  closes 0.8 of the gap, and no name.

Finished sessions are kept, a second call continues.

    python benchmarks/gap_independent.py --sessions 10 --out docs/gap_independent.json
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from gap_certification import ALPHA
from gap_combinations import SIDE, lights
from scipy.interpolate import CubicSpline

from pixelid.gap.gap import gap
from pixelid.model.shipped import find_model
from pixelid.recordings.events import Events
from pixelid.recordings.recording import Recording
from pixelid.stages.modulation import THRESHOLDS

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from tests.oracles.whole_pixel import NOTHING, Oddity, Pixel, events, signals, thresholds

PARAMETER = {"mains_flicker": "mains_flicker.modulation", "timestamp_jitter": "timestamp_jitter.sigma_s"}
FIRST_SEED = 40_000
DEPTHS = 0.015, 0.3  # log-uniform
DEAD_TIMES = 1.5
REFERENCE = 100.0  # radiance about which what depends on it turns

# Something the library has no name for → quantities that a description may be of (which say the stage), whether it is
# of either sign, and the oddity of a strength, uniform between 0.5 and 1.5.
Made = Callable[[float], Oddity]
ODDITIES: dict[str, tuple[tuple[str, ...], bool, Made]] = {
    "ON threshold after an ON event": (("on_threshold",), True, lambda s: Oddity(after=(0.07 * s, 0, 0))),
    "OFF threshold relaxes": (("off_threshold",), True, lambda s: Oddity(relaxing=(0, 0.2 * s, 0.02))),
    "thresholds by the logarithm of light": (THRESHOLDS, True, lambda s: _both(_by_log_light(0.07 * s))),
    "ON threshold by speed": (("on_threshold",), True, lambda s: Oddity(on=_saturating(0.15 * s))),
    "thresholds jump": (
        THRESHOLDS, True, lambda s: _both(lambda t, light, speed: 0.07 * s * (t > 0.4)),
    ),
    "dead time by light": (
        ("dead_time",), False,
        lambda s: Oddity(dead_s=lambda t, light, speed: 3e-4 * s * np.sqrt(REFERENCE / light)),
    ),
    "dead time by polarity": (("dead_time",), True, lambda s: Oddity(after=(0, 0, 7e-5 * s))),
    "dead time by speed": (("dead_time",), False, lambda s: Oddity(dead_s=_saturating(4e-4 * s))),
    "bandwidth warms up": (
        ("rate",), False,
        lambda s: Oddity(faster=lambda t, light, speed: 1.0 - 0.25 * s * np.exp(-t / 0.3)),
    ),
    "bandwidth by light": (
        ("rate",), True,
        lambda s: Oddity(faster=lambda t, light, speed: (light / REFERENCE) ** (0.15 * s)),
    ),
    "lamp fades": (
        ("light",), False, lambda s: Oddity(light=lambda t, light, speed: 1.0 - 0.25 * s * t),
    ),
    "gain by light": (("response", "light"), True, lambda s: Oddity(responds=_bent(0.03 * s))),
    "leak grows": (("leak",), False, lambda s: Oddity(leak_hz=lambda t, light, speed: 2.0 * s * t)),
}  # fmt: skip


def _both(what) -> Oddity:
    return Oddity(on=what, off=what)


def _by_log_light(strength: float):
    return lambda t, light, speed: strength * np.log10(light / REFERENCE)


def _saturating(strength: float):
    return lambda t, light, speed: strength * speed / (speed + 50.0)


def _bent(strength: float):
    return lambda t, light, speed: -strength * np.log(light / REFERENCE) ** 2


KINDS = ("nothing", *PARAMETER, *ODDITIES)


def camera(rng: np.random.Generator) -> Pixel:
    """The shipped pixel with filters, thresholds and dead time of its own."""
    values = find_model("dvs128").values
    alpha, beta, follower, differencing = (
        values[name] * math.exp(rng.uniform(-0.3, 0.3)) for name in ("alpha", "beta", "sf_cutoff_hz", "diff_cutoff_hz")
    )
    on, off = rng.uniform(0.17, 0.24, 2)
    return Pixel(
        alpha, beta, values["gamma"], 2 * math.pi * follower, 2 * math.pi * differencing, on, off,
        rng.uniform(1e-4, 3e-4), 0.02, 0.035,
    )  # fmt: skip


def session(missing: str, seed: int) -> tuple[list[Recording], float]:
    """(recordings, strength of what is missing: a depth, seconds, or that of an oddity)."""
    rng = np.random.default_rng(seed)
    pixel = camera(rng)
    own = thresholds(pixel, SIDE * SIDE, rng)
    depth = math.exp(rng.uniform(*np.log(DEPTHS))) if missing == "mains_flicker" else 0.0
    hertz = float(rng.choice([100.0, 120.0]))
    jitter_s = DEAD_TIMES * pixel.dead_s if missing == "timestamp_jitter" else 0.0
    odd, strength = NOTHING, depth or jitter_s
    if missing in ODDITIES:
        _, signed, made = ODDITIES[missing]
        strength = float(rng.uniform(0.5, 1.5) * (rng.choice([-1.0, 1.0]) if signed else 1.0))
        odd = made(strength)
    recordings = []
    for name, stimulus in lights(seed).items():
        phase, smooth = rng.uniform(0, 2 * math.pi), CubicSpline(stimulus.t, np.log(stimulus.radiance))

        def light(t, smooth=smooth, phase=phase):
            return np.exp(smooth(t)) * (1.0 + depth * np.sin(2 * math.pi * hertz * t + phase))

        t, which, signs = events(pixel, own, signals(pixel, light, stimulus.duration_s, odd), rng, odd)
        stamps = np.rint(1e9 * (t + jitter_s * rng.standard_normal(len(t)))).astype(np.int64)
        inside = np.flatnonzero((stamps >= 0) & (stamps <= 1e9 * stimulus.duration_s))
        order = inside[np.argsort(stamps[inside], kind="stable")]
        x, y, p = which[order] % SIDE, which[order] // SIDE, (signs[order] > 0).astype(np.uint8)
        made_events = Events(stamps[order], x.astype(np.uint16), y.astype(np.uint16), p, SIDE, SIDE, 1)
        recordings.append(Recording(made_events, stimulus, condition=name))
    return recordings, strength


def run(missing: str, seed: int) -> dict:
    """One search: what is missing and what it reports."""
    recordings, strength = session(missing, seed)
    begun = time.process_time()
    report = gap(recordings, find_model("dvs128"), alpha=ALPHA, seed=seed, recommend=False)
    found = {name: each for effect in report.effects for name, each in effect.parameters.items()}
    return {
        "seed": seed,
        "missing": missing,
        "strength": strength,
        "events": sum(len(r.events) for r in recordings),
        "verdict": report.verdict,
        "named": [effect.name for effect in report.effects],
        "described": [[one.effect, one.words, one.closed] for one in report.described],
        "found": found.get(PARAMETER.get(missing, "")),
        "p": report.global_p,
        "closed": report.free_run.closed if report.free_run else None,
        "cpu_seconds": time.process_time() - begun,
    }


def right(row: dict) -> bool:
    """Whether a session came out as wanted."""
    missing, said = row["missing"], (row["verdict"], row["named"])
    if missing == "nothing":
        return said == ("none", [])
    if missing in PARAMETER:
        return said == ("named", [missing])
    quantities = ODDITIES[missing][0]
    told = [name.split(".")[1] for name, *_ in row["described"]]
    return said == ("unknown", []) and bool(told) and set(told) <= set(quantities)


def summary(rows: list[dict]) -> dict:
    """What is missing → sessions right, relative errors of the strength, intervals that hold, what is closed."""
    found = {}
    for missing in KINDS:
        mine = [r for r in rows if r["missing"] == missing]
        if not mine:
            continue
        told = [r for r in mine if r["found"]]
        errors = [abs(r["found"][0] / r["strength"] - 1.0) for r in told]
        closed = [r["described"][0][-1] for r in mine if r["described"] and r["described"][0][-1] is not None]
        found[missing] = {
            "sessions": len(mine),
            "right": sum(map(right, mine)),  # what a description closes is counted by itself
            "errors_median_and_largest": [float(np.median(errors)), max(errors)] if errors else None,
            "intervals_hold": [sum(r["found"][1][0] <= r["strength"] <= r["found"][1][1] for r in told), len(told)],
            "closed_0.8": [sum(c >= 0.8 for c in closed), len(closed)],
            "cpu_seconds_median_and_largest": [
                float(np.median([r["cpu_seconds"] for r in mine])), max(r["cpu_seconds"] for r in mine)
            ],
        }  # fmt: skip
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sessions", type=int, default=10, help="of each kind")
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS, help="which")
    parser.add_argument("--out", type=Path, default=Path("docs/gap_independent.json"))
    options = parser.parse_args()
    rows = json.loads(options.out.read_text())["runs"] if options.out.exists() else []
    done = {(row["missing"], row["seed"]) for row in rows}
    for i in range(options.sessions):
        for missing in options.kinds:
            seed = FIRST_SEED + 100 * KINDS.index(missing) + i
            if (missing, seed) in done:
                continue
            row = run(missing, seed)
            rows.append(row | {"wrong": not right(row)})
            temporary = options.out.with_suffix(".tmp")
            temporary.write_text(json.dumps({"summary": summary(rows), "runs": rows}, indent=1, default=float) + "\n")
            temporary.replace(options.out)
            print(" ".join(f"{key}={value}" for key, value in rows[-1].items()), flush=True)


if __name__ == "__main__":
    main()
