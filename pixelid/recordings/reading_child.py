"""The child process that reads files which a person did not write: it answers requests with numbers and JSON.

A request is a line of JSON: the reader or function, the file, and the limits of CPU time and memory.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from pixelid.errors import InputError
from pixelid.recordings.answers import send, taken_apart
from pixelid.recordings.parts import cut
from pixelid.recordings.recording import Recording

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
            send(answers, header, arrays)
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
            yield taken_apart(recording, arrays), arrays
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
        yield reader_of(reader)(path)
        return
    streaming = STREAMING.get(reader)
    cut_already = streaming and importlib.import_module(streaming).stream(path)
    head, parts = cut_already or cut(reader_of(reader)(path))
    yield head
    yield from parts


def _limit(cpu_s: float, memory: int) -> None:
    """CPU seconds from now on (0: no limit; SIGPROF then ends the process), and bytes of address space."""
    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_PROF, cpu_s)
        with contextlib.suppress(ImportError, ValueError, OSError):
            import resource

            resource.setrlimit(resource.RLIMIT_AS, (memory, resource.getrlimit(resource.RLIMIT_AS)[1]))


def reader_of(name: str) -> Callable[[Path], Recording]:
    """The function `read` of a reader."""
    return importlib.import_module(READERS[name]).read
