"""Damage files at random and see that every reader says no in one line: `make fuzz`, or

    python tests/fuzz.py --runs 2000 --seed 0 --keep fuzz-failures

Each target is a parser with good files.  They are damaged in bytes (cut, copied, overwritten) and in values (numbers,
texts and keys replaced by hostile ones), and what the parser answers is judged by `complaint`.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import random
import re
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pixelid.cli.main import main
from pixelid.documents import printable
from pixelid.errors import InputError

ROOT = Path(__file__).resolve().parents[1]
CPU_S = 5.0
NETS = ("this is a bug", "Traceback", "Warning")  # what only the last net, or nobody, says
RUN = re.compile(rb'"(?:[^"\\\n]|\\.)*"|[-+]?[0-9][0-9.eE+-]*|[A-Za-z_]+|[\[\]{}=:,\n]')
HOSTILE = [
    *(b'""', b'"\xf0\x9f\x98\x80"', b'"\\u001b[31mred\\u202e\\u0000"', b'"\\ud800"', b'"a\\nb"'),
    *(b"0", b"-1", b"1e999", b"-1e308", b"1e-320", b"nan", b"NaN", b"inf", b"-Infinity", b"9" * 5000),
    *(b"9" * 30, b"9223372036854775807", b"1e18", b"0x7fffffffffffffff", b"1979-05-27", b"07:32:00", b"true", b"null"),
    *(b"[]", b"{}", b"[[1]]", b'[""]', b'{"a": 1}', b"{ a = 1 }", b"[" * 1000, b"[" * 500 + b"]" * 500, b'{"a":' * 99),
    *(b"a." * 500 + b"a", b"\xff\xfe", b"\x00", b"\xef\xbb\xbf", b"\r", b"\x1b[2J", b"", b"\n", b"=", b",", b"#"),
]  # fmt: skip


@dataclass(frozen=True)
class Target:
    """A parser: good files of it by suffix, and how it is called (with the path of a damaged one)."""

    name: str
    suffix: str
    originals: tuple[bytes, ...]
    call: Callable[[Path], object]


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


class Hang(BaseException):
    """The CPU time is used up."""


def complaint(target: Target, path: Path) -> str:
    """What is wrong with how the target answers a file; empty when nothing is."""

    def too_long(*_: object) -> None:
        raise Hang

    signal.signal(signal.SIGVTALRM, too_long)
    out, err, began = io.StringIO(), io.StringIO(), time.process_time()
    signal.setitimer(signal.ITIMER_VIRTUAL, 4 * CPU_S)
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = target.call(path)
    except InputError as error:
        code, lines = 2, str(error).splitlines()
        print("\n".join(lines), file=err)
    except Hang:
        return f"took more than {4 * CPU_S:g} s"
    except (Exception, SystemExit):
        return traceback.format_exc(limit=-6)
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
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


def targets(folder: Path) -> dict[str, Target]:
    """Every parser by name; `folder` receives the files that targets need beside the damaged one."""
    found = [*_documents(folder), *_results(folder), *_recordings(folder)]
    return {target.name: target for target in found}


def _documents(folder: Path) -> Iterator[Target]:
    from pixelid.design.menu import read_menu
    from pixelid.fit.recipe import read_recipe
    from pixelid.stimuli.files import load_stimulus
    from pixelid.tables.rates.reading import read_table
    from pixelid.tables.rates.recipe import read_pool_recipe

    def command(path: Path) -> int:
        return main(["models", str(path)])

    def recipe(path: Path) -> None:
        read = read_recipe(path)
        read.prepared_model()
        read.prepared_gauge()

    models = tuple(path.read_bytes() for path in sorted((ROOT / "models").glob("*.toml")))
    yield Target("model", ".toml", models, command)
    more = b'with = ["leak:rate_hz=0.1"]\nfix = ["gamma=1.12"]\ngauge = ["q_in=0.875", "A_loop=0.7 A_amp"]\n'
    more += b'between = "auto"\nengine = "casadi"\nseed = 3\nroi = [0, 0, 4, 4]\ntime = [0.1, 0.5]\npixels = 3\n'
    recipe_file = b'[fit]\nrecordings = ["a.h5"]\nmodel = "dvs128"\n'
    yield Target("recipe", ".toml", (recipe_file + more, recipe_file), recipe)
    kinds = ("constant", "sine", "slow", "chirp", "steps", "pulse", "edge", "grating")
    entries = [f'kind = "{kind}"\nlevel = 24.0\nduration_s = 0.05\nstart_s = 0.1\n'.encode() for kind in kinds]
    samples = b'[stimulus]\nkind = "samples"\nt = [0.0, 0.1, 0.2]\nradiance = [1.0, 2.0, 3]\nunit = "lux"\n'
    light = b"time_ms,radiance_lux\n# unit: lux\n0,10\n1,11.5\n2,12\n3,11\n"
    (folder / "light.csv").write_bytes(light)
    file = b'[stimulus]\nkind = "file"\npath = "light.csv"\nunit = "lux"\nfps = 30.0\ngamma = "linear"\n'
    steps = b'[stimulus]\nkind = "steps"\nhold_s = 0.02\nedge_s = 0.0002\nduration_s = 0.1\ndt = 0.00005\nseed = 1\n'
    yield Target("stimulus", ".toml", (*(b"[stimulus]\n" + e for e in entries), samples, file, steps), load_stimulus)
    yield Target("light table", ".csv", (light, b"t;light [fA]\n0;1\n.1;2\n.2;3\n"), load_stimulus)
    menu = b"".join(
        b"[[stimulus]]\nname = 'n%d'\n%s\n" % (k, e.replace(b"start_s = 0.1\n", b"")) for k, e in enumerate(entries[:7])
    )
    yield Target("menu", ".toml", (menu,), read_menu)
    np.savez(folder / "pool.npz", mean=np.ones((2, 3)), spread=np.full((2, 3), 0.1))
    pool = b'[rates]\ntable = "pool.npz"\nfrequency_hz = [5.0, 12.5, 25]\nconditions = ["a", "b"]\n'
    pool += b'arrays = [{ mean = "mean", spread = "spread", label = "near" }]\n'
    yield Target("pool recipe", ".toml", (pool,), read_pool_recipe)
    yield Target("rate table", ".csv", (b"# rates\nfreq_hz,slow,fast\n1,70,80\n10,300,\n50,100.5,200\n",), read_table)
    t = np.linspace(0, 1, 20)
    for suffix, save in (
        (".npy", lambda f: np.save(f, np.stack([t, t + 1]))),
        (".npz", lambda f: np.savez(f, t=t, radiance=t + 1)),
    ):
        save(folder / f"light{suffix}")
        yield Target(f"light {suffix}", suffix, ((folder / f"light{suffix}").read_bytes(),), load_stimulus)


def _results(folder: Path) -> Iterator[Target]:
    from pixelid.fit.draws import read_fit, uncertainty
    from pixelid.fit.result import FitResult
    from pixelid.gap.result import GapReport
    from pixelid.model.files import load_model

    def loaded(name: str, load: Callable[[Path], object]) -> Callable[[Path], int]:
        def command(path: Path) -> int:
            result = folder / name
            result.mkdir(exist_ok=True)
            (result / f"{name}.json").write_bytes(path.read_bytes())
            (result / "model.toml").write_bytes((ROOT / "models" / "dvs128.toml").read_bytes())
            code = main(["report", str(result), "--quiet"])
            with contextlib.suppress(InputError):
                repr(load(result))
            return code

        return command

    def fit(result: Path) -> object:
        with contextlib.suppress(InputError):
            fitted = read_fit(result)
            assert fitted is not None
            uncertainty(fitted, load_model(result / "model.toml"))
        return FitResult.load(result)

    yield Target("fit.json", ".json", ((ROOT / "tests/data/fit.json").read_bytes(),), loaded("fit", fit))
    yield Target("gap.json", ".json", ((ROOT / "tests/data/gap.json").read_bytes(),), loaded("gap", GapReport.load))


def _recordings(folder: Path) -> Iterator[Target]:
    from pixelid.recordings import Events, Recording, open_recording, write_recording
    from pixelid.stimuli.shapes import steps

    chance = np.random.default_rng(0)
    t = np.sort(chance.integers(0, 700_000_000, 60))
    events = Events.from_columns(
        t, chance.integers(0, 4, 60), chance.integers(0, 4, 60), chance.integers(0, 2, 60), 4, 4
    )
    recording = Recording(events, steps(20.0, duration_s=0.8), "a", "b", attributes={"biases": {"diff": 80}})
    for suffix in (".h5", ".npz", ".csv"):
        write_recording(recording, folder / f"r{suffix}")
        yield Target(f"recording {suffix}", suffix, ((folder / f"r{suffix}").read_bytes(),), open_recording)
    words = [0x8000, 0x600A, 0xA201, 0x0005, 0x2807, 0x6014, 0xA200, 0x601E, 0x3864, 0x4005]
    raw = b"% evt 3.0\n% geometry 640x480\n% end\n" + np.array(words, "<u2").tobytes()
    yield Target("recording .raw", ".raw", (raw,), open_recording)
    head = b"#!AER-DAT2.0\r\n# HARDWARE INTERFACE: DAVIS240C\r\n# AEChip: eu.seebetter.ini.chips.davis.DAVIS240C\r\n"
    addresses = (
        (chance.integers(0, 180, 50) << 22) | (chance.integers(0, 240, 50) << 12) | (chance.integers(0, 2, 50) << 11)
    )
    records = np.stack([addresses, np.arange(50) * 100], axis=1).astype(">u4").tobytes()
    yield Target("recording .aedat", ".aedat", (head + records,), open_recording)
    dat = b"% Height 480\n% Width 640\n% Version 2\n% end\n" + bytes([12, 8])
    rows = np.stack([np.arange(40) * 100, (chance.integers(0, 640, 40)) | (chance.integers(0, 480, 40) << 14)], axis=1)
    yield Target("recording .dat", ".dat", (dat + rows.astype("<u4").tobytes(),), open_recording)


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
    options = parser.parse_args()
    limit_memory()
    runs: Counter[str] = Counter()
    failures: dict[str, list[str]] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        chosen = [t for t in targets(folder).values() if (options.target or "") in t.name]
        for k in range(options.runs):
            chance = random.Random(f"{options.seed} {k}")
            target = chosen[k % len(chosen)]
            content = damaged(chance.choice(target.originals), chance)
            path = folder / f"damaged{target.suffix}"
            path.write_bytes(content)
            said = complaint(target, path)
            runs[target.name] += 1
            if not said:
                continue
            key = f"{target.name}: {said.strip().splitlines()[-1][:120]}"
            failures.setdefault(key, []).append(said)
            if len(failures[key]) <= 3:
                options.keep.mkdir(parents=True, exist_ok=True)
                stem = options.keep / f"{target.name.replace(' ', '_')}_{options.seed}_{k}"
                stem.with_name(stem.name + target.suffix).write_bytes(content)
                stem.with_name(stem.name + ".txt").write_text(said)
    print(json.dumps({"runs": sum(runs.values()), "by_target": runs, "seed": options.seed}, indent=1))
    for key, said in sorted(failures.items()):
        print(f"{len(said):5d} × {key}")
    print(f"{sum(map(len, failures.values()))} failures" + (f", kept in {options.keep}" if failures else ""))
    return 1 if failures else 0


if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    sys.exit(fuzz())
