"""What an effect would show, against refits and dense algebra, where times are known and where a readout blurs them."""

from dataclasses import replace

import numpy as np
import pytest

from pixelid import stages
from pixelid.fit.maximise import maximise
from pixelid.gap.attribute.candidates import variants
from pixelid.gap.attribute.directions import cosine, direction, residual_space
from pixelid.gap.detect.residuals import compare, residuals
from pixelid.gap.imputation.blur import blur_by, slopes_of, spreads
from pixelid.gap.imputation.imputed import JITTER, TICK, Imputation
from pixelid.gap.imputation.windows import Windows, jitter_windows, with_stamp_delay
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.shipped import find_model
from pixelid.recordings.own_light import with_fine_light
from pixelid.simulate import simulate
from pixelid.stimuli.resample import resampled
from pixelid.stimuli.shapes import chirp, steps

POLE, TICK_S = "differencing_pole", 7e-5
CAMERA = find_model("dvs128").set({"threshold_sigma": 0.02, "refractory_s": 1.7e-4, "threshold_mismatch.sigma": 0.03})


@pytest.fixture(scope="module")
def recordings():
    lights = {f"{name}_{level:g}": light for level in (24.0, 400.0) for name, light in {
        "chirp": chirp(level, stop_hz=level), "steps": steps(level, seed=3),
    }.items()}  # fmt: skip
    made = []
    for i, (name, light) in enumerate(lights.items()):
        r = simulate(CAMERA, resampled(light, "smooth"), width=3, height=2, seed=i, sensor_seed=1)
        made.append(with_fine_light(replace(r, stimulus=light, condition=name).within_stimulus(), "smooth"))
    return made


@pytest.fixture(scope="module")
def likelihood(recordings):
    return EventTimes(recordings)


def test_a_pole_shows_by_what_a_refit_gains(likelihood):
    """Dead time and a delay of the stamps imitate the amplifier, on steep edges as well as on flat ones."""
    whole = with_stamp_delay(CAMERA, TICK_S)
    less = maximise(likelihood, whole.without_effect(POLE), tolerance=0.01, max_steps=60)
    gain = maximise(likelihood, whole, tolerance=0.01, max_steps=60).value - less.value
    told = direction(residual_space(likelihood, less), POLE)
    assert gain < 5.0
    assert 0.5 * told.seen == pytest.approx(gain, abs=3.0)


def test_an_effect_that_nothing_imitates_shows_by_what_a_refit_gains(likelihood):
    """0.5 `seen` at the typical strength, and by the square of the strength elsewhere: the gain to second order."""
    rate_hz = 0.6
    leak = CAMERA.with_effect("leak", {"rate_hz": rate_hz})
    base = maximise(likelihood, CAMERA, tolerance=0.01, max_steps=40)
    typical = CAMERA.with_effect("leak").values["leak.rate_hz"]
    expected = 0.5 * direction(residual_space(likelihood, base), "leak").seen * (rate_hz / typical) ** 2
    leaky = []
    for i, r in enumerate(likelihood.recordings):
        made = simulate(leak, r.stimulus, width=3, height=2, seed=50 + i, sensor_seed=1)
        leaky.append(with_fine_light(replace(made, stimulus=r.stimulus).within_stimulus(), "smooth"))
    pool = EventTimes(leaky)
    with_it, without = (maximise(pool, model, tolerance=0.01, max_steps=40).value for model in (leak, CAMERA))
    assert expected > 100.0
    assert with_it - without == pytest.approx(expected, rel=0.25)  # two standard errors of the gain


def test_slopes_are_what_moved_stamps_do_to_levels(likelihood):
    circuit = CAMERA.circuit()
    here = likelihood.terms(circuit)
    slopes = slopes_of(likelihood, circuit, here)
    rng, h = np.random.default_rng(0), 1000
    moved, late = [], []
    for recording in likelihood.recordings:
        off = h * (rng.random(len(recording.events)) < 0.03)
        moved.append(replace(recording, events=replace(recording.events, t=recording.events.t + off)))
        late.append(off)
    if any((np.diff(r.events.t) < 0).any() for r in moved):
        moved = [replace(r, events=r.events.select(np.argsort(r.events.t, kind="stable"))) for r in moved]
    there = EventTimes(moved)
    order, again = slopes.order, np.lexsort((there.time_s, there.pixel, there.recording_of_event))
    shift = np.round(1e9 * (there.time_s[again] - likelihood.time_s[order]))
    change = there.terms(circuit).z[again] - here.z[order]
    alone = (shift == h) & ~slopes.aside[order]
    alone[1:] &= shift[:-1] == 0  # the event before stays
    np.testing.assert_allclose(change[alone] / (1e-9 * h), slopes.own[order][alone], rtol=0.1, atol=20.0)
    after = np.flatnonzero((shift[:-1] == h) & (shift[1:] == 0) & slopes.follows[1:]) + 1
    after = after[~slopes.aside[order][after]]
    assert alone.sum() > 20
    assert len(after) > 20
    np.testing.assert_allclose(change[after] / (1e-9 * h), slopes.before[order][after], rtol=0.1, atol=20.0)


