"""Documents, help, messages and docstrings use the field's words, in sentences that one reads once.

`pixelid/gap` is left out.  Names in backticks, options, arguments and keys may be what they are.
"""

from __future__ import annotations

import ast
import json
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
MOST_WORDS = 40  # of a sentence in a document: about three lines on a page
# Private words, and what the field writes.
INSTEAD = {
    r"told|tells?|telling": "identified, estimated, shows; called with",
    r"besides?": "with, next to, in addition to, compared with",
    r"anew|once more|as ever": "again; independently; re-estimated",
    r"(?:stands?|stood|standing) in for": "is confounded with; replaces",
    r"(?:is|are|be|been|was|were) said": "is stated",
    r"taken back|put right|mend(?:s|ed)?": "removed; corrected",
    r"borne out|astray|hopeless|blindest|unfelt": "supported; far off; least detectable",
    r"disbeliev\w*|disbelief": "down-weighted; outlier",
    r"whoever|thrice": "anyone who; three times",
}
PRIVATE = {re.compile(rf"\b(?:{words})\b", re.IGNORECASE): instead for words, instead in INSTEAD.items()}
NAMES = re.compile(r"`[^`\n]*`|--\w+|\"\w+\"|^\s+\w+(?: \([^)]*\))?:|;  \w+:|\{[^{}]*\}", re.MULTILINE)
ABBREVIATIONS = re.compile(r"\b(e\.g|i\.e|et al|eq|vs)\.")
NOTICES = {"LICENSE.md"}  # words of others


def tracked(*patterns: str) -> list[Path]:
    """Files of the repository that match, and that exist in this checkout."""
    listed = subprocess.run(["git", "ls-files", *patterns], cwd=ROOT, text=True, capture_output=True, check=False)
    paths = [ROOT / line for line in listed.stdout.splitlines()]
    return [path for path in paths if path.exists() and path.name not in NOTICES]


DOCUMENTS = tracked("*.md")
CODE = [path for path in tracked("pixelid/*.py", "docs/*.py") if ROOT / "pixelid" / "gap" not in path.parents]
OTHER = tracked("pixelid/*.html", "pixelid/*captions.toml", "docs/schemas/*.json", "notebooks/*.ipynb")

pytestmark = pytest.mark.skipif(not DOCUMENTS, reason="needs a checkout")


def prose(markdown: str) -> str:
    """A page without its code, equations, comments and addresses."""
    text = re.sub(r"^`{4,}.*$", "\n", markdown, flags=re.MULTILINE)  # containers, whose text is prose
    text = re.sub(r"^(```|~~~)[^`\n]*\n(?:.*?\n)?\1$", "\n\n", text, flags=re.MULTILINE | re.DOTALL)
    text = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
    text = re.sub(r"\$\$.*?\$\$", "equation", text, flags=re.DOTALL)
    text = re.sub(r"\$[^$\n]+\$", "symbol", text)
    return re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", text)


def sentences(text: str) -> Iterator[str]:
    """The sentences of a page: of its paragraphs, its list items, and the cells of its tables."""
    for block in re.split(r"\n\s*\n|^\s*(?:[-*+]|\d+\.|:)\s|^#+ .*$|\n(?=\|)", text, flags=re.MULTILINE):
        parts = block.split("|") if block.lstrip().startswith("|") else [block]
        for part in parts:
            line = ABBREVIATIONS.sub(r"\1", " ".join(part.split()))
            yield from filter(None, re.split(r"(?<=[.!?])[\"')*_]*\s+", line))


def private(text: str) -> list[str]:
    """Each private word of a text, where it stands, with what to write instead."""
    text = NAMES.sub("name", text)
    return [
        f"…{' '.join(text[max(found.start() - 30, 0) : found.end() + 20].split())}…: write {instead}"
        for words, instead in PRIVATE.items()
        for found in words.finditer(text)
    ]


def strings(code: str) -> str:
    """What a module shows: its docstrings, help and messages, none of its names."""
    constants = (node.value for node in ast.walk(ast.parse(code)) if isinstance(node, ast.Constant))
    return "\n".join(text for text in constants if isinstance(text, str) and " " in text)


def shown(path: Path) -> str:
    """The words of a template, a schema or a notebook that someone reads."""
    text = path.read_text()
    if path.suffix == ".ipynb":
        cells = json.loads(text)["cells"]
        return "\n\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown")
    if path.suffix == ".json":
        return "\n".join(re.findall(r'"description": "(.*)"', text))
    return re.sub(r"\{%.*?%\}", " ", text, flags=re.DOTALL)


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_documents(path):
    text = prose(path.read_text())
    assert not private(text)
    assert not [sentence for sentence in sentences(text) if len(sentence.split()) > MOST_WORDS]


def test_help_messages_and_docstrings():
    assert not [(str(path.relative_to(ROOT)), words) for path in CODE for words in private(strings(path.read_text()))]


def test_pages_schemas_and_notebooks():
    assert not [(str(path.relative_to(ROOT)), words) for path in OTHER for words in private(shown(path))]


@pytest.mark.parametrize(
    ("text", "instead"),
    [
        ("The events tell α.", "identified"),
        ("A leak beside noise.", "with"),
        ("Noise is drawn\nanew.", "again"),
        ("A jitter stands in for it.", "confounded"),
        ("More is not said.", None),
        ("What is said of it.", "stated"),
    ],
)
def test_private_words_are_found(text, instead):
    found = private(text)
    assert bool(found) == (instead is not None)
    assert instead is None or instead in found[0]


@pytest.mark.parametrize("text", ["`beside` of it", "pixelid reconstruct --beside blurred", '    beside: "told"'])
def test_names_may_be_what_they_are(text):
    assert not private(text)


def test_long_sentences_are_found():
    """In paragraphs and cells of tables, not in code."""
    words = "word " * MOST_WORDS
    page = f"Short. {words}end.\n\n- {words}\n\n| {words}end. | cell |\n\n```sh\n{words}end\n```\n"
    assert [len(sentence.split()) for sentence in sentences(prose(page))] == [1, 41, 40, 41, 1]


def test_every_page_is_looked_at():
    assert len(DOCUMENTS) > 50
    assert len(CODE) > 400
    assert {path.suffix for path in OTHER} == {".html", ".toml", ".json", ".ipynb"}
