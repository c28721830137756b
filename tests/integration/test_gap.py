"""The gap: residuals that are normal when the model is right, signatures, windows that hold the truth, verdicts."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats
from scipy.interpolate import CubicSpline

from pixelid.cli.main import main
from pixelid.cluster import Where, Work
from pixelid.design.menu import candidate
from pixelid.errors import InputError
from pixelid.fit import fit as fitted
from pixelid.fit.coordinates import Coordinates
from pixelid.fit.maximise import maximise, maximise_with_restarts
from pixelid.gap.attribute.candidates import canonical, missing
from pixelid.gap.attribute.pixels import candidates_of
from pixelid.gap.attribute.significance import chance_of_gain, leads
from pixelid.gap.confirm.free_run import FreeRun, closes_nothing, free_run
from pixelid.gap.criteria import Criteria
from pixelid.gap.detect import covariates
from pixelid.gap.detect.covariates import sort_events
from pixelid.gap.detect.maps import map_residuals
from pixelid.gap.detect.residuals import Tangents, residuals, tangents
from pixelid.gap.gap import gap
from pixelid.gap.imputation.draws import draw_times
from pixelid.gap.imputation.imputed import uneven
from pixelid.gap.imputation.windows import jitter_windows, queue_windows, with_times
from pixelid.gap.options import Context, Options
from pixelid.gap.phases import Phase
from pixelid.gap.result import Named
from pixelid.gap.search import begin
from pixelid.gap.shot_noise.beside import chance_of_excess
from pixelid.gap.split import split_pixels
from pixelid.gap.steps import confirm as confirming
from pixelid.gap.steps.describe_remainder import Described
from pixelid.gap.steps.name_effect import name_effect
from pixelid.inspection.timestamps import find_grid, find_service_time
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.shipped import find_model
from pixelid.recordings import Events, Recording, open_recordings, write_recording
from pixelid.recordings.selection import only
from pixelid.simulate import Twins, simulate
from pixelid.stimuli.course import course
from pixelid.stimuli.resample import resampled
from pixelid.stimuli.shapes import chirp, constant, sine, slow, steps
from pixelid.stimuli.stimulus import Stimulus

CASES = Path(__file__).resolve().parents[3] / "shared" / "gap_cases"
MODEL = find_model("dvs128")


def session(model, side=3, seed=0, lights=None):
    """A small session of one camera: conditions → recordings whose stimuli are as recorded, not as simulated."""
    lights = lights or {
        "chirp_24": chirp(24.0, stop_hz=200.0), "steps_24": steps(24.0, seed=1), "slow_24": slow(24.0, seed=2),
        "constant_24": constant(24.0), "chirp_400": chirp(400.0, stop_hz=400.0), "steps_400": steps(400.0, seed=3),
    }  # fmt: skip
    sessions = []
    for i, (name, light) in enumerate(lights.items()):
        r = simulate(model, resampled(light, "smooth"), width=side, height=side, seed=100 * seed + i, sensor_seed=seed)
        sessions.append(replace(r, stimulus=light, condition=name, attributes={}))
    return sessions


def likelihood_of(recordings):
    return EventTimes([r.with_stimulus(resampled(r.stimulus, "smooth")) for r in recordings])


@pytest.fixture(scope="module")
def plain():
    """(likelihood, residuals, tangents, cells) of the true model of a session."""
    likelihood, coordinates = likelihood_of(session(MODEL, side=4, seed=3)), Coordinates.of(MODEL)
    here = residuals(likelihood, MODEL.circuit())
    cells = sort_events(likelihood, MODEL.circuit(), here)
    return likelihood, here, tangents(likelihood, coordinates, coordinates.start, here), cells


# --- the light between its samples ---


def test_corners_between_samples_are_found():
    t = np.arange(0.0, 0.05, 5e-5)
    corners = np.array([0.0, 0.00512, 0.00533, 0.02017, 0.02051, 0.05])
    values = np.array([0.0, 0.0, 0.7, 0.7, -0.2, -0.2])
    interpolated = course(t, np.interp(t, corners, values))
    np.testing.assert_allclose(interpolated.corners, corners[1:-1], atol=1e-9)
    fine = np.linspace(0.0, t[-1], 7001)
    np.testing.assert_allclose(interpolated(fine), np.interp(fine, corners, values), atol=1e-9)


def test_smooth_light_is_a_spline_and_a_jump_a_straight_line():
    t = np.arange(0.0, 0.05, 5e-5)
    u = np.sin(2 * np.pi * 90 * t)
    fine = np.linspace(0.0, t[-1], 3001)
    np.testing.assert_allclose(course(t, u)(fine), CubicSpline(t, u)(fine), atol=1e-12)
    jump = np.where(t < 0.0201, 1.0, 2.0)
    between = course(t, jump)(np.array([t[401], 0.5 * (t[401] + t[402]), t[402]]))
    assert np.all(np.diff(between) >= 0)
    assert between[0] in (1.0, 2.0)


# --- residuals ---


def test_residuals_of_the_truth_are_standard_normal():
    model = MODEL.set({"threshold_sigma": 0.03})
    likelihood = likelihood_of(session(model, side=4))
    z = residuals(likelihood, model.circuit())
    assert z.background.sum() == 0
    n = len(z.e)
    assert n > 3000
    assert abs(z.e.mean()) < 4 / np.sqrt(n)
    assert abs(z.e.std() - 1.0) < 4 / np.sqrt(2 * n) + 16 * 2 / n  # each group's threshold is its own estimate
    assert stats.kstest(z.e, "norm").pvalue > 1e-3


def test_maps_find_a_shift_where_it_is_and_nothing_where_there_is_none(plain):
    likelihood, here, tangent, cells = plain
    assert map_residuals(likelihood, here, tangent, cells, Criteria(), 0).p > 0.01
    pair = cells[0]
    moved = replace(here, e=here.e + 0.5 * (pair.cell == pair.labels.index("ON after OFF")))
    mapped = map_residuals(likelihood, moved, tangent, cells, Criteria(), 0)
    assert mapped.p < 0.01
    top = next(c for c in mapped.cells if c.response == "level")
    assert top.factor == "the previous event's polarity"
    assert top.label.startswith("ON after")


@pytest.mark.parametrize(("on", "off"), [(1.3, 0.8), (1.0, 1.0)])
def test_maps_find_that_one_polarity_scatters_more(plain, on, off):
    """Noise goes with the threshold, so that another threshold of ON events could pass for more noise of theirs."""
    likelihood, here, tangent, cells = plain
    scattered = replace(here, e=here.e * np.where(likelihood.sign > 0, on, off))
    maps = map_residuals(likelihood, scattered, tangent, cells, Criteria(), 0)
    if on == off:
        assert maps.p > 0.01
        return
    top = maps.cells[0]
    assert maps.p < 1e-3
    assert top.response == "spread"
    assert (top.label, top.score > 0) in (("all ON events", True), ("all OFF events", False))


def test_squares_of_residuals_know_how_much_their_own_threshold_took():
    """Of a few events of a pixel and polarity, their common threshold takes a good part of what they scatter."""
    model = MODEL.set({"threshold_mismatch.sigma": 0.3})
    t = np.arange(0.0, 0.02, 2e-4)
    light = Stimulus(t, 4000.0 * np.exp(0.35 * np.sin(2 * np.pi * 50 * t)))
    recording = simulate(model, resampled(light, "smooth"), width=30, height=30, seed=5)
    likelihood = likelihood_of([recording.with_stimulus(light)])
    here = residuals(likelihood, model.circuit())
    n = len(here.e)
    assert n > 1000
    assert here.taken.mean() > 0.1
    assert abs((here.e**2 - 1.0 + here.taken).mean()) < 4 * np.sqrt(2 / n)
    assert abs((here.e**2 - 1.0).mean()) > 4 * np.sqrt(2 / n)


def test_speeds_that_are_all_the_same_cut_nothing_in_a_true_model(monkeypatch):
    """At a limit of the slew most fast changes have its speed."""
    slewed = MODEL.set({"threshold_sigma": 0.02}).with_effect(
        "slew_limit", {"rise_per_s": 1100.0, "fall_per_s": 1100.0}
    )
    likelihood = likelihood_of(session(slewed, side=5, seed=3, lights={"chirp_400": chirp(400.0, stop_hz=400.0)}))
    coordinates = Coordinates.of(slewed)
    here = residuals(likelihood, slewed.circuit())
    tangent = tangents(likelihood, coordinates, coordinates.start, here)

    def p():
        cells = sort_events(likelihood, slewed.circuit(), here)
        return map_residuals(likelihood, here, tangent, cells, Criteria(), 0).p_normal

    assert p() > 0.01
    monkeypatch.setattr(covariates, "SPEED_BLUR", 0.0)
    assert p() < 1e-10


@pytest.mark.slow
def test_what_sessions_simulated_from_the_model_leave_too_is_nothing(monkeypatch):
    """Of maps that err by themselves (see above) a bootstrap says that a true model leaves as much, and only then."""
    slewed = MODEL.set({"threshold_sigma": 0.02}).with_effect(
        "slew_limit", {"rise_per_s": 1100.0, "fall_per_s": 1100.0}
    )
    remembering = slewed.with_effect("polarity_memory", {"strength": 0.05})
    monkeypatch.setattr(covariates, "SPEED_BLUR", 0.0)
    for true, verdict in ((slewed, "none"), (remembering, "unknown")):
        recordings = session(true, side=6, seed=3, lights={"chirp_400": chirp(400.0, stop_hz=400.0)})
        report = gap(recordings, slewed, leave_out=["polarity_memory"], recommend=False)
        (looked_at,) = (entry["bootstrap"] for entry in report.rounds if "bootstrap" in entry)
        assert report.verdict == verdict
        assert (looked_at["p_of_what_is_left"] >= 0.005) == (verdict == "none")


def test_maps_do_not_depend_on_the_rounding_of_what_parameters_move(plain):
    likelihood, here, tangent, cells = plain
    rng = np.random.default_rng(0)
    rounded = Tangents(
        *(J + 1e-8 * rng.standard_t(2, J.shape) * (J != 0) for J in (tangent.level, tangent.log_scale, tangent.apart))
    )
    one, other = (
        {(c.response, c.label): c.score for c in map_residuals(likelihood, here, t, cells, Criteria(), 0).cells}
        for t in (tangent, rounded)
    )
    assert one.keys() == other.keys()
    assert max(abs(one[key] - other[key]) for key in one) < 1e-3


def test_a_lead_needs_to_be_beyond_its_scatter():
    assert leads(np.array([3.0, 2.0, 4.0]), Criteria())
    assert not leads(np.array([9.0, -8.0, 1.0]), Criteria())
    assert leads(np.array([9.0, -8.0, 1.0]), replace(Criteria(), min_lead_standard_errors=0.01))


def test_chance_of_a_gain_is_that_of_a_strength_on_its_boundary():
    assert chance_of_gain("leak", 0.5 * 3.841, 1) == pytest.approx(0.025, rel=1e-3)  # half of χ²'s 5 %
    assert chance_of_gain("leak", 0.5 * 3.841, 10) == pytest.approx(0.25, rel=1e-3)
    assert chance_of_gain("leak", -1.0, 3) == 1.0


def test_criteria_are_positive():
    with pytest.raises(InputError, match="min_lead_nats"):
        Criteria(min_lead_nats=-1.0)


def test_jitter_is_one_normal_for_all():
    recording = session(MODEL, side=2, lights={"slow_24": slow(24.0, seed=2)})[0]
    window, rng = jitter_windows(recording, 5e-5), np.random.default_rng(0)
    t = window.stamp - window.sd * rng.standard_normal(len(window.stamp))
    assert not uneven([recording], [window], [t], 0.1, 0.005)
    one_polarity_late = window.stamp - window.sd * np.where(recording.events.p == 1, 1.0, 0.1)
    assert uneven([recording], [window], [one_polarity_late + rng.normal(0, 0.3 * window.sd, len(t))], 0.1, 0.005)


@pytest.mark.parametrize("few", [2, 16, 40])
def test_a_few_events_do_not_speak_against_a_jitter(few):
    """Three hundred times one recording with a few events beside one with many."""
    rng, wrong = np.random.default_rng(few), 0
    many = session(MODEL, side=2, lights={"chirp_24": chirp(24.0, stop_hz=200.0)})[0]
    rare = replace(many, events=many.events.select(np.arange(few)))
    windows = [jitter_windows(r, 5e-5) for r in (many, rare)]
    for _ in range(300):
        times = [w.stamp - w.sd * rng.standard_normal(len(w.stamp)) for w in windows]
        wrong += uneven([many, rare], windows, times, 0.1, 0.005)
    assert wrong <= 6  # 0.005 of 300, and four standard deviations
    late = [w.stamp - w.sd * (1.0 + rng.standard_normal(len(w.stamp))) for w in windows]
    assert uneven([many, rare], windows, late, 0.1, 0.005)


# --- readout ---


def test_service_time_is_read_off_the_timestamps():
    queued = MODEL.with_effect("readout_latency", {"service_s": 2.5e-5})
    service = find_service_time(session(queued, side=5))
    assert service is not None
    assert service.p < 1e-12
    assert service.value == pytest.approx(2.5e-5, rel=1e-3)
    assert find_service_time(session(MODEL, side=5)) is None


def test_grid_of_timestamps():
    ticked = MODEL.with_effect("timestamp_quantisation", {"tick_s": 2e-4})
    recordings = [replace(r, events=replace(r.events, tick_ns=1)) for r in session(ticked, side=4)]
    grid = find_grid(recordings)
    assert grid is not None
    assert grid.value == pytest.approx(2e-4, rel=1e-3)
    assert find_grid(session(MODEL, side=4)) is None


def test_a_grid_is_found_through_the_rounding_of_floats_and_rounding_alone_is_none():
    ticked = MODEL.with_effect("timestamp_quantisation", {"tick_s": 2e-5})
    for model, tick in ((ticked, 2e-5), (MODEL, None)):
        rounded = [
            replace(r, events=replace(r.events, t=16 * np.rint(r.events.t / 16 + rng.normal(0.0, 2.5, len(r.events)))
                                      .astype(np.int64), tick_ns=1))
            for rng in [np.random.default_rng(0)] for r in session(model, side=4)
        ]  # fmt: skip
        found = find_grid([replace(r, events=replace(r.events, t=np.sort(r.events.t))) for r in rounded])
        if tick is None:
            assert found is None
        else:
            assert found is not None
            assert found.value == pytest.approx(tick, rel=1e-4)


def test_queue_windows_hold_the_arrivals():
    light = {"steps_400": steps(400.0, seed=3)}
    arrivals = session(MODEL, side=5, lights=light)[0].events
    queued = MODEL.with_effect("readout_latency", {"service_s": 3e-5})
    recording = session(queued, side=5, lights=light)[0]
    window = queue_windows(recording, 3e-5)
    assert len(arrivals) == len(window.lo)  # first come, first served: departures keep the order
    assert (arrivals.t >= window.lo - 2).all()
    assert (arrivals.t <= window.hi + 2).all()
    exact = window.hi == window.lo
    assert 0.02 < exact.mean() < 1.0
    np.testing.assert_allclose(arrivals.t[exact], window.lo[exact], atol=2)


# --- slew limit in the likelihood, twins in the simulator ---


def test_levels_at_events_of_a_slewing_pixel_are_its_thresholds():
    exact = MODEL.without_effect("threshold_mismatch").set({"threshold_sigma": 1e-5})
    slewing = exact.with_effect("slew_limit", {"rise_per_s": 400.0, "fall_per_s": 250.0})
    recordings = session(slewing, side=1, lights={"steps_400": steps(400.0, seed=3)})
    likelihood = likelihood_of(recordings)
    terms = likelihood.terms(slewing.set({"threshold_sigma": 0.01}).circuit())
    np.testing.assert_allclose(terms.z, 0.25, rtol=2e-4)
    plain = likelihood.terms(exact.set({"threshold_sigma": 0.01}).circuit())
    assert np.abs(plain.z - 0.25).max() > 0.02  # the limit matters here


def test_what_was_taken_back_leaves_what_the_base_leaves(monkeypatch):
    """Sentence, cells and the flexible alternative are the base model's, and the round says that its effect is gone."""
    monkeypatch.setattr(confirming, "closes_nothing", lambda *_: True)
    monkeypatch.setattr(confirming, "describe_remainder", lambda *_: Described())
    lights = {"constant": constant(24.0), "chirp": chirp(24.0, stop_hz=50.0)}
    report = gap(session(MODEL.with_effect("leak", {"rate_hz": 20.0}), side=2, lights=lights), MODEL, recommend=False)
    assert (report.verdict, report.effects, report.details["withdrawn"]) == ("unknown", (), ["leak"])
    assert report.details["remaining"] == report.details["seen_before"]
    assert report.details["remaining_p"] < 0.005
    assert report.term is not None
    assert [one["withdrawn"] for one in report.rounds if one["named"] == "leak"] == [confirming.TAKEN_BACK]


