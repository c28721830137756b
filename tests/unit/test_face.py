"""What `import pixelid` shows: a dozen names, quick, in every import order, and forgiving about what they are given."""

import doctest
import importlib
import inspect
import pickle
import pydoc
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path
from unittest import mock

import numpy as np
import pytest

import pixelid as px
from pixelid.errors import Doubtful, InputError, did_you_mean
from pixelid.inputs import as_model, as_recordings, as_stimulus
from pixelid.outputs import refuse_existing
from pixelid.recordings import Events, Recording, write_recording

NAMES = {
    "check", "calibrate", "open", "find_model", "simulate", "fit", "sample", "gap", "lowlight", "design",
    "reconstruct", "load_field", "align", "convert", "crop", "inspect", "stimulus", "biases", "view", "compare",
    "sensor", "rates", "latency", "flicker", "noise", "conform", "export", "dataset", "render", "report",
    "Model", "Recording", "Stimulus", "Status",
}  # fmt: skip
SUBPACKAGES = (
    "fit", "sample", "gap", "lowlight", "design", "simulate", "biases", "compare", "conform", "export", "report",
)  # fmt: skip


def test_the_names():
    assert set(px.__all__) == NAMES
    assert set(dir(px)) == NAMES | {"__version__"}
    for name in NAMES:
        assert callable(getattr(px, name))
    with pytest.raises(AttributeError, match="has no attribute 'fitt'"):
        _ = px.fitt  # pyright: ignore[reportAttributeAccessIssue]


def test_importing_loads_nothing_heavy():
    code = "import sys, pixelid; print(*sorted(m for m in sys.modules if '.' not in m))"
    loaded = set(subprocess.check_output([sys.executable, "-c", code], text=True).split())
    assert not loaded & {"numpy", "scipy", "numba", "torch", "casadi", "matplotlib", "pandas", "arviz"}


ORDERS = {
    "subpackage first": "import pixelid.fit.fit; import pixelid as px; f = px.fit",
    "face first": "import pixelid as px; f = px.fit; import pixelid.fit.fit; assert px.fit is f",
    "from the package": "from pixelid import fit as f; import pixelid.fit.result",
    "subpackage by another name": "import pixelid.fit as f",
    "module by another name": "import pixelid.fit.result as r; assert r.FitResult; from pixelid import fit as f",
    "dotted use": "import pixelid.fit.result; assert pixelid.fit.result.FitResult; f = pixelid.fit",
    "star": "from pixelid import *; f = fit",
    "inner function": "from pixelid.fit import fit as inner; from pixelid import fit as f; assert inner is not f",
}


@pytest.mark.parametrize("order", ORDERS)
def test_fit_is_the_function_in_every_import_order(order):
    check = (
        "\nimport sys, types, pixelid.api"
        "\nassert f is pixelid.api.fit, f"
        "\nimport pixelid.fit.result"
        "\nassert f.FitResult is sys.modules['pixelid.fit'].FitResult"
        "\nassert isinstance(sys.modules['pixelid.fit'], types.ModuleType)"
        "\ntry: f(3, 'dvs128')"
        "\nexcept pixelid.api.InputError: print('called')"
    )
    code = ORDERS[order] + check
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout == "called\n", done.stderr


@pytest.mark.parametrize("name", SUBPACKAGES)
def test_functions_are_documented_pickled_and_patched_like_any_other(name, monkeypatch):
    function = getattr(px, name)
    assert "Args:" in inspect.getdoc(function)
    assert "Returns:" in inspect.getdoc(function)
    assert name in ("export", "report") or "progress" in inspect.signature(function).parameters
    assert pickle.loads(pickle.dumps(function)) is function
    assert inspect.isfunction(function)
    printed = pydoc.render_doc(function, renderer=pydoc.plaintext)
    for parameter in inspect.signature(function).parameters:
        assert f"{parameter}: " in printed.partition("Args:")[0]  # in the line of the signature
    with mock.patch(f"pixelid.{name}", return_value=7):
        assert getattr(px, name)() == 7
    assert getattr(px, name) is function
    importlib.import_module(f"pixelid.{name}")
    monkeypatch.setattr(f"pixelid.{name}.anything", "patched", raising=False)
    assert sys.modules[f"pixelid.{name}"].anything == "patched"


