"""Read files that a person did not write in a process of its own, which may crash, hang or run out of memory.

Decoders are compiled libraries: for damaged bytes some abort, some loop, some ask for all the memory there is.  So one
child process serves all reading.  It gets a line of JSON (reader, file) and answers on a pipe of its own with headers
of JSON and raw columns: the recording without its events, its parts one by one, at last nothing.  Its CPU time and its
memory are limited in proportion to the file; when it dies, the caller gets one plain line, and the next file a new
child.  Only numbers and JSON come back, nothing that is executed.

Long recordings come from a child of their own that lives as long as they are read.
"""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import signal
import stat
import subprocess
import sys
import threading
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pixelid.documents import refuse_hollow
from pixelid.errors import InputError
from pixelid.recordings.answers import assembled, receive
from pixelid.recordings.parts import joined
from pixelid.recordings.recording import Recording

# per file, after the imports: readers take 1e-8 (binary) to 1e-7 s (text) a byte; .h5 packs to one byte an event, which
# takes 2e-7 s to unpack and check.  A core that several programs share does them at half its speed.
CPU_S, CPU_S_PER_BYTE = 3.0, 1e-6
LOOK_S, MOST_IDLE_LOOKS = 2.0, 15  # a child that sleeps at every one of so many looks waits for nothing that comes
MEMORY_BYTES, MEMORY_PER_BYTE = 4 << 30, 64  # address space: libraries take 1 GiB; compressed columns grow tenfold
START = """import json, sys
sys.path[:] = json.loads(sys.argv[1])
from pixelid.recordings.reading_child import serve
serve()
"""
Answer = tuple[dict[str, Any], dict[str, np.ndarray]]  # header and columns
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}


def read_isolated(reader: str, path: Path, options: Mapping[str, Any] | None = None) -> Recording:
    """The recording that a reader of `reading_child.READERS` finds in a file, with what is stated of it.

    Raises:
        InputError: the reader's own; or that reading crashed, took too long, or needed too much memory.
    """
    path, stated = path.resolve(), dict(options or {})
    try:
        head, *parts = _recordings(_CHILD.all_answers({"reader": reader, "options": stated}, path), path)
    except OSError:  # no process can be started: read here
        from pixelid.recordings.reading_child import recordings_of

        head, *parts = recordings_of(reader, path, stated)
    return joined(head, parts)


def stream_isolated(reader: str, path: Path, options: Mapping[str, Any] | None = None) -> Iterator[Recording]:
    """The same in parts: first the recording without events, then its parts.

    Raises:
        InputError: as `read_isolated`, also between parts.
    """
    return _recordings(_streamed({"reader": reader, "options": dict(options or {})}, path), path)


def arrays_isolated(
    function: str, path: Path, *, single: bool = False, **arguments: Any
) -> Iterator[dict[str, np.ndarray]]:
    """What a generator of `reading_child.FUNCTIONS` yields, arrays by name; each of its steps has the time of a file.

    Args:
        function: its name.
        path: the file that it reads.
        single: it yields once, which spares starting a process of its own.
        arguments: more of its arguments, that JSON can hold.

    Raises:
        InputError: as `read_isolated`, also between steps.
    """
    request = {"reader": function, "arguments": arguments}
    answers = _CHILD.all_answers(request, path) if single else _streamed(request, path)
    return (columns for _, columns in answers)


def _recordings(answers: Iterable[Answer], path: Path) -> Iterator[Recording]:
    """A head and its parts, which come without what the head has."""
    head: Recording | None = None
    for answer in answers:
        part = assembled(*answer, path)
        head = head or part
        yield replace(head, events=part.events, triggers=part.triggers)


def _streamed(request: dict[str, Any], path: Path) -> Iterator[Answer]:
    """Every answer to a request, of a process of its own."""
    child = _Child()
    try:
        yield from child.answers(request, path)
    finally:
        child.stop()


