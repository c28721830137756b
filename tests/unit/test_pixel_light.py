"""Light of each pixel's own: likelihood, simulation and files, against pixels one by one under full-field light."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pixelid.cli.main import main as run
from pixelid.errors import InputError
from pixelid.fit.coordinates import Coordinates
from pixelid.fit.event_times import EventTimesObjective
from pixelid.likelihood import sections
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.shipped import find_model
from pixelid.recordings import Events, Recording, open_recording, write_recording
from pixelid.recordings.alignment import aligned, find_alignment
from pixelid.recordings.crop import Crop
from pixelid.recordings.own_light import with_fine_light, with_pixel_lights
from pixelid.recordings.selection import only
from pixelid.recordings.sensor_light import light_caveats, measurements, with_measured_light
from pixelid.simulate import simulate
from pixelid.stimuli.pixel_lights import PixelLights, in_a_row, log_radiance_at
from pixelid.stimuli.resample import resampled
from pixelid.stimuli.shapes import grating, sine, slow, steps
from pixelid.stimuli.stimulus import Stimulus

MODEL = find_model("dvs128")
VIDEO = grating(100.0, 0.6, 12.0, 8.0, width=5, height=3, duration_s=0.5, dt=2e-4)


@pytest.fixture(scope="module")
def recording() -> Recording:
    return simulate(MODEL, VIDEO, seed=1)


def column(video: Stimulus, pixel: int) -> Stimulus:
    return replace(video, radiance=video.radiance.reshape(len(video.t), -1)[:, pixel].copy())


def one_by_one(recording: Recording, light=VIDEO) -> list[EventTimes]:
    """The likelihood of each pixel by itself, under full-field light."""
    pixels = np.unique(recording.events.pixel)
    return [EventTimes([only([recording], np.array([k]))[0].with_stimulus(column(light, k))]) for k in pixels]


@pytest.mark.parametrize(
    "model",
    [
        MODEL,
        MODEL.with_effect("leak", {"rate_hz": 2.0}).with_effect("polarity_memory"),
        MODEL.with_effect("parasitic_photocurrent", {"rate_hz_per_radiance": 0.02}),
        MODEL.with_effect("slew_limit", {"rise_per_s": 60.0, "fall_per_s": 50.0}),
        MODEL.with_effect("lower_cutoff", {"cutoff_hz": 2.0}),
        MODEL.without_effect("differencing_pole"),
        MODEL.with_effect("mains_flicker"),
    ],
    ids=["plain", "leak", "parasitic", "slew", "lower_cutoff", "no_amplifier_pole", "flicker"],
)
@pytest.mark.parametrize("section_samples", [1, 6000, 10**9])
def test_the_likelihood_is_that_of_the_pixels_one_by_one(recording, model, section_samples, monkeypatch):
    """Pixels are independent: thresholds are each pixel's own.  However many lights a section holds."""
    monkeypatch.setattr(sections, "SECTION_SAMPLES", section_samples)
    likelihood, circuit = EventTimes([recording]), model.circuit()
    assert len(likelihood.evaluators) == {1: 5, 6000: 2, 10**9: 1}[section_samples]  # five columns, 2501 samples each
    terms = likelihood.terms(circuit)
    alone = [single.terms(circuit).total for single in one_by_one(recording)]
    np.testing.assert_allclose(terms.per_pixel, alone, rtol=1e-11, atol=1e-9)
    assert terms.total == pytest.approx(sum(alone), rel=1e-12)


def test_gradient_and_information_are_those_of_the_pixels_one_by_one(recording):
    coordinates = Coordinates.of(MODEL)
    x = coordinates.start + 0.01
    together = EventTimesObjective(EventTimes([recording]), coordinates).local(x)
    parts = [EventTimesObjective(single, coordinates).local(x) for single in one_by_one(recording)]
    prior = coordinates.prior_gradient_and_curvature(x)
    more = len(parts) - 1
    gradient = sum(part.gradient for part in parts) - more * prior[0]
    information = sum(part.information for part in parts) - more * np.diag(prior[1])
    np.testing.assert_allclose(together.gradient, gradient, rtol=1e-6, atol=1e-4)
    np.testing.assert_allclose(together.information, information, rtol=1e-5, atol=1e-6 * np.abs(information).max())


