"""What every result can do: be read in one screen, be shown in a notebook, go to a folder and come back.

A result says what it found as tables and sentences; how they look on a terminal and in a notebook is written here.
"""

from __future__ import annotations

import textwrap
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, cast

from pixelid.documents import is_number, read_json, read_toml
from pixelid.errors import InputError, shown, spelled
from pixelid.outputs import holds_result, into_folder, whole_folder, write_json
from pixelid.status import Status

if TYPE_CHECKING:
    import pandas as pd  # pyright: ignore[reportMissingTypeStubs]

    from pixelid.inputs import RecordingsLike
    from pixelid.recordings.recording import Recording


@dataclass(frozen=True)
class Table:
    """Formatted cells under headings; columns named in `left` are words, the others numbers."""

    title: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    left: frozenset[str] = frozenset()

    def text(self, most_rows: int | None = None, width: int | None = None) -> str:
        """The table as lines of plain text, columns of words wrapped into `width`; no word is ever broken or cut.

        >>> rows = (("leak.rate_hz", "0.1"), ("alpha", "60 000"))
        >>> print(Table("", ("name", "value"), rows, frozenset({"name"})).text())
        name           value
        leak.rate_hz     0.1
        alpha         60 000
        """
        rows = self.rows if most_rows is None else self.rows[:most_rows]
        widths = [max(len(row[k]) for row in (self.headings, *rows)) for k in range(len(self.headings))]
        if width is not None:
            widths = self._narrowed(rows, widths, width)
        lines = [self.title] if self.title else []
        for row in (self.headings, *rows):
            cells = [
                textwrap.wrap(cell, w, break_long_words=False, break_on_hyphens=False) or [""]
                if len(cell) > w
                else [cell]
                for cell, w in zip(row, widths, strict=True)
            ]
            for each in zip_longest(*cells, fillvalue=""):
                aligned = [
                    cell.ljust(w) if heading in self.left else cell.rjust(w)
                    for cell, w, heading in zip(each, widths, self.headings, strict=True)
                ]
                lines.append("  ".join(aligned).rstrip())
        if len(rows) < len(self.rows):
            lines.append(f"… {len(self.rows) - len(rows)} more")
        return "\n".join(lines)

    def _narrowed(self, rows: Sequence[tuple[str, ...]], widths: list[int], width: int) -> list[int]:
        """Widths of the columns that fit into `width`: the widest gives way, down to its longest word.

        Numbers are broken last, at the dots of an interval, after words and headings.
        """
        widths, columns = list(widths), range(len(self.headings))
        cells = [max((len(row[k]) for row in rows), default=0) for k in columns]
        word = [max(len(part) for row in (self.headings, *rows) for part in (row[k].split() or [""])) for k in columns]
        whole = [word[k] if self.headings[k] in self.left else max(word[k], cells[k]) for k in columns]
        for least in (whole, word):
            while sum(widths) + 2 * (len(widths) - 1) > width:
                wide = max(columns, key=lambda k, least=least: (widths[k] > least[k]) * widths[k])
                if widths[wide] <= least[wide]:
                    break
                widths[wide] -= 1
        return widths


