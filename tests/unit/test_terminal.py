"""What a terminal shows: lines that fit, whole words, a coloured verdict, the page's path, and what Ctrl-C leaves."""

import re
from pathlib import Path

import pytest

import pixelid as px
from pixelid.cli import terminal
from pixelid.cli.main import COMMANDS, main
from pixelid.interruption import keeping, sentence
from pixelid.results import Table, wrapped

ROWS = (
    (
        "photoreceptor",
        "parasitic_photocurrent",
        "it would show here at its typical strength, and nothing of it is seen",
    ),
    ("differencing_amplifier", "leak", "held-out pixels gain 21 nats"),
)
TABLE = Table("", ("stage", "effect", "why"), ROWS, frozenset({"stage", "effect", "why"}))


@pytest.mark.parametrize("width", [60, 80, 100])
def test_tables_fit_and_break_between_words_only(width):
    lines = TABLE.text(width=width).splitlines()
    assert max(map(len, lines)) <= width
    words = " ".join(lines).split()
    for row in ROWS:
        for cell in row:
            assert set(cell.split()) <= set(words)
    assert sorted(words) == sorted(" ".join([*TABLE.headings, *(" ".join(row) for row in ROWS)]).split())


def test_tables_without_a_width_or_with_too_little_stay_whole():
    assert len(TABLE.text().splitlines()) == 3
    assert "parasitic_photocurrent" in TABLE.text(width=10)
    numbers = Table("", ("name", "value"), (("a", "1.234567"),), frozenset({"name"}))
    assert "1.234567" in numbers.text(width=3)


def test_sentences_are_wrapped_between_words():
    text = "- " + "identified strengths of parasitic_photocurrent.rate_hz_per_radiance " * 4
    lines = wrapped(text, 60, "  ").splitlines()
    assert max(map(len, lines)) <= 60
    assert all(line.startswith("  ") for line in lines[1:])
    assert " ".join(" ".join(lines).split()) == " ".join(text.split())
    assert wrapped(text, None) == text


@pytest.mark.parametrize(("word", "code"), [("converged", "32"), ("not_converged", "31"), ("misfit", "33")])
def test_the_verdict_is_coloured_on_a_terminal_only(word, code, monkeypatch):
    line = f"fit of dvs128: {word}; 9 events"
    assert terminal.coloured(line) == line
    monkeypatch.setattr("sys.stdout.isatty", lambda: True, raising=False)
    monkeypatch.delenv("NO_COLOR", raising=False)
    assert re.search(rf"\x1b\[{code}m\x1b\[1m{word}\x1b\[0m", terminal.coloured(line))
    monkeypatch.setenv("NO_COLOR", "1")
    assert terminal.coloured(line) == line


def test_every_command_that_writes_a_page_says_where_it_is():
    folder = Path(terminal.__file__).parent
    for name in COMMANDS:
        text = (folder / f"{name}_command.py").read_text()
        if "write_report" in text and name != "inspect":
            assert re.search(r"say_result\(|say_page\(|report\.html'|say\(str\(path\)\)", text), name


def test_a_result_ends_with_its_page(tmp_path, capsys):
    assert main(["lowlight", "dvs128", "--out", str(tmp_path / "low")]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == str(tmp_path / "low" / "report.html")


def test_models_are_one_line_each(capsys):
    assert main(["models"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[:-1]] == ["dvs128", "dvs128_low_light", "gen31", "ideal", "imx636",
                                                        "photoreceptor"]  # fmt: skip


def test_simulators_are_named_in_any_case(tmp_path, capsys):
    assert main(["export", "dvs128", "--to", "V2E", "--out", str(tmp_path / "a.txt"), "--quiet"]) == 0


def test_an_interruption_says_what_is_kept(tmp_path):
    assert sentence().endswith("half written; the same command starts again")
    fits = tmp_path / ".gap.fits"

    def stopped() -> str:
        with pytest.raises(KeyboardInterrupt), keeping(fits, "fits"):
            raise KeyboardInterrupt
        return sentence()

    assert stopped().endswith("the same command starts again")  # nothing made yet
    fits.write_text("a\nb\nc\n")
    assert stopped().endswith("half written; 3 fits kept: the same command goes on from there")
    with keeping(fits, "fits"):
        pass
    assert sentence().endswith("the same command starts again")
    tiles = tmp_path / "out.tiles"
    tiles.mkdir()
    for name in ("problem.json", "0.npz", "1.npz"):
        (tiles / name).touch()
    with pytest.raises(KeyboardInterrupt), keeping(tiles, "tiles"):
        raise KeyboardInterrupt
    assert "2 tiles kept" in sentence()


def test_corner_plots_have_histograms_on_their_diagonal():
    import matplotlib.pyplot as plt
    import numpy as np

    from pixelid.fit.coordinates import Coordinates
    from pixelid.sample.figures import draw_corner

    model = px.find_model("ideal")
    names = ("on_threshold", "off_threshold")

    class Draws:
        coordinates = Coordinates.of(model.fix({name: None for name in model.free if name not in names}))

        def values(self):
            rng = np.random.default_rng(0)
            return {name: rng.normal(0.25, 0.01, 500) for name in names}

    axes = draw_corner(Draws())
    for axis in np.diag(axes):
        (histogram,) = (patch for patch in axis.patches if len(patch.get_xy()) > 10)
        assert histogram.get_linewidth() > 0.5
    plt.close(axes[0, 0].figure)


def test_numbers_and_headings_break_where_words_do_not_suffice():
    rows = (("alpha", "1216 … 3.089e+06", "6.127e+04 … 6.131e+04", "1/s²/fA"),)
    table = Table(
        "", ("parameter", "95 % interval before", "95 % interval after", "unit"), rows, frozenset({"parameter"})
    )
    for width, lines in ((60, 3), (40, 4)):
        text = table.text(width=width)
        assert max(map(len, text.splitlines())) <= width
        assert len(text.splitlines()) <= lines + 2
        assert {"1216", "3.089e+06", "6.131e+04", "1/s²/fA"} <= set(text.split())
    assert "6.127e+04 … 6.131e+04" in table.text(width=60)  # headings give way first


def test_an_answer_without_a_verdict_in_it_has_the_colour_of_its_status(monkeypatch):
    monkeypatch.setattr("sys.stdout.isatty", lambda: True, raising=False)
    monkeypatch.delenv("NO_COLOR", raising=False)
    assert terminal.coloured("Usable: 11 of 11 parameters identified", "converged").startswith("\x1b[32m\x1b[1mUsable")
    assert terminal.coloured("words", "") == "words"
