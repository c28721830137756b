"""What is common to all functions that `import pixelid` shows.

Plain values are checked against the annotations, so that a wrong one is a sentence and not a traceback from inside a
compiled kernel.  Linear algebra uses one thread while the work lasts: matrices of ten by ten gain nothing from more,
whose waiting costs up to thirty times the work.  Who gives no `progress` sees a bar where there is a terminal or a
notebook to show it.
"""

from __future__ import annotations

import functools
import inspect
import sys
from collections.abc import Callable, Generator
from contextlib import contextmanager
from numbers import Integral, Real
from typing import Any, ParamSpec, TypeVar, cast

from pixelid.errors import InputError, shown

P = ParamSpec("P")
R = TypeVar("R")

MOST_SEED = 2**32 - 1  # of NumPy's generators on every platform
LEAST = {"seed": 0, "sensor_seed": 0, "starts": 0, "pixels": 1, "threads": 1, "draws": 1, "wanted": 1, "max_steps": 1}
MOST = {"seed": MOST_SEED, "sensor_seed": MOST_SEED}
KINDS: dict[str, tuple[tuple[type, ...], str]] = {
    "int": ((Integral,), "a whole number"),
    "float": ((Real,), "a number"),
    "bool": ((bool,), "True or False"),
    "str": ((str,), "text"),
}


def public(function: Callable[P, R]) -> Callable[P, R]:
    """The function with its plain values checked, one thread of linear algebra, and progress by default."""
    signature = inspect.signature(function)
    plain = {name: p.annotation.split(" | ") for name, p in signature.parameters.items()
             if isinstance(p.annotation, str) and set(p.annotation.split(" | ")) <= {*KINDS, "None"}}  # fmt: skip

    @functools.wraps(function)
    def checked(*args: P.args, **options: P.kwargs) -> R:
        given = signature.bind(*args, **options).arguments
        for name, kinds in plain.items():
            if name in given:
                _check(name, given[name], kinds)
        if "progress" not in signature.parameters:
            return function(*args, **options)
        from pixelid.parallel import one_blas_thread

        with one_blas_thread(), _reporting(given.get("progress")) as report:
            changed: dict[str, Any] = {**given, "progress": report}
            return cast("Callable[..., R]", function)(**changed)

    return checked


def _check(name: str, value: object, kinds: list[str]) -> None:
    """Raise InputError for a value of another kind than its annotation, or out of range."""
    if value is None and "None" in kinds:
        return
    known = [KINDS[kind] for kind in kinds if kind != "None"]
    fits = any(isinstance(value, types) and (types == (bool,) or not isinstance(value, bool)) for types, _ in known)
    words = " or ".join(words for _, words in known)
    if not fits:
        raise InputError(f"--{name.replace('_', '-')}: expected {words}, found {shown(value)}")
    if name in LEAST or name in MOST:
        number, low, high = float(cast("float", value)), LEAST.get(name), MOST.get(name)
        if low is not None and number < low:
            raise InputError(f"--{name.replace('_', '-')}: expected at least {low}, found {value}")
        if high is not None and number > high:
            raise InputError(f"--{name.replace('_', '-')}: expected at most {high}, found {value}")


@contextmanager
def _reporting(progress: Any) -> Generator[Callable[[str, float], None] | None]:
    """The function to report to: the user's, a bar where one can be shown, or none (False: none in any case)."""
    if progress is False:
        yield None
    elif progress is not None:
        yield progress
    elif not (sys.stderr.isatty() or in_notebook()):
        yield None
    else:
        from pixelid.cli.progress import bar

        with bar(quiet=False) as report:
            yield report


def in_notebook() -> bool:
    """Whether a Jupyter kernel runs this."""
    shell = sys.modules.get("IPython")
    running = shell.get_ipython() if shell is not None else None
    return type(running).__name__ == "ZMQInteractiveShell"
