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
import ctypes
import errno
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))
from processes import NOT_BEGUN, Outcome, import_everything, run, start

KINDS = ("write", "fsync", "rename", "link", "mkdir", "create", "truncate")  # as in faults.c
ALWAYS = 1 << 30
CHANGING = tuple(kind for kind in KINDS if kind != "fsync")
# fault → the calls that fail, each error in turn, and how many calls fail from the nth on
FAULTS: dict[str, tuple[tuple[str, ...], tuple[int, ...], int]] = {
    "full disk": (("write", "mkdir", "create", "truncate"), (errno.ENOSPC,), ALWAYS),
    "read-only folder": (CHANGING, (errno.EROFS,), ALWAYS),
    **{kind: ((kind,), (errno.EIO, errno.ENOSPC) if kind == "write" else (errno.EIO,), 1) for kind in KINDS},
}
MOST_CALLS = 4  # of one kind that fail in turn, spread over all there are
VARYING = {"seconds", "versions", "resumed", "exact_evaluations", "rays_per_second", "seconds_per_step"}
LIGHT = "simulate dvs128 --stimulus chirp --out chirp.h5 --pixels 4 --quiet"
STEPS = "simulate dvs128 --stimulus steps --out steps.h5 --pixels 4 --quiet"
FEW = "convert chirp.h5 few.h5 --time 0:0.4 --pixels 2 --quiet"
MAINS = "simulate dvs128 --stimulus mains.toml --out mains.h5 --pixels 4 --quiet"
FIT = "fit chirp.h5 --model ideal --with threshold_noise --out {out} --engine scipy"
SCENE = "reconstruct hard --out {out} --cells 8 --bandwidth off"
COMMANDS = {  # name → words; {out} is the result
    "models": "models dvs128",
    "simulate": "simulate dvs128 --stimulus chirp --out {out}.h5 --pixels 4",
    "convert to .h5": "convert chirp.h5 {out}.h5",
    "convert to .npz": "convert chirp.h5 {out}.npz",
    "convert to .csv": "convert chirp.h5 {out}.csv",
    "inspect": "inspect chirp.h5 --out {out}",
    "check": "check bench",
    "calibrate": "calibrate bench --out {out} --pixels 4",
    "export": "export dvs128 --to v2e --out {out}.json",
    "lowlight": "lowlight dvs128 --out {out}",
    "noise": "noise noise.csv --out {out} --predict --model dvs128",
    "latency": "latency latency.csv --out {out} --predict --model gen31",
    "rates": "rates rates.csv --out {out}",
    "flicker": "flicker mains.h5 --out {out} --groups 1x1 --frequency 100",
    "design": "design dvs128 --out {out} --menu menu.toml --pixels 1 --draws 1",
    "compare": "compare few.h5 --model photoreceptor --model dvs128 --out {out}",
    "sensor": "sensor chirp.h5 --model dvs128 --out {out} --bandwidth none --bootstrap 0 --tile 1",
    "fit": FIT,
    "fit --sample": FIT + " --sample",
    "gap": "gap chirp.h5 --model dvs128 --out {out}",
    "conform": "conform chirp.h5 --model dvs128 --out {out}",
    "dataset": "dataset eds eds {out}",
    "reconstruct": SCENE + " --steps 4",
    "render": "render scene --out {out} --frames 2 --size 8 8 --depth",
    "report": "report {out}",
}
LONGER = COMMANDS | {
    "reconstruct": SCENE + " --steps 300",
    "sensor": COMMANDS["sensor"].replace("none", "sf_cutoff_hz"),
}
KILLED = ("convert to .h5", "sensor", "fit --sample", "gap", "reconstruct", "calibrate")
INTERRUPTED = (
    "fit",
    "fit --sample",
    "gap",
    "calibrate",
    "sensor",
    "reconstruct",
    "convert to .h5",
    "simulate",
    "design",
    "rates",
)
NOISE = "lux,ON_events_per_s_per_px,OFF_events_per_s_per_px\n1,2.5,0.1\n10,0.5,0.05\n100,0.125,0.02\n1000,0.1,0.01\n"
RATES = "freq_hz,slow,fast\n1,70,80\n5,200,300\n10,300,500\n50,100.5,200\n100,20,80\n200,3,30\n"
LATENCY = "camera,lens,polarity,irradiance_W_m2,bias_config,median,stdev,pixels\nCAM3,f2,1,0.05,0,210,3,100\n"
MENU = '[[stimulus]]\nname = "a"\nkind = "sine"\nduration_s = 0.3\n'


