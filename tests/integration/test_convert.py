"""`pixelid convert`: lossless there and back, nothing half written."""

from itertools import pairwise

import numpy as np
import pytest

from pixelid.cli.main import main
from pixelid.recordings import Events, Recording, open_recording, text, write_recording
from pixelid.stimuli.stimulus import Stimulus


@pytest.fixture
def source(tmp_path):
    rng = np.random.default_rng(0)
    t = np.sort(rng.integers(0, 10**9, 300))
    events = Events.from_columns(t, rng.integers(0, 9, 300), rng.integers(0, 5, 300), rng.integers(0, 2, 300), 9, 5)
    light = Stimulus.from_arrays([0, 1], [1.5, 1 / 3], "lux", "previous")
    write_recording(Recording(events, light, "c", "s", attributes={"temperature_k": 300.5}), tmp_path / "a.h5")
    return tmp_path / "a.h5"


def test_around_every_format_and_back(source, tmp_path, capsys):
    path = [str(source), *(str(tmp_path / name) for name in ("b.csv", "c.npz", "d.txt", "e.hdf5"))]
    for before, after in pairwise(path):
        assert main(["convert", before, after]) == 0
    assert "300 events" in capsys.readouterr().out
    first, last = open_recording(path[0]), open_recording(path[-1])
    for column in "txyp":
        np.testing.assert_array_equal(getattr(first.events, column), getattr(last.events, column))
    np.testing.assert_array_equal(first.stimulus.radiance, last.stimulus.radiance)
    assert (first.condition, first.sensor, first.attributes) == (last.condition, last.sensor, last.attributes)
    assert (first.stimulus.unit, first.stimulus.interpolation) == (last.stimulus.unit, last.stimulus.interpolation)


def test_an_existing_output_is_kept(source, tmp_path, capsys):
    (tmp_path / "b.csv").write_text("precious")
    assert main(["convert", str(source), str(tmp_path / "b.csv")]) == 2
    assert "exists already" in capsys.readouterr().err
    assert (tmp_path / "b.csv").read_text() == "precious"
    assert main(["convert", str(source), str(tmp_path / "b.csv"), "--overwrite", "--quiet"]) == 0
    assert capsys.readouterr().out == ""
    assert len(open_recording(tmp_path / "b.csv").events) == 300


def test_a_failure_leaves_nothing(source, tmp_path, monkeypatch):
    def broken(recording, path):
        path.write_text("half")
        raise KeyboardInterrupt

    monkeypatch.setattr(text, "write", broken)
    assert main(["convert", str(source), str(tmp_path / "b.csv")]) == 130
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.h5"]


def test_another_stimulus(source, tmp_path):
    pytest.importorskip("pixelid.stimuli.files")
    np.savez(tmp_path / "events.npz", t=[1, 2, 900_000], x=[0, 1, 2], y=[0, 0, 0], p=[1, 0, 1])
    code = main(["convert", str(tmp_path / "events.npz"), str(tmp_path / "b.h5"), "--stimulus", str(source)])
    assert code == 0
    assert open_recording(tmp_path / "b.h5").stimulus.unit == "lux"
    np.savez(tmp_path / "long.npz", t=[1, 2, 2_900_000], x=[0, 1, 2], y=[0, 0, 0], p=[1, 0, 1])
    lamp = tmp_path / "lamp.h5"
    events = Events.empty(1, 1)
    write_recording(Recording(events, Stimulus.from_arrays([0, 1], [1.0, 2.0])), lamp)
    assert main(["convert", str(tmp_path / "long.npz"), str(tmp_path / "c.h5"), "--stimulus", str(lamp)]) == 2
