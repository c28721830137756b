"""Calibrate bench sessions that another simulator made, and count what comes out.

`tests/oracles/bench_sessions.py` shares no code with the package.  It draws circuit, effects, file format, unit of
light, clocks and, in half of the sessions, one wrong statement.  `pixelid calibrate` sees the folder without its
`truth.json`.  Counted are

- circuit parameters: 95 % intervals that hold the truth, and relative errors (targets 3 %, gamma 8 %);
- effects: named where planted above `LIMITS`, and named or described where nothing was planted;
- wrong statements of the bench: found, missed, and doubted where they are right;
- status and CPU time.

Finished sessions are kept; with `--resume` a second call continues.  `--folders` runs folders that exist.

    python benchmarks/bench_sessions.py --sessions 40 --seed 100 --out docs/bench_sessions.json --resume
    python benchmarks/bench_sessions.py --folders ../shared/bench/b0? --out out.json
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

from bench_tally import CIRCUIT, summary

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from tests.oracles.bench_sessions import make_session

ROOT = Path(__file__).resolve().parents[1]
KEPT = "status", "advice", "sentence", "verdict", "effects", "described", "parameters", "unidentified", "bench"
TIMEOUT_S = 3600  # of wall-clock time; the target is five minutes


def run_folder(folder: Path, truth: dict[str, Any], seed: int) -> dict[str, Any]:
    """Calibrate a folder without its truth: exit code, CPU seconds and what `calibration.json` says."""
    with tempfile.TemporaryDirectory() as place:
        bench, out = Path(place) / "bench", Path(place) / "out"
        shutil.copytree(folder, bench, ignore=shutil.ignore_patterns("truth.json"))
        options = ["--out", str(out), "--overwrite", "--quiet", "--seed", str(seed)]
        command = [sys.executable, "-m", "pixelid", "calibrate", str(bench), *options]
        paths = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
        before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S,
                                  env=os.environ | {"PYTHONPATH": paths})  # fmt: skip
            code, errors = done.returncode, done.stderr[-1000:]
        except subprocess.TimeoutExpired:
            code, errors = None, f"stopped after {TIMEOUT_S} s"
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        file = out / "calibration.json"
        result = json.loads(file.read_text()) if file.exists() else {}
    return {
        "seed": seed,
        "truth": {key: value for key, value in truth.items() if key != "recordings"},
        "exit": code,
        "errors": errors,
        "seconds": time.monotonic() - begun,
        "cpu_seconds": after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime,
        "calibration": {key: result[key] for key in KEPT if key in result},
    }


def run_seed(seed: int) -> dict[str, Any]:
    """Make the session of a seed and calibrate it."""
    with tempfile.TemporaryDirectory() as place:
        truth = make_session(Path(place) / "session", seed)
        return run_folder(Path(place) / "session", truth, seed)


def in_words(row: dict[str, Any]) -> str:
    """A run in one line: what was planted and wrong, and what is reported."""
    truth, result = row["truth"], row["calibration"]
    status = result.get("status", f"exit {row['exit']}: {row['errors'].strip()[-200:]}")
    planted = ", ".join(f"{name} {strength:.3g}" for name, strength in truth["effects"].items()) or "nothing"
    named = ", ".join(effect["name"] for effect in result.get("effects", [])) or "nothing"
    doubted = ", ".join(f"{one['statement']} {one.get('recording') or ''}" for one in result.get("bench", []))
    wrong = f"{truth['fault']} {', '.join(truth.get('fault_recordings', [])[:2])}" if truth["fault"] else "nothing"
    return (
        f"{status}, {row['cpu_seconds']:.0f} CPU s; planted {planted}; named {named}; "
        f"wrong {wrong}; doubted {doubted or 'nothing'}"
    )


def print_table(found: dict[str, Any]) -> None:
    """A summary of `bench_tally.summary` in columns."""
    print(f"{found['sessions']} sessions   status: " + ", ".join(f"{n} {s}" for s, n in found["status"].items()))
    print(f"\n{'parameter':<18}{'in 95 %':>10}{'median error':>14}{'largest':>10}{'within target':>15}")
    for name in CIRCUIT:
        row = found["parameters"][name]
        if row["reported"]:
            held = f"{row['covered']}/{row['with_interval']}"
            target = "" if row["within_target"] is None else f"{row['within_target']}/{row['reported']}"
            print(f"{name:<18}{held:>10}{row['median_error']:>14.2%}{row['largest_error']:>10.2%}{target:>15}")
    print(f"\n{'effect':<26}{'above limit, named':>20}{'below, named':>14}{'wrongly named':>15}{'in 95 %':>10}")
    for name, row in found["effects"].items():
        above, below = (f"{a}/{b}" for a, b in (row["above_limit"], row["below_limit"]))
        print(f"{name:<26}{above:>20}{below:>14}{row['wrongly_named']:>15}{'{}/{}'.format(*row['covered']):>10}")
    print(f"described in {found['described']} sessions; nothing missing and `none`: {'{}/{}'.format(*found['nulls'])}")
    print(f"\n{'fault':<12}{'found':>8}{'missed':>8}")
    for fault, row in found["faults"].items():
        print(f"{fault:<12}{row['found']:>8}{row['missed']:>8}")
    doubts = Counter(found["doubted_without_cause"])
    print("doubted without cause: " + (", ".join(f"{s} ×{n}" for s, n in doubts.items()) or "nothing"))
    print("CPU s: median {:.0f}, largest {:.0f}".format(*found["cpu_seconds_median_and_largest"]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sessions", type=int, default=40, help="how many seeds")
    parser.add_argument("--seed", type=int, default=100, help="the first")
    parser.add_argument("--folders", type=Path, nargs="*", help="bench folders with a truth.json, instead of seeds")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--resume", action="store_true", help="keep the sessions that are in --out")
    options = parser.parse_args()
    if options.out.exists() and not options.resume:
        parser.error(f"{options.out} exists; continue it with --resume")
    rows = json.loads(options.out.read_text())["runs"] if options.out.exists() else []
    done = {row.get("folder", row["seed"]) for row in rows}
    todo = options.folders or range(options.seed, options.seed + options.sessions)
    for each in todo:
        key = str(each) if options.folders else each
        if key in done:
            continue
        if options.folders:
            row = run_folder(each, json.loads((each / "truth.json").read_text()), 0) | {"folder": key}
        else:
            row = run_seed(each)
        rows.append(row)
        temporary = options.out.with_suffix(".tmp")
        temporary.write_text(json.dumps({"summary": summary(rows), "runs": rows}, indent=1) + "\n")
        temporary.replace(options.out)
        print(f"{key}: {in_words(row)}", flush=True)
    if rows:
        print_table(summary(rows))


if __name__ == "__main__":
    main()