class Result(ABC):
    """A finished computation.

    FILE: the JSON that marks a folder as a result of this kind.  What is needed to go on working with a result is in
    its folder, and the class method `load` of fits, posteriors, gaps, low-light analyses and designs brings it back.
    """

    FILE: ClassVar[str]

    @property
    @abstractmethod
    def headline(self) -> str:
        """One line: of what, from what, how it ended."""

    @abstractmethod
    def as_dict(self) -> dict[str, Any]:
        """The content of the JSON."""

    @abstractmethod
    def tables(self) -> Sequence[Table]:
        """What was found, the most important table first."""

    @abstractmethod
    def records(self) -> list[dict[str, Any]]:
        """The rows of the most important table as numbers, the first key being the row's name."""

    @abstractmethod
    def sentences(self) -> Sequence[str]:
        """Advice and caveats."""

    @abstractmethod
    def write_companions(self, folder: Path) -> None:
        """Write what belongs next to the JSON into an existing folder."""

    def summary(self, width: int | None = None) -> str:
        """Everything found, as the command line prints it; wrapped at words where a width is given."""
        return _text(self.headline, self.tables(), self.sentences(), width=width)

    def to_dataframe(self) -> pd.DataFrame:
        """The most important table as a pandas data frame, indexed by the rows' names."""
        import pandas as pd  # pyright: ignore[reportMissingTypeStubs]

        records = self.records()
        columns = list(dict.fromkeys(name for row in records for name in row))
        frame: Any = pd.DataFrame([[row.get(name) for name in columns] for row in records], columns=columns)
        return frame.set_index(columns[0]) if columns else frame

    def write(self, folder: str | Path) -> None:
        """Write the JSON and what belongs to it into an existing folder, next to what is there."""
        folder = Path(folder)
        write_json(folder / self.FILE, self.as_dict())
        self.write_companions(folder)

    def save(self, folder: str | Path, *, overwrite: bool = False) -> None:
        """Write the result's folder, whole or not at all; nothing is replaced unless `overwrite` is given.

        A folder that holds none of the files is written into, next to what is there.

        Args:
            folder: of the result.
            overwrite: replace the result of pixelid that the folder holds, of whatever kind.

        Raises:
            InputError: a file of this name is there, and is not to be replaced or belongs to no result of pixelid.
        """
        folder = Path(folder)
        if folder.is_dir() and not (overwrite and holds_result(folder)):
            with into_folder(folder) as temporary:
                self.write(temporary)
            return
        with whole_folder(folder, overwrite) as temporary:
            self.write(temporary)

    def write_figures(self, folder: Path, recordings: Sequence[Recording] = ()) -> None:  # noqa: B027
        """Draw what the page shows into an existing folder, if anything; some figures need the recordings."""

    def report(self, folder: str | Path, recordings: RecordingsLike | None = None, *, overwrite: bool = False) -> Path:
        """Write the result's folder with its figures and its page, as the command line does.

        Args:
            folder: of the result.
            recordings: that it was made from, where figures show events; without them these are left out.
            overwrite: replace the result of pixelid that the folder holds.

        Returns:
            The path of the page, report.html.

        Raises:
            InputError: the folder is there and is not to be replaced, or belongs to no result of pixelid.
        """
        from pixelid.inputs import as_recordings
        from pixelid.report.html import write_report

        opened = [] if recordings is None else as_recordings(recordings)
        with whole_folder(Path(folder), overwrite) as temporary:
            self.write(temporary)
            self.write_figures(temporary, opened)
            write_report(temporary)
        return Path(folder) / "report.html"

    def __repr__(self) -> str:
        sentences = list(self.sentences())
        sentences_shown = 4
        hidden = len(sentences) - sentences_shown
        shown = sentences[:sentences_shown] + ([f"… {hidden} more in .summary()"] if hidden > 0 else [])
        rows_shown = 18  # of each table, in a `repr`: with headings and a few sentences one screen of 24 lines
        return _text(self.headline, list(self.tables())[:1], [_cut(s) for s in shown], rows_shown)

    def _repr_html_(self) -> str:
        return html_page(self.headline, list(self.tables())[:1], self.sentences())


@dataclass(frozen=True, repr=False)
class ContentResult(Result):
    """A result that is what its JSON says.

    content: of the JSON (docs/formats.md)
    """

    content: Mapping[str, Any]

    @property
    def status(self) -> Status:
        """How it ended."""
        return Status(self.content["status"])

    def as_dict(self) -> dict[str, Any]:
        """The content of the JSON."""
        return dict(self.content)


