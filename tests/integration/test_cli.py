"""The command line: instant help, plain refusals, and the listing of circuits."""

import importlib.util
import json
import os
import subprocess
import sys

import click
import pytest

from pixelid.cli import main as command_line
from pixelid.cli.main import COMMANDS, main
from pixelid.errors import UntrustworthyResult
from pixelid.model.files import save_model
from pixelid.model.shipped import find_model, shipped_models

HEAVY = {
    "torch",
    "casadi",
    "numba",
    "matplotlib",
    "scipy",
    "numpy",
    "arviz_base",
    "arviz_stats",
    "emcee",
    "pandas",
    "h5py",
    "faery",
}
PRESENT = [name for name in COMMANDS if importlib.util.find_spec(f"pixelid.cli.{name}_command")]


@pytest.mark.parametrize("words", [[], *([name] for name in PRESENT)], ids=" ".join)
def test_help_imports_nothing_heavy(words):
    code = (
        "import sys\n"
        "from pixelid.cli.main import main\n"
        f"code = main({[*words, '--help']!r})\n"
        "print(*sorted(name for name in sys.modules if '.' not in name), file=sys.stderr)\n"
        "sys.exit(code)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "Usage: pixelid" in done.stdout
    assert not HEAVY & set(done.stderr.split())


@pytest.mark.parametrize("name", PRESENT)
def test_help_shows_an_example_of_the_command(name, capsys):
    assert main([name, "--help"]) == 0
    printed = capsys.readouterr().out
    assert f"pixelid {name}" in printed.partition("Example:")[2]
    assert {"--seed", "--quiet"} <= {option for p in _command(name).params for option in p.opts}


def _command(name: str) -> click.Command:
    command = command_line.cli.get_command(click.Context(command_line.cli), name)
    assert command is not None
    return command


def test_every_listed_command_is_there(capsys):
    assert main(["--help"]) == 0
    printed = capsys.readouterr().out
    for name in COMMANDS:
        assert f"  {name} " in printed


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["develop"], "no command 'develop'; known: check, calibrate, models"),
        (["models", "--colour"], "--colour"),
        (["models", "dvs128", "ideal"], "unexpected extra argument"),
        (["convert", "one.h5"], "Missing argument"),
        (["models", "--seed", "x"], "'x' is not a valid integer"),
        (["models", "--seed", "-1"], "--seed"),
        (["gap", "a.h5", "--model", "dvs128", "--out", "o", "--alpha", "nan"], "--alpha': expected a number above 0"),
        (["gap", "a.h5", "--model", "dvs128", "--out", "o", "--alpha", "0.7"], "found 0.7"),
        (["design", "dvs128", "--out", "o", "--spread", "inf"], "--spread"),
        (["reconstrukt"], "(did you mean 'reconstruct'?)"),
        (["models", "dvs129"], "(did you mean 'dvs128'?)"),
        (["simulate", "dvs128", "--stimulus", "chrip", "--out", "o.h5"], "(did you mean 'chirp'?)"),
        (["simulate", "dvs128", "--stimulus", "chirp", "--out", "o.h5", "--with", "leek"], "(did you mean 'leak'?)"),
        (["simulate", "dvs128", "--stimulus", "chirp", "--out", "o.h5", "--set", "alpa=1"], "(did you mean 'alpha'?)"),
        (["models", "dvs129"], "no model 'dvs129': expected a .toml file, a fit folder, or one of dvs128"),
    ],
)
def test_wrong_usage_is_one_plain_line(words, says, capsys):
    assert main(words) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("pixelid: ")
    assert printed.err.count("\n") == 1
    assert says in printed.err


def test_no_command_shows_the_commands(capsys):
    assert main([]) == 2
    printed = capsys.readouterr()
    assert (printed.out + printed.err).startswith("Usage: pixelid")


@pytest.mark.parametrize(
    ("error", "code", "says"),
    [
        (KeyboardInterrupt(), 130, "stopped; nothing is left half written; the same command starts again"),
        (UntrustworthyResult("no optimum", "start elsewhere"), 1, "no optimum"),
        (MemoryError(), 2, "not enough memory"),
        (PermissionError(13, "Permission denied", "models"), 2, "models: Permission denied"),
        (ZeroDivisionError("division by zero"), 1, "unexpected ZeroDivisionError: division by zero; this is a bug"),
        (RuntimeError("two\nlines"), 1, "unexpected RuntimeError: two lines"),
    ],
)
def test_interruption_and_distrust_have_their_exit_codes(error, code, says, monkeypatch, capsys):
    def stop():
        raise error

    monkeypatch.setattr("pixelid.model.shipped.shipped_models", stop)
    assert main(["models"]) == code
    printed = capsys.readouterr().err
    assert says in printed
    assert printed.strip().count("\n") == 0


