"""Read files that a person did not write in a process of its own, which may crash, hang or run out of memory.

Decoders are compiled libraries: for damaged bytes some abort, some loop, some ask for all the memory there is.  So one
child process serves all reading.  It gets a line of JSON (reader, file) and answers with a header of JSON and the raw
columns, on a pipe of its own.  Its CPU time and its memory are limited in proportion to the file; when it dies, the
caller gets one plain line, and the next file a new child.  Only numbers and JSON come back, nothing that is executed.

Long recordings come in parts, from a child of their own that lives as long as they are read: first the recording
without its events, then its parts one by one, at last nothing.
"""

from __future__ import annotations

import atexit
import contextlib
import importlib
import json
import os
import signal
import stat
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np

from pixelid.documents import printable, refuse_hollow
from pixelid.errors import InputError
from pixelid.outputs import plain
from pixelid.recordings.events import Events
from pixelid.recordings.parts import cut
from pixelid.recordings.recording import Recording
from pixelid.recordings.triggers import COLUMNS as EDGE_COLUMNS
from pixelid.recordings.triggers import Triggers
from pixelid.stimuli.pixel_lights import PixelLights
from pixelid.stimuli.stimulus import Stimulus

READERS = {  # name → module with the function `read` (or the function named)
    name: f"pixelid.recordings.{name}"
    for name in ("aedat2", "decoded", "frames", "hdf5", "matlab", "npz", "ros", "text")
}
STREAMING = {  # those with the function `stream`; bags and MATLAB files are read whole by the child
    name: READERS[name] for name in ("aedat2", "decoded", "hdf5", "npz", "text")
}
FUNCTIONS = {  # name → module with a generator of that name: (path, arguments) → arrays by name
    "picture": "pixelid.recordings.pictures", "video": "pixelid.recordings.pictures",
    "event_blocks": "pixelid.nerf.published.hdf5_events",
}  # fmt: skip
LIBRARIES = {  # what readers import; that takes a second, which is none of a file's
    "decoded": ("faery.extension", "faery.file_decoder"), "frames": ("faery.extension",), "hdf5": ("h5py",),
    "matlab": ("scipy.io",),
    "ros": ("rosbags.highlevel", "rosbags.typesys", "faery.extension"),
    "picture": ("skimage.io", "imageio.v3", "tifffile"), "video": ("av",), "event_blocks": ("h5py", "hdf5plugin"),
}  # fmt: skip
# per file, after the imports: readers take 1e-8 (binary) to 1e-7 s (text) a byte; .h5 packs to one byte an event, which
# takes 2e-7 s to unpack and check.  A core that several programs share does them at half its speed.
CPU_S, CPU_S_PER_BYTE = 3.0, 1e-6
LOOK_S, MOST_IDLE_LOOKS = 2.0, 15  # a child that sleeps at every one of so many looks waits for nothing that comes
MEMORY_BYTES, MEMORY_PER_BYTE = 4 << 30, 64  # address space: libraries take 1 GiB; compressed columns grow tenfold
START = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1])\nfrom pixelid.recordings.isolated import serve; serve()"
)
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}


def read_isolated(reader: str, path: Path) -> Recording:
    """The recording that a reader of `READERS` finds in a file.

    Raises:
        InputError: the reader's own; or that reading crashed, took too long, or needed too much memory.
    """
    path, size = _regular(path)
    return _CHILD.read(reader, path, size)


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


def stream_isolated(reader: str, path: Path) -> Iterator[Recording]:
    """The same in parts: first the recording without events, then its parts.

    Raises:
        InputError: as `read_isolated`, also between parts.
    """
    path, size = _regular(path)
    child = _Child()
    try:
        process = child.start()
        header = child.ask(process, {"reader": reader, "stream": True}, path, size)
        while header is not None:
            yield _assembled(header, path)
            header = child.answer(process, path, size)
    finally:
        child.stop()


def arrays_isolated(
    function: str, path: Path, *, single: bool = False, **arguments: Any
) -> Iterator[dict[str, np.ndarray]]:
    """What a generator of `FUNCTIONS` yields, arrays by name; each of its steps has the time of a file.

    Args:
        function: its name.
        path: the file that it reads.
        single: only what it yields first, which spares starting a process of its own.
        arguments: more of its arguments, that JSON can hold.

    Raises:
        InputError: as `read_isolated`, also between steps.
    """
    path, size = _regular(path)
    request = {"reader": function, "arguments": arguments, "stream": not single}
    if single:
        yield _CHILD.arrays(request, path, size)
        return
    child = _Child()
    try:
        process = child.start()
        answer = child.ask(process, request, path, size)
        while answer is not None:
            yield answer["arrays"]
            answer = child.answer(process, path, size)
    finally:
        child.stop()


