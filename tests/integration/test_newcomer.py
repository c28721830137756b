"""The newcomer's page as written: open, fit, summary, plot, gap; and results that go to a folder and come back."""

import os
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest

import pixelid as px
from pixelid.recordings import write_recording

PAGE = """\
import pixelid as px

recordings = px.open("session/")
result = px.fit(recordings, "dvs128")
print(result.summary())
result.plot_response(recordings)
result.save("fit")

report = px.gap(recordings, "fit", recommend=False)
print(report.summary())
report.plot_map()
"""


@pytest.fixture(scope="module")
def session(tmp_path_factory) -> Path:
    """A folder with a small session of four pixels."""
    folder = tmp_path_factory.mktemp("newcomer")
    (folder / "session").mkdir()
    for name, level in (("chirp", 24.0), ("steps", 120.0)):
        (folder / f"{name}.toml").write_text(f'[stimulus]\nkind = "{name}"\nlevel = {level}\nduration_s = 0.4\n')
        recording = px.simulate("dvs128", folder / f"{name}.toml", pixels=6, seed=1)
        write_recording(recording, folder / "session" / f"{name}.h5")
    return folder


@pytest.fixture(scope="module")
def page(session) -> dict:
    """The names that the page has defined after it ran."""
    names: dict = {}
    before = os.getcwd()
    os.chdir(session)
    try:
        exec(compile(PAGE, "newcomer", "exec"), names)
    finally:
        os.chdir(before)
        plt.close("all")
    return names


def test_the_page_runs_as_written(page):
    assert len([line for line in PAGE.splitlines() if line]) <= 10
    assert page["result"].status in (px.Status.converged, px.Status.at_bound)
    assert page["report"].verdict in ("none", "named", "ambiguous", "unknown")


@pytest.mark.parametrize("name", ["result", "report"])
def test_results_are_shown_in_one_screen_and_escaped(name, page):
    from dataclasses import replace

    result = page[name]
    assert len(repr(result).splitlines()) <= 26
    assert len(repr(result)) < 3000
    assert all(sentence in result.summary() for sentence in result.sentences())
    evil = replace(result, advice="<script>")
    assert "<script>" not in evil._repr_html_()
    assert "&lt;script&gt;" in evil._repr_html_()


def test_a_fit_comes_back_and_goes_on(page, session):
    result = page["result"]
    again = type(result).load(session / "fit")
    np.testing.assert_allclose(again.x, result.x, rtol=1e-12)
    np.testing.assert_allclose(again.covariance, result.covariance, rtol=1e-12)
    assert again.coordinates.names == result.coordinates.names
    assert again.as_dict().keys() == result.as_dict().keys()
    assert repr(again) == repr(result)
    assert again.status is result.status
    assert px.simulate(again.model, "chirp", pixels=1).events.width == 1
    frame = again.to_dataframe()
    assert list(frame.index) == list(result.estimates)
    assert frame.loc["alpha", "value"] == result.estimates["alpha"].value
    axes = again.plot_residuals(session / "session")
    assert axes.shape == (2, 2)
    plt.close("all")


def test_a_gap_comes_back(page, session):
    report = page["report"]
    report.save(session / "gap")
    again = type(report).load(session / "gap")
    assert again.as_dict().keys() == report.as_dict().keys()
    assert again.summary() == report.summary()
    assert again.model == report.model
    assert again.base == report.base
    again.plot_map()
    plt.close("all")


def test_a_posterior_comes_back(page, session):
    posterior = px.sample(session / "fit", session / "session", wanted=20, max_steps=40)
    posterior.save(session / "posterior")
    again = type(posterior).load(session / "posterior")
    assert np.array_equal(again.chain, posterior.chain)
    assert repr(again) == repr(posterior)
    assert again.status is posterior.status
    data = again.to_arviz()
    assert set(data.posterior.data_vars) == set(posterior.coordinates.names)
    assert list(data.log_likelihood["recording_name"].values) == ["chirp", "steps"]
    d = len(posterior.coordinates)
    assert again.plot_corner().shape == (d, d)
    assert again.plot_trace().size >= d
    assert list(again.to_dataframe().columns)[:2] == ["mean", "sd"]
    plt.close("all")


def test_low_light_and_design_come_back(session):
    for report in (px.lowlight("dvs128"), px.design("dvs128", draws=1, menu=session / "menu.toml", pixels=1)
                   if _menu(session) else None):  # fmt: skip
        assert report is not None
        folder = session / type(report).__name__
        report.save(folder)
        again = type(report).load(folder)
        assert again.summary() == report.summary()
        assert again.status is px.Status.converged
        assert len(again.to_dataframe()) > 0
    assert again.stimulus.duration_s > 0
    assert type(again).load(folder).plot_ranking().get_xlabel().startswith("expected information")
    lowlight = px.lowlight("dvs128")
    assert lowlight.plot_poles().shape == (1, 3)
    plt.close("all")


def _menu(folder: Path) -> bool:
    text = '[[stimulus]]\nkind = "sine"\nlevel = 24.0\nduration_s = 0.2\n'
    (folder / "menu.toml").write_text(text)
    return True
