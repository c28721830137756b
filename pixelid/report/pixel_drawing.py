"""The signal path of a pixel as a drawing: each stage with its numbers, from light to events.

One drawing is as wide as a page, another as a phone; both are SVG in the page's own colours.
"""

from __future__ import annotations

import textwrap
from collections.abc import Collection, Sequence

from markupsafe import Markup, escape

from pixelid.report.quantities import STAGES, Quantity

# Sizes in user units, which are pixels where the drawing has its full width.
WIDE, NARROW = 960, 360  # widths of the two drawings
COLUMNS = dict(zip(STAGES, (144, 162, 150, 184, 160, 160), strict=True))  # widths, as titles and numbers need them
TEXT = 132  # where the text of the narrow one begins
BOX = 138  # width of the frame of an added effect
GLYPH = 104, 60  # of a stage's symbol
TITLE, LINE, GAP = 26, 16, 9  # heights: of a stage's title, of a line of text, between two parameters
LETTERS, NAME = 22, 20  # of a value with its unit, and of a name, that a column holds at full size
ADDED = "added:"
# What each stage does to a signal, drawn in its box: the log of a step that is smoothed, delayed, amplified, compared.
_GLYPHS = {
    "photocurrent": '<circle cx="30" cy="30" r="9"/><path d="M30 13v-6M30 53v-6M13 30h-6M53 30h-6M42 18l4-4M18 42l-4 4'
    'M42 42l4 4M18 18l-4-4"/><path class="thin" d="M62 22h24m-6-5 6 5-6 5M62 38h24m-6-5 6 5-6 5"/>',
    "photoreceptor": '<path class="thin" d="M10 48h84M10 48V10"/><path d="M10 48C18 22 40 16 94 13"/>'
    '<text x="58" y="40">ln L</text>',
    "source_follower": '<path class="thin" d="M10 50h84M10 50V10"/><path d="M10 18h34C62 18 70 26 88 48"/>'
    '<text x="54" y="16">|H|</text>',
    "differencing": '<path class="thin" d="M8 30h22M40 30h18M86 30h10"/><path d="M30 18v24M40 18v24"/>'
    '<path d="M58 14v32l28-16z"/>',
    "comparator": '<path class="thin" stroke-dasharray="3 3" d="M8 14h88M8 46h88"/>'
    '<path d="M8 34 28 14v16L52 46V30L76 14v16l18 8"/>',
    "readout": '<path class="thin" d="M8 30h88"/><path class="on" d="M18 30V12M30 30V12M76 30V12M84 30V12"/>'
    '<path class="off" d="M46 30v18M58 30v18M66 30v18"/>',
}


def draw_pixel(quantities: Sequence[Quantity], added: Collection[str] = (), narrow: bool = False) -> Markup:
    """The pixel's stages in the order in which a signal meets them.

    Args:
        quantities: the parameters, of any stage.
        added: effects that the start model lacked, to be set off.
        narrow: one stage below the other, for phones and paper.

    Returns:
        An SVG element.
    """
    of_stage = {stage: [q for q in quantities if q.stage == stage] for stage in STAGES}
    parts, y = [], 8.0
    if narrow:
        for stage, own in of_stage.items():
            height = max(GLYPH[1], TITLE + sum(_height(q, added) for q in own)) + 16
            parts.append(_stage(stage, own, added, (4, y), (TEXT, y), (TEXT, y + TITLE)))
            if stage != list(STAGES)[-1]:
                parts.append(_arrow(4 + GLYPH[0] / 2, y + GLYPH[1], 4 + GLYPH[0] / 2, y + height))
            y += height
        size = NARROW, y
    else:
        x, middle = 8.0, y + TITLE + GLYPH[1] / 2
        for stage, own in of_stage.items():
            parts.append(_stage(stage, own, added, (x, y + TITLE), (x, y), (x, y + TITLE + GLYPH[1] + 12)))
            if stage != list(STAGES)[-1]:
                parts.append(_arrow(x + GLYPH[0], middle, x + COLUMNS[stage], middle))
            x += COLUMNS[stage]
        tallest = max(sum(_height(q, added) for q in own) for own in of_stage.values())
        size = WIDE, y + TITLE + GLYPH[1] + 12 + tallest + 8
    words = ". ".join(
        f"{STAGES[stage]}: " + ("; ".join(_in_words(q) for q in own) or "no parameters")
        for stage, own in of_stage.items()
    )
    return Markup('<svg class="pixel {}" viewBox="0 0 {} {:.0f}" role="img" aria-label="{}">{}</svg>').format(
        "narrow" if narrow else "wide", *size, f"The signal path of the pixel. {words}.", Markup("").join(parts)
    )