def test_twins_keep_their_thresholds_and_wait_for_their_release():
    light = slow(24.0, seed=2)
    exact = MODEL.without_effect("threshold_mismatch").set({"threshold_sigma": 1e-5})
    twins = Twins(np.array([0.1, 0.4]), np.array([0.1, 0.4]), np.array([0.2, 0.5]))
    events = simulate(exact, resampled(light), width=2, height=1, seed=1, twins=twins).events
    for pixel, fired in enumerate(twins.event_s):
        assert (events.t[events.pixel == pixel] * 1e-9 > fired + exact.values["refractory_s"]).all()
    assert np.sum(events.pixel == 0) > 2 * np.sum(events.pixel == 1)
    memory = exact.with_effect("leak", {"rate_hz": 10.0}).with_effect("polarity_memory", {"strength": 0.2})
    after = replace(twins, on=np.full(3, 0.25), off=np.full(3, 0.25), event_s=np.full(3, 0.1))
    after = replace(after, after=np.array([1.0, 0.0, -1.0]))
    dark = constant(24.0)
    events = simulate(memory, dark, width=3, height=1, seed=1, twins=after).events
    first = [events.t[events.x == x][0] * 1e-9 for x in range(3)]
    first_free = 0.1 + exact.values["refractory_s"]
    np.testing.assert_allclose(first, first_free + 0.1 * np.array([1.2, 1.0, 0.8]), rtol=1e-3)
    longer = "described.dead_time.previous_polarity.constant"  # after ON 30 ms more, after OFF none
    dead = exact.with_effect("leak", {"rate_hz": 10.0}).with_effect(longer, {"strength": 0.03})
    events = simulate(dead, dark, width=3, height=1, seed=1, twins=after).events
    first = [events.t[events.x == x][0] * 1e-9 for x in range(3)]
    dead_s = exact.values["refractory_s"] + np.array([0.03, 0.0, -exact.values["refractory_s"]])
    np.testing.assert_allclose(first, 0.1 + dead_s + 0.1, rtol=1e-3)
    with pytest.raises(InputError, match="twins"):
        simulate(exact, light, width=3, height=1, twins=twins)