def test_weighed_columns_have_the_information_of_dense_algebra(likelihood):
    rng, circuit = np.random.default_rng(1), CAMERA.circuit()
    sd = [rng.uniform(1e-6, 1e-4, len(r.events)) for r in likelihood.recordings]
    blur = blur_by(likelihood, circuit, sd)
    here = likelihood.terms(circuit)
    slopes = slopes_of(likelihood, circuit, here)
    some = slopes.order[:400]
    own, of = {}, {}
    for i, (recording, spread) in enumerate(zip(likelihood.recordings, sd, strict=True)):
        for t, pixel, value in zip(recording.events.t, recording.events.pixel, spread, strict=True):
            own[i, int(pixel), int(t)] = value
    for i, intervals in enumerate(likelihood.intervals):
        events = likelihood.recordings[i].events
        rows = np.flatnonzero(likelihood.recording_of_event == i)
        for row, event in zip(rows, intervals.event, strict=True):
            of[row] = (i, int(events.pixel[event]), int(events.t[event]))
    stamps = sorted(own)
    place = {stamp: k for k, stamp in enumerate(stamps)}
    A = np.zeros((len(some), len(stamps)))
    for k, row in enumerate(some):
        if slopes.aside[row]:
            continue
        at = place[of[row]]
        A[k, at] = slopes.own[row] / here.scale[row] * own[stamps[at]]
        A[k, at - 1] = slopes.before[row] / here.scale[row] * own[stamps[at - 1]]
    V = np.eye(len(some)) + A @ A.T
    column = np.zeros(likelihood.events)
    column[some] = rng.normal(size=len(some))
    weighed = blur.weigh(column)
    np.testing.assert_allclose(weighed[some] @ weighed[some], column[some] @ np.linalg.solve(V, column[some]))
    G = np.zeros((likelihood.events, blur.groups))
    G[np.arange(likelihood.events), blur.group] = 1.0
    rows = np.stack([blur.weigh(g) for g in G.T], axis=1)
    whole = blur.weigh(rng.normal(size=likelihood.events))
    left, *_ = np.linalg.lstsq(rows, whole, rcond=None)
    np.testing.assert_allclose(blur.without_pixel_means(whole), whole - rows @ left, atol=1e-8)


def test_a_blur_hides_what_exact_times_show(likelihood):
    """Fine times cost nothing; a coarse tick leaves an amplifier's pole without its trace and a leak with its own."""
    end = maximise(likelihood, CAMERA.without_effect("source_follower_pole"), tolerance=0.05, max_steps=60)
    exact = residual_space(likelihood, end)
    fine = residual_space(likelihood, end, [np.full(len(r.events), 1e-9) for r in likelihood.recordings])
    coarse = residual_space(likelihood, end, [np.full(len(r.events), 3e-4) for r in likelihood.recordings])
    for effect in ("source_follower_pole", "leak"):
        shown = [direction(at, effect).seen for at in (exact, fine, coarse)]
        assert shown[1] == pytest.approx(shown[0], rel=1e-2)
        assert shown[2] < shown[0]
    share = [direction(coarse, e).seen / direction(exact, e).seen for e in ("source_follower_pole", "leak")]
    assert share[0] < 0.3 * share[1]


