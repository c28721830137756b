"""How paths are timed: interleaved runs, ratios run by run, and the rates of this computer that bound them."""

from __future__ import annotations

import gc
import os
import statistics
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numba import njit

from pixelid.dynamics.vector_math import vexp

WORTH_S = 0.05  # a run is repeated within one reading of the clock until it takes so long
LONG_S = 3.0  # a first call that takes longer, compiling included, is not worth repeating to find how often
CLOCKS = {"cpu": time.process_time, "wall": time.perf_counter}


@dataclass(frozen=True)
class Other:
    """What a path is compared with.

    work: per item of ours, the same unit: `share` of our items where it works on fewer
    """

    name: str
    version: str
    work: Callable[[], Any]
    share: float = 1.0


@dataclass(frozen=True)
class Target:
    """A value to reach: `of` "ratio", "seconds" or "rate" (items per second), at least or at most `value`."""

    of: str
    value: float

    def met(self, measured: float) -> bool:
        """Whether it is; seconds are at most, the rest at least."""
        return measured <= self.value if self.of == "seconds" else measured >= self.value


@dataclass(frozen=True)
class Counts:
    """Work per item, counted in the formulas: bytes to and from memory, + − × ÷, and exponentials (or √, sin)."""

    bytes: float = 0.0
    flops: float = 0.0
    exponentials: float = 0.0


@dataclass(frozen=True)
class Task:
    """One row to measure: `measure()` gives the row without section and path."""

    section: str
    path: str
    measure: Callable[[], dict[str, Any]] = field(repr=False)


def interleaved(ways: Mapping[str, Callable[[], Any]], runs: int, clock: str = "cpu") -> dict[str, list[float]]:
    """Seconds per call of every way, run after run in turn; the first call of each is left out (it compiles)."""
    now, calls = CLOCKS[clock], dict.fromkeys(ways, 1)
    for name, way in ways.items():
        begun = now()
        way()
        if now() - begun < LONG_S:
            begun = now()
            way()
            calls[name] = max(1, min(100, round(WORTH_S / max(now() - begun, 1e-9))))
    times: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(runs):
        for name, way in ways.items():
            gc.collect()
            begun = now()
            for _ in range(calls[name]):
                way()
            times[name].append((now() - begun) / calls[name])
    return times


def compared(ours: Callable[[], Any], other: Other | None, runs: int, **known: Any) -> dict[str, Any]:
    """A row of ours and, in turn with it, the other way; known: as for `row`."""
    before = os.getloadavg()[0]
    ways = {"ours": ours} | ({other.name: other.work} if other else {})
    times = interleaved(ways, runs, known.get("clock", "cpu"))
    theirs = [t / other.share for t in times[other.name]] if other else []
    return row(times["ours"], other, theirs, load=before, **known)


def row(
    ours: list[float],
    other: Other | None = None,
    theirs: list[float] | None = None,
    *,
    size: str,
    item: str,
    items: float,
    clock: str = "cpu",
    threads: int = 1,
    target: Target | None = None,
    counts: Counts | None = None,
    words: str = "",
    load: float | None = None,
    note: str = "",
    extra: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """A row of docs/speed.json (its keys: tests/integration/test_speed.py).

    ours, theirs: s per run;  items: how many `item` a run works through;  words: what bounds the path
    """
    ratio = None
    if other is not None and theirs:
        each = [b / a for a, b in zip(ours, theirs, strict=True)]
        ratio = {"median": statistics.median(each), "least": min(each), "most": max(each)}
    seconds = statistics.median(ours)
    measured = {"ratio": ratio and ratio["median"], "seconds": seconds, "rate": items / seconds}
    return {
        "size": size,
        "item": item,
        "items": items,
        "clock": clock,
        "threads": threads,
        "ours_s": ours,
        "other": {"name": other.name, "version": other.version, "seconds": theirs} if other else None,
        "ratio": ratio,
        "target": target
        and {"of": target.of, "value": target.value, "measured": measured[target.of],
             "met": target.met(measured[target.of])},
        "bound": bound(counts, items / seconds) | {"words": words} if counts else {"words": words},
        "load": [os.getloadavg()[0] if load is None else load, os.getloadavg()[0]],
        "note": note,
        **(extra or {}),
    }  # fmt: skip


def bound(counts: Counts, rate: float) -> dict[str, Any]:
    """Counts per item, this computer's rates just now, and the share of each that `rate` items/s make of them."""
    now = peaks()
    return {
        "bytes_per_item": counts.bytes,
        "flops_per_item": counts.flops,
        "exponentials_per_item": counts.exponentials,
        **now,
        "share_of_copy": counts.bytes * rate / now["copy_bytes_per_s"],
        "share_of_flops": counts.flops * rate / now["flops_per_s"],
        "share_of_exponentials": counts.exponentials * rate / now["exponentials_per_s"],
    }


COPY = 1 << 24  # float64: 128 MiB each way, beyond the caches
NEAR, REPEATS, CHAINED = 256, 20_000, 16  # float64 in the first cache, multiply-adds from one load to its store


@njit(cache=True)
def _copy(a, b):
    for i in range(len(a)):
        b[i] = a[i]


@njit(cache=True, fastmath={"contract"})
def _multiply_add(x, times):
    for _ in range(times):
        for i in range(len(x)):
            value = x[i]
            for _ in range(CHAINED):
                value = value * 0.999 + 1e-7
            x[i] = value


@njit(cache=True, fastmath={"contract"})
def _exponentials(x, out, times):
    for k in range(times):
        for i in range(len(x)):
            out[i] = vexp(x[i] - 1e-4 * k)


def peaks() -> dict[str, float]:
    """Rates of one core, by its CPU time, the best of three: bytes copied (read and written), multiply-adds of
    vectors (two flops each), exponentials of vectors."""
    a, b, x = np.ones(COPY), np.zeros(COPY), np.full(NEAR, 0.5)
    works = {
        "copy_bytes_per_s": (lambda: _copy(a, b), 16.0 * COPY),
        "flops_per_s": (lambda: _multiply_add(x, REPEATS), 2.0 * CHAINED * NEAR * REPEATS),
        "exponentials_per_s": (lambda: _exponentials(-x, np.empty(NEAR), REPEATS // 4), 1.0 * NEAR * (REPEATS // 4)),
    }
    found = {}
    for name, (work, amount) in works.items():
        work()
        best = np.inf
        for _ in range(3):
            begun = time.thread_time()
            work()
            best = min(best, time.thread_time() - begun)
        found[name] = amount / best
    return found