def test_free_run_gap_of_the_truth_is_chance_and_of_a_wrong_model_is_not():
    leaking = MODEL.with_effect("leak", {"rate_hz": 3.0})
    recordings = session(leaking, side=3, seed=5)
    fine = [r.with_stimulus(resampled(r.stimulus, "smooth")) for r in recordings]
    run = free_run(fine, fine, np.arange(9), np.arange(9), 16, MODEL, leaking, Criteria(), 0)
    assert run.after < 2.5 < run.before
    assert run.closed is not None
    assert run.closed > 0.8


# --- the whole search ---


def test_split_is_by_pixels_and_repeatable():
    recordings = session(MODEL, side=5)
    split = split_pixels(recordings, 7)
    parts = np.concatenate([split.fit, split.select, split.confirm])
    assert len(np.unique(parts)) == len(parts) == 25
    assert split.apart
    np.testing.assert_array_equal(split_pixels(recordings, 7).confirm, split.confirm)
    assert set(only(recordings, split.confirm)[0].events.pixel) <= set(split.confirm)


def test_poles_that_commute_are_named_by_convention():
    grown = MODEL.with_effect("extra_pole", {"cutoff_hz": 3100.0}).set({"sf_cutoff_hz": 900.0})
    assert canonical(grown, MODEL).values["extra_pole.cutoff_hz"] == 900.0
    assert "leak" in missing(MODEL)
    assert "refractory_period" not in missing(MODEL)


