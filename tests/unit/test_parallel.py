"""Threads: order, nesting, errors and interrupts."""

import os
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from threadpoolctl import threadpool_info

from pixelid.errors import InputError
from pixelid.parallel import map_threads, ranges, thread_count


def test_results_come_in_order_of_the_items():
    def late_first(i):
        time.sleep(0.02 * (3 - i))
        return i

    assert map_threads(late_first, range(4), threads=4) == [0, 1, 2, 3]


def test_items_run_at_the_same_time():
    meeting = threading.Barrier(2, timeout=10)
    assert sorted(map_threads(lambda _: meeting.wait(), range(2), threads=2)) == [0, 1]


def test_linear_algebra_uses_one_thread_while_threads_work():
    """Its own threads beside them waited for one another: fits of noise tables took four times as long."""
    np.linalg.solve(np.eye(2), np.ones(2))

    def blas_threads():
        return {each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"}

    before = blas_threads()
    assert map_threads(lambda _: blas_threads(), range(2), threads=2) == [{1}, {1}]
    assert blas_threads() == before


def test_nested_use_does_not_deadlock():
    def outer(i):
        return sum(map_threads(lambda j: 10 * i + j, range(5), threads=2))

    assert map_threads(outer, range(8), threads=2) == [50 * i + 10 for i in range(8)]


def test_the_first_error_is_raised_and_the_rest_dropped():
    begun = []

    def work(i):
        begun.append(i)
        if i == 0:
            raise ValueError("item 0")
        time.sleep(0.05)

    with pytest.raises(ValueError, match="item 0"):
        map_threads(work, range(200), threads=2)
    assert len(begun) < 100


def test_the_environment_sets_the_number_of_threads(monkeypatch):
    monkeypatch.setenv("PIXELID_THREADS", "3")
    assert thread_count() == 3
    monkeypatch.setenv("PIXELID_THREADS", "many")
    with pytest.raises(InputError, match="PIXELID_THREADS"):
        thread_count()
    monkeypatch.delenv("PIXELID_THREADS")
    assert thread_count() >= 1


def test_an_interrupt_ends_the_work_promptly():
    program = """
import signal, time
from pixelid.parallel import map_threads
signal.signal(signal.SIGINT, signal.default_int_handler)  # shells start what runs in the background without it
print("ready", flush=True)
map_threads(lambda i: time.sleep(0.1), range(1000), threads=2)
"""
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == b"ready\n"
        time.sleep(0.3)
        os.kill(child.pid, signal.SIGINT)
        begun = time.monotonic()
        child.communicate(timeout=20)
        assert time.monotonic() - begun < 5
        assert child.returncode != 0


def test_a_forked_child_gets_threads_of_its_own():
    map_threads(lambda i: i, range(4), threads=2)
    if not hasattr(os, "fork"):
        pytest.skip("no fork here")
    child = os.fork()
    if child == 0:
        os._exit(0 if map_threads(lambda i: i, range(4), threads=2) == [0, 1, 2, 3] else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


@pytest.mark.parametrize(("count", "parts"), [(0, 3), (1, 4), (7, 3), (12, 4)])
def test_ranges_cover_everything_once(count, parts):
    cuts = ranges(count, parts)
    assert [i for cut in cuts for i in range(cut.start, cut.stop)] == list(range(count))
    assert len(cuts) == min(count, parts)
