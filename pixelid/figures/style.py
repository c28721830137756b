"""The style of every figure: one colour per meaning, one set of sizes, SVG files with text as text.

Drawing functions are called `draw_<what>(…, axes=None)`, are decorated with `styled`, put their artists on the axes
given or on new ones, and return the axes.  Files are written by `save_figure`.

The colours are those of Okabe and Ito (jfly.uni-koeln.de/color), distinguished with every kind of colour blindness; ON
and OFF differ in lightness as well.  `INK` and `PAPER` are neutral: a report replaces them by the colours of its
page, so that a figure reads in the dark too.
"""

from __future__ import annotations

import functools
import io
import re
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numpy as np

from pixelid.figures.interaction import mark_series, readings
from pixelid.figures.words import SUPERSCRIPT

INK, PAPER, MUTED = "#20242b", "#fefefd", "#8b919b"
ON, OFF = "#d55e00", "#0072b2"
IMPROVED, UNEXPLAINED = "#009e73", "#b0578d"
SERIES = ("#009e73", "#b0578d", "#e69f00", "#56b4e9", "#7a6a4f", MUTED)  # none is a polarity's
SEQUENTIAL, DENSITY, CYCLIC = "viridis", "Blues", "twilight"

MOST_WIDTH = 8.6  # inches: a page shows so much without making text smaller than it is

STYLE = {
    "font.size": 9.0, "axes.titlesize": 9.0, "axes.labelsize": 9.0, "xtick.labelsize": 8.0, "ytick.labelsize": 8.0,
    "legend.fontsize": 8.0, "legend.title_fontsize": 8.0, "figure.titlesize": 10.0,
    "axes.spines.top": False, "axes.spines.right": False, "axes.linewidth": 0.7, "axes.titlelocation": "left",
    "axes.edgecolor": INK, "axes.labelcolor": INK, "axes.titlecolor": INK, "text.color": INK,
    "xtick.color": INK, "ytick.color": INK, "axes.facecolor": "none", "figure.facecolor": PAPER,
    "axes.grid": True, "grid.color": MUTED, "grid.alpha": 0.25, "grid.linewidth": 0.5, "axes.axisbelow": True,
    "lines.linewidth": 1.2, "lines.markersize": 4.5, "patch.linewidth": 0.0, "errorbar.capsize": 0.0,
    "legend.frameon": False, "legend.handlelength": 1.5, "image.interpolation": "nearest",
    "axes.formatter.useoffset": False, "axes.unicode_minus": True, "text.parse_math": False,
    "svg.fonttype": "none", "svg.hashsalt": "pixelid", "savefig.dpi": 150.0,
}  # fmt: skip

LEAST_PLAIN, MOST_PLAIN = 1e-3, 1e5  # of ticks that are written without powers of ten

_CONTROL = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\ufffe\uffff]")
Arguments = ParamSpec("Arguments")
Drawn = TypeVar("Drawn")