@pytest.mark.slow
def test_a_dead_time_far_above_the_shipped_one_is_fitted(shared):
    recordings = open_recordings(sorted((shared / "gap_cases" / "refractory").glob("*.h5")))
    state = begin(recordings, MODEL, Context(Options(alpha=0.01, seed=0)))
    assert MODEL.values["refractory_s"] < 1.5e-3 / 10
    assert state.base.model.values["refractory_s"] == pytest.approx(1.5e-3, rel=1e-3)
    assert state.base.model.values["threshold_sigma"] == pytest.approx(0.02, rel=0.05)  # not noise in place of filters
    assert state.first.p > 0.01


def test_leak_is_found_and_nothing_in_its_absence():
    leaking = MODEL.with_effect("leak", {"rate_hz": 3.0})
    report = gap(session(leaking, side=4, seed=1), MODEL)
    assert (report.verdict, [e.name for e in report.effects]) == ("named", ["leak"])
    value, interval = report.effects[0].parameters["leak.rate_hz"]
    assert interval is not None
    assert report.free_run is not None
    assert report.free_run.closed is not None
    assert interval[0] < 3.0 < interval[1]
    assert value == pytest.approx(3.0, rel=0.1)
    assert report.free_run.closed > 0.8
    nothing = gap(session(MODEL, side=4, seed=2), MODEL)
    assert (nothing.verdict, nothing.effects, nothing.remainder) == ("none", (), False)