def test_intervals_stay_with_their_events(recording):
    likelihood = EventTimes([recording])
    events, iv = recording.events, likelihood.intervals[0]
    np.testing.assert_array_equal(events.t[iv.event] * 1e-9, likelihood.time_s)
    np.testing.assert_array_equal(events.pixel[iv.event], likelihood.flat_pixels[likelihood.pixel])
    assert len(iv) == likelihood.events


def test_what_is_not_remembered_is_the_same(recording, monkeypatch):
    monkeypatch.setattr("pixelid.likelihood.sections.SECTION_SAMPLES", 1)
    totals = []
    for most in (0, 10**9):
        monkeypatch.setattr("pixelid.likelihood.event_times.MOST_REMEMBERED", most)
        likelihood = EventTimes([recording])
        totals.append([likelihood.terms(MODEL.circuit().with_(refractory=dead)).total for dead in (1e-4, 2e-4)])
    assert totals[0] == totals[1]


def test_equal_columns_of_a_video_are_one_light():
    lights = PixelLights.of_video(VIDEO)
    assert len(lights.lights) == 5
    np.testing.assert_array_equal(lights.of_pixel, np.tile(np.arange(5), (3, 1)))
    some = PixelLights.of_video(VIDEO, np.array([3, 8, 11]))
    assert len(some.lights) == 2
    np.testing.assert_array_equal(some.of_pixels(np.array([3, 8, 11])), [0, 0, 1])
    with pytest.raises(InputError, match=r"pixel \(0, 0\) has none"):
        some.of_pixels(np.array([0]))


def test_each_light_is_resampled_for_itself():
    step, quiet = Stimulus(np.arange(5.0), np.array([1.0, 1.0, 2.0, 2.0, 2.0])), Stimulus(np.arange(5.0), np.ones(5))
    fine = resampled(PixelLights.of_groups([step, quiet], np.array([[0, 1]])))
    assert len(fine.lights[0].t) > 30
    assert len(fine.lights[1].t) == 5


def test_splines_that_ring_give_way_to_straight_lines():
    """Exposures come in pairs close together, seconds apart: a cubic through them leaves their range by far."""
    t = np.array([0.0, 1.0, 1.0001, 2.0, 2.0001, 3.0])
    measured = Stimulus(t, np.exp([0.0, 0.0, 0.5, 0.5, 0.0, 0.1]))
    fine, straight = resampled(measured, "smooth"), resampled(measured, "linear")
    np.testing.assert_array_equal(fine.radiance, straight.radiance)


def test_light_is_looked_up_pixel_by_pixel():
    pixel, time = np.array([2, 0, 9, 2]), np.array([0.1, 0.2, 0.3, 0.4])
    told = log_radiance_at(VIDEO, pixel, time)
    alone = [np.interp(t, VIDEO.t, np.log(column(VIDEO, int(k)).radiance)) for k, t in zip(pixel, time, strict=True)]
    np.testing.assert_allclose(told, alone)
    row = in_a_row(VIDEO, pixel)
    assert row.size == (4, 1)
    np.testing.assert_allclose(log_radiance_at(row, np.arange(4), time), told)


def test_groups_fire_as_full_field_pixels_do():
    """A pixel's thresholds and draws are its own, whatever light it sees: each light alone gives the same."""
    model = MODEL.with_effect("leak", {"rate_hz": 2.0})
    lights = [slow(60.0, duration_s=0.4, seed=k) for k in range(3)]
    of_pixel = np.array([[2, 0, 2, 1], [0, 1, 1, -1]])
    events = simulate(model, PixelLights.of_groups(lights, of_pixel), seed=4).events
    assert (events.width, events.height) == (4, 2)
    for k, light in enumerate(lights):
        alone = simulate(model, light, width=4, height=2, seed=4).events
        there = np.isin(alone.pixel, np.flatnonzero(of_pixel.ravel() == k))
        here = np.isin(events.pixel, np.flatnonzero(of_pixel.ravel() == k))
        np.testing.assert_array_equal(events.t[here], alone.t[there])
        np.testing.assert_array_equal(events.pixel[here], alone.pixel[there])
    assert not (events.pixel == 7).any()


def test_groups_with_shot_noise_fire_as_the_video():
    model = MODEL.with_effect("shot_noise")
    video = grating(100.0, 0.6, 12.0, 8.0, width=4, height=1, duration_s=0.1, dt=1e-3)
    noisy = [simulate(model, light, seed=2).events for light in (video, PixelLights.of_video(video))]
    assert len(noisy[0]) > 20
    np.testing.assert_array_equal(noisy[0].t, noisy[1].t)