@dataclass(frozen=True, repr=False)
class WrittenResult(ContentResult):
    """A result whose files are written as they are made, and that ends in an error where it cannot be made.

    content: of the JSON, with caveats under `notes`
    """

    @property
    def status(self) -> Status:
        """Always converged."""
        return Status.converged

    def sentences(self) -> list[str]:
        """What was assumed or could not be made."""
        return list(self.content["notes"])

    def write_companions(self, folder: Path) -> None:
        """Nothing: they are there."""


def _text(
    headline: str,
    tables: Sequence[Table],
    sentences: Sequence[str],
    most_rows: int | None = None,
    width: int | None = None,
) -> str:
    parts = [wrapped(headline, width), *(table.text(most_rows, width) for table in tables if table.rows)]
    said = "\n".join(wrapped(f"- {spelled(sentence)}", width, "  ") for sentence in sentences if sentence)
    return "\n".join([*parts, said] if said else parts)


def wrapped(text: str, width: int | None, indent: str = "") -> str:
    """The text in lines of at most `width`, broken between words; as it is without a width."""
    if width is None:
        return text
    options: dict[str, Any] = {"break_long_words": False, "break_on_hyphens": False, "subsequent_indent": indent}
    return "\n".join(textwrap.fill(line, max(width, 20), **options) for line in text.splitlines())


def _cut(sentence: str) -> str:
    width_shown = 110
    return sentence if len(sentence) <= width_shown else sentence[: width_shown - 1] + "…"


_HTML = """<div><p><b>{{ headline }}</b></p>
{% for table in tables if table.rows %}<table>{% if table.title %}<caption>{{ table.title }}</caption>{% endif %}
<tr>{% for h in table.headings %}<th style="text-align: {{ "left" if h in table.left else "right" }}">{{ h }}</th>
{%- endfor %}</tr>
{% for row in table.rows %}<tr>{% for cell in row %}
<td style="text-align: {{ "left" if table.headings[loop.index0] in table.left else "right" }}">{{ cell }}</td>
{%- endfor %}</tr>
{% endfor %}</table>
{% endfor %}{% if sentences %}<ul>{% for s in sentences %}<li>{{ s }}</li>{% endfor %}</ul>{% endif %}</div>"""


def html_page(headline: str, tables: Sequence[Table], sentences: Sequence[str] = ()) -> str:
    """A compact fragment for notebooks; every text is escaped."""
    import jinja2

    said = [spelled(sentence) for sentence in sentences if sentence]
    template = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined).from_string(_HTML)
    return template.render(headline=headline, tables=tables, sentences=said)


def number(value: float | None) -> str:
    """Four significant digits, or a dash."""
    return "–" if value is None else f"{value:.4g}"


def interval(limits: Sequence[float | None] | None) -> str:
    """The two limits with dots between, or a dash."""
    return f"{number(limits[0])} … {number(limits[1])}" if limits else "–"


def read_result(folder: str | Path, file: str) -> dict[str, Any]:
    """The JSON of a result folder.

    Raises:
        InputError: the file is missing, or not a JSON object.
    """
    path = Path(folder) / file
    if not path.exists():
        raise InputError(f"{path}: expected the folder of a result, found no such file")
    return read_json(path)


def latency_fit_of(folder: Path) -> tuple[Path, str | None] | None:
    """Where latency.json of a fitted model's folder lies, and which of its cameras the model is; None without one.

    The folder itself for a fit of one camera, which needs no name; for one camera's folder of several, that above.

    Raises:
        InputError: a damaged model file.
    """
    folder = folder.absolute()
    if (folder / "latency.json").is_file():
        return folder, None
    if not ((folder / "model.toml").is_file() and (folder.parent / "latency.json").is_file()):
        return None
    of_latencies = read_toml(folder / "model.toml").get("latency", {})
    camera = cast("dict[str, Any]", of_latencies).get("camera") if isinstance(of_latencies, dict) else None
    return None if camera is None else (folder.parent, str(camera))