def prepare(folder: Path) -> None:
    """Write the inputs of every command."""
    sys.path.insert(0, str(Path(__file__).resolve().parent / "integration"))
    import test_nerf_published as published

    from pixelid.nerf.synthetic import make_dataset

    for name, text in (("noise", NOISE), ("rates", RATES), ("latency", LATENCY)):
        (folder / f"{name}.csv").write_text(text)
    (folder / "menu.toml").write_text(MENU)
    bench = folder / "bench"
    bench.mkdir()
    for source in (Path(__file__).resolve().parents[1] / "pixelid" / "demo" / "bench").glob("steps_*"):
        shutil.copy(source, bench)
    made = make_dataset(folder / "hard", "hard", seed=3, side=published.SIDE, revolutions=1.0, frames_per_turn=300)
    published.write_eds(folder / "eds", published.as_simulated(made))
    (folder / "mains.toml").write_text('[stimulus]\nkind = "sine"\nfrequency_hz = 100.0\nduration_s = 1.3\n')
    for words in (LIGHT, FEW, STEPS, MAINS, SCENE.format(out="scene") + " --steps 4 --quiet"):
        done = run(words.split(), folder)
        assert done.code in (0, 1), done.said


def library() -> ctypes.CDLL | None:
    """What lets calls fail (faults.c); None where it is not preloaded."""
    found = ctypes.CDLL(None)
    if not hasattr(found, "fault_arm"):
        return None
    found.fault_arm.argtypes = [ctypes.c_char_p, ctypes.c_uint, ctypes.c_long, ctypes.c_long, ctypes.c_long]
    found.fault_count.restype = ctypes.c_long
    return found


def compiled(folder: Path) -> Path | None:
    """faults.c as a library in a folder; None without a C compiler."""
    found, source = folder / "faults.so", Path(__file__).with_suffix(".c")
    words = ["cc", "-shared", "-fPIC", "-O1", "-w", "-o", str(found), str(source), "-ldl"]
    if shutil.which("cc") is None or subprocess.run(words, check=False).returncode:
        return None
    return found


def preload(folder: Path) -> None:
    """Start this process again with faults.c preloaded, where it is not yet.

    Raises:
        SystemExit: there is no C compiler.
    """
    if library() is not None:
        return
    found = compiled(folder)
    if found is None:
        sys.exit("tests/faults.py needs a C compiler")
    os.execve(sys.executable, [sys.executable, *sys.argv], {**os.environ, "LD_PRELOAD": str(found)})


@contextmanager
def failing(folder: Path, fault: str = "", nth: int = 1, code: int = errno.EIO) -> Iterator[dict[str, int]]:
    """Let the nth call of a fault fail, and those after it; count all calls."""
    calls, counted = library(), {}
    assert calls is not None, "faults.c is not preloaded"
    kinds, _, many = FAULTS.get(fault, ((), (), 0))
    bits = sum(1 << KINDS.index(kind) for kind in kinds)
    calls.fault_arm(os.fsencode(folder.resolve()), bits, nth, many, code)
    try:
        yield counted
    finally:
        counted |= {kind: calls.fault_count(k) for k, kind in enumerate(KINDS)}
        calls.fault_arm(b"", 0, 1, 0, 0)


