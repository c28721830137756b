"""Where in its tick a stamp lies: the delay that stands for it, and searches behind stamps of a tick's end."""

from dataclasses import replace

import numpy as np
import pytest

from pixelid.gap.gap import gap
from pixelid.gap.imputation.windows import tick_windows, with_stamp_delay
from pixelid.model.shipped import find_model
from pixelid.simulate import simulate
from pixelid.stimuli.resample import resampled
from pixelid.stimuli.shapes import chirp, slow, steps

TICK_S = 5e-5
MODEL = find_model("dvs128")


def test_a_delay_of_half_a_tick_is_a_stamp_of_its_end():
    light = resampled(chirp(60.0, stop_hz=60.0, duration_s=0.3), "smooth")
    exact = simulate(MODEL, light, width=2, height=2, seed=1).events
    ticked = MODEL.with_effect("timestamp_quantisation", {"tick_s": TICK_S})
    events = simulate(ticked.set({"delay_s": 0.5 * TICK_S}), light, width=2, height=2, seed=1).events
    ends = np.ceil(exact.t / (1e9 * TICK_S)) * 1e9 * TICK_S
    np.testing.assert_array_equal(np.sort(events.t), np.sort(ends))


def test_true_times_and_their_delay_fill_the_window_of_a_stamp():
    """Whichever end of a tick is stamped, a delay within half a tick puts the true time into the window."""
    light = resampled(chirp(60.0, stop_hz=60.0, duration_s=0.3), "smooth")
    r = simulate(MODEL, light, width=2, height=2, seed=1)
    tick, half = 1e9 * TICK_S, 0.5e9 * TICK_S
    for round_to, delay in ((np.floor, -half), (np.rint, 0.0), (np.ceil, half)):
        stamped = replace(r, events=replace(r.events, t=(round_to(r.events.t / tick) * tick).astype(np.int64)))
        window = tick_windows(stamped, TICK_S)
        assert (window.lo <= r.events.t + delay).all()
        assert (r.events.t + delay <= window.hi).all()


def test_the_delay_is_free_within_half_a_tick_of_its_value():
    freed = with_stamp_delay(MODEL.set({"delay_s": 1e-3}), TICK_S).parameter("delay_s")
    assert freed.free
    assert (freed.lower, freed.value, freed.upper) == pytest.approx((1e-3 - 0.5 * TICK_S, 1e-3, 1e-3 + 0.5 * TICK_S))


@pytest.mark.slow
def test_stamps_of_the_end_of_a_tick_are_no_pole():
    """Of 64 pixels: of 9 the delay is known to 2 µs only, as ten sessions say (23 ± 2 µs), for cutoffs share it."""
    lights = {"chirp": chirp(24.0, stop_hz=200.0), "steps": steps(24.0, seed=1), "slow": slow(60.0, seed=2)}
    base = MODEL.without_effect("source_follower_pole")
    camera, recordings = base.set({"threshold_sigma": 0.02}), []
    for i, (name, light) in enumerate(lights.items()):
        r = simulate(camera, resampled(light, "smooth"), width=8, height=8, seed=i, sensor_seed=7)
        t = (np.ceil(r.events.t / (1e9 * TICK_S)) * 1e9 * TICK_S).astype(np.int64)
        events = replace(r.events, t=t, tick_ns=1)
        recordings.append(replace(r, events=events, stimulus=light, condition=name, attributes={}))
    report = gap(recordings, base, recommend=False)
    assert (report.verdict, [e.name for e in report.effects]) == ("named", ["timestamp_quantisation"])
    assert report.model.values["delay_s"] == pytest.approx(0.5 * TICK_S, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("stated", [1, 100_000])
@pytest.mark.parametrize(("strength", "known"), [(0.12, True), (0.0, True), (0.0, False)])
def test_a_tick_is_one_whoever_says_so(stated, strength, known):
    """Of 0.1 ms.  Stated by the file it was taken for a jitter, and where thresholds remember, the true model was told
    to lose events: times were drawn with the OFF threshold moved the wrong way."""
    base = MODEL.set({"threshold_sigma": 0.02, "refractory_s": 1.8e-4})
    base = base.with_effect("polarity_memory", {"strength": strength}) if strength else base
    camera, recordings = base.with_effect("timestamp_quantisation", {"tick_s": 1e-4}), []
    for i, light in enumerate((chirp(400.0, stop_hz=400.0), steps(24.0, seed=1))):
        r = simulate(camera, resampled(light, "smooth"), width=4, height=4, seed=i, sensor_seed=7)
        events = replace(r.events, tick_ns=stated)
        recordings.append(replace(r, events=events, stimulus=light, condition=f"part_{i}", attributes={}))
    report = gap(recordings, camera if known else base, recommend=False)
    assert [e.name for e in report.effects] == ([] if known else ["timestamp_quantisation"])
    assert report.verdict == ("none" if known else "named")
