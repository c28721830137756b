"""Figures inside a page: SVG inline, in the page's own colours and harmless; other pictures as data."""

from __future__ import annotations

import base64
import re
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from markupsafe import Markup

from pixelid.errors import printable
from pixelid.figures.style import INK, OFF, ON, PAPER, without_control_characters

SVG = "http://www.w3.org/2000/svg"
COLOURS = {INK: "var(--ink)", PAPER: "none", ON: "var(--on)", OFF: "var(--off)"}
MOST_BYTES = 20 << 20  # of a picture; those that pixelid draws have less than 1 MiB
DROPPED = ("script", "foreignObject", "iframe", "metadata", "animate", "set", "style")


@dataclass(frozen=True)
class Picture:
    """A figure of a page: its name, its markup, its caption, the name of its file."""

    name: str
    markup: Markup
    caption: str
    file: str


def read_picture(path: Path, caption: str, alt: str) -> Picture:
    """The figure of a file (.svg or .png).

    Args:
        path: the file.
        caption: what to see, under the figure.
        alt: what it shows, for those who do not see it.
    """
    file = printable(path.name)
    if path.suffix != ".svg":
        if path.stat().st_size > MOST_BYTES:
            return Picture(path.stem, Markup("<p>{} is too large for a page.</p>").format(path.name), caption, file)
        data = base64.b64encode(path.read_bytes()).decode()
        markup = Markup('<img alt="{}" src="data:image/png;base64,{}">').format(alt, data)
        return Picture(path.stem, markup, caption, file)
    return Picture(path.stem, _drawn(path, alt), caption, file)


def _drawn(path: Path, alt: str) -> Markup:
    """The drawing of a file, or a sentence that there is none."""
    try:
        if path.stat().st_size > MOST_BYTES:
            raise ValueError("too large")
        return _inline(path.read_text(encoding="utf-8"), path.stem, alt)
    except (ValueError, RecursionError):
        return Markup("<p>{}.svg is not a drawing that can be read.</p>").format(path.stem)


def _inline(text: str, name: str, alt: str) -> Markup:
    """The drawing of a file as an element of the page: no script, no reference to anything outside of it."""
    ElementTree.register_namespace("", SVG)
    ElementTree.register_namespace("xlink", "http://www.w3.org/1999/xlink")
    text = without_control_characters(text)
    try:
        root = ElementTree.fromstring(re.sub(r"<!DOCTYPE[^>]*>", "", text))
    except ElementTree.ParseError:
        return Markup("<p>{}.svg is not a drawing that can be read.</p>").format(name)
    for parent in root.iter():
        for child in list(parent):
            if not isinstance(child.tag, str) or child.tag.rpartition("}")[2] in DROPPED:
                parent.remove(child)
        for key, text_of in list(parent.attrib.items()):
            if _reaches_out(key.rpartition("}")[2].lower(), text_of):
                del parent.attrib[key]
    width = re.sub(r"[^\d.]", "", root.attrib.pop("width", ""))
    root.attrib.pop("height", None)
    root.attrib |= {"role": "img", "aria-label": alt}
    if width:
        root.set("style", f"--natural: {float(width) * 96 / 72 * 1.15:.0f}px")
    markup = ElementTree.tostring(root, encoding="unicode")
    # several drawings share a page: their names for clips and markers must not meet
    prefix = re.sub(r"\W", "_", name)
    markup = re.sub(r'\bid="', f'id="{prefix}-', markup)
    markup = re.sub(r"url\(#", f"url(#{prefix}-", markup)
    markup = re.sub(r'href="#', f'href="#{prefix}-', markup)
    for colour, variable in COLOURS.items():
        markup = re.sub(re.escape(colour), variable, markup, flags=re.IGNORECASE)
    return Markup(markup)


def _reaches_out(attribute: str, value: str) -> bool:
    """Whether an attribute runs a script or names anything outside of the drawing."""
    if attribute.startswith("on"):
        return True
    if attribute == "href":
        return not value.startswith(("#", "data:image/"))
    return "url(" in value and not re.search(r"url\(\s*['\"]?#", value)