@pytest.mark.parametrize("suffix", ["h5", "npz"])
def test_groups_come_back_from_files(tmp_path, recording, suffix):
    fine = with_fine_light(recording, "smooth")
    path = tmp_path / f"recording.{suffix}"
    write_recording(fine, path)
    read = open_recording(path)
    for name, array in fine.stimulus.arrays.items():
        np.testing.assert_array_equal(read.stimulus.arrays[name], array)
    assert repr(read.stimulus) == repr(fine.stimulus)
    with pytest.raises(InputError, match="text holds no per-pixel stimulus"):
        write_recording(fine, tmp_path / "recording.csv")


def test_cuts_keep_the_light_of_the_pixels_left(recording):
    cut = Crop(roi=(1, 0, 3, 3), time_s=(0.1, 0.31)).applied(recording)
    assert len(cut.stimulus.lights) == 2
    assert cut.stimulus.end_s == pytest.approx(0.31, abs=3e-4)
    whole = EventTimes([Crop(time_s=(0.1, 0.31)).applied(recording)]).terms(MODEL.circuit()).per_pixel
    part = EventTimes([cut])
    np.testing.assert_allclose(part.terms(MODEL.circuit()).per_pixel, whole.reshape(3, 5)[:, 1:3].ravel(), rtol=1e-9)


def test_lights_of_different_times_end_together_when_cut():
    t = np.linspace(0.0, 1.0, 11)
    lights = [Stimulus(t, np.exp(t)), Stimulus(np.array([0.0, 0.31, 1.0]), np.exp([0.0, 0.31, 1.0]))]
    cut = PixelLights.of_groups(lights, np.array([[0, 1]])).until(0.55)
    assert [light.t[-1] for light in cut.lights] == [0.55, 0.55]
    np.testing.assert_allclose([light.radiance[-1] for light in cut.lights], np.exp(0.55))


def test_pixels_that_fire_in_one_recording_have_light_in_all(recording):
    silent = replace(recording, events=recording.events.select(recording.events.pixel != 4))
    grouped = with_pixel_lights([silent, recording])
    assert (grouped[0].stimulus.of_pixels(np.arange(15)) >= 0).all()
    plain = [replace(recording, stimulus=sine())]
    assert with_pixel_lights(plain)[0] is plain[0]


def test_light_of_another_sensor_is_refused(recording):
    other = grating(width=4, height=3, duration_s=0.5, dt=1e-3)
    with pytest.raises(InputError, match="expected light for 5 x 3 pixels, found 4 x 3"):
        EventTimes([recording.with_stimulus(other)])
    with pytest.raises(InputError, match="one span of time"):
        PixelLights.of_groups([sine(), sine(duration_s=2.0)], np.array([[0, 1]]))
    with pytest.raises(InputError, match=r"of_pixel: expected 0\.\.0, found 1"):
        PixelLights.of_groups([sine()], np.array([[0, 1]]))
    with pytest.raises(InputError, match="where the samples of each light begin"):
        PixelLights.from_arrays(np.arange(4.0), np.ones(4), np.array([0, 3]), np.array([[0]]))


def exposures_of(lights, charge: float, begins: dict[int, np.ndarray]):
    """Measurements of an ATIS: each pixel's begins, and the ends at which its light has moved the charge."""
    rows = []
    for pixel, light in enumerate(lights):
        moved = np.concatenate([[0.0], np.cumsum(0.5 * (light[1][1:] + light[1][:-1]) * np.diff(light[0]))])
        for begin in begins[pixel]:
            end = np.interp(np.interp(begin, light[0], moved) + charge, moved, light[0])
            rows += [(begin, pixel, 0), (end, pixel, 1)]
    t, x, p = (np.array(column) for column in zip(*sorted(rows), strict=True))
    return Events.from_columns(np.rint(t * 1e9).astype(np.int64), x, np.zeros(len(x), int), p, 3, 1)