@pytest.mark.slow
@pytest.mark.parametrize(
    "planted",
    [
        {"parasitic_photocurrent": {"rate_hz_per_radiance": 5e-3}, "threshold_drift": {"per_s": 0.1}},
        {"slew_limit": {"rise_per_s": 600.0, "fall_per_s": 300.0}},
    ],
    ids="+".join,
)
def test_all_that_is_missing_is_named_and_nothing_else(planted):
    """Two effects that explain about as much as each other, and a strong limit, which once left a remainder."""
    truth = MODEL
    for effect, values in planted.items():
        truth = truth.with_effect(effect, values)
    report = gap(session(truth, side=5, seed=23), MODEL)
    assert (report.verdict, sorted(e.name for e in report.effects)) == ("named", sorted(planted))
    for effect in report.effects:
        for name, (value, _) in effect.parameters.items():
            assert value == pytest.approx(truth.values[name], rel=0.1), name


@pytest.mark.slow
@pytest.mark.parametrize(("sigma_s", "dead_s"), [(2e-5, 1e-4), (5e-5, 2.5e-4), (5e-5, 1.2e-4)])
def test_true_times_behind_a_jitter_are_found_and_nothing_is_left(sigma_s, dead_s):
    truth = MODEL.with_effect("timestamp_jitter", {"sigma_s": sigma_s}).set({"refractory_s": dead_s})
    report = gap(session(truth, side=5, seed=5), MODEL)
    assert (report.verdict, [e.name for e in report.effects]) == ("named", ["timestamp_jitter"])
    value, _ = report.effects[0].parameters["timestamp_jitter.sigma_s"]
    assert value == pytest.approx(sigma_s, rel=0.04)


@pytest.mark.slow
def test_times_are_drawn_again_under_a_model_that_has_gained_an_effect():
    """Drawn once, under a base without dark current, times behind a tick hide an eighth of it."""
    truth = MODEL.with_effect("dark_current", {"radiance": 2.0})
    truth = truth.with_effect("timestamp_quantisation", {"tick_s": 5e-5})
    as_in_files = [replace(r, events=replace(r.events, tick_ns=1)) for r in session(truth, side=5, seed=6)]
    report = gap(as_in_files, MODEL)
    assert (report.verdict, {e.name for e in report.effects}) == ("named", {"timestamp_quantisation", "dark_current"})
    dark = next(e for e in report.effects if e.name == "dark_current")
    assert dark.parameters["dark_current.radiance"][0] == pytest.approx(2.0, rel=0.03)


