"""The child process that reads files which a person did not write: it answers requests with numbers and JSON.

A request is a line of JSON: the reader or function, the file, and the limits of CPU time and memory.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from pixelid.errors import InputError, on_command_line
from pixelid.recordings.answers import send, taken_apart
from pixelid.recordings.raw import interpreted
from pixelid.recordings.recording import Recording
from pixelid.recordings.source import ReadingOptions

READERS = {  # name → module with the function `opened`, which finds the columns
    name: f"pixelid.recordings.{name}" for name in ("aedat2", "decoded", "hdf5", "matlab", "npz", "ros", "text")
}
FUNCTIONS = {  # name → module with a generator of that name: (path, arguments) → arrays by name
    "picture": "pixelid.recordings.pictures", "video": "pixelid.recordings.pictures",
    "frames": "pixelid.recordings.frames",
    "event_blocks": "pixelid.nerf.data.published.hdf5_events",
}  # fmt: skip
LIBRARIES = {  # what readers import; that takes a second, which is none of a file's
    "decoded": ("faery.extension", "faery.file_decoder"), "frames": ("faery.extension",),
    "hdf5": ("h5py", "hdf5plugin"),
    "matlab": ("scipy.io",), "text": ("pandas",),
    "ros": ("rosbags.highlevel", "rosbags.typesys", "faery.extension"),
    "picture": ("imageio.v3", "tifffile"), "video": ("av",), "event_blocks": ("h5py", "hdf5plugin"),
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
        for header, columns in _answers(request):
            send(answers, header, columns)
            if "arguments" in request:
                _limit(request["cpu_s"], request["bytes"])
        _limit(0.0, request["bytes"])


def _answers(request: dict[str, Any]) -> Iterator[tuple[dict[str, Any], dict[str, np.ndarray]]]:
    """What answers a request: headers, each with its columns; at last nothing."""
    name, path = request["reader"], Path(request["path"])
    try:
        if "arguments" in request:
            for found in getattr(importlib.import_module(FUNCTIONS[name]), name)(path, **request["arguments"]):
                yield {"arrays": True}, found
        else:
            recordings = recordings_of(name, path, request["options"])
            yield taken_apart(next(recordings))
            for part in recordings:
                yield taken_apart(Recording(part.events, triggers=part.triggers))
        yield {}, {}
    except InputError as error:
        with on_command_line():  # as it was raised: whoever reads it spells it
            yield {"error": str(error)}, {}
    except MemoryError:
        yield {"error": f"{path}: damaged: it declares more than memory holds"}, {}
    except Exception as error:
        reason = str(error).splitlines()[0][:120] if str(error) else ""
        yield {"error": f"{path}: damaged ({type(error).__name__}: {reason})"}, {}


def recordings_of(reader: str, path: Path, options: dict[str, Any] | None = None) -> Iterator[Recording]:
    """The recording in a file as a reader of `READERS` finds it: without its events, then its parts."""
    stated = ReadingOptions.of(options or {})
    raw = importlib.import_module(READERS[reader]).opened(path, stated)
    try:
        head, parts = interpreted(raw, stated)
        yield head
        yield from parts
    finally:
        raw.close()


def _limit(cpu_s: float, memory: int) -> None:
    """CPU seconds from now on (0: no limit; SIGPROF then ends the process), and bytes of address space."""
    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_PROF, cpu_s)
        with contextlib.suppress(ImportError, ValueError, OSError):
            import resource

            resource.setrlimit(resource.RLIMIT_AS, (memory, resource.getrlimit(resource.RLIMIT_AS)[1]))