def test_an_atis_measures_its_own_light():
    t = np.linspace(0.0, 1.0, 20001)
    lights = [(t, 200.0 * np.exp(np.sin(6.0 * t))), (t, 50.0 + 20.0 * t), (t, 100.0 + 0.0 * t)]
    begins = {0: np.arange(0.05, 0.9, 0.02), 1: np.array([0.1, 0.5]), 2: np.array([0.4])}
    fired = Events.from_columns([1000, 2000, 3000], [0, 1, 2], [0, 0, 0], [1, 1, 0], 3, 1)
    recording = with_measured_light(Recording(fired, exposures=exposures_of(lights, 0.5, begins)))
    assert recording.events.x.tolist() == [0, 1]  # one measurement tells no change
    assert [len(light.t) for light in recording.stimulus.lights] == [45, 4]
    for (when, light), told in zip(lights[:2], recording.stimulus.lights, strict=True):
        inside = told.t[1:-1]
        np.testing.assert_allclose(told.radiance[1:-1], np.interp(inside, when, light) / 0.5, rtol=2e-3)
    assert EventTimes([replace(recording, events=twice(fired))]).events == 1
    with pytest.raises(InputError, match="expected exposure measurements"):
        with_measured_light(Recording(fired))


def test_polarities_that_the_measured_light_contradicts_are_exchanged():
    t = np.linspace(0.0, 1.0, 20001)
    light = (t, 200.0 * np.exp(np.sin(6.0 * t)))
    exposures = exposures_of([light], 0.2, {0: np.arange(0.02, 0.95, 0.004)})
    told = np.diff(np.interp(np.arange(0.004, 0.97, 0.004), *light)) > 0  # rising light, at each event
    when = np.arange(len(told)) * 4_000_000 + 6_000_000
    zeros = np.zeros(len(told), int)
    right = Recording(Events.from_columns(when, zeros, zeros, told, 3, 1), exposures=exposures)
    wrong = replace(right, events=replace(right.events, p=1 - right.events.p))
    kept, mended = with_measured_light(right), with_measured_light(wrong)
    assert "polarity" not in kept.attributes
    assert mended.attributes["polarity"].startswith("ON and OFF exchanged")
    assert kept.events.p.tolist() == mended.events.p.tolist() == told.tolist()


def twice(events: Events) -> Events:
    """Two events of the first pixel."""
    return Events.from_columns([1000, 50_000_000], [0, 0], [0, 0], [1, 1], events.width, events.height)


def test_a_real_atis_recording_brings_its_light(shared, tmp_path):
    source, out = shared / "recordings" / "atis" / "gorchard_example_data.mat", tmp_path / "atis.h5"
    assert run(["convert", str(source), str(out), "--stimulus", "sensor", "--pixels", "60", "--quiet"]) == 0
    recording = open_recording(out)
    assert len(recording.stimulus.lights) == len(np.unique(recording.events.pixel)) == 60
    assert np.isfinite(EventTimes([with_fine_light(recording, "linear")]).log_likelihood(MODEL.circuit()))
    assert light_caveats([recording]) != []
    assert run(["convert", str(source), str(out), "--stimulus", "sensor", "--align", "auto"]) == 2


def test_a_measurement_that_the_next_breaks_off_is_left_out():
    t, p = np.array([0, 10, 20, 30, 50]) * 10**6, [0, 0, 1, 0, 1]
    pixel, middle, light = measurements(Events.from_columns(t, [0] * 5, [0] * 5, p, 1, 1))
    assert pixel.tolist() == [0, 0]
    np.testing.assert_allclose(middle, [0.015, 0.040])
    np.testing.assert_allclose(light, [100.0, 50.0])


def test_events_find_light_of_pixels_own_on_its_clock():
    """No two pixels of a row see the same steps, so that what they see on average tells little."""
    light = PixelLights.of_groups([steps(400.0, seed=k) for k in range(4)], np.tile(np.arange(4), (4, 1)))
    recording = simulate(MODEL, light, seed=3)
    late = replace(recording, events=replace(recording.events, t=recording.events.t + 2_345_678_000), stimulus=None)
    alignment = find_alignment(late, light, "auto")
    low, high = alignment.offset_interval_95
    assert low < 2.345678 < high
    assert high - low < 1e-4
    assert aligned(late, light, alignment).stimulus.size == (4, 4)
    flat = light.with_lights([replace(one, radiance=np.ones(len(one.t))) for one in light.lights])
    with pytest.raises(InputError, match="light is constant"):
        find_alignment(late, flat, "auto")