class _Child:
    """The reading process, started when first needed."""

    def __init__(self) -> None:
        self._process: subprocess.Popen | None = None
        self._lock = threading.Lock()
        self._owner = 0

    def read(self, reader: str, path: Path, size: int) -> Recording:
        """The recording that a reader finds in a file."""
        with self._lock:
            try:
                process = self.start()
            except OSError:  # no process can be started: read here
                return _reader(reader)(path)
            return _assembled(self._whole(process, {"reader": reader}, path, size), path)

    def arrays(self, request: dict[str, Any], path: Path, size: int) -> dict[str, np.ndarray]:
        """The arrays of a request that has one answer."""
        with self._lock:
            return self._whole(self.start(), request, path, size)["arrays"]

    def _whole(self, process: subprocess.Popen, request: dict[str, Any], path: Path, size: int) -> dict[str, Any]:
        try:
            header = self.ask(process, request, path, size)
        except InputError:
            raise
        except BaseException:  # an answer half read would be taken for the next one
            self.stop()
            raise
        assert header is not None
        return header

    def start(self) -> subprocess.Popen:
        """The process, which is started where none runs."""
        if self._process is not None and self._process.poll() is None and self._owner == os.getpid():
            return self._process
        command = [sys.executable, "-c", START, json.dumps(sys.path)]
        pipe, nothing = subprocess.PIPE, subprocess.DEVNULL
        environment = {**os.environ, **ONE_THREAD}
        self._process = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=nothing, env=environment)
        self._owner = os.getpid()
        return self._process

    def ask(self, process: subprocess.Popen, request: dict, path: Path, size: int) -> dict[str, Any] | None:
        """The answer to a request about a file of `size` bytes."""
        assert process.stdin is not None
        limits = {"cpu_s": _cpu_s(size), "bytes": MEMORY_BYTES + MEMORY_PER_BYTE * size}
        request = {**request, "path": str(path), **limits}
        return self.answer(process, path, size, json.dumps(request).encode() + b"\n")

    def answer(self, process: subprocess.Popen, path: Path, size: int, request: bytes = b"") -> dict[str, Any] | None:
        """The next answer; None where there is no more."""
        assert process.stdin is not None
        assert process.stdout is not None
        cpu_s = _cpu_s(size)
        received = _Counted(process.stdout)
        answered = threading.Event()
        watch = threading.Thread(target=_end_idle, args=(process, received, answered), daemon=True)
        watch.start()
        try:
            process.stdin.write(request)
            process.stdin.flush()
            answer = _receive(received)
        except (EOFError, OSError, ValueError):
            code = process.wait()
            self._process = None
            why = {
                -signal.SIGPROF: f"took more than {cpu_s:.0f} s", -signal.SIGKILL: "hung, or took too much memory",
            }.get(code, "made the decoder crash")  # fmt: skip
            raise InputError(f"{path}: damaged: reading it {why}") from None
        finally:
            answered.set()
        if "error" in answer:
            raise InputError(answer["error"])
        return answer if answer.keys() & {"events", "arrays"} else None

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


def _cpu_s(size: int) -> float:
    return CPU_S + CPU_S_PER_BYTE * size


class _Counted:
    """A pipe that counts what came through it."""

    def __init__(self, pipe: IO[bytes]) -> None:
        self._pipe, self.count = pipe, 0

    def read(self, count: int) -> bytes:
        data = self._pipe.read(count)
        self.count += len(data)
        return data

    def readinto(self, view: memoryview) -> int:
        count = self._pipe.readinto(view) or 0  # type: ignore[attr-defined]
        self.count += count
        return count


def _end_idle(process: subprocess.Popen, received: _Counted, answered: threading.Event) -> None:
    """Kill a child that neither computes nor sends nor waits for its turn, look after look.

    How long that takes is no measure: a child gets little of a core that others want, none while the machine sleeps or
    the terminal has stopped it, and its own CPU limit sees to those that loop.
    """
    idle, before = 0, None
    while not answered.wait(LOOK_S):
        state, cpu = _state(process.pid)
        now = cpu, received.count
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