def test_examples():
    import pixelid.api
    import pixelid.api_models
    import pixelid.api_recordings
    import pixelid.errors
    import pixelid.model.model
    import pixelid.recordings.recording
    import pixelid.recordings.selection
    import pixelid.results

    homes = (pixelid.api, pixelid.api_models, pixelid.api_recordings, pixelid.errors, pixelid.results,
             pixelid.recordings.selection, pixelid.recordings.recording, pixelid.model.model)  # fmt: skip
    for home in homes:
        tried = doctest.testmod(home)
        assert tried.attempted > 0
        assert tried.failed == 0, home


# --- what is accepted -------------------------------------------------------------------------------------------


@pytest.fixture
def folder(tmp_path) -> Path:
    for name in ("a", "b"):
        write_recording(Recording(Events.empty(2, 2), condition=name), tmp_path / f"{name}.h5")
    return tmp_path


def test_open(folder):
    one = px.open(folder / "a.h5")
    assert isinstance(one, Recording)
    assert one.condition == "a"
    for several in (folder, str(folder), [folder / "a.h5", str(folder / "b.h5")]):
        opened = px.open(several)
        assert isinstance(opened, tuple)
        assert [r.condition for r in opened] == ["a", "b"]


def test_recordings_come_as_paths_values_or_lists_of_both(folder):
    value = px.open(folder / "b.h5")
    assert isinstance(value, Recording)
    assert as_recordings(value) == [value]
    assert [r.condition for r in as_recordings([folder / "a.h5", value])] == ["a", "b"]
    assert len(as_recordings(iter([value, folder]))) == 3


def test_models_and_stimuli_come_as_names_files_or_values(tmp_path):
    model = px.find_model("dvs128")
    assert as_model(model) is model
    assert as_model("dvs128") == model
    light = as_stimulus("chirp")
    assert as_stimulus(light) is light
    (tmp_path / "light.toml").write_text('[stimulus]\nkind = "sine"\nlevel = 3.0')
    assert as_stimulus(tmp_path / "light.toml").radiance.max() < 5


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: px.find_model("dvs129"), r"no model 'dvs129': .*\(did you mean 'dvs128'\?\)"),
        (lambda: px.find_model(3), "model: expected a Model, a .toml file, a fit folder, or one of .*found int 3"),
        (lambda: px.simulate("dvs128", "chrip"), r"no stimulus 'chrip'.*\(did you mean 'chirp'\?\)"),
        (lambda: px.simulate("dvs128", np.ones(3)), "stimulus: expected a Stimulus, .*found ndarray"),
        (lambda: px.simulate("dvs128", "chirp", pixels=0), "^pixels: expected at least 1"),
        (lambda: px.simulate("dvs128", "chirp", pixels=-1), "^pixels: expected at least 1, found -1"),
        (lambda: px.simulate("dvs128", "chirp", pixels=9.0), r"^pixels: expected a whole number, found 9\.0"),
        (lambda: px.simulate("dvs128", "chirp", pixels=1 << 40), "^pixels: expected at most"),
        (lambda: px.simulate("dvs128", "chirp", seed="a"), "^seed: expected a whole number, found 'a'"),
        (lambda: px.simulate("dvs128", "chirp", seed=-1), "^seed: expected at least 0"),
        (lambda: px.simulate("dvs128", "chirp", synchronous=1), "^synchronous: expected True or False, found 1"),
        (lambda: px.gap("x", "dvs128", alpha="low"), "^alpha: expected a number, found 'low'"),
        (lambda: px.fit("dvs128", "chirp"), "this is a stimulus: are two arguments swapped"),
        (lambda: px.fit("dvs128", px.find_model("dvs128")), "this is a model: are two arguments swapped"),
        (lambda: px.fit(px.find_model("dvs128"), "dvs128"), "this is a model: are two arguments swapped"),
        (lambda: px.fit("dvs128", [px.simulate("ideal", "sine", pixels=1)]), "this is a recording: are two"),
        (lambda: px.simulate("chirp", "dvs128"), "this is a stimulus: are two arguments swapped"),
        (lambda: px.find_model("dvs128").with_effect("leak", rate=2), r"did you mean 'leak\.rate_hz'"),
        (lambda: px.find_model("dvs128").set(on_threshold="a"), "on_threshold: expected a number, found 'a'"),
        (lambda: px.find_model("dvs128").set(on_treshold=0.2), "did you mean 'on_threshold'"),
        (lambda: px.fit(3, "dvs128"), "recordings: expected a Recording, a path, or a list of either, found int 3"),
        (lambda: px.fit([], "dvs128"), "recordings: expected at least one, found none"),
        (lambda: px.fit(["gone.h5"], "dvs128"), "gone.h5: no such file"),
        (lambda: px.gap([None], "dvs128"), "found NoneType None"),
        (lambda: px.sample("gone", "gone.h5"), "expected the folder of a result"),
        (lambda: px.sample(3, "gone.h5"), "result: expected a FitResult or a fit folder, found int"),
        (lambda: px.open("gone.h5"), "gone.h5: no such file"),
        (lambda: px.design("dvs128", criterion="beauty"), "beauty"),
        (lambda: px.reconstruct("gone", bandwidth="maybe"), "bandwidth: expected on, off or joint, found 'maybe'"),
    ],
)
def test_anything_else_is_a_plain_error(call, says):
    with pytest.raises(InputError, match=says) as caught:
        call()
    assert "\n" not in str(caught.value)


