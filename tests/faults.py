"""Commands whose disk fails, and commands that are killed.

    python tests/faults.py --out docs/results/faults.json
    python tests/faults.py --out docs/results/faults.json --kills 20

A command runs again and again over a result that is there, each time with one fault: the disk is full after so many
bytes, or one call of fsync, rename or mkdir fails.  It survives when it says so in one line with exit code 2, and the
old result is as it was, with nothing beside it; or when the fault did not matter, and the new one is whole.  A killed
command has survived when what it left is whole, and the next run gives the numbers of one that was never killed.
"""

from __future__ import annotations

import argparse
import errno
import json
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pixelid import outputs
from pixelid.cli.main import main

LIMITS = (0, 300, 3000)  # bytes that a file may have
CALLS = ("fsync", "rename", "mkdir")
MOST_CALLS = 8  # of one kind that fail in turn, spread over all there are
VARYING = {"seconds", "versions", "resumed", "exact_evaluations", "rays_per_second", "seconds_per_step"}
LIGHT = "simulate dvs128 --stimulus chirp --out chirp.h5 --pixels 4 --quiet"
STEPS = "simulate dvs128 --stimulus steps --out steps.h5 --pixels 4 --quiet"
FIT = "fit chirp.h5 steps.h5 --model dvs128 --out {out} --engine scipy"
COMMANDS = {  # name → words; {out} is the result
    "simulate": "simulate dvs128 --stimulus chirp --out {out}.h5 --pixels 4",
    "convert to .h5": "convert chirp.h5 {out}.h5",
    "convert to .npz": "convert chirp.h5 {out}.npz",
    "convert to .csv": "convert chirp.h5 {out}.csv",
    "inspect": "inspect chirp.h5 --out {out}",
    "export": "export dvs128 --to v2e --out {out}.json",
    "lowlight": "lowlight dvs128 --out {out}",
    "noise": "noise noise.csv --out {out}",
    "rates": "rates rates.csv --out {out}",
    "sensor": "sensor chirp.h5 --model dvs128 --out {out} --bandwidth none --bootstrap 0 --tile 1",
    "fit": FIT,
    "fit --sample": FIT + " --sample",
    "gap": "gap chirp.h5 steps.h5 --model dvs128 --out {out}",
}
KILLED = ("convert to .h5", "sensor", "fit --sample", "gap")
NOISE = "lux,ON_events_per_s_per_px,OFF_events_per_s_per_px\n1,2.5,0.1\n10,0.5,0.05\n100,0.125,0.02\n1000,0.1,0.01\n"
RATES = "freq_hz,slow,fast\n1,70,80\n5,200,300\n10,300,500\n50,100.5,200\n100,20,80\n200,3,30\n"


@dataclass(frozen=True)
class Outcome:
    """How a run ended: exit code, what it said, and how often it called what could have failed."""

    code: int
    said: str
    calls: dict[str, int]


def prepare(folder: Path) -> None:
    """Write the inputs of every command."""
    (folder / "noise.csv").write_text(NOISE)
    (folder / "rates.csv").write_text(RATES)
    for words in (LIGHT, STEPS):
        done = run(words.split(), folder)
        assert done.code == 0, done.said


def run(
    words: list[str], folder: Path, *, most_bytes: int | None = None, fails: tuple[str, int] | None = None
) -> Outcome:
    """Run the command line in a process of its own, with at most one fault: a full disk, or the nth call of a kind."""
    told, heard = os.pipe(), os.pipe()
    child = os.fork()
    if child == 0:
        os.chdir(folder)
        os.dup2(told[1], 2)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        sys.stdout, sys.stderr = (open(descriptor, "w", closefd=False) for descriptor in (1, 2))  # noqa: SIM115
        code, calls = 99, {}
        try:
            if most_bytes is not None:
                resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, most_bytes))
            with _failing(fails) as calls:
                code = main(words)
        except BaseException as error:
            print(f"escaped: {error!r}", file=sys.stderr)
        sys.stderr.flush()
        os.write(heard[1], json.dumps(calls).encode())
        os._exit(code)
    os.close(told[1])
    os.close(heard[1])
    with os.fdopen(told[0], errors="replace") as said, os.fdopen(heard[0]) as calls:
        text, counted = said.read(), calls.read()
    _, status = os.waitpid(child, 0)
    return Outcome(os.waitstatus_to_exitcode(status), text, json.loads(counted or "{}"))


@contextmanager
def _failing(fails: tuple[str, int] | None) -> Iterator[dict[str, int]]:
    """Count the calls that can fail, and let one of them fail as a broken disk does."""
    calls = dict.fromkeys(CALLS, 0)

    def counted(kind: str, function: Callable) -> Callable:
        def called(*arguments: Any, **settings: Any) -> Any:
            calls[kind] += 1
            if fails == (kind, calls[kind]):
                raise OSError(errno.EIO, os.strerror(errno.EIO), *(str(a) for a in arguments[:1] if kind != "fsync"))
            return function(*arguments, **settings)

        return called

    for name, kind in (("fsync", "fsync"), ("rename", "rename"), ("replace", "rename"), ("mkdir", "mkdir")):
        setattr(os, name, counted(kind, getattr(os, name)))
    outputs._exchange_at_once = counted("rename", outputs._exchange_at_once)
    yield calls


def contents(folder: Path) -> dict[str, bytes]:
    """Every file below a folder; locks of processes that ended go with the next run."""
    return {str(f.relative_to(folder)): f.read_bytes() for f in sorted(folder.rglob("*")) if f.is_file()}


