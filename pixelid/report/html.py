"""A result folder as one self-contained page: the kind of result by its JSON, a template, figures inside.

Nothing is loaded from anywhere: styles and drawings are in the page, and its content security policy forbids the rest.
Text of the result is escaped, and control characters (also those that turn the direction of text) are left out.
"""

from __future__ import annotations

import itertools
import re
import tomllib
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any

from markupsafe import Markup, escape

from pixelid import provenance
from pixelid.documents import interpreting, read_json
from pixelid.errors import InputError, printable
from pixelid.figures.style import without_control_characters
from pixelid.outputs import whole_file
from pixelid.report import format as formats
from pixelid.report.circuit import downloads
from pixelid.report.methods import bibtex
from pixelid.report.page import Page, recorded_command
from pixelid.report.pages import PAGES
from pixelid.report.pictures import Picture, read_picture
from pixelid.report.quantities import NAMES, name_of, quantity, with_index
from pixelid.report.scripts import script
from pixelid.results import check_parameters
from pixelid.stages import LIBRARY
from pixelid.status import Status

TEMPLATES = Path(__file__).parent / "templates"
CAPTIONS = Path(__file__).parent / "captions.toml"
GREEK = ("alpha", "beta", "gamma")  # written as letters; other names of letters alone are words already
_HEADING = re.compile(r'<h2(?: id="([^"]+)")?>(.*?)</h2>', re.DOTALL)
LINKED = (".json", ".toml", ".nc", ".npz", ".csv", ".h5")


def write_report(folder: Path, command: str | None = None) -> Path:
    """Write report.html of a result folder from its JSON and figures, and the command that made it.

    Args:
        folder: of any result: fit, gap, lowlight, design, rates, flicker, reconstruct, inspect, compare, sensor.
        command: the command line that made the result, kept next to it; by default the one that runs, if one does.
            Empty: what is kept already stays.

    Returns:
        The path of the page.

    Raises:
        InputError: when the folder holds no result.
    """
    folder = Path(folder)
    page = next((page for page in PAGES if (folder / page.file).is_file()), None)
    if page is None:
        known = ", ".join(page.file for page in PAGES)
        raise InputError(f"{folder}: none of {known}; expected the folder of a result")
    if (folder / "report.html").is_symlink():
        raise InputError(f"{folder / 'report.html'}: expected the page of this folder, found a link to another file")
    result = read_json(folder / page.file)
    if page.file in ("fit.json", "rates.json", "latency.json"):
        check_parameters(result, folder / page.file)
    command = provenance.command() if command is None else command
    if command and not (folder / provenance.COMMAND_FILE).is_symlink():
        with whole_file(folder / provenance.COMMAND_FILE, overwrite=True) as path:
            path.write_text(command + "\n", encoding="utf-8")
    text = render(page, result, folder)
    with whole_file(folder / "report.html", overwrite=True) as path:
        path.write_text(text, encoding="utf-8")
    return folder / "report.html"


def render(page: Page, result: dict[str, Any], folder: Path) -> str:
    """The page of a result as text.

    Raises:
        InputError: the result lacks what the page shows, or has it of another kind.
    """
    import jinja2

    file, kind = folder / page.file, f"what {page.template.removesuffix('.html')} results hold (docs/formats.md)"
    with interpreting(file, kind):
        try:
            return _rendered(page, result, folder)
        except jinja2.UndefinedError as error:
            raise LookupError(error.message) from error


def _rendered(page: Page, result: dict[str, Any], folder: Path) -> str:
    import jinja2

    named = partial(with_names, known=[*LIBRARY, *Status, *_parameters(result)])
    ids = itertools.count(1)
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["with_contents"] = with_contents
    shown = {"result": result, **page.prepare(result, folder)}
    pictures = _pictures(page, folder, partial(_caption, environment, shown))
    environment.globals |= {
        "number": formats.number,
        "value": formats.value,
        "interval": formats.interval,
        "percent": formats.percent,
        "chance": formats.chance,
        "sentence": lambda text, capital=True: with_code(formats.sentence(named(text), capital)),
        "with_powers": lambda cell: cell if isinstance(cell, Markup) else formats.with_powers(str(cell)),
        "quantity": quantity,
        "with_index": with_index,
        "counted": formats.counted,
        "unique": lambda: f"rows-{next(ids)}",
        "take": lambda name: pictures.pop(name, None),
        "has": lambda name: name in pictures,
        "has_figures": bool(pictures),
        "recorded": bool(recorded_command(folder)),
        "summary": page.summarise(result, folder),
        "files": sorted(printable(path.name) for path in folder.iterdir() if path.suffix in LINKED and path.is_file()),
        "others": (),
        "scripts": [script("page"), script("figures")],
        "downloads": downloads(folder, page.file),
        "bibtex": bibtex(shown["result"]),
        "methods": "",
        "next_sentence": "",
        **shown,
    }
    # figures that the template does not name come at its end: the first rendering says which are left
    template = environment.get_template(page.template)
    every = dict(pictures)
    template.render()
    left = list(pictures.values())
    pictures.update(every)
    ids = itertools.count(1)
    return without_control_characters(template.render(others=left))