def styled(draw: Callable[Arguments, Drawn]) -> Callable[Arguments, Drawn]:
    """`draw` under the style of this module, whatever matplotlib is set to otherwise."""

    @functools.wraps(draw)
    def with_style(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Drawn:
        import matplotlib
        from cycler import cycler

        colours = {"axes.prop_cycle": cycler(color=SERIES)}
        with matplotlib.rc_context(STYLE | colours):  # pyright: ignore[reportArgumentType]
            axes = draw(*args, **kwargs)
            _write_powers_plainly(axes)
            shows = matplotlib.is_interactive()
        matplotlib.interactive(shows)  # a notebook turns it on with the first figure, and the style would turn it off
        return axes

    return with_style


def _figure_of(axes: Any) -> Any:
    return np.ravel(np.asarray(axes, dtype=object))[0].figure


def _write_powers_plainly(axes: Any) -> None:
    """Ticks of logarithmic axes as 10⁻³ instead of mathematical markup; as 200 where they span less than two decades.

    Names with a $ in them are just names.
    """
    from matplotlib.ticker import LogFormatterSciNotation, NullFormatter

    class Plain(LogFormatterSciNotation):
        def __call__(self, x, pos=None):  # pyright: ignore[reportIncompatibleMethodOverride]
            text = re.sub(r"[${}]|\\mathdefault", "", super().__call__(x, pos)).replace(r"\times", " × ")
            low, high = (abs(end) for end in self.axis.get_view_interval()) if self.axis else (0.0, 0.0)
            if text and LEAST_PLAIN <= low < high < min(100.0 * low, MOST_PLAIN):
                return f"{x:g}"
            mantissa, power, exponent = text.partition("^")
            return mantissa + exponent.translate(SUPERSCRIPT) if power else text

    for axis in _figure_of(axes).axes:
        for side in (axis.xaxis, axis.yaxis):
            if side.get_scale() in ("log", "symlog") and not isinstance(side.get_major_formatter(), NullFormatter):
                linear = getattr(side.get_transform(), "linthresh", None)
                side.set_major_formatter(Plain(linthresh=linear))
                if side.get_scale() == "log":
                    side.set_minor_formatter(Plain(minor_thresholds=(1.0, 0.4)))


def new_axes(
    rows: int, columns: int, width: float, height: float, *, sharex: bool = False, height_ratios: Any = None
) -> np.ndarray:
    """(rows, columns) axes of a new figure, each `width` × `height` inches on average, no wider than a page."""
    import matplotlib.pyplot as plt

    width = min(width, MOST_WIDTH / columns)
    _, axes = plt.subplots(
        rows, columns, figsize=(width * columns, height * rows), squeeze=False, layout="constrained", sharex=sharex,
        gridspec_kw={"height_ratios": height_ratios} if height_ratios is not None else None,
    )  # fmt: skip
    return axes


def new_axis(width: float = 7.0, height: float = 4.0) -> Any:
    """The one axis of a new figure, in inches."""
    return new_axes(1, 1, width, height)[0, 0]


def new_pairs(rows: int, columns: int, width: float, height: float) -> np.ndarray:
    """(2 rows, columns) axes of a new figure: every second row is the residual panel of the one above.

    Args:
        rows: of pairs.
        columns: of pairs.
        width: of a pair, in inches.
        height: of a pair; the residual panel takes a third of it.
    """
    return new_axes(2 * rows, columns, width, height / 2, height_ratios=(2, 1) * rows)


def finish_pair(top: Any, bottom: Any) -> None:
    """One range of time for both panels, labelled below; chance shaded in the lower one, which shows at least ±4."""
    low, high = bottom.get_ylim()
    bottom.axhspan(-2, 2, color=MUTED, alpha=0.15, linewidth=0)
    bottom.axhline(0.0, color=INK, linewidth=0.6)
    bottom.set_ylim(min(low, -4.0), max(high, 4.0))
    left, right = (f(a, b) for f, a, b in zip((min, max), top.get_xlim(), bottom.get_xlim(), strict=True))
    for axis in (top, bottom):
        axis.set_xlim(left, right)
    top.tick_params(labelbottom=False)


def legend_above(axes: Any, columns: int = 4, title: str = "") -> None:
    """One legend of all panels, each label once, above them, where it covers no data."""
    named: dict[str, Any] = {}
    for axis in np.ravel(np.asarray(axes, dtype=object)):
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True):
            named.setdefault(label, handle)
    figure, width = _figure_of(axes), np.inf
    while named and columns and width > figure.bbox.width:  # as many labels in a row as the figure is wide
        for drawn in list(figure.legends):
            drawn.remove()
        legend = figure.legend(
            named.values(), named, loc="outside upper left", ncols=columns, title=title or None, alignment="left"
        )
        width, columns = legend.get_window_extent().width, columns - 1


def series_colours(count: int) -> list[Any]:
    """`count` colours for series without a meaning of their own; beyond six, ordered ones."""
    if count <= len(SERIES):
        return list(SERIES[:count])
    import matplotlib

    return list(matplotlib.colormaps[SEQUENTIAL](np.linspace(0.0, 0.9, count)))


def save_figure(axes: Any, path: Path) -> Path:
    """Write the figure that `axes` belong to, as SVG by the same bytes every time, and close it; returns the path.

    Args:
        axes: one axis, or an array of them.
        path: ends in `.svg`, or in another format that matplotlib writes.
    """
    import matplotlib
    import matplotlib.pyplot as plt

    figure = _figure_of(axes)
    with matplotlib.rc_context(STYLE), warnings.catch_warnings():  # pyright: ignore[reportArgumentType]
        warnings.filterwarnings("ignore", "Glyph")  # text stays text: the reader's machine has the script
        if path.suffix == ".svg":
            text = io.StringIO()
            mark_series(figure)
            figure.savefig(text, format="svg", metadata={"Date": None})
            drawing = text.getvalue().replace("<svg ", f'<svg data-axes="{readings(figure)}" ', 1)
            path.write_text(without_control_characters(drawing), encoding="utf-8")
        else:
            figure.savefig(path)
    plt.close(figure)
    return path


def without_control_characters(text: str) -> str:
    """`text` without the characters that neither a page nor a drawing may contain; line breaks and tabs stay."""
    return _CONTROL.sub("", text)
