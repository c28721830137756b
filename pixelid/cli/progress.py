"""Progress: a bar with the time left on stderr, a line in a notebook, or nothing when quiet or not a terminal."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from typing import Any

from pixelid.public import in_notebook


@contextmanager
def bar(quiet: bool, compiles: bool = False) -> Iterator[Callable[[str, float], None]]:
    """Yield report(what, fraction), which moves one bar from 0 to 1.

    Args:
        quiet: show nothing.
        compiles: say so once when compiled code has to be made first, on a terminal or not: that takes long and silent.
    """
    if quiet:
        yield lambda what, fraction: None
        return
    if in_notebook():
        with _line_in_notebook() as report:
            yield report
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    from pixelid.errors import printable  # names of recordings come from whoever made the files

    # names of recordings and parameters hold brackets, which are no markup
    columns = (
        TextColumn("{task.description:>20}", markup=False), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn()
    )  # fmt: skip
    console = Console(stderr=True, markup=False)
    shows = console.is_terminal
    with Progress(*columns, console=console, transient=True, disable=not shows) as progress:
        task = progress.add_task("starting", total=1.0)
        with _compilation_announced(console) if compiles else nullcontext():
            yield lambda what, fraction: progress.update(task, description=printable(what), completed=fraction)


@contextmanager
def _line_in_notebook() -> Iterator[Callable[[str, float], None]]:
    """One output that is replaced as the work goes on, and empty at its end; rich would need ipywidgets for that."""
    from html import escape

    from IPython.display import HTML, display  # pyright: ignore[reportMissingImports]

    from pixelid.errors import printable

    shown_at = 0.0
    handle: Any = display(HTML(""), display_id=True)

    between_s = 0.3  # updates of a notebook's line

    def report(what: str, fraction: float) -> None:
        nonlocal shown_at
        if time.monotonic() - shown_at > between_s:
            shown_at = time.monotonic()
            words = f"{escape(printable(what))}, {100 * fraction:.0f} %"
            handle.update(HTML(f'<progress value="{fraction:.3f}"></progress> {words}'))

    try:
        yield report
    finally:
        handle.update(HTML(""))


def _compilation_announced(console):
    from pixelid.compilation import announced

    return announced(lambda sentence: console.print(f"pixelid: {sentence}", highlight=False))
