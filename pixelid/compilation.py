"""Compile what the first commands need, so that nobody waits for it later: `python -m pixelid.compilation`.

`simulate` and `fit` are run on little in one process, `reconstruct` next to them in another.

Numba keeps compiled code next to the package, or in the user's cache where the package cannot be written
(`NUMBA_CACHE_DIR` says another place).  `make setup` runs this; users of a wheel wait once, in the first
command.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

NOTICEABLE_S = 1.0  # of compiling before anything is said: a missing kernel or two nobody notices
DURATION_S = 0.3  # of the light: enough events for a fit, next to nothing to compute
RECONSTRUCTION = "reconstruction"  # what the second process is asked for
SENTENCE = "compiling, first run only (up to a minute)"


@contextmanager
def announced(say: Callable[[str], None]) -> Iterator[None]:
    """Inside, `say` is called with `SENTENCE` once compiling has taken `NOTICEABLE_S`, and not at all otherwise."""
    from numba.core import event

    class Listener(event.Listener):
        """Adds up the time during which anything is compiled; kernels are compiled inside each other."""

        depth, spent_s, begun_s, said = 0, 0.0, 0.0, False

        def on_start(self, event) -> None:
            now = time.monotonic()
            if self.depth == 0:
                self.begun_s = now
            self.depth += 1
            if not self.said and self.spent_s + now - self.begun_s > NOTICEABLE_S:
                self.said = True
                say(SENTENCE)

        def on_end(self, event) -> None:
            self.depth -= 1
            if self.depth == 0:
                self.spent_s += time.monotonic() - self.begun_s

    with event.install_listener("numba:compile", Listener()):
        yield


def compile_kernels() -> None:
    """Run `simulate` and `fit` once on little, which compiles what they need.

    Raises:
        RuntimeError: one of them could not be run.
    """
    from pixelid.cli.main import main

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "session").mkdir()
        for kind, level in (("chirp", 24.0), ("steps", 120.0)):
            light, recording = folder / f"{kind}.toml", folder / "session" / f"{kind}.h5"
            light.write_text(f'[stimulus]\nkind = "{kind}"\nlevel = {level}\nduration_s = {DURATION_S}\n')
            _run(main, ["simulate", "dvs128", "--stimulus", str(light), "--pixels", "4", "--out", str(recording)])
        _run(main, ["fit", str(folder / "session"), "--model", "dvs128", "--out", str(folder / "fit")])


def compile_reconstruction() -> None:
    """The same of `simulate` under a video and `reconstruct`.

    Raises:
        RuntimeError: it could not be run.
    """
    from pixelid.cli.main import main
    from pixelid.nerf.synthetic import make_dataset

    with tempfile.TemporaryDirectory() as name:
        data = make_dataset(Path(name) / "scene", side=8, revolutions=1.0, frames_per_turn=60)
        small = ["--steps", "2", "--batch", "16", "--cells", "8"]
        _run(main, ["reconstruct", str(data), *small, "--out", str(Path(name) / "out")])


def _run(main: Callable[[list[str]], int], words: list[str]) -> None:
    code = main([*words, "--quiet"])
    if code not in (0, 1):  # 1: so little light says little
        raise RuntimeError(f"pixelid {words[0]} ended with exit code {code}")


def compile_now() -> int:
    """Compile, and say how long it took; what cannot be compiled now is compiled when it is used."""
    begun_s = time.monotonic()
    beside = subprocess.Popen([sys.executable, "-m", "pixelid.compilation", RECONSTRUCTION])
    try:
        compile_kernels()
        what = "simulate, fit"
    except Exception as error:
        print(f"pixelid: not compiled now ({error}); the first commands will take longer", file=sys.stderr)
        what = ""
    done = ", ".join(filter(None, [what, "reconstruct" if beside.wait() == 0 else ""]))
    if done:
        print(f"compiled for {done}, in {time.monotonic() - begun_s:.0f} s")
    return 0


def compile_beside() -> int:
    """What the second process compiles; 1 where it cannot."""
    try:
        compile_reconstruction()
    except Exception as error:
        print(f"pixelid: reconstruct is not compiled now ({error}); the first one will take longer", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(compile_beside() if sys.argv[1:] == [RECONSTRUCTION] else compile_now())
