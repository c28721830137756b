"""What a page needs to read values off a drawing and to hide one series of it: marks in the SVG itself.

Artists of a label have ids `series-N.k`, the label's text in a legend `toggle-N.k`; the root has the axes' places and
scales as JSON in `data-axes`.  `report/templates/figures.js` reads both.
"""

from __future__ import annotations

import html
import itertools
import json
import re
from collections import defaultdict
from typing import Any


def mark_series(figure: Any) -> None:
    """Give ids to the artists of every label in the figure's legends.

    An artist without a label belongs to the label of its colour, where only one has it: the line through the points.
    """
    axes_legends = [axis.get_legend() for axis in figure.axes if axis.get_legend() is not None]
    texts = defaultdict(list)
    for text in (text for legend in [*figure.legends, *axes_legends] for text in legend.get_texts()):
        texts[text.get_text()].append(text)
    labels = list(texts) if len(texts) > 1 else []  # of one series nothing is to be hidden
    labelled: dict[str, list[Any]] = defaultdict(list)
    for axis in figure.axes:
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True):
            labelled[label] += _leaves(handle)
    colours = defaultdict(set)
    for label in labels:
        for artist in labelled[label]:
            colours[_colour(artist)].add(label)
    own = {id(artist) for artists in labelled.values() for artist in artists}
    for artist in (a for axis in figure.axes for a in (*axis.lines, *axis.collections, *axis.patches)):
        of = colours.get(_colour(artist), set())
        if id(artist) not in own and len(of) == 1:
            labelled[next(iter(of))].append(artist)
    count = itertools.count()
    for n, label in enumerate(labels):
        for kind, artists in (("series", labelled[label]), ("toggle", texts[label])):
            for artist in artists:
                artist.set_gid(f"{kind}-{n}.{next(count)}")


def _leaves(handle: Any) -> list[Any]:
    """The artists that a legend's handle stands for: of bars and errors each of them."""
    if not isinstance(handle, tuple):  # containers of artists are tuples, and nested ones
        return [handle]
    parts = getattr(handle, "get_children", lambda: handle)()
    return [leaf for part in parts if part is not None for leaf in _leaves(part)]


def _colour(artist: Any) -> str:
    """An artist's colour as text; empty for what has none or several."""
    import matplotlib.colors as mcolors
    import numpy as np

    for name in ("get_color", "get_facecolor", "get_edgecolor"):
        if hasattr(artist, name):
            every = np.atleast_2d(mcolors.to_rgba_array(getattr(artist, name)()))
            if len(every) == 1 and every[0, 3] > 0:
                return mcolors.to_hex(every[0])
    return ""


def readings(figure: Any) -> str:
    """Where the axes of a drawn figure are in its SVG, and how places become values, as JSON for an attribute."""
    width, height = (72.0 * side for side in figure.get_size_inches())
    axes = [axis for axis in figure.axes if axis.axison and axis.get_label() != "<colorbar>"]
    entries = []
    for axis in axes:
        (left, low), (right, high) = axis.get_position().get_points()
        box = [left * width, (1 - high) * height, right * width, (1 - low) * height]
        scales = {"x": _scale(axis.xaxis), "y": _scale(axis.yaxis)}
        if not scales["x"]["label"]:  # panels above each other have one label, below
            same = (other.get_xlabel() for other in axes if other.get_xlim() == axis.get_xlim())
            scales["x"]["label"] = next((" ".join(label.split()) for label in same if label), "")
        entries.append({"box": [round(side, 3) for side in box], **scales})
    return html.escape(json.dumps(entries, ensure_ascii=False), quote=True)


def _scale(axis: Any) -> dict[str, Any]:
    """Limits, scale, label, and the names at ticks that are no numbers."""
    from matplotlib.ticker import FixedLocator

    low, high = (float(end) for end in axis.get_view_interval())
    scale = {"ends": [low, high], "scale": axis.get_scale(), "label": " ".join(axis.get_label_text().split())}
    if scale["scale"] == "symlog":
        scale["linear"] = float(axis.get_transform().linthresh)
    most_names = 60  # ticks of an axis that are names and not numbers
    labels = [text.get_text() for text in axis.get_ticklabels()][:most_names]
    if isinstance(axis.get_major_locator(), FixedLocator) and any(re.search(r"[^\W\d]{2}", label) for label in labels):
        scale["names"] = dict(zip([float(at) for at in axis.get_ticklocs()], labels, strict=False))
    return scale
