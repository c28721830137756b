"""What hangs on each criterion of the search for the gap: halve and double it, and count the verdicts that change.

    python benchmarks/gap_sensitivity.py --certification docs/gap_certification.json --out docs/gap_sensitivity.json

The fixed set is what the certification searched at typical strength: nulls, every effect, some with the planted effect
left out of the library.  The certification noted for each session which changes of a criterion would turn some decision
on the way (`decisions.py`).  All others cannot change the verdict.  Where that leaves more than 2 % of the sessions
in question, they are searched again here, at most `--most` per change, drawn evenly; what was not searched counts like
what was, and where nothing was searched, all in question count as changed.  Runs are added to `--out` one by one, so
the benchmark can be interrupted and continued.  `--share I/N` takes every N-th run, to divide the work among processes
with a file each; `--merge FILE …` joins them.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import defaultdict
from dataclasses import fields, replace
from pathlib import Path

from decisions import FACTORS, scaled
from gap_certification import ALPHA, camera, planted, session

from pixelid.gap.criteria import Criteria
from pixelid.gap.gap import gap

NAMES = tuple(field.name for field in fields(Criteria))
MOST = 40  # searches per change: if none of 40 turns, fewer than 1 in 13 of those in question does (95 %)
FEW = 0.02  # of the sessions: so few in question need no search
Change = tuple[str, float]


def changed(name: str, factor: float) -> Criteria:
    """The criteria with one of them multiplied; counts stay whole."""
    value = scaled(name, factor)
    return replace(Criteria(), **{name: round(value) if isinstance(getattr(Criteria(), name), int) else value})


def key_of(row: dict) -> str:
    """A session's name: planted effect, seed, and whether the library lacked it."""
    return f"{row['effect']}:{row['seed']}" + (":left_out" if row["left_out"] else "")


def fixed_set(certification: Path) -> dict[str, dict]:
    """key → what the certification found, of nulls and of effects at their typical strength."""
    rows = json.loads(certification.read_text())["runs"]
    return {key_of(row): row for row in rows if row["factor"] in (0.0, 1.0) and "decided_by" in row}


def in_question(sessions: dict[str, dict]) -> dict[Change, list[str]]:
    """(criterion, factor) → keys of the sessions in which some decision would be another."""
    keys: dict[Change, list[str]] = {(name, factor): [] for name in NAMES for factor in FACTORS}
    for key, row in sorted(sessions.items()):
        for name, factor in row["decided_by"]:
            keys[name, factor].append(key)
    return keys


def evenly(keys: list[str], most: int) -> list[str]:
    """At most so many of them."""
    return keys if len(keys) <= most else [keys[(i * len(keys)) // most] for i in range(most)]


def run(name: str, factor: float, row: dict) -> dict:
    """One search with one criterion changed, and what it found."""
    model, base = planted(row["effect"], 1.0, camera(row["seed"]))
    began = time.perf_counter()
    report = gap(
        session(model, row["seed"]),
        base,
        alpha=ALPHA,
        seed=row["seed"],
        leave_out=(row["effect"],) if row["left_out"] else (),
        criteria=changed(name, factor),
        recommend=False,
    )
    named = [effect.name for effect in report.effects]
    seconds = time.perf_counter() - began
    return {"criterion": name, "factor": factor, "session": key_of(row), "verdict": report.verdict, "named": named,
            "p": report.global_p, "seconds": seconds}  # fmt: skip


def summary(sessions: dict[str, dict], runs: list[dict]) -> list[dict]:
    """Per change: sessions, those with another decision, those searched, verdicts that changed, and the share."""
    done: dict[Change, list[dict]] = defaultdict(list)
    for r in runs:
        done[r["criterion"], r["factor"]].append(r)
    table = []
    for (name, factor), keys in in_question(sessions).items():
        mine = [r for r in done[name, factor] if r["session"] in keys]  # others were in question for an earlier search
        turned = [r for r in mine if not _same(r, sessions[r["session"]])]
        share = (len(turned) / len(mine) if mine else 1.0) * len(keys) / len(sessions)
        table.append(
            {
                "criterion": name,
                "value": getattr(Criteria(), name),
                "changed_to": getattr(changed(name, factor), name),
                "sessions": len(sessions),
                "some_decision_changes": len(keys),
                "searched": len(mine),
                "verdict_changes": len(turned),
                "share_at_most" if not mine else "share": share,
                "which": [f"{r['session']}: {_said(sessions[r['session']])} -> {_said(r)}" for r in turned],
            }
        )
    return table


def _same(one: dict, other: dict) -> bool:
    return one["verdict"] == other["verdict"] and sorted(one["named"]) == sorted(other["named"])


def _said(row: dict) -> str:
    return f"{row['verdict']} {'+'.join(sorted(row['named']))}".strip()


def _print(table: list[dict]) -> None:
    print(f"{'criterion':40}{'changed to':>11}{'decisions':>11}{'searched':>10}{'verdicts':>10}{'share':>8}")
    for row in table:
        share = f"{100 * row['share']:.1f} %" if "share" in row else f"≤ {100 * row['share_at_most']:.1f} %"
        print(
            f"{row['criterion']:40}{row['changed_to']:>11.4g}{row['some_decision_changes']:>11}{row['searched']:>10}"
            f"{row['verdict_changes']:>10}{share:>8}"
        )
        for line in row["which"]:
            print("    " + line)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--certification", type=Path, default=Path("docs/gap_certification.json"))
    parser.add_argument("--out", type=Path, default=Path("gap_sensitivity.json"))
    parser.add_argument("--most", type=int, default=MOST, help="searches per change")
    parser.add_argument("--criteria", nargs="*", default=list(NAMES), choices=NAMES, metavar="NAME")
    parser.add_argument("--share", default="0/1", metavar="I/N", help="only every N-th run, from the I-th")
    parser.add_argument("--merge", nargs="*", default=[], type=Path, help="files of other shares to join")
    parser.add_argument("--minutes", type=float, default=1e9, help="stop after so long; run again to go on")
    options = parser.parse_args()
    sessions = fixed_set(options.certification)
    runs = []
    for path in (options.out, *options.merge):
        runs += json.loads(path.read_text())["runs"] if path.exists() else []
    done = {(r["criterion"], r["factor"], r["session"]) for r in runs}
    first, step = map(int, options.share.split("/"))
    plan = [
        (name, factor, key)
        for (name, factor), keys in in_question(sessions).items()
        if name in options.criteria and len(keys) > FEW * len(sessions)
        for key in evenly(keys, options.most)
    ][first::step]
    until = time.monotonic() + 60.0 * options.minutes

    def write() -> None:
        options.out.write_text(
            json.dumps({"summary": summary(sessions, runs), "runs": runs}, indent=1, default=float) + "\n"
        )

    for name, factor, key in plan:
        if time.monotonic() > until:
            break
        if (name, factor, key) in done:
            continue
        runs.append(run(name, factor, sessions[key]))
        write()
        print(f"{name} x{factor:g} {key}: {_said(sessions[key])} -> {_said(runs[-1])}", flush=True)
    write()
    _print(summary(sessions, runs))


if __name__ == "__main__":
    main()
