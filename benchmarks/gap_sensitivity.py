"""What hangs on each criterion of the search for the gap: halve and double it, and count the verdicts that change.

    python benchmarks/gap_sensitivity.py --out gap_sensitivity.json [--workers N] [--criteria NAME …] [--sessions KEY …]

Sessions are those of `gap_certification.py`: ten nulls, each effect once at its typical strength, five with the planted
effect left out of the library.  A session's key is the planted effect and its seed, with `:left_out` where it applies
(`leak:5400`, `leak:5400:left_out`; a null is `:1000`).  Each is searched with the criteria as they are, and again with
one of them halved and doubled.  Runs are added line by line to `--out` (JSON lines), so a benchmark can be interrupted
and continued; `--workers` runs on Dask.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import defaultdict
from dataclasses import fields, replace
from pathlib import Path

from gap_certification import ALPHA, camera, first_seeds, planted, session

from pixelid.gap.criteria import Criteria
from pixelid.gap.gap import gap

NULLS = 10
LEFT_OUT = ("dark_current", "leak", "lower_cutoff", "threshold_drift", "source_follower_pole")
FACTORS = (0.5, 2.0)
NAMES = tuple(field.name for field in fields(Criteria))


def sessions() -> list[dict]:
    """The fixed set: {"effect", "seed", "left_out"} of each session."""
    first = first_seeds()
    nulls = [{"effect": "", "seed": 1000 + i, "left_out": False} for i in range(NULLS)]
    whole = [{"effect": effect, "seed": first[effect], "left_out": False} for effect in first]
    return [*nulls, *whole, *({"effect": e, "seed": first[e], "left_out": True} for e in LEFT_OUT)]


def key_of(job: dict) -> str:
    """A session's name on the command line."""
    return f"{job['effect']}:{job['seed']}" + (":left_out" if job["left_out"] else "")


def changed(name: str, factor: float) -> Criteria:
    """The criteria with one of them multiplied; shares and chances stay below one, counts whole."""
    if not name:
        return Criteria()
    default = getattr(Criteria(), name)
    value = factor * default
    if isinstance(default, int):
        value = max(round(value), 1)
    elif name in ("min_hidden_cosine", "complete_closed_fraction"):  # what is left to one
        value = 1.0 - (1.0 - default) * factor
    return replace(Criteria(), **{name: value})


def run(job: dict) -> dict:
    """One search: a job {"criterion", "factor", "effect", "seed", "left_out"} and what it found."""
    model, base = planted(job["effect"], 1.0, camera(job["seed"]))
    began = time.perf_counter()
    report = gap(
        session(model, job["seed"]),
        base,
        alpha=ALPHA,
        seed=job["seed"],
        leave_out=(job["effect"],) if job["left_out"] else (),
        criteria=changed(job["criterion"], job["factor"]),
        recommend=False,
    )
    named = sorted(effect.name for effect in report.effects)
    return {**job, "verdict": report.verdict, "named": named, "seconds": time.perf_counter() - began}


def jobs(names: list[str], keys: list[str]) -> list[dict]:
    """The sessions as they are, then with each criterion changed."""
    chosen = [job for job in sessions() if not keys or key_of(job) in keys]
    changes = [("", 1.0), *((name, factor) for name in names for factor in FACTORS)]
    return [{"criterion": name, "factor": factor, **job} for name, factor in changes for job in chosen]


def table(rows: list[dict]) -> str:
    """Per criterion and factor: how many verdicts change, of how many, and which."""
    usual = {key_of(r): (r["verdict"], r["named"]) for r in rows if not r["criterion"]}
    groups: dict[tuple[str, float], list[dict]] = defaultdict(list)
    for row in rows:
        if row["criterion"] and key_of(row) in usual:
            groups[row["criterion"], row["factor"]].append(row)
    lines = [f"{'criterion':38}{'value':>12}  changed"]
    for (name, factor), mine in groups.items():
        moved = [r for r in mine if (r["verdict"], r["named"]) != usual[key_of(r)]]
        lines.append(f"{name:38}{getattr(changed(name, factor), name):>12.4g}  {len(moved)} of {len(mine)}")
        lines += [f"    {key_of(r)}: {_said(*usual[key_of(r)])} -> {_said(r['verdict'], r['named'])}" for r in moved]
    return "\n".join(lines)


def _said(verdict: str, named: list[str]) -> str:
    return f"{verdict} {'+'.join(named)}".strip()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("gap_sensitivity.json"))
    parser.add_argument("--workers", type=int, default=0, help="Dask workers; 0: here")
    parser.add_argument("--criteria", nargs="*", default=list(NAMES), choices=NAMES, metavar="NAME")
    parser.add_argument("--sessions", nargs="*", default=[], metavar="KEY", help="keys; all when none is given")
    parser.add_argument("--minutes", type=float, default=1e9, help="stop after so long; run again to go on")
    options = parser.parse_args()
    unknown = set(options.sessions) - {key_of(job) for job in sessions()}
    if unknown:
        parser.error(f"--sessions: {', '.join(sorted(unknown))}: not among {', '.join(map(key_of, sessions()))}")
    rows = [json.loads(line) for line in options.out.read_text().splitlines()] if options.out.exists() else []
    done = {(r["criterion"], r["factor"], key_of(r)) for r in rows}
    plan = jobs(options.criteria, options.sessions)
    plan = [job for job in plan if (job["criterion"], job["factor"], key_of(job)) not in done]
    until = time.monotonic() + 60.0 * options.minutes

    def keep(row: dict) -> None:
        rows.append(row)
        with options.out.open("a") as file:
            file.write(json.dumps(row) + "\n")
        said = _said(row["verdict"], row["named"])
        print(f"{row['criterion'] or 'as it is'} x{row['factor']:g} {key_of(row)} -> {said}", flush=True)

    if options.workers:
        from distributed import Client, as_completed

        with Client(n_workers=options.workers, threads_per_worker=1) as client:
            for _, row in as_completed(client.map(run, plan, pure=False), with_results=True):
                keep(row)
    else:
        for job in plan:
            if time.monotonic() > until:
                break
            keep(run(job))
    print(table(rows))


if __name__ == "__main__":
    main()
