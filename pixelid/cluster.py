"""Many independent tasks, in this process or on a Dask cluster, with the same results.

A task carries its own data, so workers need no shared disk.  Results may be kept on disk as they arrive: an interrupted
run continues where it stopped.  Dask gives the tasks of a worker that dies to another one.
"""

from __future__ import annotations

import asyncio
import logging
import os
import time
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Any, TypeVar

import numpy as np

from pixelid.arrays import load_arrays
from pixelid.errors import InputError, UntrustworthyResult, first_line, shown
from pixelid.outputs import set_aside, whole_file
from pixelid.parallel import map_threads

Result = Mapping[str, np.ndarray]
Item = TypeVar("Item")
Made = TypeVar("Made")
MARK = "of"  # the array of a kept result that says what it belongs to

# Dask has its workers hand every freed 64 KiB back to the system; fits allocate and free arrays of megabytes thousands
# of times, and getting the pages back took as long as the fits themselves.
KEEP_FREED_MEMORY = "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_"
ONE_THREAD = "distributed.nanny.pre-spawn-environ.PIXELID_THREADS"  # local workers share the cores already

ANSWER_S = 5.0  # for a scheduler to answer, and to name a worker: one that runs takes milliseconds
LOOPBACK = "127.0.0.1"
GO_ON = "what is finished is kept: start the same command again"
WORKERS_S = 30.0  # for a worker to come back when all are lost
LOOK_S = 2.0  # between looks whether workers are left


@dataclass(frozen=True)
class Where:
    """Where tasks run: in this process, on `workers` local processes, or on the scheduler at `cluster`.

    Attributes:
        cluster: address of a running scheduler, tcp://HOST:PORT, or tls://HOST:PORT with the certificates that Dask's
            own configuration names.
        workers: how many local processes; they listen on this computer's loopback interface alone.
    """

    cluster: str = ""
    workers: int = 0

    def __post_init__(self) -> None:
        """Check that they fit each other.  Raises InputError naming the option."""
        if self.cluster and self.workers:
            raise InputError("--cluster and --workers exclude each other")


@dataclass(frozen=True)
class Work:
    """Who does the independent parts of a computation: the threads of this process, or the workers of a Dask client.

    Attributes:
        client: Of `connected`; None: this process.
    """

    client: Any = None

    @property
    def apart(self) -> bool:
        """Whether other processes do it."""
        return self.client is not None

    def map(
        self,
        function: Callable[[Item], Made],
        items: Iterable[Item],
        begun: Callable[[Item], None] = lambda item: None,
    ) -> list[Made]:
        """Apply a function to every item.

        Args:
            function: What to do with one item, in any thread; with a client it and the items go to other processes.
            items: The items.
            begun: Called with each item when its turn comes, of several at a time by one of them.

        Returns:
            The results in the order of the items.

        Raises:
            UntrustworthyResult: The workers were lost.
        """
        items = list(items)
        one_at_a_time = Lock()

        def task(i: int) -> tuple[Item]:
            with one_at_a_time:
                begun(items[i])
            return (items[i],)

        if self.client is None:
            return map_threads(lambda i: function(*task(i)), range(len(items)))
        return run_tasks(function, len(items), task, client=self.client)  # type: ignore[arg-type, return-value]


def run_tasks(
    function: Callable[..., Result],
    count: int,
    task: Callable[[int], tuple],
    *,
    client: Any = None,
    keep: Path | None = None,
    identity: str = "",
    progress: Callable[[float], None] | None = None,
) -> list[Result]:
    """[function(*task(i)) for i in range(count)], each a mapping of names to arrays.

    client: of `connected`, or None for this process.
    task(i) is called when task i is sent off, a few tasks ahead of the workers, so that memory stays bounded.
    keep: folder for results (i.npz); those found there are not computed again, unless they are damaged or of another
    `identity`: these are set aside, and said.
    """
    kept = {} if keep is None else {i: _kept(keep / f"{i}.npz", f"{identity} {i}") for i in range(count)}
    results: dict[int, Result] = {i: result for i, result in kept.items() if result is not None}

    def store(i: int, result: Result) -> None:
        results[i] = result
        if keep is not None:
            with whole_file(keep / f"{i}.npz", overwrite=True) as path:
                np.savez(path, allow_pickle=False, **_sealed(result, f"{identity} {i}"))
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


def _sealed(result: Mapping[str, Any], mark: str) -> dict[str, Any]:
    """The columns of a result with whose it is; the archive has a checksum of each."""
    return {**{name: np.asarray(column) for name, column in result.items()}, MARK: np.array(mark)}