def _regular(path: Path) -> tuple[Path, int]:
    """The file's absolute path and its size."""
    path = path.resolve()
    try:
        status = path.stat()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    if not stat.S_ISREG(status.st_mode):
        raise InputError(f"{path}: expected a regular file, found a device, pipe or socket")
    refuse_hollow(path)
    return path, status.st_size


class _Child:
    """The reading process, started when first needed."""

    def __init__(self) -> None:
        self._process: subprocess.Popen | None = None
        self._lock = threading.Lock()
        self._owner = 0

    def all_answers(self, request: dict[str, Any], path: Path) -> list[Answer]:
        """Every answer to a request, together.  Raises OSError where no process can be started."""
        with self._lock:
            try:
                return list(self.answers(request, path))
            except (InputError, OSError):
                raise
            except BaseException:  # an answer half read would be taken for the next one
                self.stop()
                raise

    def start(self) -> subprocess.Popen:
        """The process, which is started where none runs."""
        if self._process is not None and self._process.poll() is None and self._owner == os.getpid():
            return self._process
        command = [sys.executable, "-c", START, json.dumps(sys.path)]
        pipe, nothing = subprocess.PIPE, subprocess.DEVNULL
        self._process = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=nothing, env=os.environ | ONE_THREAD)
        self._owner = os.getpid()
        return self._process

    def answers(self, request: dict[str, Any], path: Path) -> Iterator[Answer]:
        """The answers to a request about a file, one by one."""
        path, size = _regular(path)
        cpu_s = CPU_S + CPU_S_PER_BYTE * size
        limits = {"cpu_s": cpu_s, "bytes": MEMORY_BYTES + MEMORY_PER_BYTE * size}
        self.start()
        answer = self._answer(path, cpu_s, json.dumps({**request, "path": str(path), **limits}).encode() + b"\n")
        while answer is not None:
            yield answer
            answer = self._answer(path, cpu_s)

    def _answer(self, path: Path, cpu_s: float, request: bytes = b"") -> Answer | None:
        """The next answer; None where there is no more."""
        process = self._process
        assert process is not None and process.stdin is not None and process.stdout is not None  # noqa: PT018
        answered = threading.Event()
        threading.Thread(target=_end_idle, args=(process, answered), daemon=True).start()
        try:
            process.stdin.write(request)
            process.stdin.flush()
            header, columns = receive(process.stdout)
        except (OSError, ValueError):
            code = process.wait()
            self._process = None
            why = {
                -signal.SIGPROF: f"took more than {cpu_s:.0f} s",
                -signal.SIGKILL: "hung, or took too much memory",
            }.get(code, "made the decoder crash")
            raise InputError(f"{path}: damaged: reading it {why}") from None
        finally:
            answered.set()
        if "error" in header:
            raise InputError(header["error"])
        return (header, columns) if header else None

    def stop(self) -> None:
        """End the process, if one runs."""
        process, self._process = self._process, None
        if process is not None and self._owner == os.getpid():
            process.kill()
            for pipe in (process.stdin, process.stdout):
                with contextlib.suppress(OSError, AttributeError):
                    pipe.close()  # pyright: ignore[reportOptionalMemberAccess]
            process.wait()


_CHILD = _Child()
atexit.register(_CHILD.stop)


def _end_idle(process: subprocess.Popen, answered: threading.Event) -> None:
    """Kill a child that neither computes nor waits for its turn, look after look.

    How long that takes is no measure: a child gets little of a core that others want, none while the machine sleeps or
    the terminal has stopped it, and its own CPU limit sees to those that loop.
    """
    idle, before = 0, -1
    while not answered.wait(LOOK_S):
        state, now = _state(process.pid)
        idle = idle + 1 if now == before and state == "S" else 0
        before = now
        if idle >= MOST_IDLE_LOOKS:
            process.kill()
            return


def _state(process: int) -> tuple[str, int]:
    """(state, clock ticks of CPU used) of a process: S sleeps, R runs or could, D waits for a disk, T is stopped."""
    try:
        fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
        return fields[0], int(fields[11]) + int(fields[12])
    except (OSError, ValueError, IndexError):  # not known on this system: only the CPU's limit holds there
        return "", 0
