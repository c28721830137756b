"""Damage files at random and see that every reader says no in one line: `make fuzz`, or

    python tests/fuzz.py --runs 2000 --seed 0 --keep fuzz-failures

Each target (`fuzz_targets.py`) is a parser with good files.  They are damaged in bytes (cut, copied, overwritten) and
in values (numbers, texts and keys replaced by hostile ones), and what the parser answers is judged by `complaint`.
"""

from __future__ import annotations

import argparse
import contextlib
import heapq
import io
import json
import os
import random
import re
import sys
import tempfile
import time
import traceback
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))
from fuzz_targets import Target, targets
from processes import Hang, limited

from pixelid.errors import InputError, printable
from pixelid.recordings import isolated

CPU_S = 5.0
LEAST_S = 1e-3  # that a run counts for: the reading process is measured in ticks of 10 ms
NETS = ("this is a bug", "Traceback", "Warning")  # what only the last net, or nobody, says
RUN = re.compile(rb'"(?:[^"\\\n]|\\.)*"|[-+]?[0-9][0-9.eE+-]*|[A-Za-z_]+|[\[\]{}=:,\n]')
HOSTILE = [
    *(b'""', b'"\xf0\x9f\x98\x80"', b'"\\u001b[31mred\\u202e\\u0000"', b'"\\ud800"', b'"a\\nb"'),
    *(b"0", b"-1", b"1e999", b"-1e308", b"1e-320", b"nan", b"NaN", b"inf", b"-Infinity", b"9" * 5000),
    *(b"9" * 30, b"9223372036854775807", b"1e18", b"0x7fffffffffffffff", b"1979-05-27", b"07:32:00", b"true", b"null"),
    *(b"[]", b"{}", b"[[1]]", b'[""]', b'{"a": 1}', b"{ a = 1 }", b"[" * 1000, b"[" * 500 + b"]" * 500, b'{"a":' * 99),
    *(b"a." * 500 + b"a", b"\xff\xfe", b"\x00", b"\xef\xbb\xbf", b"\r", b"\x1b[2J", b"", b"\n", b"=", b",", b"#"),
]  # fmt: skip


def damaged(content: bytes, chance: random.Random) -> bytes:
    """One to three injuries."""
    for _ in range(chance.randint(1, 3)):
        content = chance.choice((_value, _value, _value, _bytes, _cut, _copied))(content, chance)
    return content


def _value(content: bytes, chance: random.Random) -> bytes:
    places = list(RUN.finditer(content[: 1 << 16]))
    if not places:
        return _bytes(content, chance)
    place = chance.choice(places)
    return content[: place.start()] + chance.choice(HOSTILE) + content[place.end() :]


def _bytes(content: bytes, chance: random.Random) -> bytes:
    at = chance.randint(0, max(len(content) - 1, 0))
    if chance.random() < 0.5:  # numbers of binary files: extremes
        patch = chance.choice((b"\xff", b"\x00", b"\x7f")) * chance.choice((1, 2, 4, 8))
    else:
        patch = chance.randbytes(chance.randint(0, 8))
    return content[:at] + patch + content[at + chance.choice((0, len(patch), chance.randint(0, 40))) :]


def _cut(content: bytes, chance: random.Random) -> bytes:
    return content[: chance.randint(0, len(content))]


def _copied(content: bytes, chance: random.Random) -> bytes:
    begin = chance.randint(0, len(content))
    end = min(len(content), begin + chance.randint(0, 200))
    return content[:end] + content[begin:end] * chance.choice((1, 1, 50)) + content[end:]