@pytest.mark.slow
def test_draws_of_times_have_the_density_that_they_should():
    """One event of a pixel, all others known: many exact draws against its density by quadrature."""
    model, sd, rng = MODEL.set({"refractory_s": 2e-4}), 4e5, np.random.default_rng(0)
    recording = session(model, side=1, seed=4, lights={"sine": sine(200.0, frequency_hz=40.0)})[0]
    recording = recording.with_stimulus(resampled(recording.stimulus, "smooth"))
    window = jitter_windows(recording, 1e-9 * sd)
    t = window.stamp
    k = 1 + int(np.argmax(np.abs(np.diff(t, 2))))  # where the waits before and after differ most
    mine = np.arange(len(t)) == k
    window = replace(window, lo=np.where(mine, window.lo, t), hi=np.where(mine, window.hi, t))
    now, draws = [t], []
    for _ in range(1500):
        now = draw_times([recording], [window], now, model, rng, exact=True).times
        draws.append(now[0][k])
    grid = np.linspace(t[k - 1] + 2e5, t[k + 1] - 2e5, 401)[1:-1]
    moved = [[np.where(mine, at, t)] for at in grid]
    total = [EventTimes(with_times([recording], times)).terms(model.circuit()).total for times in moved]
    log_density = np.array(total) - 0.5 * ((grid - t[k]) / sd) ** 2
    weight = np.exp(log_density - log_density.max())
    mean = float(weight @ grid / weight.sum())
    spread = float(np.sqrt(weight @ (grid - mean) ** 2 / weight.sum()))
    assert np.mean(draws) == pytest.approx(mean, abs=0.15 * spread)
    assert np.std(draws) == pytest.approx(spread, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("density", [3.2e-5, 3.2e-4])
def test_shot_noise_is_found_by_simulation(density):
    report = gap(session(MODEL.with_effect("shot_noise", {"density": density}), side=4, seed=4), MODEL)
    assert (report.verdict, [e.name for e in report.effects]) == ("named", ["shot_noise"])
    value, interval = report.effects[0].parameters["shot_noise.density"]
    assert interval is not None
    assert interval[0] < density < interval[1]
    assert value == pytest.approx(density, rel=0.15)


@pytest.mark.slow
def test_a_missing_pole_is_named_beside_shot_noise():
    """Maps of shot noise alone look like the measurement's, the other pole in the place of both."""
    report = gap(session(MODEL.with_effect("shot_noise"), side=4, seed=2), MODEL.without_effect("source_follower_pole"))
    assert (report.verdict, {e.name for e in report.effects}) == ("named", {"source_follower_pole", "shot_noise"})
    _, interval = report.effects[0].parameters["sf_cutoff_hz"]
    assert interval is not None
    assert interval[0] < MODEL.values["sf_cutoff_hz"] < interval[1]


def test_a_gain_that_sessions_without_the_effect_show_as_well_is_chance():
    """Roots of twice a gain are normal about a share that comes of an approximation, each session's its own."""
    rng = np.random.default_rng(0)
    for usual in (0.0, 5.0, 30.0):
        of_session = usual * (1.0 + 0.2 * rng.normal(size=(4000, 3)))
        gains = 0.5 * np.maximum(of_session + rng.normal(size=(4000, 3)), 0.0) ** 2
        p = np.array([chance_of_excess(one[0], one[1:], 1, Criteria()) for one in gains])
        assert (p < 0.005).mean() < 0.009
        assert chance_of_excess(0.5 * (2.5 * usual + 7.0) ** 2, gains[0, 1:], 10, Criteria()) < 0.005


def test_a_pole_that_ran_away_comes_back(plain):
    likelihood = plain[0]
    without = maximise(likelihood, MODEL.without_effect("differencing_pole"), tolerance=1e-3, max_steps=60)
    away = without.model.with_effect("differencing_pole", {"diff_cutoff_hz": 1e8})
    assert maximise(likelihood, away, tolerance=0.05, max_steps=25).values["diff_cutoff_hz"] > 1e7
    assert maximise_with_restarts(likelihood, away, MODEL, tolerance=0.05, max_steps=25).values["diff_cutoff_hz"] < 5e4


def test_a_photoreceptor_that_ran_away_comes_back_whole():
    """With its rates alone put back, the light at which it is fast would stay where it went."""
    lights = {"chirp_24": chirp(24.0, stop_hz=200.0), "steps_24": steps(24.0, seed=1)}
    likelihood = likelihood_of(session(MODEL, side=2, seed=3, lights=lights))
    away = MODEL.set({"alpha": 2e10, "beta": 8e8, "gamma": 1e-7, "threshold_sigma": 0.2})
    assert maximise(likelihood, away, tolerance=0.05, max_steps=25).values["beta"] > 1e7
    back = maximise_with_restarts(likelihood, away, MODEL, tolerance=0.05, max_steps=25)
    truth = likelihood.log_likelihood(MODEL.circuit())
    assert back.value > truth
    for name in ("alpha", "beta"):
        assert back.values[name] == pytest.approx(MODEL.values[name], rel=0.1)


def test_cells_of_one_pool_serve_another(plain):
    theirs, circuit, first = likelihood_of(session(MODEL, side=3, seed=3)), MODEL.circuit(), plain[3]
    other = sort_events(theirs, circuit, residuals(theirs, circuit), like=first)
    assert [f.labels for f in first] == [f.labels for f in other]
    for factor in other:
        assert factor.cell.min() >= 0
        assert factor.cell.max() < len(factor.labels)


def test_a_free_run_that_closes_nothing_withdraws_a_name():
    def run(closed, interval):
        return FreeRun(9.0, 9.0, 1.0, closed, interval, {})

    assert closes_nothing(run(-3.0, (-20.0, -0.1)), False, Criteria())
    assert not closes_nothing(run(-0.2, (-20.0, 3.0)), False, Criteria())  # a gap too small to tell
    assert closes_nothing(run(0.05, (-1.0, 0.6)), True, Criteria())
    assert not closes_nothing(run(0.6, (0.5, 0.7)), True, Criteria())


@pytest.mark.parametrize(("lost", "verdict"), [((), "named"), (("dim",), "unknown")])
def test_a_gap_that_stays_open_counts_where_recordings_were_left_out_of_the_maps(monkeypatch, lost, verdict):
    """A session was once `named` with 4 % of its gap closed: what showed the rest had been left out."""
    named = Named("leak", 0.0, 9.0, None, None, 0.0, "", {}, "")
    monkeypatch.setattr(confirming, "_named", lambda *_: (named,))
    monkeypatch.setattr(confirming, "_shot_noise", lambda *_: ())
    monkeypatch.setattr(confirming, "free_run_of", lambda *_: FreeRun(9.0, 6.0, 1.0, 0.4, (0.2, 0.6), {}))
    state = SimpleNamespace(remainder=lambda alpha: False, new_signatures=(), shot_noise=None, lost=lost)
    context = Context(Options(), None, lambda what, share: None)
    found = confirming._confirmed(state, None, (), "named", context)
    assert (found.verdict, found.effects) == (verdict, (named,))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("truth", "alike", "resolved"),
    [
        (
            MODEL.set({"on_threshold": 0.24, "off_threshold": 0.26}),
            "leak and unequal thresholds look the same",
            ("none", []),
        ),
        # one level of light: what drifts by itself drifts as what its light drives
        (MODEL.with_effect("leak", {"rate_hz": 0.5}), "or parasitic_photocurrent", ("named", ["leak"])),
    ],
)
def test_what_one_sine_cannot_tell_apart_the_recommended_stimulus_can(truth, alike, resolved):
    lights = {"sine_400": sine(400.0, frequency_hz=2.0)}
    first = gap(session(truth, side=5, seed=4, lights=lights), MODEL)
    assert first.verdict == "ambiguous"
    assert alike in first.sentence
    advised = first.recommended_next["stimulus"]
    lights[advised["name"]] = candidate(advised["name"], advised["kind"], **advised["parameters"]).stimulus
    then = gap(session(truth, side=5, seed=4, lights=lights), MODEL)
    assert (then.verdict, [e.name for e in then.effects]) == resolved


