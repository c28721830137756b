"""Ctrl-C, and SIGTERM of batch systems, end a run, also where a compiled library keeps them to itself."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

INTERRUPTED, TERMINATED = 130, 143  # exit codes: 128 + SIGINT or SIGTERM, as shells have it
SENTENCE = "pixelid: interrupted; nothing was left half written"
GRACE_S = 1.2  # between Ctrl-C and the end: less than the two seconds after which people press it again

ending = threading.Event()  # set by a run that is about to say by itself that it was interrupted
terminated = threading.Event()  # set where SIGTERM was taken for an interrupt


def exit_code() -> int:
    """Of a run that was ended by a signal."""
    return TERMINATED if terminated.is_set() else INTERRUPTED


@contextmanager
def interrupt_kept() -> Iterator[None]:
    """Raise KeyboardInterrupt at the end when the library called inside the block has swallowed one.

    Optimisers take an exception in a callback for a failed evaluation, and return as if they had ended by themselves.
    Only the main thread gets interrupts: elsewhere, and where someone has a handler of their own, this does nothing.
    """
    handler = signal.default_int_handler
    if threading.current_thread() is not threading.main_thread() or signal.getsignal(signal.SIGINT) is not handler:
        yield
        return
    seen: list[int] = []

    def note(number: int, frame: object) -> None:
        seen.append(number)
        raise KeyboardInterrupt

    signal.signal(signal.SIGINT, note)
    try:
        yield
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
            os.write(2, SENTENCE.encode() + b"\n")
        os._exit(TERMINATED if number == signal.SIGTERM else INTERRUPTED)

    signal.signal(signal.SIGTERM, terminate)

    threading.Thread(target=watch, name="pixelid-interrupt", daemon=True).start()