def test_a_bug_shows_where_it_is_when_asked(monkeypatch, capsys):
    def stop():
        raise RuntimeError("a bug")

    monkeypatch.setattr("pixelid.model.shipped.shipped_models", stop)
    monkeypatch.setenv("PIXELID_DEBUG", "1")
    assert main(["models"]) == 1
    assert "Traceback" in capsys.readouterr().err


@pytest.mark.parametrize("locale", [{"LC_ALL": "C"}, {"LC_ALL": "C", "PYTHONUTF8": "0"}, {"PYTHONIOENCODING": "ascii"}])
def test_units_are_printed_whatever_the_locale(locale):
    done = subprocess.run([sys.executable, "-m", "pixelid", "models", "dvs128"], capture_output=True,
                          env={**os.environ, "COLUMNS": "300", **locale})  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "1/s²/fA" in done.stdout.decode()


def test_names_are_printed_whole(capsys):
    from pixelid.cli.terminal import say
    from pixelid.results import Table

    name = "delay_s[led_uart_3125hz_30m_with_a_very_long_name_that_goes_on_beyond_any_terminal_of_eighty_columns]"
    say(Table("", ("name", "value"), ((name, "1"),), frozenset({"name"})).text())
    assert name in capsys.readouterr().out


def test_the_installed_program_ends_with_the_exit_code():
    done = subprocess.run([sys.executable, "-m", "pixelid", "models", "dvs129"], capture_output=True, text=True)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr


def test_a_missing_file_is_refused_before_anything_slow_is_imported(tmp_path):
    words = (
        "fit no.h5 --model dvs128 --out o", "gap no.h5 --model dvs128 --out o", "sensor no.h5 --model dvs128 --out o",
        "inspect no.h5", "convert no.h5 o.h5", "flicker no.h5 --out o", "simulate no --stimulus chirp --out o.h5",
        "design dvs128 --recorded no.h5 --out o", "lowlight no --out o", "reconstruct no --out o",
        "fit no.toml --out o",
    )  # fmt: skip
    script = (
        "import sys\nfrom pixelid.cli.main import main\n"
        f"print([main(line.split()) for line in {words!r}])\n"
        "print([name for name in ('torch', 'numba', 'casadi', 'scipy.optimize', 'matplotlib') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, cwd=tmp_path)
    assert done.stdout.splitlines() == [str([2] * len(words)), "[]"], done.stdout + done.stderr


def test_version(capsys):
    from pixelid import __version__

    assert main(["--version"]) == 0
    assert __version__ in capsys.readouterr().out


# --- models -----------------------------------------------------------------------------------------------------


def test_models_lists_the_shipped_circuits(capsys):
    assert main(["models", "--quiet"]) == 0
    assert capsys.readouterr().out.split() == sorted(shipped_models())
    assert main(["models"]) == 0
    printed = capsys.readouterr().out
    for name in shipped_models():
        assert name in printed


@pytest.mark.parametrize("name", sorted(shipped_models()))
def test_one_model_in_full(name, capsys):
    assert main(["models", name, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["model"]["name"] == name
    assert main(["models", name]) == 0
    printed = capsys.readouterr().out
    assert name in printed
    for parameter in document["parameters"]:
        assert parameter in printed


def test_values_of_described_effects_fit_into_80_columns(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    values = {"strength": 0.1234, "exponent": 0.5678, "reference": 81.23}
    save_model(
        find_model("dvs128").with_effect("described.on_threshold.radiance.power", values), tmp_path / "model.toml"
    )
    assert main(["models", str(tmp_path / "model.toml")]) == 0
    printed = capsys.readouterr().out
    for value in values.values():
        assert f" {value:g} " in printed


@pytest.mark.parametrize("name", ["dvs128", "gen31"])
def test_a_model_fits_in_eighty_columns(name, capsys, monkeypatch):
    """Where values come from took the last two columns there, letter below letter."""
    monkeypatch.setenv("COLUMNS", "80")
    assert main(["models", name]) == 0
    lines = capsys.readouterr().out.splitlines()
    rows = [line for line in lines if line.startswith(("│", "┃"))]
    assert max(map(len, lines)) <= 80
    assert all(line.endswith(("│", "┃")) for line in rows)
    assert len(rows) < 100
    for parameter in find_model(name).parameters.values():
        assert any(parameter.name in line and f"{parameter.value:.6g}" in line for line in rows)


def test_a_model_shows_units_and_gauge(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "300")
    assert main(["models", "dvs128"]) == 0
    printed = capsys.readouterr().out
    for word in ("1/s²/fA", "Hz", "0.7 A_amp", "second_order", "[physical]"):
        assert word in printed