def test_events_have_the_spread_of_their_own_window(recordings):
    """Whatever the order in which the readout and the times drawn put them."""
    rng = np.random.default_rng(2)
    windows, times = [], []
    for r in recordings:
        width = rng.uniform(1e3, 1e5, len(r.events))
        windows.append(Windows(r.events.t - width, r.events.t + width))
        times.append(r.events.t + rng.uniform(-1.0, 1.0, len(r.events)) * np.minimum(width, 2e4))
    whole = Imputation(TICK, (), tuple(recordings), tuple(windows), tuple(times), {}, {})
    drawn = whole.likelihood.recordings
    chosen = np.unique(recordings[0].events.pixel)[1:4]
    part = EventTimes([replace(r, events=r.events.select(np.isin(r.events.pixel, chosen))) for r in drawn])
    for got, r, w, t, original in zip(spreads(whole, part), part.recordings, windows, times, recordings, strict=True):
        wanted = {
            (int(p), round(x)): s
            for p, x, s in zip(original.events.pixel, t, 1e-9 * (w.hi - w.lo) / np.sqrt(12.0), strict=True)
        }
        same = [wanted[int(p), int(x)] for p, x in zip(r.events.pixel, r.events.t, strict=True)]
        np.testing.assert_allclose(got, same)
    jittered = tuple(jitter_windows(r, 5e-5) for r in recordings)
    behind_jitter = replace(whole, effect=JITTER, windows=jittered)
    np.testing.assert_allclose(np.concatenate(spreads(behind_jitter, part)), 5e-5)


MOVES = ("dark_current", "mains_flicker", "leak", "parasitic_photocurrent", "threshold_drift", "polarity_memory",
         "lower_cutoff")  # fmt: skip


@pytest.mark.parametrize("effect", MOVES)
def test_a_direction_is_taken_where_moves_are_linear(likelihood, effect):
    """A third of the strength moves the residuals a third as far, in the same direction."""
    at = residual_space(likelihood, maximise(likelihood, CAMERA, tolerance=0.05, max_steps=40))
    told = direction(at, effect)
    assert told is not None
    name = next(p.name for p in stages.effect(effect).parameters if p.free)
    alike = next(m for m in variants(at.fit.model, effect) if m.values[name] == told.strength)
    weaker = residuals(likelihood, alike.set({name: told.strength / 3.0}).circuit())
    level, log_scale = compare(at.here, weaker)
    kept = ~(at.here.background | weaker.background)
    moved = at.demeaned(np.concatenate([np.where(kept, level, 0.0), np.where(kept, np.sqrt(2.0) * log_scale, 0.0)]))
    if effect == "mains_flicker":  # of several phases the one that moves most is taken
        assert np.linalg.norm(moved) < 0.4 * np.linalg.norm(told.raw)
        return
    assert cosine(moved, told.raw) > 0.97
    ratio = np.linalg.norm(moved) / np.linalg.norm(told.raw)
    assert ratio == pytest.approx(1.0 / 3.0, rel=0.1)


@pytest.mark.parametrize(("effect", "name", "third"), [
    ("extra_pole", "extra_pole.cutoff_hz", 3.0), ("bandwidth_floor", "bandwidth_floor.radiance", 1.0 / 3.0),
])  # fmt: skip
@pytest.mark.parametrize("sd_s", [None, 1e-4])
def test_effects_that_show_at_once_have_a_direction_too(likelihood, effect, name, third, sd_s):
    """A hundredth of their usual strength moves every residual far."""
    fit = maximise(likelihood, CAMERA, tolerance=0.05, max_steps=40)
    unknown = None if sd_s is None else [np.full(len(r.events), sd_s) for r in likelihood.recordings]
    at = residual_space(likelihood, fit, unknown)
    told = direction(at, effect)
    assert told is not None
    weaker = residuals(likelihood, fit.model.with_effect(effect, {name: third * told.strength}).circuit())
    level, log_scale = compare(at.here, weaker)
    kept = ~(at.here.background | weaker.background)
    moved = np.concatenate([np.where(kept, level, 0.0), np.where(kept, np.sqrt(2.0) * log_scale, 0.0)])
    moved = at.demeaned(at.weighed(moved))
    assert cosine(moved, told.raw) > 0.97
    assert np.linalg.norm(moved) / np.linalg.norm(told.raw) == pytest.approx(1.0 / 3.0, rel=0.1)


def test_what_only_takes_events_away_has_no_direction(likelihood):
    at = residual_space(likelihood, maximise(likelihood, CAMERA, tolerance=0.05, max_steps=40))
    assert direction(at, "lost_events") is None
    assert direction(at, "dead_time_without_reset") is None
