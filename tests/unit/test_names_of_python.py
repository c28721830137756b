"""Python has what the command line has, under the same names; the table in the documents is made of these names."""

import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"
pytestmark = pytest.mark.skipif(not (DOCS / "names.py").exists(), reason="needs a checkout")
ISSUED = {
    "inspect", "check", "calibrate", "convert", "align", "crop", "compare", "sensor", "rates", "latency", "flicker",
    "noise", "biases", "conform", "export", "dataset", "render", "report",
}  # fmt: skip


@pytest.fixture
def names(monkeypatch):
    monkeypatch.syspath_prepend(DOCS)
    import names  # pyright: ignore[reportMissingImports]

    yield names
    sys.modules.pop("names")


def test_python_and_the_command_line_have_the_same_names(names):
    assert names.apart() == []


def test_what_drifts_apart_is_found(names, monkeypatch):
    import pixelid

    def rates(source, *, unit=None, other=None):
        """Lacks two options, and has one more."""

    monkeypatch.setattr(pixelid, "rates", rates)
    monkeypatch.setitem(names.OWN, ("fit", "seed"), "`seeds`")
    assert sorted(names.apart()) == [
        "('fit', 'seed'): agrees under its own name",
        "pixelid rates --bias_law: no parameter of pixelid.rates",
        "pixelid rates --data: no parameter of pixelid.rates",
        "pixelid.rates(other=…): no option of pixelid rates",
    ]


def test_the_table_has_every_command(names):
    from pixelid.cli.main import COMMANDS

    text = names.page()
    assert all(f"| `pixelid {name}` |" in text for name in COMMANDS)


def test_every_function_that_was_asked_for_is_there_and_documented(monkeypatch):
    import pixelid

    assert set(pixelid.__all__) >= ISSUED
    pytest.importorskip("sphinx")
    monkeypatch.syspath_prepend(DOCS)
    import reference  # pyright: ignore[reportMissingImports]

    assert set(reference.NAMES) == set(pixelid.__all__)