def _kept(path: Path, mark: str) -> Result | None:
    """The result that an earlier run kept, if it is whole and belongs to this one."""
    if not os.path.lexists(path):
        return None
    try:
        arrays = load_arrays(path)
    except InputError:
        set_aside(path, "is damaged", "damaged")
        return None
    if str(arrays.pop(MARK, None)) != mark:
        set_aside(path, "belongs to another run", "other")
        return None
    return arrays


def _distributed(client, function, left: list[int], task) -> Iterator[tuple[int, Result]]:
    """Results as they come.  Raises UntrustworthyResult when no worker is left, or a task ends every one it gets."""
    from distributed import KilledWorker, wait

    waiting = iter(left)
    ahead = 2 * max(sum(client.nthreads().values()), 1)
    index: dict[Any, int] = {}
    run = uuid.uuid4().hex
    alone_since = None

    def send() -> None:
        i = next(waiting, None)
        if i is not None:
            future = client.submit(function, *task(i), key=f"pixelid-{run}-{i}", pure=False)
            index[future] = i

    for _ in range(ahead):
        send()
    while index:
        try:
            finished = wait(list(index), timeout=LOOK_S, return_when="FIRST_COMPLETED").done
        except TimeoutError:
            if _workers_left(client):
                alone_since = None
                continue
            alone_since = time.monotonic() if alone_since is None else alone_since
            if time.monotonic() - alone_since > WORKERS_S:
                raise UntrustworthyResult(f"the cluster has lost every worker, and none came back; {GO_ON}") from None
            continue
        for future in finished:
            i = index.pop(future)
            try:
                result = future.result()
            except KilledWorker as error:
                raise UntrustworthyResult(
                    f"task {i} brought down {error.last_worker}; its tasks may need more memory than workers have: "
                    "use smaller tiles"
                ) from error
            yield i, result
            future.release()
            send()


def _workers_left(client: Any) -> bool:
    """Whether the scheduler has a worker.  Raises UntrustworthyResult when there is no scheduler any more."""
    try:
        if client.status == "running":
            return bool(client.nthreads())
    except (OSError, TimeoutError):
        pass
    raise UntrustworthyResult(f"the Dask scheduler no longer answers; {GO_ON}")


@contextmanager
def connected(where: Where) -> Iterator[Any]:
    """A Dask client, or None for work in this process.

    Raises:
        InputError: dask is missing, no scheduler answers at the address, it does not take us, or it has no workers.
        UntrustworthyResult: it was lost meanwhile.
    """
    if not where.cluster and where.workers < 1:
        yield None
        return
    try:
        import distributed
        from distributed.comm.core import CommClosedError
    except ImportError as error:
        raise InputError("--workers and --cluster need dask: pip install 'pixelid[cluster]'") from error
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what matters of it is said here, in one line
    try:
        with _client(where, distributed) as client:
            yield client
    except (CancelledError, CommClosedError) as error:
        raise UntrustworthyResult(f"the Dask scheduler was lost; {GO_ON}") from error


@contextmanager
def _client(where: Where, distributed: Any) -> Iterator[Any]:
    if where.cluster:
        try:
            with ThreadPoolExecutor(1) as alone:  # a notebook has a loop of its own in this thread
                workers = alone.submit(lambda: asyncio.run(_workers_of(where.cluster))).result()
        except Exception as error:  # whatever answers there may say anything
            raise InputError(
                f"--cluster {shown(where.cluster)}: no Dask scheduler answers there ({first_line(error)})"
            ) from None
        if not workers:
            raise InputError(f"--cluster {shown(where.cluster)}: its scheduler has no workers; start some")
        with distributed.Client(where.cluster, timeout=ANSWER_S) as client:
            yield client
        return
    from dask import config

    with (
        config.set({KEEP_FREED_MEMORY: 1 << 31, ONE_THREAD: 1}),
        distributed.LocalCluster(
            n_workers=where.workers, threads_per_worker=1, processes=True, host=LOOPBACK,
            dashboard_address=f"{LOOPBACK}:0", silence_logs=50,
        ) as cluster,
        distributed.Client(cluster) as client,
    ):  # fmt: skip
        yield client


async def _workers_of(address: str) -> int:
    """How many workers the scheduler at an address has, asked within `ANSWER_S`: a Dask client may wait for ever."""
    from distributed import Security
    from distributed.comm.core import connect

    arguments = Security().get_connection_args("client")
    async with asyncio.timeout(ANSWER_S):
        comm = await connect(address, timeout=ANSWER_S, **arguments)
        try:
            await comm.write({"op": "identity", "reply": True})
            answer = await comm.read()
            return len(answer["workers"])
        finally:
            comm.abort()
