"""What commands write, Python writes: results with their figures and pages, and plots of fits."""

import json

import matplotlib.pyplot as plt
import numpy as np
import pytest

import pixelid as px
from pixelid.cli.main import main
from pixelid.errors import InputError


@pytest.fixture(scope="module")
def fitted():
    return px.fit(px.simulate("dvs128", "chirp", pixels=4), "dvs128", starts=0)


@pytest.fixture
def table(tmp_path):
    frequency = np.array([1, 10, 50, 100, 200, 500, 1000])
    rows = [f"{f},{70 * f / np.hypot(1, f / 300):.0f}" for f in frequency]
    (tmp_path / "table.csv").write_text("\n".join(["freq_hz,slow", *rows]) + "\n")
    return tmp_path / "table.csv"


def names_in(folder):
    return sorted(path.name for path in folder.iterdir() if path.name != "command.txt")


def test_a_table_has_the_same_result_either_way(table, tmp_path):
    assert main(["rates", str(table), "--out", str(tmp_path / "a"), "--quiet"]) in (0, 1)
    result = px.rates(table)
    assert result.report(tmp_path / "b") == tmp_path / "b" / "report.html"
    assert names_in(tmp_path / "a") == names_in(tmp_path / "b") == ["rates.json", "rates.svg", "report.html"]
    one, other = (json.loads((tmp_path / name / "rates.json").read_text()) for name in "ab")
    assert {**one, "seconds": 0} == {**other, "seconds": 0}
    assert result.to_dataframe().loc["cutoff_hz[slow]", "value"] == one["parameters"]["cutoff_hz[slow]"]["value"]
    assert "cutoff_hz[slow]" in result.summary(80)
    with pytest.raises(InputError, match="exists already"):
        result.report(tmp_path / "b")


def test_an_export_is_the_same_file(tmp_path):
    assert main(["export", "dvs128", "--to", "v2e", "--out", str(tmp_path / "a.args"), "--quiet"]) == 0
    exported = px.export("dvs128", "V2E", tmp_path / "b.args")
    assert (tmp_path / "a.args").read_text() == (tmp_path / "b.args").read_text()
    assert exported.parameters == px.export(px.find_model("dvs128"), "v2e").parameters
    with pytest.raises(InputError, match=r"^to: expected .*v2e"):
        px.export("dvs128", "v3e")


def test_a_fit_keeps_its_recordings_for_figures(fitted, tmp_path):
    page = fitted.report(tmp_path / "fit")
    assert {"conditions.svg", "residuals.svg", "fit.json", "model.toml"} <= set(names_in(page.parent))
    loaded = type(fitted).load(page.parent)
    assert loaded.hash == fitted.hash
    with pytest.raises(InputError, match="recordings: expected those of the fit"):
        loaded.plot_residuals()
    assert not {"conditions.svg", "residuals.svg"} & set(names_in(loaded.report(tmp_path / "again").parent))
    assert px.report(tmp_path / "again") == tmp_path / "again" / "report.html"


def test_intervals_are_plotted_with_start_and_truth(fitted):
    axis = fitted.plot_intervals()
    free = [name for name, e in fitted.estimates.items() if not e.fixed and e.value > 0]
    assert len(axis.get_yticks()) == len(free)
    truth = px.find_model("dvs128")
    axis = fitted.plot_truth(truth.set(on_threshold=0.5), start="dvs128")
    crosses = {line.get_label(): line for line in axis.lines if line.get_marker() == "x"}
    assert set(crosses) == {"truth, in the interval", "truth, outside the interval"}
    assert crosses["truth, outside the interval"].get_xdata()[0] == pytest.approx(0.5 / truth.values["on_threshold"])
    plt.close("all")


def test_the_health_of_a_recording_becomes_a_page(tmp_path):
    health = px.inspect(px.simulate("ideal", "sine", pixels=4))
    page = health.report(tmp_path / "health")
    assert names_in(page.parent) == [
        "inspect.json", "intervals.svg", "pixels.svg", "preview.npz", "rate.svg", "report.html",
    ]  # fmt: skip
    text = page.read_text()
    assert 'id="event-data"' in text
    data = json.loads(text.partition('id="event-data">')[2].partition("</script>")[0])
    assert len({len(data[name]) for name in "txyp"}) == 1
    assert max(data["t"]) == 1000
    assert (data["width"], data["height"]) == (2, 2)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: px.rates("gone.csv"), "gone.csv: no such file"),
        (lambda: px.latency("x.csv", predict=True), "^predict: expected model with it"),
        (lambda: px.noise("x.csv", predict=True), "^predict: expected model with it"),
        (lambda: px.render("gone", "out"), "expected the folder of a reconstruction, found nothing"),
        (lambda: px.dataset("esim", "gone", "out"), "gone: no such file or folder"),
        (lambda: px.compare([], ["dvs128", "ideal"]), "recordings: expected at least one"),
        (lambda: px.report("."), "expected the folder of a result"),
    ],
)
def test_what_cannot_be_done_is_said_in_python_s_words(call, says, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=says):
        call()
