"""How fast every path is, side by side with a plain way or a peer, in one run.

    python benchmarks/speed.py --out docs/speed.json [--only filter video …] [--again]

Every row is measured in interleaved runs: ours, the other, ours, the other …  Rows are written as they are made; what
the file holds is not measured again unless `--again`.  CPU time of the process, with one thread, so that a busy
machine leaves ratios comparable; wall time where a row says so.  ESIM is a peer where evlib is on PYTHONPATH
(`pip install --no-deps --target DIR evlib`).
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import platform
import statistics
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

for name in ("PIXELID_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ[name] = "1"  # before anything that reads them is imported; rows with two threads say so

from paths.sizes import TINY, Sizes  # noqa: E402
from paths.timing import Task, peaks  # noqa: E402

from pixelid.outputs import write_json  # noqa: E402
from pixelid.provenance import versions  # noqa: E402

SECTIONS = ("filter", "video", "likelihood", "analysis", "rays", "growth", "startup")


def tasks(sizes: Sizes, only: Sequence[str] = SECTIONS) -> Iterator[Task]:
    """The rows to measure, section by section; a section is imported when it is reached."""
    for section in only:
        yield from importlib.import_module(f"paths.{section}").tasks(sizes)


def machine() -> dict:
    """What the numbers were measured on."""
    model = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        names = [line.split(":", 1)[1].strip() for line in cpuinfo.read_text().splitlines() if "model name" in line]
        model = names[0] if names else model
    return {"processor": model, "cores": os.cpu_count(), "system": platform.system(), **peaks()}


def measure(out: Path, sizes: Sizes, only: Sequence[str], again: bool) -> list[dict]:
    """Add the rows that `out` lacks (with `again`, measure those of `only` anew), writing after each."""
    rows = json.loads(out.read_text())["rows"] if out.exists() else []
    if again:
        rows = [row for row in rows if row["section"] not in only]
    done = {(row["section"], row["path"]) for row in rows}
    for task in tasks(sizes, only):
        if (task.section, task.path) in done:
            continue
        rows.append({"section": task.section, "path": task.path, **task.measure()})
        rows.sort(key=lambda row: SECTIONS.index(row["section"]))
        content = {"machine": machine(), "versions": versions(), "runs": sizes.runs, "rows": rows}
        write_json(out, content)
        print(line(rows, task), flush=True)
    return rows


def line(rows: list[dict], task: Task) -> str:
    """A row in a line of text."""
    found = next(row for row in rows if (row["section"], row["path"]) == (task.section, task.path))
    seconds = statistics.median(found["ours_s"])
    words = [
        f"{task.section:10} {task.path:42} {seconds:10.4g} s",
        f"{found['items'] / seconds:10.4g} {found['item']}s/s",
    ]
    if found["ratio"]:
        words.append("{median:.3g} x ({least:.3g} to {most:.3g})".format(**found["ratio"]))
    if found["target"]:
        words.append("target {value:g}: {measured:.4g}".format(**found["target"]))
    return "  ".join([*words, found["note"]])


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("speed.json"))
    parser.add_argument("--only", nargs="+", choices=SECTIONS, default=SECTIONS, help="sections to measure")
    parser.add_argument("--again", action="store_true", help="measure also what the file holds")
    parser.add_argument("--tiny", action="store_true", help="the smallest sizes: whether it runs, not how fast")
    options = parser.parse_args()
    measure(options.out, TINY if options.tiny else Sizes(), options.only, options.again)


if __name__ == "__main__":
    sys.exit(main())