def left_to_go_on(folder: Path) -> list[Path]:
    """What an unfinished run keeps for the next one, and a picture of how far it came."""
    return [*folder.glob(".*"), *folder.glob("out*.tiles*"), *folder.glob("out.preview.png")]


def tidy(folder: Path) -> None:
    """Remove what is kept to go on."""
    for left in left_to_go_on(folder):
        shutil.rmtree(left) if left.is_dir() else left.unlink()


def contents(folder: Path) -> dict[str, bytes]:
    """Every file below a folder; locks of processes that ended go with the next run."""
    return {str(f.relative_to(folder)): f.read_bytes() for f in sorted(folder.rglob("*")) if f.is_file()}


def without_kept(files: dict[str, bytes]) -> dict[str, bytes]:
    """The files of `contents` but those of `left_to_go_on`."""
    kept = ("tiles", "out.preview.png")
    return {n: content for n, content in files.items() if not (n.startswith(".") or any(part in n for part in kept))}


def complaint(outcome: Outcome, before: dict[str, bytes], after: dict[str, bytes]) -> str:
    """What is wrong with how a command met a fault; empty when nothing is."""
    if any(net in outcome.said for net in ("this is a bug", "Traceback", "escaped")):
        return f"not foreseen: {outcome.said[:300]}"
    if outcome.code == 2:
        if len(outcome.said.strip().splitlines()) != 1:
            return f"not one line: {outcome.said[:300]!r}"
        kept = without_kept(after)
        return "" if kept == before else f"changed: {sorted(set(kept.items()) ^ set(before.items()))[:1]!s:.300}"
    if outcome.code not in (0, 1):
        return f"exit code {outcome.code}: {outcome.said[:300]}"
    return "" if after.keys() == before.keys() else f"left: {sorted(after.keys() ^ before.keys())}"