def test_did_you_mean():
    assert did_you_mean("leek", ["leak"]) == " (did you mean 'leak'?)"
    assert did_you_mean("sawtooth", ["leak"]) == ""


# --- values in one screen ---------------------------------------------------------------------------------------


def test_values_are_shown_in_one_screen_and_escaped(folder):
    model = px.find_model("dvs128")
    recording = Recording(Events.empty(2, 2), as_stimulus("chirp"), condition="<b>&")
    for value in (model, recording, as_stimulus("chirp"), as_recordings(folder)):
        assert len(repr(value).splitlines()) <= 24
        assert len(repr(value)) < 2000
    assert "<b>&" not in recording._repr_html_()
    assert "&lt;b&gt;&amp;" in recording._repr_html_()
    assert "refractory_s" in model._repr_html_()


def test_a_recording_is_plotted():
    recording = px.simulate("ideal", "sine", pixels=4)
    axes = recording.plot()
    assert axes.shape == (2, 1)
    assert axes[0, 0].collections
    import matplotlib.pyplot as plt

    plt.close(axes[0, 0].figure)


def test_simulating_is_what_the_command_line_does(tmp_path):
    from pixelid.cli.main import main

    assert main(["simulate", "ideal", "--stimulus", "sine", "--out", str(tmp_path / "a.h5"), "--pixels", "4",
                 "--seed", "3", "--quiet"]) == 0  # fmt: skip
    file, own = px.open(tmp_path / "a.h5"), px.simulate("ideal", "sine", pixels=4, seed=3)
    assert isinstance(file, Recording)
    assert np.array_equal(file.events.t, own.events.t)
    assert len(own.events) > 0


# --- one way of naming parameters --------------------------------------------------------------------------------


def test_errors_name_parameters_as_their_reader_writes_them(tmp_path, capsys):
    from pixelid.cli.main import main
    from pixelid.errors import on_command_line, spelled

    words = "--pixels: expected 1; use --fix NAME, `pixelid convert --align`, --use_log_image (add --with leak)"
    python = 'pixels: expected 1; use fixed NAME, `pixelid convert --align`, --use_log_image (add with_effect("leak"))'
    assert spelled(words) == python
    assert str(InputError(f"a.h5: {InputError(words)}")) == f"a.h5: {python}"
    with on_command_line():
        assert str(InputError(words)) == words
    error = pickle.loads(pickle.dumps(InputError(words)))
    assert str(error) == python
    (tmp_path / "fit.json").write_text("{}")
    with pytest.raises(InputError, match="exists already; choose another path or pass overwrite=True"):
        refuse_existing(tmp_path, False)
    assert main(["lowlight", "dvs128", "--out", str(tmp_path)]) == 2
    assert "choose another --out or pass --overwrite" in capsys.readouterr().err
    assert main(["simulate", "dvs128", "--stimulus", "chirp", "--pixels", "0", "--out", str(tmp_path / "a.h5")]) == 2
    assert "--pixels: expected at least 1" in capsys.readouterr().err


# --- what is new in a keyword, an index or a path ----------------------------------------------------------------


def test_models_change_by_keyword():
    model = px.find_model("dvs128").with_effect("leak", rate_hz=2).set(on_threshold=0.3)
    assert model == px.find_model("dvs128").with_effect("leak", {"rate_hz": 2.0}).set({"on_threshold": 0.3})