def _stage(
    stage: str,
    own: Sequence[Quantity],
    added: Collection[str],
    glyph: tuple[float, float],
    title: tuple[float, float],
    text: tuple[float, float],
) -> Markup:
    """A stage's symbol, title and parameters, the upper left corners of each given; parameters go downwards."""
    state = "" if any(q.identified or q.fixed for q in own) or not own else " open"
    parts = [
        Markup('<text class="title{}" x="{:g}" y="{:g}">{}</text>').format(
            state, title[0], title[1] + 14, STAGES[stage]
        ),
        Markup(
            '<g class="glyph{}" transform="translate({:g} {:g})"><rect width="{}" height="{}" rx="6"/>{}</g>'
        ).format(state, *glyph, *GLYPH, Markup(_GLYPHS[stage])),
    ]
    text_x, text_y = text
    for q in own:
        parts.append(_parameter(q, q.effect in added, text_x, text_y))
        text_y += _height(q, added)
    return Markup("").join(parts)


def _parameter(q: Quantity, is_added: bool, x: float, y: float) -> Markup:
    """Name, value and interval of one parameter, one below the other."""
    state = "fixed" if q.fixed else "" if q.identified else "not identified"
    letter, index = q.symbol
    symbol = Markup("{}{} = ").format(letter, _index(index)) if letter else Markup("")
    small = " long" if len(f"{letter}{index} = {q.value} {q.unit}") > LETTERS else ""
    value = Markup('<tspan class="value{}">{}{}</tspan> <tspan class="unit">{}</tspan>').format(
        small, symbol, q.value, q.unit
    )
    heading = [escape(line) for line in _heading(q, is_added)]
    if is_added:
        heading[0] = Markup('<tspan class="mark">{}</tspan>{}').format(ADDED, heading[0].removeprefix(ADDED))
    lines = [
        *((line, "name") for line in heading),
        (value, ""),
        (escape(state or q.interval.replace("–", "")), "interval"),
    ]
    box = Markup('<rect class="box" x="{:g}" y="{:g}" width="{}" height="{:g}" rx="4"/>').format(
        x - 6, y - 2, BOX, LINE * len(lines) + 5
    )
    texts = Markup("").join(
        Markup('<text class="{}" x="{:g}" y="{:g}">{}</text>').format(style, x, y + 12 + LINE * i, line)
        for i, (line, style) in enumerate(lines)
    )
    kind = "added" if is_added else "open" if state == "not identified" else ""
    return Markup('<g class="parameter {}"><title>{}</title>{}{}</g>').format(
        kind, _in_words(q), box if is_added else "", texts
    )


def _heading(q: Quantity, is_added: bool) -> list[str]:
    """The lines of a parameter's name; none where its symbol says it all."""
    if q.name == q.symbol[0] and not is_added:
        return []
    return textwrap.wrap(f"{ADDED} {q.name}" if is_added else q.name, NAME)


def _height(q: Quantity, added: Collection[str]) -> float:
    return LINE * (len(_heading(q, q.effect in added)) + 2) + GAP


def _index(index: str) -> Markup:
    if not index:
        return Markup("")
    return Markup('<tspan class="index" dy="3">{}</tspan><tspan dy="-3">\u200b</tspan>').format(index)


def _arrow(x0: float, y0: float, x1: float, y1: float) -> Markup:
    """From one stage's symbol to the next, with a head."""
    head = "-6 -4M0 0 -6 4" if y0 == y1 else "-4 -6M0 0 4 -6"
    return Markup(
        '<path class="wire" d="M{:g} {:g}L{:g} {:g}"/><path class="wire" transform="translate({:g} {:g})" d="M0 0 {}"/>'
    ).format(x0, y0, x1, y1, x1, y1, head)


def _in_words(q: Quantity) -> str:
    if q.fixed:
        return f"{q.label} {q.value} {q.unit}, fixed".replace("  ", " ")
    if not q.identified:
        return f"{q.label}: not identified"
    known = f" ({q.interval})" if q.interval != "–" else ""
    return f"{q.label} {q.value}{known} {q.unit}".strip()
