"""Runs of the command line in processes of their own, forked from one in which everything is imported."""

from __future__ import annotations

import importlib
import json
import os
import pkgutil
import resource
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pixelid
from pixelid.cli import main as home
from pixelid.cli.main import main
from pixelid.recordings import isolated

NOT_BEGUN = 125  # exit code of a process that was interrupted before its command line had begun


@dataclass(frozen=True)
class Outcome:
    """How a run ended.

    Attributes:
        code: the exit code; minus the signal that ended it.
        said: on standard error.
        told: what the surroundings of the run counted.
        printed: on standard output.
        cpu_s: CPU time of the process and those that it waited for.
        bytes: most memory at once.
    """

    code: int
    said: str
    told: Mapping[str, int]
    printed: str = ""
    cpu_s: float = 0.0
    bytes: int = 0


class Hang(BaseException):
    """The CPU time is used up."""


@contextmanager
def limited(cpu_s: float) -> Iterator[None]:
    """Raise `Hang` where the block has used so much CPU time."""

    def too_long(*_: object) -> None:
        raise Hang

    before = signal.signal(signal.SIGVTALRM, too_long)
    signal.setitimer(signal.ITIMER_VIRTUAL, cpu_s)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
        signal.signal(signal.SIGVTALRM, before)


def import_everything() -> None:
    """Import every module, and the libraries that they load when used, so that no run pays for it."""
    for module in pkgutil.walk_packages(pixelid.__path__, "pixelid."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
    for name in ("casadi", "emcee", "h5py", "matplotlib.pyplot", "rosbags.highlevel", "ruamel.yaml", "skimage.io",
                 "torch", "faery"):  # fmt: skip
        importlib.import_module(name)


def run(
    words: Sequence[str], folder: Path, around: AbstractContextManager[dict[str, int]] | None = None, cpu_s: int = 0
) -> Outcome:
    """Run the command line.

    Args:
        words: of the command line.
        folder: where it runs.
        around: entered before the command, left after it; what it yields comes back as `told`.
        cpu_s: CPU time after which the process is ended (SIGXCPU); 0: never.
    """
    with tempfile.TemporaryFile() as said, tempfile.TemporaryFile() as printed, tempfile.TemporaryFile() as told:
        sys.stdout.flush()
        sys.stderr.flush()
        reader = isolated._CHILD.start()
        child = os.fork()
        if child == 0:
            code, counted = 99, {}
            try:
                _take_over(reader)
                os.chdir(folder)
                os.dup2(printed.fileno(), 1)
                os.dup2(said.fileno(), 2)
                sys.stdout, sys.stderr = (open(descriptor, "w", closefd=False) for descriptor in (1, 2))  # noqa: SIM115
                if cpu_s:
                    used = resource.getrusage(resource.RUSAGE_SELF)
                    most = int(used.ru_utime + used.ru_stime) + cpu_s
                    resource.setrlimit(resource.RLIMIT_CPU, (most, most + 5))
                with around or nullcontext({}) as counted:
                    code = main(list(words))
            except BaseException as error:
                print(f"escaped: {error!r}", file=sys.stderr)
            sys.stdout.flush()
            sys.stderr.flush()
            os.write(told.fileno(), json.dumps(counted).encode())
            os._exit(code)
        _, status, used = os.wait4(child, 0)
        if os.WIFSIGNALED(status):  # an answer may be left in its pipe
            isolated._CHILD.stop()

        def text(file: Any) -> str:
            file.seek(0)
            return file.read().decode(errors="replace")

        return Outcome(
            os.waitstatus_to_exitcode(status), text(said), json.loads(text(told) or "{}"), text(printed),
            used.ru_utime + used.ru_stime, used.ru_maxrss * 1024,
        )  # fmt: skip


def _take_over(reader: subprocess.Popen) -> None:
    """Let a forked process ask the reading process of its parent: starting one of its own takes most of a short run."""
    isolated._CHILD._owner = os.getpid()
    reader.poll = lambda: None  # it is no child of this process, which must not look after it


def start(words: Sequence[str], folder: Path) -> int:
    """Run the command line and do not wait for it; the process, leader of a group of its own.

    An interrupt that comes before the command line has begun waits for it, and ends the process with `NOT_BEGUN`: in a
    process that was started by itself, Python's own start takes that time.
    """
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    child = os.fork()
    if child == 0:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        os.setpgid(0, 0)
        os.chdir(folder)
        nothing = os.open(os.devnull, os.O_RDWR)
        for descriptor in (1, 2):
            os.dup2(nothing, descriptor)
        sys.argv[1:] = words
        code: object = NOT_BEGUN
        try:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
            home.run()
        except SystemExit as end:
            code = end.code
        except KeyboardInterrupt:
            pass
        finally:
            os._exit(code if isinstance(code, int) else 1)
    signal.pthread_sigmask(signal.SIG_SETMASK, mask)
    with suppress(OSError):
        os.setpgid(child, child)  # whoever of the two comes first
    return child