def faults_of(name: str, folder: Path, most: int = MOST_CALLS) -> dict[str, dict[str, Any]]:
    """Fault → how many runs met it, were refused, survived, and the first complaint."""
    words = [*COMMANDS[name].format(out="out").split(), "--quiet"]
    words += ["--overwrite"] if name not in ("models", "report", "check") else []
    if name == "report":
        shutil.copytree(folder / "scene", folder / "out")
    first = run(words, folder)
    assert first.code in (0, 1), first.said
    first = run(words, folder, failing(folder))  # once more: over a result that is there
    before = contents(folder)
    found: dict[str, dict[str, Any]] = {}
    for fault, (kinds, errors, many) in FAULTS.items():
        count = sum(first.told[kind] for kind in kinds)
        turns = (most if many == 1 else min(most, 2)) if count else 0
        entry = found.setdefault(fault, {"runs": 0, "refused": 0, "survived": 0, "complaint": ""})
        nth = {1 + k * (count - 1) // max(turns - 1, 1) for k in range(turns)}
        for k, n in enumerate(sorted(nth)):
            outcome = run(words, folder, failing(folder, fault, n, errors[k % len(errors)]))
            said = complaint(outcome, before, contents(folder))
            entry["runs"] += 1
            entry["refused"] += outcome.code == 2
            entry["survived"] += not said
            entry["complaint"] = entry["complaint"] or (f"call {n} of {count}: {said}" if said else "")
            tidy(folder)
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
    words = [*LONGER[name].format(out="out").split(), "--quiet"]
    chance, entry = random.Random(f"{seed} {name}"), {"kills": 0, "equal": 0, "complaint": ""}
    begun = time.monotonic()
    whole = run(words, folder)
    assert whole.code in (0, 1), whole.said
    took, wanted = time.monotonic() - begun, numbers(folder)
    for _ in range(count):
        for left in (*folder.glob("out*"), *folder.glob(".out*")):
            shutil.rmtree(left) if left.is_dir() else left.unlink()
        child = start(words, folder)
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
        if same and left_to_go_on(folder):  # killed between the result and the tidying, which the next run does
            again = run([*words, "--overwrite"], folder)
            same = again.code == whole.code and numbers(folder) == wanted
        left = [file.name for file in left_to_go_on(folder)]
        entry["equal"] += same and not left
        entry["complaint"] = (
            entry["complaint"] or ("" if same else "other numbers") or (f"left: {left}" if left else "")
        )
    return entry


def interrupts_of(name: str, folder: Path, count: int, seed: int) -> dict[str, Any]:
    """How many interrupts at random moments ended the run with 130, left nothing but what is kept, and how fast [s]."""
    words = [*LONGER[name].format(out="out").split(), "--quiet", "--overwrite"]
    chance = random.Random(f"{seed} {name}")
    entry: dict[str, Any] = {"interrupts": 0, "in_two_seconds": 0, "slowest_s": 0.0, "complaint": ""}
    run(words, folder)  # what is compiled or read once is not timed
    begun = time.monotonic()
    whole = run(words, folder)
    assert whole.code in (0, 1), whole.said
    lasts, before = time.monotonic() - begun, contents(folder)
    for _ in range(count):
        child = start(words, folder)
        time.sleep(chance.uniform(0.02, 1.0) * lasts)
        pressed = time.monotonic()
        os.killpg(child, signal.SIGINT)
        _, status = os.waitpid(child, 0)
        took = time.monotonic() - pressed
        code = os.waitstatus_to_exitcode(status)
        after = contents(folder)
        if code == NOT_BEGUN or (code in (0, 1) and after.keys() == before.keys()):
            before = after
            continue  # it had not begun, or was faster
        said = f"exit code {code}" if code != 130 else "" if without_kept(after) == before else "changed"
        said = said or (f"took {took:.1f} s" if took > 2.0 else "")
        entry["interrupts"] += 1
        entry["in_two_seconds"] += not said
        entry["slowest_s"] = max(entry["slowest_s"], round(took, 2))
        entry["complaint"] = entry["complaint"] or said
        tidy(folder)
    return entry


def survey() -> int:
    """Every command with every fault; 1 when one did not survive."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="only commands whose name contains one of these, between commas")
    parser.add_argument("--kills", type=int, default=0, help="of each command that can be continued")
    parser.add_argument("--interrupts", type=int, default=0, help="of each command that takes long")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="JSON file for the table; what is in it is not done again")
    parser.add_argument("--most", type=int, default=MOST_CALLS, help="calls of one kind that fail in turn")
    options = parser.parse_args()
    import_everything()
    found: dict[str, Any] = {"faults": {}, "kills": {}, "interrupts": {}, "seed": options.seed}
    if options.out is not None and options.out.exists():
        found |= json.loads(options.out.read_text())
    what = "kills" if options.kills else "interrupts" if options.interrupts else "faults"
    bad = 0
    base = Path(tempfile.mkdtemp())
    prepare(base)
    for name in {"kills": KILLED, "interrupts": INTERRUPTED, "faults": COMMANDS}[what]:
        if not any(part in name for part in options.only.split(",")) or name in found[what]:
            continue
        with tempfile.TemporaryDirectory() as place:
            shutil.copytree(base, place, dirs_exist_ok=True)
            if what == "kills":
                entry = kills_of(name, Path(place), options.kills, options.seed)
            elif what == "interrupts":
                entry = interrupts_of(name, Path(place), options.interrupts, options.seed)
            else:
                entry = faults_of(name, Path(place), options.most)
        bad += any(each["complaint"] for each in (entry.values() if what == "faults" else [entry]))
        found[what][name] = entry
        print(name, json.dumps(entry), flush=True)
        if options.out is not None:
            options.out.write_text(json.dumps(found, indent=1) + "\n")
    shutil.rmtree(base)
    return int(bad > 0)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place:
        preload(Path(place))
    sys.exit(survey())
