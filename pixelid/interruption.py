"""Ctrl-C, and SIGTERM of batch systems, end a run, also where a compiled library keeps them to itself."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

INTERRUPTED, TERMINATED = 130, 143  # exit codes: 128 + SIGINT or SIGTERM, as shells have it
STOPPED = "pixelid: stopped; nothing is left half written"
GRACE_S = 1.2  # between Ctrl-C and the end: less than the two seconds after which people press it again

ending = threading.Event()  # set by a run that is about to say by itself that it was interrupted
terminated = threading.Event()  # set where SIGTERM was taken for an interrupt


_kept: list[tuple[Path, str]] = []  # what this run leaves for the same command to go on from


@contextmanager
def keeping(path: Path, what: str) -> Iterator[None]:
    """While the block runs, an interruption says what `path` keeps: entries of a folder, lines of a text, or `what`.

    Args:
        path: file or folder that the work keeps as it goes on.
        what: its entries in the plural ("fits"), or what it is ("the training").
    """
    _kept.append((path, what))
    yield  # an interruption leaves the entry, for the sentence that follows
    _kept.remove((path, what))


def sentence() -> str:
    """What a run that was interrupted says: what is kept, and what the same command does next."""
    kept = [words for path, what in _kept if (words := _in_words(path, what))]
    _kept.clear()
    if not kept:
        return f"{STOPPED}; the same command starts again"
    return f"{STOPPED}; {' and '.join(kept)} kept: the same command goes on from there"


def _in_words(path: Path, what: str) -> str:
    try:
        if path.is_dir():
            count = sum(1 for entry in path.iterdir() if entry.suffix != ".json")  # a note of what they belong to
        elif path.is_file() and path.suffix == ".fits":
            with path.open("rb") as lines:
                count = sum(1 for _ in lines)
        else:
            return what if path.is_file() else ""
    except OSError:
        return ""
    return f"{count} {what}" if count else ""


def exit_code() -> int:
    """Of a run that was ended by a signal."""
    return TERMINATED if terminated.is_set() else INTERRUPTED


@contextmanager
def interrupt_kept() -> Iterator[None]:
    """Raise KeyboardInterrupt at the end when the library called inside the block has swallowed one.

    Optimisers take an exception in a callback for a failed evaluation, and return as if they had ended by themselves.
    Only the main thread gets interrupts: elsewhere, and where someone has a handler of their own, this does nothing.
    """
    with _noted(raising=True):
        yield


@contextmanager
def interrupt_held() -> Iterator[Callable[[], None]]:
    """Let an interrupt wait until the block asks for it, by what it gets here, or ends.

    Libraries that call back crash where an exception passes through them.
    """
    with _noted(raising=False) as seen:

        def look() -> None:
            if seen:
                raise KeyboardInterrupt

        yield look


@contextmanager
def _noted(raising: bool) -> Iterator[list[int]]:
    """Interrupts of the block, which end it, at once or at its end; nothing where others have them."""
    handler, seen = signal.default_int_handler, []
    if threading.current_thread() is not threading.main_thread() or signal.getsignal(signal.SIGINT) is not handler:
        yield seen
        return

    def note(number: int, frame: object) -> None:
        seen.append(number)
        if raising:
            raise KeyboardInterrupt

    signal.signal(signal.SIGINT, note)
    try:
        yield seen
    except Exception:
        if seen:
            raise KeyboardInterrupt from None
        raise
    finally:
        signal.signal(signal.SIGINT, handler)
    if seen:
        raise KeyboardInterrupt


def end_on_interrupt(clean: Callable[[], None]) -> None:
    """From now on Ctrl-C ends this process with exit code 130, and SIGTERM with 143, at once or `GRACE_S` later.

    Python raises KeyboardInterrupt between two of its own instructions: not inside compiled code, and not for good
    where that swallows it.  A thread waits for the signal, gives the run time to end by itself, and ends it then.

    Args:
        clean: called before a forced end; it must not wait for anything.
    """
    if threading.current_thread() is not threading.main_thread() or sys.platform == "win32":
        return  # Windows takes sockets instead of pipes, and ends compiled code by Ctrl-Break
    heard, told = os.pipe()
    os.set_blocking(told, False)
    signal.set_wakeup_fd(told, warn_on_full_buffer=False)

    def terminate(number: int, frame: object) -> None:
        terminated.set()
        signal.raise_signal(signal.SIGINT)

    def watch() -> None:
        while (number := os.read(heard, 1)[0]) not in (signal.SIGINT, signal.SIGTERM):
            pass
        time.sleep(GRACE_S)
        clean()
        if not ending.is_set():
            os.write(2, sentence().encode() + b"\n")
        os._exit(TERMINATED if number == signal.SIGTERM else INTERRUPTED)

    signal.signal(signal.SIGTERM, terminate)

    threading.Thread(target=watch, name="pixelid-interrupt", daemon=True).start()
