"""The cache of fits: read back as they were, keyed by all that they depend on, safe against damage."""

from dataclasses import replace

import numpy as np
import pytest

from pixelid.cluster import LOOPBACK, Work
from pixelid.errors import SetAside
from pixelid.fit.cache import FitCache, map_fits
from pixelid.fit.maximise import maximise
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.shipped import find_model
from pixelid.simulate import simulate
from pixelid.stimuli.shapes import slow

MODEL = find_model("dvs128")


@pytest.fixture(scope="module")
def likelihood():
    return EventTimes([simulate(MODEL, slow(24.0, seed=2), width=3, height=1, seed=1)])


def test_a_fit_is_read_back_as_it_was(tmp_path, likelihood):
    made = maximise(likelihood, MODEL, tolerance=0.5, max_steps=3, cache=FitCache(tmp_path / "fits"))
    cache = FitCache(tmp_path / "fits")
    again = maximise(likelihood, MODEL, tolerance=0.5, max_steps=3, cache=cache)
    plain = maximise(likelihood, MODEL, tolerance=0.5, max_steps=3)
    for other in (again, plain):
        assert (other.value, other.unexplained, other.converged) == (made.value, made.unexplained, made.converged)
        np.testing.assert_array_equal(other.x, made.x)
        np.testing.assert_array_equal(other.information, made.information)
    cache.remove()
    assert not (tmp_path / "fits").exists()


def test_a_key_depends_on_likelihood_model_and_settings(tmp_path, likelihood):
    cache = FitCache(tmp_path / "fits")
    circuit = MODEL.with_effect("timestamp_jitter").circuit()
    shifted = replace(likelihood.recordings[0], events=replace(
        likelihood.recordings[0].events, t=likelihood.recordings[0].events.t + 1
    ))  # fmt: skip
    keys = [
        cache.key(likelihood, MODEL, 0.1, 5),
        cache.key(likelihood, MODEL, 0.1, 6),
        cache.key(likelihood, MODEL.set({"on_threshold": 0.21}), 0.1, 5),
        cache.key(likelihood.weighed(circuit), MODEL, 0.1, 5),
        cache.key(likelihood.with_threshold_factor(np.full(likelihood.events, 1.01)), MODEL, 0.1, 5),
        cache.key(EventTimes([shifted]), MODEL, 0.1, 5),
    ]
    assert len(set(keys)) == len(keys)
    assert cache.key(EventTimes(likelihood.recordings), MODEL, 0.1, 5) == keys[0]


def test_a_line_cut_off_at_the_end_is_dropped(tmp_path):
    path = tmp_path / "fits"
    cache = FitCache(path)
    for key in ("a", "b"):
        cache.add(key, {"x": [1.0]})
    path.write_bytes(path.read_bytes()[:-9])
    again = FitCache(path)
    assert again.get("a") == {"x": [1.0]}
    assert again.get("b") is None
    again.add("b", {"x": [2.0]})
    third = FitCache(path)  # what was cut off is not in the middle now
    assert third.entries == {"a": {"x": [1.0]}, "b": {"x": [2.0]}}
    assert [file.name for file in tmp_path.iterdir()] == ["fits"]


@pytest.mark.parametrize(
    "damage",
    [
        b"\xff\x00garbage",
        b'{"key": "a"}',
        b'{"key": "a", "checksum": "0", "entry": "{}"}',
        b'{"key": 1, "checksum": "0", "entry": 2.5}',
    ],
)
def test_a_damaged_file_is_set_aside_and_its_sound_lines_kept(tmp_path, damage):
    path = tmp_path / "fits"
    cache = FitCache(path)
    for key in ("a", "b", "c"):
        cache.add(key, {"x": [1.0]})
    lines = path.read_bytes().split(b"\n")
    path.write_bytes(b"\n".join([lines[0], damage, *lines[2:]]))
    with pytest.warns(SetAside, match="is damaged"):
        again = FitCache(path)
    assert [again.get(key) for key in ("a", "b", "c")] == [None, {"x": [1.0]}, {"x": [1.0]}]
    assert (tmp_path / "fits.damaged").exists()
    assert FitCache(path).get("c") == {"x": [1.0]}


def test_fits_made_elsewhere_are_the_same_and_are_kept(tmp_path, likelihood):
    from distributed import Client, LocalCluster

    starts = [MODEL.set({"on_threshold": threshold}) for threshold in (0.19, 0.2, 0.21)]
    quiet = {"host": LOOPBACK, "dashboard_address": f"{LOOPBACK}:0", "silence_logs": 50, "protocol": "tcp"}

    def fit(start, cache):
        return maximise(likelihood, start, tolerance=0.5, max_steps=2, cache=cache)

    begun = []
    here = map_fits(Work(), fit, starts, None)
    with LocalCluster(1, threads_per_worker=2, processes=False, **quiet) as cluster, Client(cluster) as client:
        there = map_fits(Work(client), fit, starts, FitCache(tmp_path / "fits"), begun.append)
    assert begun == starts
    for one, other in zip(here, there, strict=True):
        assert one.value == other.value
        np.testing.assert_array_equal(one.x, other.x)
    kept = FitCache(tmp_path / "fits")
    assert len(kept.entries) == len(starts)
    assert kept.added == {}
    assert all(kept.get(kept.key(likelihood, start, 0.5, 2)) is not None for start in starts)


def test_fits_made_by_threads_side_by_side_are_those_made_alone(tmp_path, likelihood, monkeypatch):
    """They share a likelihood, which remembers the latest trajectories, and a file."""
    starts = [MODEL.set({"sf_cutoff_hz": cutoff}) for cutoff in (1500.0, 2000.0, 2500.0, 3000.0, 3500.0, 4000.0)]

    def fit(start, cache):
        return maximise(likelihood, start, tolerance=0.5, max_steps=3, cache=cache)

    alone = [fit(start, None) for start in starts]
    monkeypatch.setenv("PIXELID_THREADS", "3")
    begun = []
    beside = map_fits(Work(), fit, starts, FitCache(tmp_path / "fits"), begun.append)
    assert {start.values["sf_cutoff_hz"] for start in begun} == {start.values["sf_cutoff_hz"] for start in starts}
    for one, other in zip(alone, beside, strict=True):
        assert one.value == other.value
        np.testing.assert_array_equal(one.x, other.x)
    assert len(FitCache(tmp_path / "fits").entries) == len(starts)
