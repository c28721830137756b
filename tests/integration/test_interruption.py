"""Ctrl-C and SIGTERM: exit code 130 or 143 within two seconds, whatever runs, and the old result whole."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import click
import pytest

from pixelid.cli import main as home
from pixelid.interruption import INTERRUPTED, TERMINATED, interrupt_kept

BUSY = {
    "in Python": "while True: pass",
    "in a library that swallows it": """
while True:
    try:
        time.sleep(60)
    except KeyboardInterrupt:
        pass
""",
    "in compiled code": "import ctypes\nwhile True: ctypes.CDLL(None).sleep(60)",
    "in a thread that is waited for": """
from concurrent.futures import ThreadPoolExecutor
with ThreadPoolExecutor(1) as pool:
    pool.submit(time.sleep, 60).result()
""",
}
RUN = """
import sys, time
from pathlib import Path
from pixelid.cli import main as home
from pixelid.outputs import claimed, whole_folder
def main(argv=None):
    try:
        with claimed(Path("out"), True), whole_folder(Path("out"), True) as folder:
            (folder / "half.txt").write_text("half")
            print("busy", flush=True)
            {busy}
    except KeyboardInterrupt:
        return home._interrupted()
home.main = main
home.run()
"""


def heeded() -> None:
    """Ctrl-C means something here, also where a shell started the tests in the background, which ignores it."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(autouse=True)
def _heeded():
    before = signal.getsignal(signal.SIGINT)
    heeded()
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, INTERRUPTED), (signal.SIGTERM, TERMINATED)])
@pytest.mark.parametrize("what", BUSY)
def test_a_signal_ends_a_run(what, number, code, tmp_path):
    run = RUN.replace("{busy}", BUSY[what].strip().replace("\n", "\n            "))
    for attempt in range(3):  # a busy computer may hold one up
        folder = tmp_path / str(attempt)
        (folder / "out").mkdir(parents=True)
        (folder / "out" / "fit.json").write_text("{}")
        if interrupted(run, folder, number, code) < 2.0:
            return
    pytest.fail("none of three runs ended within two seconds")


def interrupted(run: str, folder: Path, number: int, code: int) -> float:
    """Seconds from a signal to the end of a run, of which nothing is left but what was there."""
    started = subprocess.Popen(
        [sys.executable, "-c", run],
        cwd=folder,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        preexec_fn=heeded,
    )
    assert started.stdout is not None
    assert started.stdout.readline() == "busy\n"
    begun = time.monotonic()
    started.send_signal(number)
    _, said = started.communicate(timeout=60)
    took = time.monotonic() - begun
    assert started.returncode == code
    assert said.strip() == "pixelid: stopped; nothing is left half written; the same command starts again"
    assert sorted(os.listdir(folder)) in (["out"], [".out.lock", "out"])  # the lock ends with the process that held it
    assert os.listdir(folder / "out") == ["fit.json"]
    return took


def test_an_interrupt_that_a_library_swallows_comes_back():
    def swallows(then=None):
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        if then is not None:
            raise then

    with pytest.raises(KeyboardInterrupt), interrupt_kept():
        swallows()
    with pytest.raises(KeyboardInterrupt), interrupt_kept():
        swallows(RuntimeError("what the library makes of it"))
    with pytest.raises(RuntimeError), interrupt_kept():
        raise RuntimeError
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_an_interrupt_inside_hdf5_waits_for_it(tmp_path, monkeypatch):
    """An exception that passes through HDF5 crashes the process."""
    from pixelid.recordings import Events, Recording, hdf5_writing, write_recording

    plain, recording = hdf5_writing._PatientFile.write, Recording(Events.from_columns([1], [0], [0], [1], 1, 1))

    def write(self, data):
        signal.raise_signal(signal.SIGINT)
        return plain(self, data)

    monkeypatch.setattr(hdf5_writing._PatientFile, "write", write)
    with pytest.raises(KeyboardInterrupt):
        write_recording(recording, tmp_path / "a.h5")
    assert not (tmp_path / "a.h5").exists()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_the_end_of_a_file_is_no_interruption(monkeypatch, capsys):
    def ends(**settings):
        raise click.Abort from EOFError("no more input")

    monkeypatch.setattr(home.cli, "main", ends)
    assert home.main([]) == 1
    assert "unexpected EOFError: no more input" in capsys.readouterr().err
    monkeypatch.setattr(home.cli, "main", lambda **settings: (_ for _ in ()).throw(click.Abort))
    assert home.main([]) == INTERRUPTED


def test_ipopt_does_not_keep_an_interrupt_to_itself():
    """It takes what a callback raises for a failed evaluation."""
    import numpy as np

    from pixelid.fit.engines import casadi_engine
    from pixelid.fit.objective import Local

    class Coordinates:
        def bounds(self):
            return np.full(1, -9.0), np.full(1, 9.0)

        def longest_moves(self):
            return np.ones(1)

    class Objective:
        coordinates, calls = Coordinates(), 0

        def value(self, x):
            return self.local(x).value

        def local(self, x):
            self.calls += 1
            if self.calls == 3:
                signal.raise_signal(signal.SIGINT)
            return Local(-float((x**4).sum()), -4 * x**3, np.diag(12 * x**2))

    objective, x = Objective(), np.array([2.0])
    with pytest.raises(KeyboardInterrupt):
        casadi_engine._solve(objective, x, Local(-16.0, -32.0 * np.ones(1), 48.0 * np.eye(1)), False, 1e-6, 50)
    assert objective.calls < 20


def test_what_compiled_code_makes_of_an_interrupt_is_one(monkeypatch):
    def swallowed(**settings):
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as error:
            raise SystemError("returned a result with an exception set") from error

    monkeypatch.setattr(home.cli, "main", swallowed)
    assert home.main([]) == INTERRUPTED