def read_unidentified(folder: Path) -> list[str]:
    """What the fit in a folder, of events or of a table, says that it left open; nothing where there is no fit.

    Of the folder of one camera, what the fit of several next to it says of that camera.

    Raises:
        InputError: a damaged result.
    """
    there = [file for file in ("fit.json", "latency.json", "noise.json") if (folder / file).is_file()]
    of_latencies = None if there else latency_fit_of(folder)
    if of_latencies is None:
        return [sentence for file in there for sentence in _left_open(folder, file)]
    above, camera = of_latencies
    return [sentence for sentence in _left_open(above, "latency.json") if sentence.startswith(f"{camera}: ")]


def _left_open(folder: Path, file: str) -> list[str]:
    content = read_result(folder, file)
    check_kinds(content, folder / file, a_list_of_texts=("unidentified",))
    return [str(sentence) for sentence in content["unidentified"]]


def required(content: Mapping[str, Any], folder: str | Path, file: str, *names: str) -> list[Any]:
    """The values of keys that must be there.

    Raises:
        InputError: naming the first that is missing.
    """
    for name in names:
        if name not in content:
            raise InputError(f"{Path(folder) / file}: {name}: missing")
    return [content[name] for name in names]


_KINDS: dict[str, Callable[[Any], bool]] = {
    "text": lambda value: isinstance(value, str),
    "a number": lambda value: number_or_none(value),
    "a list of texts": lambda value: _list_of(value, str),
    "a list of tables": lambda value: _list_of(value, dict),
    "a table": lambda value: isinstance(value, dict),
}


def check_kinds(content: Mapping[str, Any], path: str | Path, **kinds: Sequence[str]) -> None:
    """Check values that are there: kind in words with `_` for blanks → the keys that must be of it.

    Raises:
        InputError: naming the file, the field, what was expected and found.
    """
    for kind, names in kinds.items():
        expected = kind.replace("_", " ")
        for name in names:
            if name in content and not _KINDS[expected](content[name]):
                raise InputError(f"{path}: {name}: expected {expected}, found {shown(content[name])}")


def check_parameters(content: Mapping[str, Any], path: str | Path) -> None:
    """Check the table of parameters of a fit: value, unit, std, interval_95, identified, fixed of each.

    Raises:
        InputError: naming the file, the field, what was expected and found.
    """
    table: Any = content.get("parameters")
    if not isinstance(table, dict) or not _KINDS["a list of tables"](list(cast(dict[str, Any], table).values())):
        raise InputError(
            f"{path}: parameters: expected a table of each by name, found {shown(content.get('parameters'))}"
        )
    for name, entry in cast(dict[str, dict[str, Any]], table).items():
        where = f"{path}: parameters.{shown(name)}"
        ends = entry.get("interval_95")
        numbers = cast(list[Any], ends) if isinstance(ends, list) else []
        if ends is not None and not (len(numbers) == 2 and all(map(number_or_none, numbers))):
            raise InputError(f"{where}.interval_95: expected two numbers, found {shown(entry.get('interval_95'))}")
        if None not in numbers and numbers and numbers[0] > numbers[1]:
            raise InputError(f"{where}.interval_95: expected the lower limit first, found {shown(numbers)}")
        for key in ("value", "std"):
            if not number_or_none(entry.get(key)):
                raise InputError(f"{where}.{key}: expected a number, found {shown(entry[key])}")
        if not isinstance(entry.get("unit", ""), str):
            raise InputError(f"{where}.unit: expected text, found {shown(entry['unit'])}")
        for key in ("identified", "fixed"):
            if not isinstance(entry.get(key, False), bool):
                raise InputError(f"{where}.{key}: expected true or false, found {shown(entry[key])}")


def _list_of(value: Any, kind: type) -> bool:
    return isinstance(value, list) and all(isinstance(entry, kind) for entry in cast(list[Any], value))


def number_or_none(value: object) -> bool:
    """Whether a result's value is a number, or null where there is none."""
    return value is None or is_number(value)