def complaint(outcome: Outcome, before: dict[str, bytes], after: dict[str, bytes]) -> str:
    """What is wrong with how a command met a fault; empty when nothing is."""
    if any(net in outcome.said for net in ("this is a bug", "Traceback", "escaped")):
        return f"not foreseen: {outcome.said[:300]}"
    if outcome.code == 2:
        if len(outcome.said.strip().splitlines()) != 1:
            return f"not one line: {outcome.said[:300]!r}"
        kept = {name: content for name, content in after.items() if "tiles" not in name and not name.startswith(".out")}
        return "" if kept == before else f"changed: {sorted(set(kept.items()) ^ set(before.items()))[:1]!s:.300}"
    if outcome.code not in (0, 1):
        return f"exit code {outcome.code}: {outcome.said[:300]}"
    return "" if after.keys() == before.keys() else f"left: {sorted(after.keys() ^ before.keys())}"


def faults_of(name: str, folder: Path) -> dict[str, dict[str, Any]]:
    """Fault → how many runs met it, were refused, survived, and the first complaint."""
    words = [*COMMANDS[name].format(out="out").split(), "--overwrite", "--quiet"]
    first = run(words, folder)
    assert first.code in (0, 1), first.said
    before = contents(folder)
    first = run(words, folder)  # once more: over a result that is there
    tried: list[tuple[str, dict[str, Any]]] = [("full disk", {"most_bytes": most}) for most in LIMITS]
    for kind in CALLS:
        count = first.calls[kind]
        nth = sorted({1 + k * max(count - 1, 0) // (MOST_CALLS - 1) for k in range(MOST_CALLS)}) if count else []
        tried += [(kind, {"fails": (kind, n)}) for n in nth]
    before = contents(folder)
    found: dict[str, dict[str, Any]] = {}
    for fault, settings in tried:
        outcome = run(words, folder, **settings)
        said = complaint(outcome, before, contents(folder))
        entry = found.setdefault(fault, {"runs": 0, "refused": 0, "survived": 0, "complaint": ""})
        entry["runs"] += 1
        entry["refused"] += outcome.code == 2
        entry["survived"] += not said
        entry["complaint"] = entry["complaint"] or said
        for left in (*folder.glob(".out*"), *folder.glob("out*.tiles*")):  # what is kept to go on
            shutil.rmtree(left) if left.is_dir() else left.unlink()
        before = contents(folder)
    return found


def numbers(folder: Path) -> dict[str, Any]:
    """What a result says, without what differs from run to run."""

    def plain(value: Any) -> Any:
        if isinstance(value, dict):
            return {k: plain(v) for k, v in value.items() if k not in VARYING}
        return [plain(v) for v in value] if isinstance(value, list) else value

    found: dict[str, Any] = {f.name: plain(json.loads(f.read_text())) for f in sorted(folder.glob("out/*.json"))}
    for file in folder.glob("out.h5"):
        from pixelid.recordings import open_recording

        found["events"] = open_recording(file).events.t.tolist()
    return found


def kills_of(name: str, folder: Path, count: int, seed: int) -> dict[str, Any]:
    """How many kills at random moments left something whole, and a next run with the same numbers."""
    words = [*COMMANDS[name].format(out="out").split(), "--quiet"]
    chance, entry = random.Random(f"{seed} {name}"), {"kills": 0, "equal": 0, "complaint": ""}
    begun = time.monotonic()
    whole = run(words, folder)
    assert whole.code in (0, 1), whole.said
    took, wanted = time.monotonic() - begun, numbers(folder)
    for _ in range(count):
        for left in (*folder.glob("out*"), *folder.glob(".out*")):
            shutil.rmtree(left) if left.is_dir() else left.unlink()
        child = os.fork()
        if child == 0:
            os.chdir(folder)
            sys.stdout = sys.stderr = open(os.devnull, "w")  # noqa: SIM115
            os._exit(main(words))
        time.sleep(chance.uniform(0.05, 1.0) * took)
        os.kill(child, signal.SIGKILL)
        _, status = os.waitpid(child, 0)
        if os.waitstatus_to_exitcode(status) != -signal.SIGKILL:
            continue  # it was faster
        entry["kills"] += 1
        if not any(os.path.lexists(folder / n) for n in ("out", "out.h5")):
            again = run(words, folder)
            if again.code != whole.code:
                entry["complaint"] = entry["complaint"] or f"exit code {again.code}: {again.said[:300]}"
                continue
        same = numbers(folder) == wanted
        left = [f.name for f in (*folder.glob(".out*"), *folder.glob("out.tiles*"))]
        entry["equal"] += same and not left
        entry["complaint"] = (
            entry["complaint"] or ("" if same else "other numbers") or (f"left: {left}" if left else "")
        )
    return entry


def survey() -> int:
    """Every command with every fault; 1 when one did not survive."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", help="only commands whose name contains this")
    parser.add_argument("--kills", type=int, default=0, help="of each command that can be continued")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="JSON file for the table")
    options = parser.parse_args()
    found: dict[str, Any] = {"faults": {}, "kills": {}, "seed": options.seed}
    if options.out is not None and options.out.exists():
        found = json.loads(options.out.read_text())
    chosen = [name for name in COMMANDS if (options.only or "") in name]
    for name in chosen:
        with tempfile.TemporaryDirectory() as place:
            prepare(Path(place))
            if options.kills and name in KILLED:
                found["kills"][name] = kills_of(name, Path(place), options.kills, options.seed)
            elif not options.kills:
                found["faults"][name] = faults_of(name, Path(place))
        print(name, json.dumps(found["kills" if options.kills else "faults"].get(name)), flush=True)
        if options.out is not None:
            options.out.write_text(json.dumps(found, indent=1) + "\n")
    entries = [entry for command in found["faults"].values() for entry in command.values()]
    return int(any(entry["complaint"] for entry in (*entries, *found["kills"].values())))


if __name__ == "__main__":
    sys.exit(survey())
