"""The gap of pooled recordings: what many simulated pixels fire together, their addresses forgotten."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pixelid.errors import InputError
from pixelid.fit.coordinates import Coordinates
from pixelid.fit.figures import draw_edges
from pixelid.gap.gap import gap
from pixelid.gap.pooled_counts.pooled import _describe, _shortened
from pixelid.likelihood.pooled_rate import PooledRate
from pixelid.model.shipped import find_model
from pixelid.recordings import Recording
from pixelid.recordings.events import Events
from pixelid.simulate import simulate
from pixelid.stimuli.stimulus import Stimulus

MODEL = find_model("dvs128")
POOL = MODEL.set({"on_threshold": 0.06, "off_threshold": 0.06, "threshold_mismatch.sigma": 0.15, "refractory_s": 1e-6})


def bits(model, pixels=150, seed=1, duration_s=1.6):
    """A pool of pixels under a random sequence of two light levels."""
    t = np.arange(0.0, duration_s, 0.004)
    light = np.where(np.random.default_rng(seed).random(len(t)) > 0.5, 300.0, 60.0)
    stimulus = Stimulus(t, light, "relative", "previous")
    run = simulate(model, stimulus, width=pixels, height=1, seed=seed)
    events = replace(run.events, x=np.zeros(len(run.events), np.uint16), width=1)
    return Recording(events, stimulus, condition="bits", pooled=True)


@pytest.fixture(scope="module")
def plain():
    return gap([bits(POOL)], MODEL)


def test_nothing_is_named_where_nothing_is_missing(plain):
    assert plain.effects == ()
    assert plain.model.effects == plain.base.effects
    assert plain.verdict in ("none", "unknown")  # the pooled rate is a limit: what it misses it may not name


def test_report_says_what_was_looked_at(plain):
    told = plain.as_dict()
    assert told["details"]["dispersion"] >= 1.0
    assert "timestamp_jitter" in told["details"]["not_in_pooled_counts"]
    rows = told["details"]["after_jumps"]
    assert sum(row["measured"] for row in rows) > 0.9 * len(_shortened(bits(POOL)).events)


@pytest.mark.slow
def test_a_high_pass_is_found_and_closes_most_of_the_gap():
    report = gap([bits(POOL.with_effect("lower_cutoff", {"cutoff_hz": 20.0}), 300, duration_s=0.8)], MODEL)
    assert [e.name for e in report.effects] == ["lower_cutoff"]
    value, interval = report.effects[0].parameters["lower_cutoff.cutoff_hz"]
    assert interval is not None
    assert value == pytest.approx(20.0, rel=0.15)
    assert report.free_run is not None
    assert report.free_run.closed is not None
    assert report.free_run.closed > 0.6


@pytest.mark.slow
def test_events_missing_for_an_eighth_of_the_time_are_not_explained():
    """Of a slice that long only five stretches train: too few, once, for signs of whole stretches to tell anything."""
    recording = _shortened(bits(POOL))
    t, light = recording.events.t * 1e-9, recording.stimulus
    part = (t - light.start_s) / light.duration_s * 8
    less = replace(recording, events=recording.events.select((part < 4) | (part > 5)))
    report = gap([less], MODEL)
    assert report.verdict == "unknown"
    assert "part 5 of 8" in report.sentence


@pytest.mark.slow
def test_under_light_without_jumps_counts_are_sorted_by_level_and_slope():
    t = np.arange(0.0, 1.6, 1e-4)
    light = Stimulus(t, 120.0 * np.exp(0.7 * np.sin(2 * np.pi * 20.0 * t) + 0.3 * np.sin(2 * np.pi * 31.0 * t)))
    slow = POOL.with_effect("lower_cutoff", {"cutoff_hz": 15.0})
    run = simulate(slow, light, width=150, height=1, seed=1)
    events = replace(run.events, x=np.zeros(len(run.events), np.uint16), width=1)
    report = gap([Recording(events, light, condition="smooth", pooled=True)], MODEL)
    assert "lower_cutoff" in [e.name for e in report.effects]
    assert {row["where"] for row in report.details["after_jumps"]} <= {
        "ON in smooth, before any jump of the light", "OFF in smooth, before any jump of the light",
    }  # fmt: skip


def test_a_recording_is_cut_where_its_light_is(monkeypatch):
    monkeypatch.setattr("pixelid.gap.pooled_counts.pooled.MAX_EVENTS", 3000)
    t = np.arange(0.0, 5.0, 1e-3)
    light = Stimulus(t, 100.0 + 0.0 * t, "relative", "linear")
    times = np.arange(0, 5_000_000_000, 1_000_000)
    zeros = np.zeros(len(times), np.uint16)
    recording = Recording(Events(times, zeros, zeros, zeros.astype(np.uint8), 1, 1), light, pooled=True)
    shown = _shortened(recording)
    assert shown.stimulus.end_s == 3.0
    assert shown.events.t[-1] == 3_000_000_000
    sparse = Stimulus(np.array([0.0, 4.0]), np.array([1.0, 5.0]), "relative", "linear")
    assert _shortened(replace(recording, stimulus=sparse)).stimulus.radiance.tolist() == [1.0, 4.0]
    held = replace(sparse, interpolation="previous")
    assert _shortened(replace(recording, stimulus=held)).stimulus.radiance.tolist() == [1.0, 1.0]


def test_the_effect_in_doubt_is_the_last_one_named():
    named = [SimpleNamespace(name="light_spread"), SimpleNamespace(name="extra_pole")]
    said = _describe("ambiguous", named, ["slew_limit"], None, None, ("", 0.0))
    assert said.startswith("Found: light_spread. ")
    assert said.endswith("which: extra_pole, or slew_limit.")


@pytest.mark.slow
def test_an_effect_left_out_is_not_found():
    recording = bits(POOL.with_effect("lower_cutoff", {"cutoff_hz": 20.0}), 300, duration_s=0.8)
    assert gap([recording], MODEL, leave_out=["lower_cutoff"]).verdict == "unknown"


def test_pooled_and_other_recordings_do_not_mix():
    recording = bits(POOL, pixels=5)
    with pytest.raises(InputError, match="pooled"):
        gap([recording, replace(recording, pooled=False)], MODEL)


def test_edges_of_a_pooled_fit_are_drawn():
    """Both columns, of edges up and edges down; the second once took its number of bins from the first."""
    recording = bits(POOL, pixels=20)
    coordinates = Coordinates.of(MODEL, PooledRate([recording]).nuisances())
    fitted: Any = SimpleNamespace(coordinates=coordinates, x=coordinates.start, details={"dispersion": 2.0})
    axes = draw_edges(fitted, [recording])
    assert axes.shape == (2, 2)
    for column in (0, 1):
        measured, left = axes[0, column].lines, axes[1, column].lines
        assert min(len(measured), len(left)) >= 2
        assert all(
            np.isfinite(line.get_ydata()).all() and len(line.get_ydata()) > 10 for line in (*measured, *left[:2])
        )
