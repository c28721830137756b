"""Independent work on all cores: the one place where the package starts threads.

Threads suffice because the compiled kernels, NumPy and torch release the interpreter's lock.  While they work, linear
algebra uses one thread each: its own would be one per core in each of them, and wait for one another most of the time
(fits of noise tables took four times as long).  Work over several machines or processes is Dask's (`cluster.py`) or
`torchrun`'s (`nerf/parallel.py`).
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from contextlib import contextmanager
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import TypeVar

from threadpoolctl import ThreadpoolController

from pixelid.errors import InputError

CONTAINER = Path("/sys/fs/cgroup/memory.max")  # Linux: bytes, or "max"

Item = TypeVar("Item")
Result = TypeVar("Result")

_inside = threading.local()  # .worker is True in the threads of a pool


def memory_bytes() -> int:
    """Of the computer, or what its container may use; 8 GiB where the system does not say."""
    if not hasattr(os, "sysconf"):
        return 8 << 30
    there = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    try:
        return min(there, int(CONTAINER.read_text()))
    except (OSError, ValueError):  # no container, or one without limit
        return there


def thread_count() -> int:
    """How many threads to use: `PIXELID_THREADS`, or the cores this process may run on.

    Raises:
        InputError: `PIXELID_THREADS` is not a positive whole number.
    """
    demanded = os.environ.get("PIXELID_THREADS", "")
    if demanded:
        if not (demanded.isascii() and demanded.isdigit() and int(demanded) > 0):
            raise InputError(f"PIXELID_THREADS: expected a positive whole number, found {demanded!r}")
        return int(demanded)
    if hasattr(os, "sched_getaffinity"):  # Linux: respects containers' and batch systems' pinning
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def map_threads(
    function: Callable[[Item], Result], items: Iterable[Item], *, threads: int | None = None
) -> list[Result]:
    """Apply a function to every item, on all cores.

    A single item, a single thread, and calls from inside another `map_threads` run in the calling thread, so nested
    use neither deadlocks nor takes more threads than there are cores.

    Args:
        function: what to do with one item; it must release the interpreter's lock to gain anything.
        items: the items; all are taken before the first result is returned.
        threads: how many threads, instead of `thread_count()`.

    Returns:
        The results in the order of the items, whatever the order they were finished in.

    Raises:
        Exception: whatever `function` raised, for the first such item; items not yet begun are dropped.  An
            interrupt (Ctrl-C) drops them likewise.

    Example:
        >>> map_threads(lambda x: x * x, range(4))
        [0, 1, 4, 9]
    """
    items = list(items)
    count = min(thread_count() if threads is None else threads, len(items))
    if count <= 1 or getattr(_inside, "worker", False):
        return [function(item) for item in items]
    with _linear_algebra("scipy.linalg" in sys.modules).limit(limits=1, user_api="blas"):
        futures = [_pool(threads or thread_count()).submit(function, item) for item in items]
        try:
            wait(futures, return_when=FIRST_EXCEPTION)
            for future in futures:
                if future.done() and future.exception() is not None:
                    future.result()
            return [future.result() for future in futures]
        finally:
            for future in futures:
                future.cancel()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Let linear algebra use one thread, in NumPy and in SciPy, until the end of the block."""
    import scipy.linalg  # noqa: F401  # a library is limited only once it is loaded

    with _linear_algebra(True).limit(limits=1, user_api="blas"):
        yield


def ranges(count: int, parts: int | None = None) -> list[slice]:
    """Cut `count` items into consecutive ranges of about equal length.

    Args:
        count: how many items.
        parts: how many ranges, instead of `thread_count()`; never more than there are items.

    Returns:
        Non-empty slices that cover 0 … count.

    Example:
        >>> ranges(5, 2)
        [slice(0, 2, None), slice(2, 5, None)]
    """
    parts = max(min(thread_count() if parts is None else parts, count), 1)
    edges = [count * i // parts for i in range(parts + 1)]
    return [slice(first, last) for first, last in pairwise(edges) if last > first]


@lru_cache(maxsize=2)
def _linear_algebra(scipy_loaded: bool) -> ThreadpoolController:
    """The libraries that are loaded: NumPy's, and SciPy's own once it is there."""
    return ThreadpoolController()


@lru_cache(maxsize=2)
def _pool(threads: int) -> ThreadPoolExecutor:
    """The threads, kept between calls: a likelihood asks for them thousands of times a second."""

    def mark() -> None:
        _inside.worker = True

    return ThreadPoolExecutor(threads, thread_name_prefix="pixelid", initializer=mark)


if hasattr(os, "register_at_fork"):  # a forked child has none of its parent's threads
    os.register_at_fork(after_in_child=_pool.cache_clear)
