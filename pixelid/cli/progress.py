"""Progress on stderr: a bar with the time left, or nothing when quiet or not a terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext


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
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    from pixelid.errors import printable  # names of recordings come from whoever made the files

    # names of recordings and parameters hold brackets, which are no markup
    columns = (
        TextColumn("{task.description:>20}", markup=False), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn()
    )  # fmt: skip
    console = Console(stderr=True, markup=False)
    shows = console.is_terminal or console.is_jupyter
    with Progress(*columns, console=console, transient=True, disable=not shows) as progress:
        task = progress.add_task("starting", total=1.0)
        with _compilation_announced(console) if compiles else nullcontext():
            yield lambda what, fraction: progress.update(task, description=printable(what), completed=fraction)


def _compilation_announced(console):
    from pixelid.compilation import announced

    return announced(lambda sentence: console.print(f"pixelid: {sentence}", highlight=False))