def test_a_stimulus_is_opened_or_refused(tmp_path):
    recording = px.simulate("ideal", "sine", pixels=4)
    (tmp_path / "l.csv").write_text("t_s,light_lux\n0,1\n0.5,2\n1,1\n")
    assert recording.with_stimulus(tmp_path / "l.csv").stimulus.unit == "lux"
    assert recording.with_stimulus("chirp").stimulus.duration_s == pytest.approx(0.8)
    for wrong, says in (
        (3, "expected a Stimulus"),
        ("gone.csv", "no stimulus 'gone.csv'"),
        ("grating", "4|2 x 2 pixels"),
    ):
        with pytest.raises(InputError, match=says):
            recording.with_stimulus(wrong)


def test_empty_recordings_are_said(folder):
    with pytest.warns(Doubtful, match=r"a\.h5: no events"):
        px.open(folder / "a.h5")
    with pytest.warns(Doubtful, match=r"a\.h5, .*b\.h5: no events"):
        px.open(folder)


def test_a_reconstruction_takes_models_and_results():
    from pixelid.api_scenes import _as_file
    from pixelid.model.files import load_model

    for given in (px.find_model("dvs128"), "dvs128", px.lowlight("dvs128")):
        with _as_file(given) as path:
            assert load_model(path / "model.toml").values == px.find_model("dvs128").values
    with _as_file("fit") as path:
        assert path == Path("fit")


# --- what public functions have in common ------------------------------------------------------------------------


def test_linear_algebra_uses_one_thread_while_public_functions_work():
    import threadpoolctl

    def threads() -> list[int]:
        return [lib["num_threads"] for lib in threadpoolctl.threadpool_info() if lib["user_api"] == "blas"]

    with threadpoolctl.threadpool_limits(limits=2, user_api="blas"):
        before, within = threads(), []
        px.simulate("ideal", "sine", pixels=4, progress=lambda what, share: within.append(threads()))
        assert within
        assert all(set(one) == {1} for one in within)
        assert threads()[: len(before)] == before


def test_progress_shows_itself_on_a_terminal_only(monkeypatch):
    from pixelid import public

    shown = []
    monkeypatch.setattr("pixelid.cli.progress.bar", lambda quiet: nullcontext(lambda *said: shown.append(said)))
    px.simulate("ideal", "sine", pixels=4)
    assert not shown
    monkeypatch.setattr(public.sys.stderr, "isatty", lambda: True, raising=False)
    px.simulate("ideal", "sine", pixels=4, progress=False)
    assert not shown
    px.simulate("ideal", "sine", pixels=4)
    assert shown


def test_a_result_in_the_place_of_recordings_is_said(tmp_path, capsys):
    from pixelid.cli.main import main

    px.lowlight("dvs128").save(tmp_path / "low")
    (tmp_path / "low" / "command.txt").write_text("pixelid lowlight dvs128\n")
    with pytest.raises(InputError, match="low: is a result of `pixelid lowlight`, not recordings"):
        px.fit(tmp_path / "low", "dvs128")
    for command in ("compare", "gap", "fit"):
        words = [command, str(tmp_path / "low"), "--model", "dvs128", "--out", str(tmp_path / "out")]
        assert main([*words, "--model", "ideal"] if command == "compare" else words) == 2
        assert "low: is a result of `pixelid lowlight`, not recordings" in capsys.readouterr().err


def test_progress_in_a_notebook_is_one_output_that_is_empty_in_the_end():
    pytest.importorskip("ipykernel")
    nbformat, nbclient = pytest.importorskip("nbformat"), pytest.importorskip("nbclient")
    source = 'import pixelid as px\npx.simulate("ideal", "sine", pixels=4).events.width'
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(source)])
    nbclient.NotebookClient(notebook, timeout=120, kernel_name="python3").execute()
    line, value = notebook.cells[0].outputs
    assert line.data["text/html"] == ""
    assert value.data["text/plain"] == "2"


def test_every_figure_of_a_notebook_is_shown(monkeypatch):
    monkeypatch.delenv("MPLBACKEND", raising=False)  # which the command line sets for itself
    pytest.importorskip("ipykernel")
    nbformat, nbclient = pytest.importorskip("nbformat"), pytest.importorskip("nbclient")
    head = 'import pixelid as px\nrecording = px.simulate("ideal", "sine", pixels=4, progress=False)'
    sources = [head, "recording.plot();", "recording.plot();"]
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(source) for source in sources])
    nbclient.NotebookClient(notebook, timeout=120, kernel_name="python3").execute()
    for cell in notebook.cells[1:]:
        assert [list(output.data) for output in cell.outputs] == [["text/plain", "image/png"]]