def with_code(text: str) -> Markup:
    """A text as HTML, with what stands in backticks as code, and powers raised.

    >>> str(with_code("see `pixelid gap` & <more>")), str(with_code("β × k^-0.25"))
    ('see <code>pixelid gap</code> &amp; &lt;more&gt;', 'β × k<sup>−0.25</sup>')
    """
    raised = re.sub(r"\^(-?)([\d.]*\d)", lambda m: f"<sup>{'−' * len(m[1])}{m[2]}</sup>", str(escape(text)))
    return Markup(re.sub(r"`([^`]+)`", r"<code>\1</code>", raised))


def with_names(text: object, known: Iterable[str]) -> str:
    """A sentence with names in place of the parameters and effects in it, except in backticks and options.

    >>> with_names("leak.rate_hz and `leak.rate_hz`, dead_time_s[fo 1477]", ["leak.rate_hz", "dead_time_s[fo 1477]"])
    'leak and `leak.rate_hz`, dead time, fo 1477'
    """
    spelled = sorted((name for name in known if not name.isalpha() or name in GREEK), key=len, reverse=True)
    if not spelled:
        return str(text)
    either = "|".join(map(re.escape, spelled))
    words = {*LIBRARY, *Status}
    names = {name: name.replace("_", " ") if name in words else name_of(name) for name in spelled}
    return re.sub(rf"`[^`]*`|(?<![\w.\[-])(?:{either})(?![\w\[=]|\.\w)", lambda m: names.get(m[0], m[0]), str(text))


def _parameters(result: dict[str, Any]) -> list[str]:
    """The names of a result's parameters, and of those that its circuit may have."""
    own = result.get("parameters")
    of_effects = [p.name for effect in LIBRARY.values() for p in effect.parameters]
    return [*(own if isinstance(own, dict) else ()), *of_effects, *NAMES]


def with_contents(body: str) -> Markup:
    """The body of a page whose headings can be linked to, under a list of them where there are many.

    >>> str(with_contents("<h2>One & all</h2>"))
    '<h2 id="one-all">One & all</h2>'
    """
    named = _HEADING.sub(lambda m: m[0] if m[1] else f'<h2 id="{_anchor(m[2])}">{m[2]}</h2>', body)
    links = [f'<a href="#{name}">{title}</a>' for name, title in _HEADING.findall(named)]
    contents = 4  # headings from which a page lists them
    return Markup((f'<nav aria-label="Contents">{" ".join(links)}</nav>' if len(links) >= contents else "") + named)


def _anchor(title: str) -> str:
    return re.sub(r"\W+", "-", re.sub(r"<[^>]*>|&\w+;", "", title).lower()).strip("-")


def _caption(environment: Any, shown: dict[str, Any], caption: str, path: Path) -> str:
    """A caption, of what its drawing has: it is a template over the page's names and the text of the drawing."""
    drawing = path.read_text(encoding="utf-8", errors="replace") if path.suffix == ".svg" else ""
    return environment.from_string(caption).render(shown, drawing=drawing).strip()


def _pictures(page: Page, folder: Path, caption: Callable[[str, Path], str]) -> dict[str, Picture]:
    # a link would put a file of this computer into a page that is handed on
    found = [path for path in sorted(folder.iterdir()) if path.is_file() and not path.is_symlink()]
    files = {path.stem: path for suffix in (".png", ".svg") for path in found if path.suffix == suffix}
    every = tomllib.loads(CAPTIONS.read_text(encoding="utf-8"))
    captions = every.get(page.like, {}) | every.get(Path(page.file).stem, {})
    pictures = {}
    for name, path in files.items():
        shown = printable(name)
        words = captions.get(name)
        name_only = shown.replace("_", " ")
        said = (caption(words["caption"], path), words["alt"]) if words else (name_only, f"Figure: {name_only}")
        pictures[name] = read_picture(path, *said)
    return pictures