def complaint(target: Target, path: Path) -> str:
    """What is wrong with how the target answers a file; empty when nothing is."""
    out, err, began = io.StringIO(), io.StringIO(), time.process_time()
    try:
        with limited(4 * CPU_S), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = target.call(path)
    except InputError as error:
        code, lines = 2, str(error).splitlines()
        print("\n".join(lines), file=err)
    except Hang:
        return f"took more than {4 * CPU_S:g} s"
    except (Exception, SystemExit):
        return traceback.format_exc(limit=-6)
    used, said = time.process_time() - began, err.getvalue()
    if isinstance(code, int) and code not in (0, 2):
        return f"exit code {code}: {said[:300]}"
    if any(net in said for net in NETS):
        return f"answered by the last net: {said[:500]}"
    if len(said.splitlines()) > 3:
        return f"more than three lines: {said[:500]}"
    for text in (out.getvalue(), said if target.call.__name__ == "command" else ""):
        if printable(text) != text:
            return f"control characters: {text[:300]!r}"
    return f"took {used:.1f} s" if used > CPU_S else ""


def _cpu_s() -> float:
    """CPU time of this process and of the one that reads recordings."""
    process = isolated._CHILD._process
    ticks = isolated._state(process.pid)[1] if process is not None else 0
    return time.process_time() + ticks / os.sysconf("SC_CLK_TCK")


def limit_memory(most: int = 8 << 30) -> None:
    """What asks for more gets a MemoryError, not the machine."""
    import resource

    resource.setrlimit(resource.RLIMIT_AS, (most, resource.getrlimit(resource.RLIMIT_AS)[1]))


def fuzz() -> int:
    """Run the loop of the command line; 1 when anything was found."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=2000, help="damaged files, over all targets")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--target", help="only targets whose name contains this")
    parser.add_argument("--keep", type=Path, default=Path("fuzz-failures"), help="folder for what failed")
    parser.add_argument("--out", type=Path, help="JSON file that this run is added to")
    options = parser.parse_args()
    limit_memory()
    began = time.process_time()
    runs: Counter[str] = Counter()
    failures: dict[str, list[str]] = {}
    in_memory = Path("/dev/shm")  # no waiting for a disk
    with tempfile.TemporaryDirectory(dir=in_memory if os.access(in_memory, os.W_OK) else None) as name:
        folder = Path(name)
        chosen = [t for t in targets(folder).values() if (options.target or "") in t.name]
        turns = [(0.0, k) for k in range(len(chosen))]  # CPU time spent on each target: they get the same
        for _ in range(options.runs):
            spent, which = heapq.heappop(turns)
            target, now = chosen[which], _cpu_s()
            k = runs[target.name]
            chance = random.Random(f"{options.seed} {target.name} {k}")
            content = damaged(chance.choice(target.originals), chance)
            path = folder / f"damaged{target.suffix}"
            path.write_bytes(content)
            said = complaint(target, path)
            runs[target.name] += 1
            heapq.heappush(turns, (spent + max(_cpu_s() - now, LEAST_S), which))
            if not said:
                continue
            key = f"{target.name}: {said.strip().splitlines()[-1][:120]}"
            failures.setdefault(key, []).append(said)
            if len(failures[key]) <= 3:
                options.keep.mkdir(parents=True, exist_ok=True)
                stem = options.keep / f"{target.name.replace(' ', '_')}_{options.seed}_{k}"
                stem.with_name(stem.name + target.suffix).write_bytes(content)
                stem.with_name(stem.name + ".txt").write_text(said)
    found = {"seed": options.seed, "runs": sum(runs.values()), "failures": sum(map(len, failures.values()))}
    found |= {"targets": len(runs), "kinds": len(failures), "cpu_s": round(time.process_time() - began)}
    print(json.dumps(found | {"by_target": runs}, indent=1))
    if options.out is not None:
        before = json.loads(options.out.read_text()) if options.out.exists() else []
        options.out.write_text(json.dumps([*before, found], indent=1) + "\n")
    for key, said in sorted(failures.items()):
        print(f"{len(said):5d} × {key}")
    print(f"{sum(map(len, failures.values()))} failures" + (f", kept in {options.keep}" if failures else ""))
    return 1 if failures else 0


if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    sys.exit(fuzz())
