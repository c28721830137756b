"""What the gap search says of effects that the library lacks: described in the right stage and quantity, and how much
of the gap that closes.

    python benchmarks/described_effects.py --out docs/described_effects.json [--minutes N]

Three kinds of sessions, all of the size of `gap_certification.py`.  Effects of the library, left out of it in turn: the
grammar has the same equation for some, none for others.  Effects that no library knows, made by an event-by-event
oracle that shares no code with the simulator (`tests/oracles/described_events.py`).  And nulls.  Results are added line
by line, so a run can be interrupted and continued.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from gap_certification import ALPHA, SIDE, camera, first_seeds, planted, session

from pixelid.gap.gap import gap
from pixelid.model.model import Model
from pixelid.model.shipped import find_model
from pixelid.recordings.events import Events
from pixelid.recordings.recording import Recording
from pixelid.stimuli.resample import resampled
from pixelid.stimuli.shapes import chirp, constant, slow, steps

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from tests.oracles.described_events import Before, events

EXPECTED = {  # left out of the library → (stage, quantity) that a description should have
    "polarity_memory": ("comparator", "threshold"),
    "threshold_drift": ("comparator", "threshold"),
    "leak": ("differencing", "leak"),
    "parasitic_photocurrent": ("differencing", "leak"),
    "dark_current": ("photocurrent", "light"),
    "bandwidth_floor": ("photoreceptor", "rate"),
    "linear_log": ("photocurrent", "response"),
    "refractory_period": ("comparator", "dead_time"),
    "source_follower_pole": ("source_follower", "low_pass"),
    "extra_pole": ("source_follower", "low_pass"),
    "lower_cutoff": ("source_follower", "high_pass"),
}
NO_CELL = ("differencing_pole", "mains_flicker", "lost_events")
ON, OFF, DEAD, SIGMA, MISMATCH = 0.2, 0.22, 2e-4, 0.02, 0.035
FIRST_NOVEL, FIRST_NULL = 8000, 1000
UNKNOWN_NULL = 1018  # the one null session of the certification that ends in `unknown`


@dataclass(frozen=True)
class Novel:
    """What an unknown pixel does: relative shifts of its thresholds, and its dead time, by the event before; and the
    logarithm of the light that it answers to."""

    stage: str
    quantity: str
    on: Callable[[Before, float], float] = lambda before, since: 0.0
    off: Callable[[Before, float], float] = lambda before, since: 0.0
    dead: Callable[[Before], float] = lambda before: DEAD
    response: Callable[[float, float], float] = lambda log_light, time: log_light


def _slow_recovery(before: Before, since: float) -> float:
    return 0.15 * float(np.exp(-since / 0.02)) if before.polarity else 0.0


def _brighter(before: Before, since: float) -> float:
    return 0.1 * ((before.radiance / 100.0) ** 0.4 - 1.0) if before.polarity else 0.0


def _jump(before: Before, since: float) -> float:
    return 0.06 if before.time > 0.4 else 0.0


def _faster(before: Before, since: float) -> float:
    return -0.08 * min(before.speed / 40.0, 1.5) if before.polarity else 0.0


def _dim(before: Before, since: float) -> float:
    return 0.1 * before.radiance / (before.radiance + 100.0) if before.polarity else 0.0


def _warming(log_light: float, time: float) -> float:
    return log_light + float(np.log(1.0 - 0.3 * np.exp(-time / 0.3)))


def _saturating(before: Before, since: float) -> float:
    return -0.12 * since / (since + 0.05) if before.polarity else 0.0


NOVEL = {
    "ON threshold raised after an event, relaxing in 20 ms": Novel("comparator", "on_threshold", on=_slow_recovery),
    "dead time 0.3 ms after ON, 0.1 ms after OFF": Novel(
        "comparator", "dead_time", dead=lambda before: 3e-4 if before.polarity > 0 else 1e-4
    ),
    "OFF threshold grows with radiance": Novel("comparator", "off_threshold", off=_brighter),
    "both thresholds jump by 6 % at 0.4 s": Novel("comparator", "threshold", on=_jump, off=_jump),
    "ON threshold lower in fast light": Novel("comparator", "on_threshold", on=_faster),
    "both thresholds fall with the wait, as t/(t + 50 ms)": Novel(
        "comparator", "threshold", on=_saturating, off=_saturating
    ),
    "dead time 0.2 ms after ON, 0.01 ms after OFF": Novel(
        "comparator", "dead_time", dead=lambda before: 2e-4 if before.polarity > 0 else 1e-5
    ),
    "dead time grows with radiance": Novel(
        "comparator", "dead_time", dead=lambda before: DEAD * (1.0 + before.radiance / 100.0)
    ),
    "ON threshold 10 % higher in bright light, half of it at 100": Novel("comparator", "on_threshold", on=_dim),
    "light 30 % dimmer at first, rising in 0.3 s": Novel("photocurrent", "light", response=_warming),
}


def novel_session(novel: Novel, seed: int) -> list[Recording]:
    """Six short recordings of nine pixels without poles, by the oracle; thresholds with mismatch and noise."""
    rng = np.random.default_rng(seed)
    lights = {"constant_24": constant(24.0), "slow_24": slow(24.0, seed=seed + 1)}
    for k, (level, stop) in enumerate(((24.0, 200.0), (400.0, 400.0))):
        lights[f"chirp_{level:g}"] = chirp(level, stop_hz=stop)
        lights[f"steps_{level:g}"] = steps(level, seed=seed + 2 * k)
    means = np.array([ON, OFF]) * (1.0 + MISMATCH * rng.standard_normal((SIDE * SIDE, 2)))
    recordings = []
    for name, light in lights.items():
        fine = resampled(light, "smooth")
        logs = np.log(fine.radiance.astype(float))
        stamps, pixels, polarities = [], [], []
        for pixel, (on, off) in enumerate(means):

            def draw() -> tuple[float, float]:
                first, second = SIGMA * rng.standard_normal(2)
                return ON * first, OFF * second

            times, signs = events(
                fine.t, logs, lambda b, s, on=on: on + ON * novel.on(b, s),
                lambda b, s, off=off: off + OFF * novel.off(b, s), novel.dead, novel.response,
                draw=draw,
            )  # fmt: skip
            stamps.append(np.round(1e9 * times).astype(np.int64))
            pixels.append(np.full(len(times), pixel))
            polarities.append(signs > 0)
        t, pixel, p = (np.concatenate(parts) for parts in (stamps, pixels, polarities))
        order = np.argsort(t, kind="stable")
        x, y = (pixel[order] % SIDE).astype(np.uint16), (pixel[order] // SIDE).astype(np.uint16)
        recorded = Events(t[order], x, y, p[order].astype(np.uint8), SIDE, SIDE, 1)
        recordings.append(Recording(recorded, light, condition=name, sensor=f"oracle {seed}"))
    return recordings


def ideal() -> Model:
    """The base for pixels without poles."""
    model = find_model("ideal")
    for effect in ("threshold_mismatch", "threshold_noise", "refractory_period"):
        model = model.with_effect(effect)
    return model


def run(job: dict) -> dict:
    """One search: job {"kind", "effect", "seed"} and what it reports."""
    kind, effect, seed = job["kind"], job["effect"], job["seed"]
    left_out: tuple[str, ...] = ()
    if kind == "novel":
        recordings, base = novel_session(NOVEL[effect], seed), ideal()
        expected = NOVEL[effect].stage, NOVEL[effect].quantity
    else:
        model, base = planted(effect, 1.0, camera(seed))
        recordings = session(model, seed)
        left_out = (effect,) if effect else ()
        expected = EXPECTED.get(effect)
    began = time.process_time()
    report = gap(recordings, base, alpha=ALPHA, seed=seed, leave_out=left_out, recommend=False)
    entries = [entry.as_dict() for entry in report.described]
    first = entries[0] if entries else {}
    return {
        **job,
        "expected": expected,
        "verdict": report.verdict,
        "named": [named.name for named in report.effects],
        "described": entries,
        "words": [entry.words for entry in report.described],
        "right_stage": None if expected is None else first.get("stage") == expected[0],
        "right_quantity": None if expected is None else first.get("quantity") == expected[1],
        "closed": report.free_run.closed if report.free_run else None,
        "closed_interval": report.free_run.interval if report.free_run else None,
        "tried": [_gains(told) for told in report.details.get("descriptions_tried", [])],
        "cpu_s": time.process_time() - began,
    }


def _gains(told: dict) -> dict:
    """What a round of descriptions gained on unseen pixels, in nats, by cell, and what the flexible term did."""
    gains = {c["name"].removeprefix("described."): round(c["heldout_gain_nats"], 1) for c in told["candidates"]}
    return {**gains, "flexible": round(told["flexible_heldout_gain_nats"], 1)}


def save(rows: list[dict], path: Path) -> None:
    """The summary, and a line for each run."""
    lines = ",\n".join(json.dumps(row, ensure_ascii=False, default=float) for row in rows)
    path.write_text(f'{{"summary": {json.dumps(summary(rows), indent=1)},\n"runs": [\n{lines}\n]}}\n')


def jobs(repeats: int) -> list[dict]:
    """The null that ends in `unknown`, then every effect, seed by seed."""
    plan = [{"kind": "null", "effect": "", "seed": UNKNOWN_NULL}]
    first = first_seeds()
    for i in range(repeats):
        plan += [{"kind": "left out", "effect": e, "seed": first[e] + 50 + i} for e in EXPECTED]
        plan += [{"kind": "novel", "effect": e, "seed": FIRST_NOVEL + 100 * k + i} for k, e in enumerate(NOVEL)]
        plan += [{"kind": "no cell", "effect": e, "seed": first[e] + 50 + i} for e in NO_CELL]
        plan += [{"kind": "null", "effect": "", "seed": FIRST_NULL + 900 + 10 * i + k} for k in range(3)]
    return plan


def summary(rows: list[dict]) -> dict:
    """Counts by kind."""
    told = {}
    for kind in ("left out", "novel", "no cell", "null"):
        mine = [r for r in rows if r["kind"] == kind]
        closed = [r["closed"] for r in mine if r["described"] and r["closed"] is not None]
        told[kind] = {
            "sessions": len(mine),
            "described": sum(bool(r["described"]) for r in mine),
            "right stage": sum(r["right_stage"] is True for r in mine),
            "right quantity": sum(r["right_quantity"] is True for r in mine),
            "gap shows in counts": len(closed),
            "closed 0.8 or more": sum(c >= 0.8 for c in closed),
            "an effect named or listed": sum(bool(r["named"]) for r in mine),
        }
    return told


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("described_effects.json"))
    parser.add_argument("--only", nargs="*", default=[], help="effects")
    parser.add_argument("--minutes", type=float, default=1e9, help="stop after so long; run again to go on")
    options = parser.parse_args()
    rows = json.loads(options.out.read_text())["runs"] if options.out.exists() else []
    done = {(r["kind"], r["effect"], r["seed"]) for r in rows}
    until = time.monotonic() + 60.0 * options.minutes
    for job in jobs(options.repeats):
        if tuple(job.values()) in done or (options.only and job["effect"] not in options.only):
            continue
        if time.monotonic() > until:
            break
        rows.append(run(job))
        save(rows, options.out)
        row = rows[-1]
        print(row["kind"], row["effect"], row["seed"], "->", row["verdict"], row["named"], row["words"], row["closed"],
              f"{row['cpu_s']:.0f} s", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
