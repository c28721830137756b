"""Many independent tasks, one after the other or on a Dask cluster, with the same results.

A task carries its own data, so workers need no shared disk.  Results are kept on disk as they arrive: an interrupted
run continues where it stopped.  Dask gives the tasks of a worker that dies to another one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pixelid.errors import InputError, UntrustworthyResult
from pixelid.outputs import whole_file

Result = Mapping[str, np.ndarray]

# Dask has its workers hand every freed 64 KiB back to the system; fits allocate and free arrays of megabytes thousands
# of times, and getting the pages back took as long as the fits themselves.
KEEP_FREED_MEMORY = "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_"


@dataclass(frozen=True)
class Where:
    """Where tasks run: in this process, on `workers` local processes, or on the scheduler at `cluster`."""

    cluster: str = ""
    workers: int = 0


def run_tasks(
    function: Callable[..., Result],
    count: int,
    task: Callable[[int], tuple],
    *,
    client: Any = None,
    keep: Path | None = None,
    progress: Callable[[float], None] | None = None,
) -> list[Result]:
    """[function(*task(i)) for i in range(count)], each a mapping of names to arrays.

    client: of `connected`, or None for this process.
    task(i) is called when task i is sent off, a few tasks ahead of the workers, so that memory stays bounded.
    keep: folder for results (i.npz); those found there are not computed again.
    """
    results: dict[int, Result] = {}
    for i in range(count):
        if keep is not None and (keep / f"{i}.npz").is_file():
            with np.load(keep / f"{i}.npz") as archive:
                results[i] = dict(archive)

    def store(i: int, result: Result) -> None:
        results[i] = result
        if keep is not None:
            with whole_file(keep / f"{i}.npz", overwrite=True) as path:
                np.savez(path, allow_pickle=False, **{name: np.asarray(column) for name, column in result.items()})
        if progress is not None:
            progress(len(results) / count)

    left = [i for i in range(count) if i not in results]
    if not left:
        return [results[i] for i in range(count)]
    if client is None:
        for i in left:
            store(i, function(*task(i)))
    else:
        for i, result in _distributed(client, function, left, task):
            store(i, result)
    return [results[i] for i in range(count)]


def _distributed(client, function, left: list[int], task) -> Iterator[tuple[int, Result]]:
    from distributed import KilledWorker, as_completed

    waiting = iter(left)
    ahead = 2 * max(sum(client.nthreads().values()), 1)
    index: dict[str, int] = {}
    sequence = as_completed()

    def send() -> None:
        i = next(waiting, None)
        if i is not None:
            future = client.submit(function, *task(i), key=f"pixelid-{id(index)}-{i}", pure=False)
            index[future.key] = i
            sequence.add(future)

    for _ in range(ahead):
        send()
    for future in sequence:
        try:
            result = future.result()
        except KilledWorker as error:
            raise UntrustworthyResult(
                f"task {index[future.key]} brought down {error.last_worker}; its tasks may need more memory than "
                "workers have: use smaller tiles"
            ) from error
        yield index[future.key], result
        future.release()
        send()


@contextmanager
def connected(where: Where) -> Iterator[Any]:
    """A Dask client, or None for work in this process.

    Raises InputError when dask is missing, or no scheduler answers at the address.
    """
    if not where.cluster and where.workers < 1:
        yield None
        return
    try:
        from distributed import Client, LocalCluster
    except ImportError as error:
        raise InputError("--workers and --cluster need dask: pip install 'pixelid[cluster]'") from error
    if where.cluster:
        try:
            client = Client(where.cluster, timeout=10)
        except (OSError, ValueError) as error:
            raise InputError(f"--cluster {where.cluster}: no Dask scheduler answers there") from error
        with client:
            yield client
        return
    import dask.config

    with (
        dask.config.set({KEEP_FREED_MEMORY: 1 << 31}),
        LocalCluster(
            n_workers=where.workers, threads_per_worker=1, processes=True, dashboard_address="", silence_logs=50
        ) as cluster,
        Client(cluster) as client,
    ):
        yield client
