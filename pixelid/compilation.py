"""Compile what the first `simulate` and `fit` need, so that nobody waits for it later: `python -m pixelid.compilation`.

Numba keeps compiled code beside the package, or in the user's cache where the package cannot be written
(`NUMBA_CACHE_DIR` says another place).  `make setup` runs this; whoever installs a wheel waits once, in the first
command.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

NOTICEABLE_S = 1.0  # of compiling before anything is said: a missing kernel or two nobody notices
DURATION_S = 0.3  # of the light: enough events for a fit, next to nothing to compute
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


def compile_kernels() -> float:
    """Run `simulate` and `fit` once on little, which compiles what they need; returns the seconds it took.

    Raises:
        RuntimeError: one of them could not be run.
    """
    from pixelid.cli.main import main

    begun_s = time.monotonic()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "session").mkdir()
        for kind, level in (("chirp", 24.0), ("steps", 120.0)):
            light, recording = folder / f"{kind}.toml", folder / "session" / f"{kind}.h5"
            light.write_text(f'[stimulus]\nkind = "{kind}"\nlevel = {level}\nduration_s = {DURATION_S}\n')
            _run(main, ["simulate", "dvs128", "--stimulus", str(light), "--pixels", "4", "--out", str(recording)])
        _run(main, ["fit", str(folder / "session"), "--model", "dvs128", "--out", str(folder / "fit")])
    return time.monotonic() - begun_s


def _run(main: Callable[[list[str]], int], words: list[str]) -> None:
    code = main([*words, "--quiet"])
    if code not in (0, 1):  # 1: so little light says little
        raise RuntimeError(f"pixelid {words[0]} ended with exit code {code}")


def compile_now() -> int:
    """Compile, and say how long it took; what cannot be compiled now is compiled when it is used."""
    try:
        seconds = compile_kernels()
    except Exception as error:
        print(f"pixelid: not compiled now ({error}); the first commands will take longer", file=sys.stderr)
        return 0
    print(f"compiled what simulate and fit need, in {seconds:.0f} s")
    return 0


if __name__ == "__main__":
    sys.exit(compile_now())
