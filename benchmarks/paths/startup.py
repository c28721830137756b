"""CPU time until the command line answers, and until the package is imported."""

from __future__ import annotations

import sys
from collections.abc import Iterator

from paths.memory import command_apart
from paths.sizes import Sizes
from paths.timing import Other, Target, Task, row


def tasks(sizes: Sizes) -> Iterator[Task]:
    """Two rows, each beside a Python that does nothing."""
    ways = (("pixelid --help", ["-m", "pixelid", "--help"], 0.10), ("import pixelid", ["-c", "import pixelid"], 0.15))
    for path, words, limit in ways:
        yield Task("startup", path, lambda p=path, w=words, s=limit: _measured(p, w, s, sizes))


def _measured(path: str, words: list[str], limit: float, sizes: Sizes) -> dict:
    command, nothing = [sys.executable, *words], [sys.executable, "-c", "pass"]
    command_apart(command)  # writes the byte code
    times = [(command_apart(command)["cpu_s"], command_apart(nothing)["cpu_s"]) for _ in range(sizes.runs)]
    version = ".".join(map(str, sys.version_info[:3]))
    return row(
        [ours for ours, _ in times],
        Other("python -c pass", version, lambda: None),
        [bare for _, bare in times],
        size=path,
        item="start",
        items=1,
        target=Target("seconds", limit),
        words="imports: reading and running modules",
    )