def test_maps_of_a_true_model_under_one_sine_show_nothing():
    # late events gather where waits are long, and the speed at an event depends on how late it is: neither may show
    report = gap(session(MODEL, side=4, seed=3, lights={"sine_400": sine(400.0, frequency_hz=20.0)}), MODEL)
    assert (report.verdict, report.remainder) == ("none", False)


def test_an_interrupted_search_goes_on(tmp_path):
    recordings = session(MODEL, side=3, seed=4, lights={"slow_24": slow(24.0, seed=2), "steps_24": steps(24.0, seed=1)})
    kept = tmp_path / "fits"

    def stop(what, fraction):
        if fraction > 0.7:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        gap(recordings, MODEL, progress=stop, resume=kept)
    made = kept.read_text().count("key")
    assert made > 3
    kept.write_text(kept.read_text()[:-7])  # cut off within a line
    again = gap(recordings, MODEL, resume=kept)
    assert not kept.exists()
    plain = gap(recordings, MODEL)
    assert again.base.values == plain.base.values
    assert (again.verdict, again.global_p, again.rounds) == (plain.verdict, plain.global_p, plain.rounds)


@pytest.mark.slow
@pytest.mark.parametrize(("effect", "strength"), [("leak", {"rate_hz": 5.0}), ("shot_noise", {"density": 3.2e-4})])
def test_workers_change_nothing(effect, strength, tmp_path):
    lights = {"slow_24": slow(24.0, seed=2), "steps_24": steps(24.0, seed=1), "constant_24": constant(24.0)}
    recordings = session(MODEL.with_effect(effect, strength), side=3, seed=4, lights=lights)
    alone = gap(recordings, MODEL, resume=tmp_path / "fits", recommend=False)
    began = []
    shared = gap(
        recordings, MODEL, resume=tmp_path / "fits", recommend=False, where=Where(workers=2),
        progress=lambda what, fraction: began.append(what),
    )  # fmt: skip
    assert {"leak", "dark_current"} <= {what.rsplit(" ", 1)[-1] for what in began}  # each is said as it is sent off
    plain, other = (report.as_dict() for report in (alone, shared))
    for told in (plain, other):
        del told["seconds"]
    assert plain == other
    assert [one["name"] for one in plain["effects"]] == [effect]


def test_a_round_compares_under_one_likelihood_and_leaves_its_state_as_it_was():
    recordings = session(
        MODEL.with_effect("leak", {"rate_hz": 5.0}), side=3, seed=4, lights={"slow_24": slow(24.0, seed=2)}
    )
    context = Context(Options())
    state = begin(recordings, MODEL, context)
    pools = state.hypothesis.evidence
    weighed = pools.weighed(MODEL.with_effect("timestamp_jitter").circuit())
    judged = candidates_of(weighed, state.base.model, None, None, Work())
    for fit in (judged.base, judged.fit_without("leak", judged.screen(["leak"], print)[0][0])):  # either side of a gain
        assert fit.value == pytest.approx(weighed.fitting.log_likelihood(fit.model.circuit()), abs=1e-6)
    then = name_effect(replace(state, phase=Phase.NAME), context)
    assert len(then.rounds) == 1
    assert then.rounds[0]["candidates"]
    assert state.rounds == ()
    assert state.steps == ()
    for pool in (pools.screening, pools.fitting, pools.judging, pools.training):
        np.testing.assert_array_equal(pool.clock_share, 1.0)


def test_command_writes_what_it_promises(tmp_path):
    for r in session(MODEL, side=3, seed=4, lights={"slow_24": slow(24.0, seed=2), "steps_24": steps(24.0, seed=1)}):
        write_recording(r, tmp_path / f"{r.condition}.h5")
    files = [str(p) for p in sorted(tmp_path.glob("*.h5"))]
    out = tmp_path / "gap"
    assert main(["gap", *files, "--model", "dvs128", "--out", str(out), "--quiet"]) == 0
    told = json.loads((out / "gap.json").read_text())
    for key in ("verdict", "sentence", "remainder", "global_p", "alpha", "effects", "gap", "rounds", "model",
                "recommended_next", "seconds"):  # fmt: skip
        assert key in told
    assert told["verdict"] in ("none", "named", "ambiguous", "unknown")
    assert (out / "report.html").is_file()
    assert find_model(out / "model.toml").effects == MODEL.effects


def test_pooled_and_empty_recordings_are_refused():
    light = slow(24.0, seed=2)
    with pytest.raises(InputError, match="100 events"):
        gap([Recording(Events.empty(1, 1), light, pooled=True)], MODEL)
    with pytest.raises(InputError, match="no events"):
        gap([Recording(Events.empty(2, 2), light)], MODEL)


