"""Search for the gap in sessions that lack one to three effects at once, of random strengths.

Sessions are of the practice protocol: 25 pixels, twelve recordings of four lights at three levels.  Each has a camera
of its own (`gap_certification.camera`) and one, two or three effects drawn from the library or withheld from the base;
of those that act on stamps at most one.  Strengths are log-uniform, from what single sessions of this protocol show to
3 times the typical strength.  Target: all and only the planted effects named in nine of ten sessions, an effect named
that was not planted in one of a hundred.  Finished sessions are kept, a second call continues; --again searches some of
them with the present code, and keeps what became of them before.

    python benchmarks/gap_combinations.py --sessions 100 --out docs/gap_combinations.json
"""

from __future__ import annotations

import argparse
import json
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
from gap_certification import ALPHA, STRENGTHS, WEAKER, WITHHELD, camera, rate

from pixelid.gap.gap import gap
from pixelid.model.model import Model
from pixelid.model.shipped import find_model
from pixelid.recordings.recording import Recording
from pixelid.simulate import simulate
from pixelid.stimuli.resample import resampled
from pixelid.stimuli.shapes import chirp, constant, slow, steps
from pixelid.stimuli.stimulus import Stimulus

SIDE, LEVELS, STOPS = 5, (3.0, 24.0, 400.0), (60.0, 200.0, 400.0)
OF_STAMPS = ("timestamp_jitter", "readout_latency", "timestamp_quantisation")
LEAST = {"slew_limit": 1.0, "leak": 0.6, "threshold_drift": 0.6}  # of typical strengths; 0.3 of others
MOST = 3.0
FIRST_SEED = 20_000


def plan(seed: int) -> list[tuple[str, float]]:
    """(effect, factor of its typical strength, 0 where it is withheld) of one session."""
    rng = np.random.default_rng(seed)
    wanted, chosen = int(rng.integers(1, 4)), []
    for effect in rng.permutation(sorted({*STRENGTHS, *WITHHELD})):
        taken = [name for name, _ in chosen]
        if effect in OF_STAMPS and any(name in OF_STAMPS for name in taken):
            continue
        low = LEAST.get(effect, 0.3)
        factor = 0.0 if effect in WITHHELD else float(np.exp(rng.uniform(np.log(low), np.log(MOST))))
        chosen.append((str(effect), factor))
        if len(chosen) == wanted:
            break
    return chosen


def planted(effects: list[tuple[str, float]], model: Model) -> tuple[Model, Model]:
    """(the camera with the effects;  the base without those withheld)."""
    base = find_model("dvs128")
    for effect, factor in effects:
        if effect in WITHHELD:
            base = base.without_effect(effect)
            continue
        scale = 1.0 / factor if effect in WEAKER else factor
        values = {name: value if name == "count" else value * scale for name, value in STRENGTHS[effect].items()}
        model = model.with_effect(effect, values)
    return model, base


def lights(seed: int) -> dict[str, Stimulus]:
    """Name → light of a recording, of the practice protocol."""
    found = {}
    for k, (level, stop) in enumerate(zip(LEVELS, STOPS, strict=True)):
        found |= {
            f"constant_{level:g}": constant(level),
            f"slow_{level:g}": slow(level, seed=seed + 1 + k),
            f"chirp_{level:g}": chirp(level, stop_hz=stop),
            f"steps_{level:g}": steps(level, seed=seed + 2 * k),
        }
    return found


def session(model: Model, seed: int) -> list[Recording]:
    """Twelve recordings of one small sensor; the light is smooth, the stimulus its samples."""
    recordings = []
    for i, (name, light) in enumerate(lights(seed).items()):
        r = simulate(model, resampled(light, "smooth"), width=SIDE, height=SIDE, seed=1000 * seed + i, sensor_seed=seed)
        events = replace(r.events, tick_ns=1)
        recordings.append(replace(r, stimulus=light, condition=name, attributes={}, events=events))
    return recordings


