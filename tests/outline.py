"""What a page holds, as the tests of pages ask: nothing left open, nothing from elsewhere, no drawing without words."""

import re
from html.parser import HTMLParser

VOID = {"meta", "input", "img", "br", "link", "hr"}


class Outline(HTMLParser):
    """Tags that do not close, references to anything outside of the page, and drawings without a description."""

    def __init__(self):
        super().__init__()
        self.open, self.outside, self.mute, self.headings = [], [], [], []

    def handle_starttag(self, tag, attrs):
        names = dict(attrs)
        self.outside += [
            v for k, v in attrs if k in ("src", "href", "xlink:href") and re.match(r"(https?:)?//", v or "")
        ]
        if (tag == "svg" and not names.get("aria-label")) or (tag == "img" and not names.get("alt")):
            self.mute.append(tag)
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        while self.open and self.open[-1] != tag and self.open[-1] in ("path", "use", "image", "rect", "line", "stop"):
            self.open.pop()
        assert self.open.pop() == tag

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()


def outline(page: str) -> Outline:
    parser = Outline()
    parser.feed(page)
    return parser


class Texts(HTMLParser):
    """The text of every element of a class, those inside of another left out."""

    def __init__(self, name: str):
        super().__init__()
        self.name, self.open, self.found = name, [], []

    def handle_starttag(self, tag, attrs):
        if not self.open and self.name not in (dict(attrs).get("class") or "").split():
            return
        if not self.open:
            self.found.append("")
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        if self.open:
            while self.open.pop() != tag:
                pass

    def handle_startendtag(self, tag, attrs):
        pass

    def handle_data(self, data):
        if self.open:
            self.found[-1] += data + " "


def texts(page: str, name: str) -> list[str]:
    """The text of every element of a class, blanks evened out."""
    parser = Texts(name)
    parser.feed(page)
    return [" ".join(text.split()) for text in parser.found]
