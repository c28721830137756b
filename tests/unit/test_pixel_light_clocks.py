"""Light of each pixel's own beside clocks and recordings in parts: as pixels one by one, and as recordings whole."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pixelid.fit.bench import held, with_bench
from pixelid.fit.coordinates import Coordinates
from pixelid.fit.event_times import EventTimesObjective
from pixelid.likelihood import sections
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.shipped import find_model
from pixelid.recordings import Events, Recording, npz, open_recording, write_recording
from pixelid.recordings import parts as in_parts
from pixelid.recordings import reading as opening
from pixelid.recordings.alignment import Alignment, aligned
from pixelid.recordings.crop import Crop
from pixelid.recordings.own_light import with_fine_light
from pixelid.recordings.parts import LongRecording, as_whole
from pixelid.recordings.selection import only
from pixelid.simulate import simulate
from pixelid.stimuli.pixel_lights import in_a_row
from pixelid.stimuli.shapes import grating, steps

MODEL = find_model("dvs128")
VIDEO = grating(100.0, 0.6, 12.0, 8.0, width=5, height=3, duration_s=0.5, dt=2e-4)
TOLD = {"method": "auto", "offset_s": 0.0, "clock_rate_error": 0.0, "offset_interval_95": [-1e-4, 1e-4]}


@pytest.fixture(scope="module")
def recording() -> Recording:
    return replace(simulate(MODEL, VIDEO, seed=1), condition="own", attributes={"alignment": TOLD})


@pytest.fixture(scope="module")
def beside() -> Recording:
    """Of the same sensor, under full-field light."""
    return replace(simulate(MODEL, steps(duration_s=0.2), width=5, height=3, seed=2), condition="beside")


def in_small_parts(recording: Recording, size: int = 777) -> LongRecording:
    events = recording.events
    head = replace(recording, events=Events.empty(events.width, events.height, events.tick_ns))
    return LongRecording(
        head,
        lambda: (replace(head, events=events.select(np.s_[k : k + size])) for k in range(0, max(len(events), 1), size)),
    )


def same(found: Recording, expected: Recording) -> None:
    for name in "txyp":
        np.testing.assert_array_equal(getattr(found.events, name), getattr(expected.events, name))
    assert found.stimulus.arrays.keys() == expected.stimulus.arrays.keys()
    for name, array in expected.stimulus.arrays.items():
        np.testing.assert_array_equal(found.stimulus.arrays[name], array)


@pytest.mark.parametrize("section_samples", [1, 10**9])
def test_a_clock_is_that_of_the_pixels_one_by_one(recording, section_samples, monkeypatch):
    """All sections of a recording go by its clock."""
    monkeypatch.setattr(sections, "SECTION_SAMPLES", section_samples)
    own = {"alignment.delay_s[own]": 40e-6, "alignment.clock_rate": 60e-6}
    circuit = held(with_bench(MODEL, [recording]), own).circuit()
    terms = EventTimes([recording]).terms(circuit)
    alone = [
        EventTimes([only([recording], np.array([k]))[0].with_stimulus(
            replace(VIDEO, radiance=VIDEO.radiance.reshape(len(VIDEO.t), -1)[:, k].copy())
        )]).terms(circuit).total
        for k in np.unique(recording.events.pixel)
    ]  # fmt: skip
    np.testing.assert_allclose(terms.per_pixel, alone, rtol=1e-11, atol=1e-9)
    assert abs(terms.total - EventTimes([recording]).terms(MODEL.circuit()).total) > 1.0


@pytest.mark.parametrize("section_samples", [1, 6000])
def test_gradients_along_clocks_are_those_of_the_value(recording, beside, section_samples, monkeypatch):
    """With the recording of many sections before and behind one of a single section."""
    monkeypatch.setattr(sections, "SECTION_SAMPLES", section_samples)
    for recordings in ([recording, beside], [beside, recording]):
        coordinates = Coordinates.of(with_bench(MODEL, recordings))
        rng = np.random.default_rng(1)
        likelihood = EventTimes([with_fine_light(r, "linear") for r in recordings])
        factor = rng.uniform(0.9, 1.1, likelihood.events)
        objective = EventTimesObjective(likelihood.with_threshold_factor(factor), coordinates)
        x = coordinates.start + 0.02 * rng.normal(size=len(coordinates)) * coordinates.longest_moves()
        gradient = objective.gradient(x)
        assert list(coordinates.names[-2:]) == ["alignment.delay_s[own]", "alignment.clock_rate"]
        for i in (-2, -1):
            up, down = x.copy(), x.copy()
            up[i] += 3e-8
            down[i] -= 3e-8
            assert gradient[i] == pytest.approx((objective.value(up) - objective.value(down)) / 6e-8, rel=1e-3)


def test_alignment_in_parts(recording):
    alignment = Alignment(-0.1, "given", rate_error=2e-5)
    whole = aligned(recording, VIDEO, alignment)
    same(as_whole(aligned(in_small_parts(recording), VIDEO, alignment)), whole)
    groups = with_fine_light(recording, "linear").stimulus
    same(as_whole(aligned(in_small_parts(recording), groups, alignment)), aligned(recording, groups, alignment))


@pytest.mark.parametrize(
    "crop",
    [Crop(roi=(1, 0, 3, 3)), Crop(pixels=4), Crop(time_s=(0.1, 0.31)),
     Crop(roi=(1, 0, 5, 2), time_s=(0.0, 0.3), pixels=3)],
)  # fmt: skip
@pytest.mark.parametrize("light", ["video", "groups"])
def test_crops_in_parts(recording, crop, light):
    whole = recording if light == "video" else with_fine_light(recording, "linear")
    same(as_whole(crop.applied(in_small_parts(whole), 3)), crop.applied(whole, 3))


@pytest.mark.parametrize("suffix", ["h5", "npz"])
def test_files_in_parts(recording, suffix, tmp_path, monkeypatch):
    fine, crop = with_fine_light(recording, "linear"), Crop(roi=(0, 0, 4, 3))
    path, again = tmp_path / f"whole.{suffix}", tmp_path / f"parts.{suffix}"
    write_recording(fine, path)
    expected = crop.applied(open_recording(path))
    monkeypatch.setattr(npz, "PART_EVENTS", 777)
    monkeypatch.setattr(opening, "LONG_BYTES", 0)
    monkeypatch.setattr(in_parts, "WHOLE_EVENTS", 100)
    long = opening.open_cropped(path, crop)
    assert isinstance(long, LongRecording)
    assert in_a_row(long.stimulus, np.array([0, 6])).size == (2, 1)
    write_recording(long, again)
    same(open_recording(again), expected)