def serve() -> None:
    """Answer requests until the pipe closes: what the child process runs."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends it
    requests = os.fdopen(os.dup(0), "rb")
    answers = os.fdopen(os.dup(1), "wb")
    nothing = os.open(os.devnull, os.O_RDWR)
    for descriptor in (0, 1, 2):  # libraries print
        os.dup2(nothing, descriptor)
    for line in requests:
        request = json.loads(line)
        for name in ((READERS | FUNCTIONS)[request["reader"]], *LIBRARIES.get(request["reader"], ())):
            with contextlib.suppress(ImportError):  # the reader will say so
                importlib.import_module(name)
        _limit(request["cpu_s"], request["bytes"])
        for header, arrays in _answers(request):
            _send(answers, header, arrays)
            if "arguments" in request:
                _limit(request["cpu_s"], request["bytes"])
        _limit(0.0, request["bytes"])


def _answers(request: dict[str, Any]) -> Iterator[tuple[dict[str, Any], list[np.ndarray]]]:
    """What answers a request: headers, each with the columns that it describes."""
    path = Path(request["path"])
    try:
        if "arguments" in request:
            yield from _of_function(request, path)
            return
        for recording in _recordings(request["reader"], path, bool(request.get("stream"))):
            arrays: list[np.ndarray] = []
            yield _taken_apart(recording, arrays), arrays
        if request.get("stream"):
            yield {}, []
    except InputError as error:
        yield {"error": str(error)}, []
    except MemoryError:
        yield {"error": f"{path}: damaged: it declares more than memory holds"}, []
    except Exception as error:
        reason = str(error).splitlines()[0][:120] if str(error) else ""
        yield {"error": f"{path}: damaged ({type(error).__name__}: {reason})"}, []


def _of_function(request: dict[str, Any], path: Path) -> Iterator[tuple[dict[str, Any], list[np.ndarray]]]:
    name = request["reader"]
    for found in getattr(importlib.import_module(FUNCTIONS[name]), name)(path, **request["arguments"]):
        arrays = [np.ascontiguousarray(array) for array in found.values()]
        columns = {
            key: {"dtype": array.dtype.str, "shape": list(array.shape)}
            for key, array in zip(found, arrays, strict=True)
        }
        yield {"arrays": columns}, arrays
        if not request["stream"]:
            return
    yield {}, []


def _recordings(reader: str, path: Path, in_parts: bool) -> Iterator[Recording]:
    """The recording, or a head and its parts; formats that cannot be read in parts are cut after reading."""
    if not in_parts:
        yield _reader(reader)(path)
        return
    streaming = STREAMING.get(reader)
    cut_already = streaming and importlib.import_module(streaming).stream(path)
    head, parts = cut_already or cut(_reader(reader)(path))
    yield head
    yield from parts


def _limit(cpu_s: float, memory: int) -> None:
    """CPU seconds from now on (0: no limit; SIGPROF then ends the process), and bytes of address space."""
    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_PROF, cpu_s)
        with contextlib.suppress(ImportError, ValueError, OSError):
            import resource

            resource.setrlimit(resource.RLIMIT_AS, (memory, resource.getrlimit(resource.RLIMIT_AS)[1]))


def _reader(name: str) -> Callable[[Path], Recording]:
    return importlib.import_module(READERS[name]).read


def _taken_apart(recording: Recording, arrays: list[np.ndarray]) -> dict[str, Any]:
    """The recording as JSON, its columns appended to `arrays`."""

    def column(values: np.ndarray) -> dict:
        arrays.append(np.ascontiguousarray(values))
        return {"dtype": values.dtype.str, "shape": list(values.shape)}

    def events(some: Events | None) -> dict | None:
        if some is None:
            return None
        columns = {name: column(getattr(some, name)) for name in "txyp"}
        return {**columns, "width": some.width, "height": some.height, "tick_ns": some.tick_ns}

    light, edges = recording.stimulus, recording.triggers
    return {
        "events": events(recording.events),
        "exposures": events(recording.exposures),
        "stimulus": None
        if light is None
        else {
            **{name: column(array) for name, array in light.arrays.items()},
            "unit": light.unit,
            "interpolation": light.interpolation,
        },
        "triggers": None if edges is None else {name: column(getattr(edges, name)) for name in EDGE_COLUMNS},
        "condition": recording.condition,
        "sensor": recording.sensor,
        "pooled": recording.pooled,
        "attributes": plain(recording.attributes),
    }


def _assembled(answer: dict[str, Any], path: Path) -> Recording:
    """The recording of an answer whose columns are arrays."""

    def events(some: dict | None) -> Events | None:
        return None if some is None else Events(**some)

    light, edges = answer["stimulus"], answer["triggers"]
    measured = events(answer["events"])
    assert measured is not None
    return Recording(
        events=measured,
        stimulus=None if light is None else (PixelLights.from_arrays if "of_pixel" in light else Stimulus)(**light),
        condition=printable(answer["condition"]),
        sensor=printable(answer["sensor"]),
        pooled=answer["pooled"],
        source=path,
        attributes=answer["attributes"],
        triggers=None if edges is None else Triggers(**edges),
        exposures=events(answer["exposures"]),
    )


def _send(pipe: IO[bytes], header: dict, arrays: list[np.ndarray]) -> None:
    text = json.dumps(header).encode()
    pipe.write(len(text).to_bytes(8, "little") + text)
    for array in arrays:
        pipe.write(array.reshape(-1).view(np.uint8).data)
    pipe.flush()


def _receive(pipe: _Counted) -> dict[str, Any]:
    """The header of an answer, each description of a column replaced by the column, in the order they were sent."""
    header = json.loads(_exactly(pipe, int.from_bytes(_exactly(pipe, 8), "little")))

    def filled(value: Any) -> Any:
        if isinstance(value, dict) and value.keys() == {"dtype", "shape"}:
            array = np.empty(value["shape"], np.dtype(value["dtype"]))
            _fill(pipe, array.reshape(-1).view(np.uint8))
            return array
        return {k: filled(v) for k, v in value.items()} if isinstance(value, dict) else value

    attributes = header.pop("attributes", {})
    return {**filled(header), "attributes": attributes}


def _exactly(pipe: _Counted, count: int) -> bytes:
    data = pipe.read(count)
    if len(data) < count:
        raise EOFError
    return data


def _fill(pipe: _Counted, array: np.ndarray) -> None:
    view, done = array.data, 0
    while done < len(view):
        count = pipe.readinto(view[done:])
        if not count:
            raise EOFError
        done += count