def run(seed: int) -> dict:
    """One search: what was planted, what it reports."""
    effects = plan(seed)
    model, base = planted(effects, camera(seed))
    recordings, begun = session(model, seed), time.process_time()
    report = gap(recordings, base, alpha=ALPHA, seed=seed, recommend=False)
    names, found = {effect for effect, _ in effects}, {effect.name for effect in report.effects}
    shows = report.details["shows_at_typical_strength_nats"]
    return {
        "seed": seed,
        "planted": effects,
        "events": sum(len(r.events) for r in recordings),
        "verdict": report.verdict,
        "named": [effect.name for effect in report.effects],
        "closed": report.free_run.closed if report.free_run else None,
        "strengths": {
            name: [model.values[name], value, limits]
            for effect in report.effects if effect.name in names
            for name, (value, limits) in effect.parameters.items() if name in model.values
        },
        "missed_shows_nats": {
            effect: shows[effect] * (factor or 1.0) ** 2
            for effect, factor in effects if effect in shows and effect not in found
        },
        "cpu_seconds": time.process_time() - begun,
    }  # fmt: skip


def outcome(row: dict) -> str:
    """What became of a session, in words."""
    truth, said = {effect for effect, _ in row["planted"]}, set(row["named"])
    if said - truth:
        return "an effect that was not planted"
    if row["verdict"] == "named" and said == truth:
        return "all and only those planted"
    if row["verdict"] == "named":
        return "some of those planted"
    return row["verdict"]


def summary(rows: list[dict]) -> dict:
    """Outcomes by number of effects, with the 95 % interval (Clopper–Pearson) of both shares asked about."""
    exact = sum(outcome(r) == "all and only those planted" for r in rows)
    wrong = sum(outcome(r) == "an effect that was not planted" for r in rows)
    inside = [low <= true <= high for r in rows for true, _, limits in r["strengths"].values()
              if limits and None not in limits for low, high in [limits]]  # fmt: skip
    return {
        "all and only those planted": rate(exact, len(rows)),
        "an effect that was not planted": rate(wrong, len(rows)),
        "by_number_of_effects": {
            str(n): dict(Counter(outcome(r) for r in rows if len(r["planted"]) == n)) for n in (1, 2, 3)
        },
        "intervals_hold": [sum(inside), len(inside)],
        "median_cpu_seconds": float(np.median([r["cpu_seconds"] for r in rows])),
    }


def with_row(rows: dict[int, dict], row: dict) -> dict[int, dict]:
    """Sessions by seed with one more, or one searched again: then with what became of it `before`."""
    before = rows.get(row["seed"])
    if before is not None:
        row = row | {"before": [*before.get("before", []), before["outcome"]]}
    return dict(sorted((rows | {row["seed"]: row | {"outcome": outcome(row)}}).items()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sessions", type=int, default=100)
    parser.add_argument("--first", type=int, default=0, help="first session")
    parser.add_argument("--again", type=int, nargs="+", help="seeds of sessions to search again, no others")
    parser.add_argument("--out", type=Path, default=Path("docs/gap_combinations.json"))
    parser.add_argument("--minutes", type=float, default=1e9, help="stop after so long; run again to go on")
    options = parser.parse_args()
    rows = {row["seed"]: row for row in json.loads(options.out.read_text())["runs"]} if options.out.exists() else {}
    until = time.monotonic() + 60.0 * options.minutes
    first = FIRST_SEED + options.first
    for seed in options.again or [s for s in range(first, first + options.sessions) if s not in rows]:
        if time.monotonic() > until:
            break
        row = run(seed)
        rows = with_row(rows, row)
        temporary = options.out.with_suffix(".tmp")
        found = {"summary": summary(list(rows.values())), "runs": list(rows.values())}
        temporary.write_text(json.dumps(found, indent=1, default=float) + "\n")
        temporary.replace(options.out)
        what = " + ".join(f"{name} x{factor:.2g}" if factor else f"no {name}" for name, factor in row["planted"])
        print(f"{seed} {what} -> {row['verdict']} {row['named']}, {row['cpu_seconds']:.0f} s", flush=True)


if __name__ == "__main__":
    main()