@pytest.mark.slow
@pytest.mark.skipif(not CASES.is_dir(), reason="the practice cases are not here")
@pytest.mark.parametrize(
    "case", ["null", "leak", "dark_current", "refractory", "lower_cutoff", "queue", "polarity_memory"]
)
def test_practice_cases(case):
    from pixelid.recordings import open_recordings

    truth = json.loads((CASES / "truth.json").read_text())[case]
    model = MODEL
    for effect in truth["without"]:
        model = model.without_effect(effect)
    report = gap(open_recordings([CASES / case]), model)
    if not truth["hidden"]:
        assert report.verdict == "none"
    elif truth["hidden"] == ["unknown"]:  # to the library of that time
        assert (report.verdict, [e.name for e in report.effects]) == ("named", ["polarity_memory"])
        assert report.effects[0].parameters["polarity_memory.strength"][0] == pytest.approx(-0.15, rel=0.02)
        left_out = gap(open_recordings([CASES / case]), model, leave_out=["polarity_memory"])
        assert left_out.verdict == "unknown"
        assert not left_out.effects
        assert "OFF after O" in left_out.sentence  # turns late, runs early: a pixel's free threshold makes them tie
        (described,) = left_out.described
        entry = described.as_dict()
        assert (entry["quantity"], entry["covariate"]) == ("threshold", "previous_polarity")
        assert abs(described.parameters["strength"][0]) == pytest.approx(0.15, rel=0.02)
        assert described.closed > 0.8
    else:
        assert (report.verdict, [e.name for e in report.effects]) == ("named", truth["hidden"])
        (_, (value, interval)), *_ = report.effects[0].parameters.items()
        assert interval is not None
        run = report.free_run
        assert run is not None
        assert run.closed is not None
        assert run.interval is not None
        (strength,) = truth["effects"].values()
        assert value == pytest.approx(strength, rel=0.1)
        assert interval[0] - 1e-9 <= strength <= interval[1] + 1e-9
        assert run.closed >= 0.9
        assert run.interval[0] >= 0.75


def test_hot_pixels_that_the_base_model_has_are_not_missing():
    burning = MODEL.with_effect("hot_pixels", {"rate_hz": 60.0, "count": 2})
    light = {"chirp_24": chirp(24.0, stop_hz=200.0), "steps_400": steps(400.0, seed=3)}
    recordings = session(burning, side=5, seed=6, lights=light)
    known = gap(recordings, burning, recommend=False)
    assert known.verdict == "none"
    assert known.effects == ()
    assert known.global_p > 1e-3
    assert [effect.name for effect in gap(recordings, MODEL, recommend=False).effects] == ["hot_pixels"]


def test_recordings_of_one_name_are_told_apart():
    """Two files of one stem: what was found closes the gap of both."""
    true = MODEL.with_effect("leak", {"rate_hz": 8.0})
    light = {"chirp_24": chirp(24.0, stop_hz=200.0), "steps_24": steps(24.0, seed=1)}
    recordings = [replace(r, condition="recording") for r in session(true, side=4, seed=2, lights=light)]
    report = gap(recordings, MODEL, recommend=False)
    assert [effect.name for effect in report.effects] == ["leak"]
    assert report.free_run.closed > 0.8
    assert set(report.free_run.per_recording) == {"recording", "recording (2)"}


def test_a_session_too_short_for_any_map_says_nothing():
    t = np.linspace(0, 2, 2001)
    light = Stimulus(t, 100 * np.exp(0.6 * t + 0.3 * np.sin(2 * np.pi * 3 * t)))
    recording = simulate(MODEL, light, width=2, height=1, seed=2, sensor_seed=2)
    assert len(recording.events) < 40
    report = gap([recording], MODEL, recommend=False)
    assert report.verdict == "none"
    assert report.global_p == 1.0


def test_hot_pixels_stand_out_where_others_are_silent():
    from pixelid.inspection.hot_pixels import find_hot_pixels_in_silence

    burning = MODEL.with_effect("hot_pixels", {"rate_hz": 8.0, "count": 2})
    hot = find_hot_pixels_in_silence(session(burning, side=4, seed=6))
    assert hot is not None
    assert len(hot.pixels) == 2
    low, high = hot.signature.interval
    assert low < 8.0 < high
    assert find_hot_pixels_in_silence(session(MODEL, side=4, seed=6)) is None
    sensitive = MODEL.with_effect("threshold_mismatch").set({"threshold_mismatch.sigma": 0.25})
    assert find_hot_pixels_in_silence(session(sensitive, side=4, seed=6)) is None
    assert find_hot_pixels_in_silence(session(MODEL.with_effect("leak", {"rate_hz": 2.0}), side=4, seed=6)) is None


def tiny(pixels, events):
    """A recording of so few events, under steps."""
    r = simulate(MODEL, resampled(steps(24.0, seed=1), "smooth"), width=pixels, height=1, seed=0)
    keep = np.arange(len(r.events)) < events
    return replace(r, events=r.events.select(keep), stimulus=steps(24.0, seed=1), attributes={})


@pytest.mark.parametrize(("pixels", "events"), [(1, 3), (1, 12), (2, 4), (3, 30)])
def test_next_to_nothing_is_no_verdict(pixels, events):
    """One pixel ended in a segmentation fault, three events in "the model explains these recordings"."""
    report = gap([tiny(pixels, events)], MODEL, recommend=False)
    if report.verdict == "none":
        assert report.status == "not_identified"
        assert "events could not have shown an effect" in report.advice
    assert "none was set aside to judge by" in report.advice


@pytest.mark.parametrize("events", [3, 5])
def test_few_events_are_fitted_by_every_engine(events):
    """Of no sample between events CasADi made a row where a column was meant."""
    for engine in ("casadi", "scipy"):
        assert fitted([tiny(2, events)], MODEL, engine=engine, starts=0).status != "converged"
