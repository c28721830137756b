"""Sessions as laboratories have them (`../shared/bench`): lights and cameras on clocks of their own."""

import json
from dataclasses import replace

import pytest

from pixelid.recordings import open_recording
from pixelid.recordings.alignment import find_alignment
from pixelid.recordings.session_alignment import align_session
from pixelid.stimuli.files import load_stimulus

EXTENSION = {"b01": "csv", "b02": "raw", "b03": "npz"}


def bench(shared, session):
    """(recordings, lights, what is true) of a bench session."""
    folder = shared / "bench" / session
    if not folder.exists():
        pytest.skip(f"no {folder}")
    names = sorted(path.name.removesuffix("_light.csv") for path in folder.glob("*_light.csv"))
    recordings = [open_recording(folder / f"{name}.{EXTENSION[session]}") for name in names]
    lights = [load_stimulus(str(folder / f"{name}_light.csv")) for name in names]
    return recordings, lights, json.loads((folder / "truth.json").read_text())


@pytest.mark.parametrize("session", ["b01", "b03"])
def test_every_chirp_and_step_recording_is_found_alone_and_the_session_at_once(shared, session):
    recordings, lights, truth = bench(shared, session)
    together = {one.name: one for one in align_session(recordings, lights)}
    low, high = together["steps_400"].clock_rate_interval_95
    assert low < 1e-6 * truth["clock_ppm"] < high
    assert high - low < 2e-4
    for recording, light in zip(recordings, lights, strict=True):
        one = together[recording.name]
        assert not one.doubts
        if recording.name.startswith("constant"):
            assert one.method == "inherited"
            continue
        assert one.method == "auto"
        if recording.name.startswith(("chirp", "steps")):
            alone = find_alignment(recording, light, "auto")
            assert alone.start_s == pytest.approx(one.offset_s, abs=alone.start_half_s)


def test_events_agree_with_the_trigger_edges(shared):
    recordings, lights, truth = bench(shared, "b02")
    edges = align_session(recordings, lights)
    events = align_session([replace(recording, triggers=None) for recording in recordings], lights)
    assert not any(one.doubts for one in edges)
    for by_edge, by_events in zip(edges, events, strict=True):
        assert by_edge.method == "trigger"
        assert 1e6 * by_edge.clock_rate_error == pytest.approx(truth["clock_ppm"], abs=1.0)
        if by_events.method == "auto":
            half = by_events.offset_s - by_events.interval_95[0]
            assert by_events.offset_s == pytest.approx(by_edge.offset_s, abs=2.0 * half)
            assert half < 0.02
    compared = {one.name: one for one in events}
    for name in ("steps_24", "steps_400"):
        by_edge = next(one for one in edges if one.name == name)
        assert compared[name].offset_s == pytest.approx(by_edge.offset_s, abs=3e-5)
