"""Where a search begins once something is missing (limits of a slew, times behind a queue, the knee of a response, the
shipped noise), and what better times take back."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pixelid.errors import InputError
from pixelid.fit.maximise import maximise
from pixelid.gap import search
from pixelid.gap.attribute.attribute import Attribution, Candidate
from pixelid.gap.attribute.candidates import (
    _last_unfelt,
    holds_together,
    missing,
    start_in_each,
    strongest_start,
    tried,
    variants,
)
from pixelid.gap.attribute.pixels import strongest_fit
from pixelid.gap.criteria import Criteria
from pixelid.gap.gap import gap
from pixelid.gap.imputation.exact import keeps_its_times, loses_where_times_are_exact
from pixelid.gap.imputation.impute import _completed, impute, impute_simulated, impute_with_effect
from pixelid.gap.imputation.imputed import JITTER, QUEUE, TICK, Imputation, draw_again
from pixelid.gap.imputation.windows import Windows, guess_edges, queue_windows, tick_windows, with_times
from pixelid.gap.options import Context, Options
from pixelid.gap.phases import Phase
from pixelid.gap.rounds import entry
from pixelid.gap.search import begin
from pixelid.gap.shot_noise.replicates import Corrected
from pixelid.gap.shot_noise.shot_noise import ShotNoise
from pixelid.gap.state import NamedStep
from pixelid.gap.steps import discount_imputation_noise as discounting
from pixelid.gap.steps import explain_by_shot_noise as by_noise
from pixelid.gap.steps import name_beside_shot_noise as beside
from pixelid.gap.steps import withdraw as withdrawing
from pixelid.gap.steps.ask_stamps import Stamps, ask_stamps, split_pole
from pixelid.gap.steps.name_effect import (
    NOTHING_LEFT_FOR_IT,
    ONLY_WHERE_DRAWN,
    _behind_coarse_jitter,
    _slewing_through_new_poles,
    name_effect,
    name_what_settles,
    restart,
    without_idle,
    without_misplaced,
)
from pixelid.gap.steps.withdraw import undo_readout
from pixelid.inspection.timestamps import TimestampSignature
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.shipped import find_model
from pixelid.recordings.own_light import with_fine_light
from pixelid.simulate import simulate
from pixelid.stimuli.resample import resampled
from pixelid.stimuli.shapes import chirp, slow, steps

MODEL = find_model("dvs128")
CONTEXT = Context(Options(0.01, 1, (), Criteria(), False), None, lambda what, fraction: None)


def recorded(model, lights, side):
    """One camera under each light, given as sampled."""
    fine = [resampled(light, "smooth") for light in lights]
    made = [simulate(model, light, width=side, height=side, seed=i, sensor_seed=3) for i, light in enumerate(fine)]
    return [replace(recording, stimulus=light) for recording, light in zip(made, lights, strict=True)]


@pytest.mark.parametrize(("rise", "fall"), [(400.0, 1500.0), (1500.0, 400.0), (700.0, 700.0)])
def test_limits_of_both_sides_of_a_slew_are_found_apart(rise, fall):
    """A limit at which nothing slews has no slope in the likelihood: a fit would leave it where it began."""
    slewing = MODEL.with_effect("slew_limit", {"rise_per_s": rise, "fall_per_s": fall})
    lights = [chirp(400.0, stop_hz=400.0), steps(400.0, seed=3)]
    events = EventTimes([with_fine_light(r, "smooth") for r in recorded(slewing, lights, side=2)])
    base = maximise(events, MODEL, tolerance=0.1, max_steps=30)
    ends = [
        strongest_fit(
            events, origin, "slew_limit", base.value, lambda start: maximise(events, start, tolerance=0.1, max_steps=30)
        )
        for origin in (base.model, MODEL)
    ]
    end = max((end for end in ends if end is not None), key=lambda end: end.value)
    assert end.values["slew_limit.rise_per_s"] == pytest.approx(rise, rel=0.03)
    assert end.values["slew_limit.fall_per_s"] == pytest.approx(fall, rel=0.03)


def test_a_limit_that_the_fastest_changes_just_reach_is_found():
    """The next of the strengths tried first would already hold back much that is not."""
    lights = [chirp(400.0, stop_hz=400.0), steps(400.0, seed=3)]
    free = EventTimes([with_fine_light(r, "smooth") for r in recorded(MODEL, lights, side=3)])
    finely = np.geomspace(1e5, 100.0, 500)
    loose = MODEL.with_effect("slew_limit", {"rise_per_s": 1e5, "fall_per_s": 1e5})
    fall = 0.96 * finely[_last_unfelt(free, loose, "slew_limit.fall_per_s", finely)]
    made = recorded(loose.set({"slew_limit.fall_per_s": fall}), lights, side=3)
    start = strongest_start(EventTimes([with_fine_light(r, "smooth") for r in made]), MODEL, "slew_limit")
    assert start is not None
    assert start.values["slew_limit.fall_per_s"] == pytest.approx(fall, rel=0.04)


def test_a_slew_limit_does_without_neither_pole():
    """Its likelihood needs both, so neither can be taken back from beside it."""
    slewing = MODEL.with_effect("slew_limit")
    assert holds_together(slewing)
    assert not any(holds_together(slewing.without_effect(p)) for p in ("source_follower_pole", "differencing_pole"))
    assert holds_together(MODEL.without_effect("source_follower_pole"))


def test_no_limit_of_a_slew_is_tried_where_nothing_slews():
    events = EventTimes([with_fine_light(r, "smooth") for r in recorded(MODEL, [slow(400.0, seed=2)], side=2)])
    base = maximise(events, MODEL, tolerance=0.1, max_steps=30)
    assert strongest_start(events, base.model, "slew_limit", base.value) is None


@pytest.mark.slow
def test_a_limit_of_the_slew_is_asked_for_before_what_stands_in_for_it():
    """Behind a jitter it forbids the times that are drawn; lost events and a memory of polarity explain some."""
    rise, sigma = 2700.0, 2.4e-5
    camera = MODEL.with_effect("slew_limit", {"rise_per_s": rise, "fall_per_s": rise})
    camera = camera.with_effect("timestamp_jitter", {"sigma_s": sigma})
    dim = [chirp(24.0, stop_hz=200.0), steps(24.0, seed=1), slow(24.0, seed=2)]
    made = recorded(camera, [*dim, chirp(400.0, stop_hz=400.0), steps(400.0, seed=4)], side=3)
    report = gap(made, MODEL, alpha=0.01, seed=1, recommend=False)
    assert (report.verdict, {effect.name for effect in report.effects}) == ("named", {"timestamp_jitter", "slew_limit"})
    assert report.model.values["slew_limit.rise_per_s"] == pytest.approx(rise, rel=0.03)
    assert report.model.values["timestamp_jitter.sigma_s"] == pytest.approx(sigma, rel=0.03)


@pytest.mark.slow
def test_times_drawn_without_a_dead_time_do_not_hold_it_back():
    """The shortest intervals drawn without one would stay, and bound it, if times were only drawn again."""
    service, dead = 5e-6, MODEL.values["refractory_s"]
    camera = MODEL.with_effect("readout_latency", {"service_s": service})
    lights = [chirp(24.0, stop_hz=200.0), steps(24.0, seed=1), chirp(400.0, stop_hz=400.0), steps(400.0, seed=4)]
    fine = tuple(with_fine_light(r, "smooth") for r in recorded(camera, lights, side=4))
    windows = tuple(queue_windows(r, service) for r in fine)
    times = tuple(guess_edges(fine, windows, early=True))
    state = np.random.default_rng(0).bit_generator.state
    drawn = Imputation(QUEUE, tuple(r.stimulus for r in fine), fine, windows, times, state, {})
    lacking = MODEL.without_effect("refractory_period")
    wrong = maximise(EventTimes(with_times(fine, times)), lacking, tolerance=0.5, max_steps=20)
    grown = wrong.model.with_effect("refractory_period", {"refractory_s": 0.5 * dead})
    drawn, model = impute_with_effect(drawn, grown, Options())
    assert model.values["refractory_s"] == pytest.approx(dead, rel=0.01)
    assert drawn.likelihood.terms(model.circuit()).unexplained.sum() == 0


def queued(recording, service_ns):
    """A recording behind a server, first come, first served; and the times of its events before that."""
    t = recording.events.t.astype(float)
    leaves, free = np.empty_like(t), 0.0
    for k, arrival in enumerate(t):
        free = max(arrival, free) + service_ns
        leaves[k] = free
    stamped = replace(recording, events=replace(recording.events, t=leaves.astype(np.int64), tick_ns=1))
    return with_fine_light(stamped, "smooth"), t


def behind_a_queue(lost):
    """(imputation, recordings at its times) of a camera behind a queue, one in a hundred of the drawn times wrong."""
    camera = MODEL.with_effect("lost_events", {"fraction": lost}) if lost else MODEL
    lights = [chirp(24.0, stop_hz=200.0), slow(24.0, seed=2), steps(400.0, seed=4)]
    made = [queued(r, 2e4) for r in recorded(camera, lights, side=4)]
    fine, times = tuple(r for r, _ in made), [t for _, t in made]
    windows = tuple(queue_windows(r, 2e-5) for r in fine)
    rng = np.random.default_rng(0)
    for t, window in zip(times, windows, strict=True):
        assert (np.abs(t - window.hi)[window.lo == window.hi] <= 1.0).all()
        wrong = (window.hi > window.lo) & (rng.random(len(t)) < 0.01)
        t[wrong] = window.lo[wrong]
    return Imputation(QUEUE, tuple(r.stimulus for r in fine), fine, windows, tuple(times), rng.bit_generator.state, {})


def test_events_in_a_wrong_place_leave_it_at_the_next_draw():
    """All times of a pixel are drawn at once: none is held where it is by those before and after."""
    drawn, circuit = behind_a_queue(0.0), MODEL.circuit()
    drawn = replace(drawn, times=tuple(w.lo for w in drawn.windows))
    assert drawn.likelihood.terms(circuit).unexplained.sum() > 50
    assert draw_again(drawn, MODEL).likelihood.terms(circuit).unexplained.sum() <= 1


def test_the_crowd_that_first_guesses_are_told_by_has_not_waited_itself():
    drawn = behind_a_queue(0.0)
    waiting = MODEL.with_effect(QUEUE, {"service_s": 2e-5}).fix({"readout_latency.service_s": None})
    none = np.zeros(len(drawn.windows), bool)
    one, other = (_completed(drawn, drawn.only(none), none, model, 0) for model in (MODEL, waiting))
    for times, same in zip(one.times, other.times, strict=True):
        np.testing.assert_array_equal(times, same)


@pytest.mark.parametrize(("effect", "unit_s"), [(QUEUE, 2e-5), (TICK, 2e-5), (TICK, 5e-5)])
def test_simulated_times_settle_where_the_true_ones_are(effect, unit_s):
    """Both are draws from the same law: their log likelihoods differ by what those of two such draws do."""
    unit = round(1e9 * unit_s)
    true = recorded(MODEL, [chirp(24.0, stop_hz=200.0), slow(24.0, seed=2), steps(400.0, seed=4)], side=4)
    if effect == QUEUE:
        stamped = [replace(r, events=queued(r, unit)[0].events) for r in true]
    else:
        middle = [r.events.t // unit * unit + unit // 2 for r in true]
        stamped = [replace(r, events=replace(r.events, t=t, tick_ns=1)) for r, t in zip(true, middle, strict=True)]
    signature = TimestampSignature(effect, "", unit_s, (unit_s, unit_s), 0.0, 1.0, 1, "")
    drawn, circuit = impute_simulated(stamped, signature, MODEL, 0), MODEL.circuit()
    assert drawn.lost == ()
    exact = EventTimes(with_times(drawn.fine, [r.events.t.astype(float) for r in true]))
    first = EventTimes(with_times(drawn.fine, guess_edges(drawn.fine, drawn.windows, early=effect == QUEUE)))
    many = sum(int((w.hi > w.lo).sum()) for w in drawn.windows)
    expected, sd = exact.log_likelihood(circuit), np.sqrt(many)  # of a difference of sums of squares of normals, halved
    assert abs(drawn.likelihood.log_likelihood(circuit) - expected) < 3.0 * sd
    assert abs(first.log_likelihood(circuit) - expected) > 3.0 * sd


def test_a_recording_is_told_by_lost_times_only_where_the_model_holds_at_exact_ones():
    """Behind a queue all recordings that a bandwidth floor had touched were once left out, and it was not found."""
    drawn = behind_a_queue(0.0)
    last = drawn.windows[-1]
    times = np.where(last.hi > last.lo, last.lo, drawn.times[-1])  # no event waited: too early by what it did
    wrong = replace(drawn, times=(*drawn.times[:-1], times))
    most = CONTEXT.options.criteria.max_unexplained_share_of_recording
    assert keeps_its_times(wrong, MODEL, most).tolist() == [True, True, False]
    slower = MODEL.set({"alpha": 0.8 * MODEL.values["alpha"]})
    assert keeps_its_times(wrong, slower, most).all()


def test_a_fine_tick_leaves_out_no_recording():
    """It loses no times: what is unexplained behind it is the model's, here a bandwidth floor that it lacks."""
    tick, camera = 2e-5, MODEL.with_effect("bandwidth_floor", {"radiance": 100.0})
    dim, bright = recorded(camera, [steps(24.0, seed=1), steps(4000.0, seed=2)], side=3)
    unit = round(1e9 * tick)
    stamped = [replace(r, events=replace(r.events, t=r.events.t // unit * unit, tick_ns=1)) for r in (dim, bright)]
    signature = TimestampSignature(
        "timestamp_quantisation", "timestamp_quantisation.tick_s", tick, (tick, tick), 0.0, 1.0, 1, ""
    )
    drawn = impute(stamped, signature, MODEL, CONTEXT.options)
    assert (len(drawn.recordings), drawn.lost) == (2, ())


def test_times_drawn_without_an_effect_are_left_once_it_is_named():
    """Exact draws hardly leave times that a model does not explain: events seemed lost that had only been misplaced."""
    tick, camera = 2e-5, MODEL.with_effect("bandwidth_floor", {"radiance": 100.0})
    (exact,) = recorded(camera, [chirp(400.0, stop_hz=400.0)], side=2)
    fine = with_fine_light(exact, "smooth")
    window = tick_windows(replace(fine, events=replace(fine.events, t=fine.events.t // 20_000 * 20_000 + 10_000)), tick)
    rng = np.random.default_rng(0)
    wrong = rng.choice([0.01, 0.99], len(fine.events)) * (window.hi - window.lo) + window.lo
    drawn = Imputation(TICK, (exact.stimulus,), (fine,), (window,), (wrong,), rng.bit_generator.state, {})
    assert drawn.likelihood.terms(camera.circuit()).unexplained.sum() > 20
    drawn, model = impute_with_effect(drawn, camera, Options())
    assert drawn.likelihood.terms(model.circuit()).unexplained.sum() == 0
    assert model.values["bandwidth_floor.radiance"] == pytest.approx(100.0, rel=0.1)


@pytest.mark.parametrize("lost", [0.0, 0.01, 0.1])
def test_lost_events_have_to_be_missing_where_times_are_exact_too(lost):
    """Those of a busy readout lack one in any case, since some of the drawn times are wrong."""
    drawn = behind_a_queue(lost)
    without = maximise(drawn.likelihood, MODEL, tolerance=0.1, max_steps=30).model
    fitted = without.with_effect("lost_events", {"fraction": max(lost, 0.005)})
    assert loses_where_times_are_exact(drawn, fitted, without, CONTEXT.options) == (lost > 0)
    ticked = replace(drawn, effect="timestamp_quantisation")
    assert loses_where_times_are_exact(ticked, fitted, without, CONTEXT.options)


@pytest.mark.slow
@pytest.mark.parametrize("lost", [0.0, 0.05])
def test_lost_events_that_are_only_misplaced_are_withdrawn_and_not_tried_again(lost):
    drawn = behind_a_queue(lost)
    state = begin(list(drawn.recordings), MODEL, CONTEXT)
    hypothesis = state.hypothesis
    model = hypothesis.fit.model.with_effect("lost_events", {"fraction": max(lost, 0.005)})
    fit = maximise(hypothesis.evidence.training, model, tolerance=1.0, max_steps=0)
    winner = Candidate("lost_events", fit, 600.0, 0.0, hypothesis.fit.x)
    state = replace(
        state, hypothesis=replace(hypothesis, fit=fit, start=hypothesis.start.with_effect("lost_events")),
        steps=(NamedStep(winner, Attribution((), {}, None, (), {}), "", True, hypothesis),), imputation=drawn,
        rounds=(entry(1, 0.0, named="lost_events"),),
    )  # fmt: skip
    left = without_misplaced(state, CONTEXT)
    assert left.hypothesis.fit.model.has("lost_events") == (lost > 0)
    assert len(left.steps) == int(lost > 0)
    assert left.given_up == (frozenset() if lost else {"lost_events"})
    assert left.rounds[0].get("withdrawn") == (None if lost else ONLY_WHERE_DRAWN)


def test_a_first_effect_that_was_refused_leaves_a_round_to_go_on_with(complete, monkeypatch):
    monkeypatch.setattr(search, "name_effect", lambda state, context: state)
    state = replace(complete, phase=Phase.NAME, turn=1, given_up=frozenset({"lost_events"}))
    assert search.name_next(state, CONTEXT) is state


def test_a_knee_between_the_dark_current_and_the_light_is_found():
    """One below all light does nothing, one far too high does harm: between them lies less than half a decade."""
    known = MODEL.with_effect("dark_current", {"radiance": 7.0})
    kneed = known.with_effect("linear_log", {"knee": 11.0})
    lights = [chirp(3.0, stop_hz=60.0), steps(3.0, seed=3), chirp(24.0, stop_hz=200.0)]
    events = EventTimes([with_fine_light(r, "smooth") for r in recorded(kneed, lights, side=3)])
    base = maximise(events, known, tolerance=0.1, max_steps=30)
    start = strongest_start(events, base.model, "linear_log")
    assert start is not None
    end = maximise(events, start, tolerance=0.1, max_steps=30)
    assert end.value > base.value + 100.0
    assert end.values["linear_log.knee"] == pytest.approx(11.0, rel=0.03)


def begun(model):
    """A search of two recordings of a camera, its base fitted."""
    return begin(recorded(model, [chirp(400.0, stop_hz=400.0), steps(400.0, seed=3)], side=3), MODEL, CONTEXT)


@pytest.fixture(scope="module")
def complete():
    """Nothing is missing."""
    return begun(MODEL)


def test_an_effect_that_noise_has_covered_for_is_looked_for_from_the_shipped_noise(complete):
    """A seventh of the events lost behind a slew limit: noise of thresholds takes the place of both, and keeps it."""
    lossy = MODEL.with_effect("lost_events", {"fraction": 0.15})
    state = begun(lossy.with_effect("slew_limit", {"rise_per_s": 2000.0, "fall_per_s": 2000.0}))
    pool, fit = state.hypothesis.evidence.screening, state.hypothesis.fit
    assert fit.values["threshold_sigma"] > 2.0 * MODEL.values["threshold_sigma"]
    again = restart(state, CONTEXT)
    assert again is not None
    assert again.values["threshold_sigma"] == MODEL.values["threshold_sigma"]
    ends = []
    for origin in (fit.model, again):
        start = strongest_start(pool, origin, "lost_events")
        assert start is not None
        ends.append(maximise(pool, start, tolerance=0.1, max_steps=15))
    assert ends[1].value > ends[0].value + 1000.0
    assert ends[1].values["threshold_sigma"] < 2.0 * MODEL.values["threshold_sigma"]
    assert restart(complete, CONTEXT) is None


@pytest.mark.parametrize(
    ("effect", "value", "stays"),
    [
        ("lost_events", {"fraction": 1e-5}, False),
        ("lost_events", {"fraction": 0.02}, True),
        # a strength that a camera may have, but hardly likelier than none: times drawn with 112 us of jitter and a
        # drift in the model left it 4 of the 10 nats for which it had been named
        ("threshold_drift", {"per_s": 1e-3}, False),
        ("threshold_drift", {"per_s": 0.05}, True),
    ],
)
def test_an_effect_that_times_drawn_anew_leave_nothing_is_withdrawn(complete, effect, value, stays):
    """The recordings hold what stays, and nothing of the rest."""
    state = begun(MODEL.with_effect(effect, value)) if stays else complete
    hypothesis = state.hypothesis
    model = hypothesis.fit.model.with_effect(effect, value)
    fit = maximise(hypothesis.evidence.training, model, tolerance=0.01, max_steps=40)
    winner = Candidate(effect, fit, 600.0, 0.0, hypothesis.fit.x)
    step = NamedStep(winner, Attribution((), {}, None, (), {}), "", True, hypothesis)
    state = replace(
        state, hypothesis=replace(hypothesis, fit=fit, start=hypothesis.start.with_effect(effect)),
        steps=(step,), rounds=(entry(1, 0.0, named=effect),),
    )  # fmt: skip
    left = without_idle(state, CONTEXT)
    assert left.hypothesis.fit.model.has(effect) == left.hypothesis.start.has(effect) == stays
    assert len(left.steps) == int(stays)
    assert left.rounds[0].get("withdrawn") == (None if stays else NOTHING_LEFT_FOR_IT)


def test_an_effect_taken_back_from_beside_shot_noise_leaves_the_noise_found_before_it(complete, monkeypatch):
    """And is taken back where it was named last: shot noise had explained it once before."""
    monkeypatch.setattr(withdrawing, "flexible_alternative", lambda *given: None)
    hypothesis = complete.hypothesis
    left = replace(hypothesis, seen=replace(hypothesis.seen, p=0.0))
    corrected = Corrected(
        hypothesis.fit.model, np.zeros_like(hypothesis.fit.x), left.seen, np.ones_like(hypothesis.fit.x)
    )
    before, found = (ShotNoise(density, (0.0, 1.0), corrected, 100.0, 5.0) for density in (1e-4, 3e-4))
    winner = Candidate("leak", hypothesis.fit, 600.0, 0.0, hypothesis.fit.x)
    step = NamedStep(winner, Attribution((), {}, None, (), {}), "", False, hypothesis, before)
    rounds = (entry(1, 0.0, named="leak", withdrawn="shot noise explains it"), entry(2, 0.0, named="leak"))
    state = replace(complete, hypothesis=left, steps=(step,), rounds=rounds, shot_noise=found)
    state = withdrawing.withdraw(state, CONTEXT)
    assert not state.steps
    assert state.hypothesis is hypothesis
    assert state.shot_noise is before
    assert state.rounds[0]["withdrawn"] == "shot noise explains it"
    assert "withdrawn" in state.rounds[1]


def beside_shot_noise(complete, monkeypatch, left_alone, left_beside, p_beside):
    """A search that has named a leak, where shot noise is said to leave so much, without it (None: not found) and
    beside it."""
    hypothesis = complete.hypothesis
    left = replace(hypothesis, seen=replace(hypothesis.seen, p=0.0))
    winner = Candidate("leak", hypothesis.fit, 600.0, 0.0, 0.0 * hypothesis.fit.x)
    step = NamedStep(winner, Attribution((), {}, None, (), {}), "", True, left)
    state = replace(complete, hypothesis=left, steps=(step,), turn=1, rounds=(entry(1, 0.0, named="leak"),))

    def found(evidence, fit, seen, options, cache, work):
        alone = seen is not left.seen
        amount = left_alone if alone else left_beside
        if amount is None:
            return None
        corrected = Corrected(
            fit.model, np.zeros_like(fit.x), replace(seen, p=0.0 if alone else p_beside), 1.0 + 0.0 * fit.x
        )
        return ShotNoise(1e-4, (0.0, 1.0), corrected, 1000.0, amount)

    bare = replace(left, seen=replace(left.seen, p=1e-9))
    monkeypatch.setattr(by_noise, "find_shot_noise", found)
    monkeypatch.setattr(by_noise, "_bare", lambda state, context: bare)
    return looked_for_both_ways(state)


def looked_for_both_ways(state):
    """Shot noise in place of the effects that were named, and together with them."""
    trials = by_noise.Trial(None, 0), by_noise.Trial(state.hypothesis, len(state.steps))
    return by_noise.explain_by_shot_noise(state, trials, CONTEXT)


@pytest.mark.parametrize(("left_alone", "named"), [(None, True), (50.0, True), (10.0, False)])
def test_an_effect_that_shot_noise_alone_cannot_replace_stays_beside_it(complete, monkeypatch, left_alone, named):
    """Though what it gained before, in a likelihood that misread the noise, is less than the noise explains."""
    state = beside_shot_noise(complete, monkeypatch, left_alone, 10.0, 0.5)
    assert (state.shot_noise is not None) == named
    assert state.phase is (Phase.BESIDE_SHOT_NOISE if named else complete.phase)
    assert [step.effect for step in state.steps] == ["leak"]
    assert state.rounds[-1]["named"] == ("shot_noise" if named else None)


@pytest.mark.parametrize("alike", [True, False])
def test_shot_noise_that_the_base_looks_like_is_tried_before_any_effect(complete, monkeypatch, alike):
    hypothesis = complete.hypothesis
    left = replace(hypothesis, seen=replace(hypothesis.seen, p=1e-9))
    corrected = Corrected(
        hypothesis.fit.model, 0.0 * hypothesis.fit.x, replace(hypothesis.seen, p=0.5), 1.0 + 0.0 * hypothesis.fit.x
    )
    noise = ShotNoise(1e-4, (0.0, 1.0), corrected, 1000.0, 5.0)
    monkeypatch.setattr(by_noise, "find_shot_noise", lambda *given: noise)
    monkeypatch.setattr(by_noise, "looks_like_shot_noise", lambda seen, criteria: alike)
    monkeypatch.setattr(by_noise, "named_in_noise", lambda state, context: state)
    state = by_noise.try_in_noise(replace(complete, hypothesis=left), CONTEXT)
    assert state.shot_noise is (noise if alike else None)
    assert state.global_p == (2e-9 if alike else 1.0)  # that of the base, not of what the noise leaves


@pytest.mark.parametrize("why", ["left out", "there already", "nothing is left"])
def test_shot_noise_that_may_not_be_named_is_not_tried_before_effects(complete, monkeypatch, why):
    monkeypatch.setattr(by_noise, "looks_like_shot_noise", lambda seen, criteria: True)
    monkeypatch.setattr(by_noise, "named_in_noise", lambda state, context: pytest.fail("tried"))
    hypothesis = complete.hypothesis
    hypothesis = replace(hypothesis, seen=replace(hypothesis.seen, p=1.0 if why == "nothing is left" else 1e-9))
    if why == "there already":
        noisy = hypothesis.fit.model.with_effect("shot_noise")
        hypothesis = replace(hypothesis, fit=replace(hypothesis.fit, model=noisy))
    left_out = ("shot_noise",) if why == "left out" else ()
    context = replace(CONTEXT, options=replace(CONTEXT.options, leave_out=left_out))
    state = replace(complete, hypothesis=hypothesis)
    assert by_noise.try_in_noise(state, context) is state


@pytest.mark.parametrize("explained", [True, False])
def test_where_shot_noise_leaves_something_it_counts_with_what_explains_that(complete, monkeypatch, explained):
    asked = []

    def look(state, context):
        asked.append(state.shot_noise)
        seen = replace(state.hypothesis.seen, p=0.5 if explained else 0.0)
        return state.then(Phase.DISCOUNT, hypothesis=replace(state.hypothesis, seen=seen))

    monkeypatch.setattr(by_noise, "name_beside_shot_noise", look)
    state = beside_shot_noise(complete, monkeypatch, None, 10.0, 1e-6)
    assert len(asked) == 1
    assert asked[0].left == 10.0
    assert (state.shot_noise is asked[0]) == explained
    assert state.phase is (Phase.DISCOUNT if explained else complete.phase)
    again = looked_for_both_ways(replace(state, shot_noise=None, phase=Phase.NAME))
    assert again.shot_noise is None
    assert len(asked) == 1  # not beside the same hypothesis again


@pytest.mark.parametrize("slews", [pytest.param(True, marks=pytest.mark.slow), False])
def test_a_slew_limit_is_named_with_a_pole_that_it_needs(slews):
    """The pole by itself explains nothing while the limit acts, and what that leaves passes for a jitter."""
    limits = {"rise_per_s": 1200.0, "fall_per_s": 1200.0}
    base = MODEL.without_effect("source_follower_pole")
    camera = MODEL.with_effect("slew_limit", limits) if slews else base.with_effect(JITTER, {"sigma_s": 3e-5})
    lights = [chirp(400.0, stop_hz=400.0), steps(400.0, seed=3)]
    state = begin(recorded(camera, lights, side=3), base, CONTEXT)
    told = (entry(1, 0.0),)
    found = _slewing_through_new_poles(replace(state, turn=1, rounds=told), 0.0, CONTEXT)
    if not slews:
        assert found is None
        return
    assert found is not None
    assert [step.effect for step in found.steps] == ["source_follower_pole", "slew_limit"]
    assert [one["named"] for one in found.rounds] == [None, "source_follower_pole", "slew_limit"]
    assert found.hypothesis.start.has("source_follower_pole")
    assert all(step.before is state.hypothesis for step in found.steps)
    values = found.hypothesis.fit.values
    assert values["slew_limit.rise_per_s"] == pytest.approx(1200.0, rel=0.05)
    assert values["sf_cutoff_hz"] == pytest.approx(MODEL.values["sf_cutoff_hz"], rel=0.3)
    least = found.steps[-1].winner.gain + 1.0
    assert _slewing_through_new_poles(replace(state, turn=1, rounds=told), least, CONTEXT) is None


def test_a_jitter_of_dead_times_is_looked_for_beside_a_dead_time_named_on_the_way():
    """The base has no dead time whose shipped value the times could be followed from."""
    lights = [chirp(400.0, stop_hz=400.0), steps(400.0, seed=3)]
    state = begin(recorded(MODEL, lights, side=3), MODEL.without_effect("refractory_period"), CONTEXT)
    start = state.hypothesis.start.with_effect("refractory_period")
    fit = maximise(state.hypothesis.evidence.training, start, tolerance=0.1, max_steps=30)
    state = replace(state, hypothesis=replace(state.hypothesis, fit=fit, start=start))
    assert _behind_coarse_jitter(state, Attribution((), {}, None, (), {}), CONTEXT) is None


def test_stamps_without_a_blur_say_what_the_density_of_event_times_says():
    """Two engines, sums over cells of time and the density at the event: circuits differ by as many nats in both."""
    lights = [chirp(24.0, stop_hz=100.0), slow(24.0, seed=2)]
    fine = tuple(with_fine_light(r, "smooth") for r in recorded(MODEL, lights, side=3))
    times = tuple(r.events.t.astype(float) for r in fine)
    random = np.random.default_rng(0).bit_generator.state
    points = tuple(Windows(t, t) for t in times)
    stamps, events = Stamps(Imputation(QUEUE, tuple(lights), fine, points, times, random, {})), EventTimes(fine)
    here = MODEL.circuit()
    for other in ({"beta": 0.93 * MODEL.values["beta"]}, {"sf_cutoff_hz": 1.15 * MODEL.values["sf_cutoff_hz"]}):
        there = MODEL.set(other).circuit()
        known = events.log_likelihood(here) - events.log_likelihood(there)
        assert known > 15.0
        assert stamps.log_likelihood(here) - stamps.log_likelihood(there) == pytest.approx(known, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("slews", [True, False])
def test_a_limit_of_the_slew_behind_a_coarse_tick_is_named_where_there_is_one(slews):
    """Times drawn without it are too early for it: no limit that the drawn times know of is worth a fit."""
    camera = MODEL.with_effect("slew_limit", {"rise_per_s": 1500.0, "fall_per_s": 1500.0}) if slews else MODEL
    camera = camera.set({"threshold_sigma": 0.02}).with_effect(TICK, {"tick_s": 2e-4})
    lights = [chirp(400.0, stop_hz=400.0), slow(24.0, seed=2), steps(400.0, seed=5), steps(24.0, seed=6)]
    stamped = [replace(r, events=replace(r.events, tick_ns=1)) for r in recorded(camera, lights, side=4)]
    state = undo_readout(begin(stamped, MODEL, CONTEXT), CONTEXT)
    asked = ask_stamps(state, CONTEXT)
    if not slews:
        assert (asked.steps, asked.rounds) == ((), state.rounds)
        assert asked.hypothesis is state.hypothesis
        return
    assert [step.effect for step in asked.steps] == ["slew_limit"]
    assert asked.hypothesis.fit.values["slew_limit.rise_per_s"] == pytest.approx(1500.0, rel=0.1)
    assert asked.hypothesis.seen.background_fraction < 0.1 * state.hypothesis.seen.background_fraction


def test_a_pole_more_takes_what_the_others_are_later_than_shipped():
    """In all as late as before, dead time and recovery of the amplifier too; nothing where they are no later."""
    names = ("sf_cutoff_hz", "diff_cutoff_hz")
    late = MODEL.set({**{name: 0.4 * MODEL.values[name] for name in names}, "refractory_s": 3e-4})
    start = split_pole(late, MODEL)
    assert start is not None
    assert [start.values[name] for name in names] == [MODEL.values[name] for name in names]
    delays = [1.0 / late.values[name] for name in names], [1.0 / start.values[name] for name in names]
    assert sum(delays[1]) + 1.0 / start.values["extra_pole.cutoff_hz"] == pytest.approx(sum(delays[0]))
    recovery = [m.values["refractory_s"] + 1.0 / (2 * np.pi * m.values["diff_cutoff_hz"]) for m in (late, start)]
    assert recovery[0] == pytest.approx(recovery[1])
    assert split_pole(MODEL, MODEL) is None
    named = late.with_effect("leak"), MODEL.with_effect("leak")  # beside effects named on the way
    assert split_pole(*named).values["leak.rate_hz"] == named[0].values["leak.rate_hz"]
    assert split_pole(MODEL.set({"sf_cutoff_hz": 1.5 * MODEL.values["sf_cutoff_hz"]}), MODEL) is None


@pytest.mark.parametrize("planted", [{}, {"leak": {"rate_hz": 3.0}}, {"mains_flicker": {"modulation": 0.12}}])
def test_strengths_left_out_would_not_have_been_the_best(planted):
    """From weak to strong, as far as it is worth it: the best of those is the best of all, and some are left out."""
    truth = MODEL
    for effect, values in planted.items():
        truth = truth.with_effect(effect, values)
    made = recorded(truth, [chirp(24.0, stop_hz=200.0), steps(400.0, seed=3)], 2)
    pool = EventTimes([with_fine_light(r, "smooth") for r in made])
    base = maximise(pool, MODEL, tolerance=0.1, max_steps=25).model
    count = {"all": 0, "tried": 0}
    for effect in missing(base):
        if effect in ("slew_limit", "dead_time_without_reset"):
            continue  # looked for in other ways
        values = []
        for trial in variants(base, effect):
            try:
                values.append(pool.log_likelihood(trial.circuit()))
            except (InputError, FloatingPointError):
                continue
        some = tried(pool, base, effect)
        assert max(one.value for one in some) == pytest.approx(np.nanmax(values), abs=1e-9)
        count["all"] += len(values)
        count["tried"] += len(some)
    assert count["tried"] < 0.8 * count["all"]


def test_flicker_of_each_recordings_own_phase_is_tried_as_strong_as_it_is():
    """At no phase that all share does a strong flicker explain anything: what suits each recording counts."""
    lights = [steps(24.0, seed=k) for k in range(4)]
    made = []
    for k, light in enumerate(lights):
        values = {"modulation": 0.12, "frequency_hz": 100.0, "phase_rad": 0.5 * np.pi * k}
        fine = resampled(light, "smooth")
        one = simulate(MODEL.with_effect("mains_flicker", values), fine, width=2, height=2, seed=k, sensor_seed=3)
        made.append(replace(one, stimulus=fine, condition=f"steps_{k}"))
    pool = EventTimes(made)
    strengths = {one.model.values["mains_flicker.modulation"] for one in tried(pool, MODEL, "mains_flicker")}
    start = start_in_each(pool, MODEL, "mains_flicker")
    assert start is not None
    assert start[0].values["mains_flicker.modulation"] == pytest.approx(0.12, rel=0.6)  # half decades
    assert max(strengths) > start[0].values["mains_flicker.modulation"]


@pytest.mark.slow
def test_an_effect_that_leaves_nothing_is_named_before_anything_dearer(monkeypatch):
    """As it would have been from the shipped values as well, and without a look at shot noise."""
    lights = [chirp(24.0, stop_hz=200.0), steps(24.0, seed=1), slow(24.0, seed=2), chirp(400.0, stop_hz=400.0)]
    camera = MODEL.with_effect("lower_cutoff", {"cutoff_hz": 1.5})
    state = undo_readout(begin(recorded(camera, lights, 3), MODEL, CONTEXT), CONTEXT)
    assert restart(state, CONTEXT) is not None
    plain = name_what_settles(state, CONTEXT)
    assert plain is not None
    full = name_effect(state, CONTEXT)
    for found in (plain, full):
        assert [step.effect for step in found.steps] == ["lower_cutoff"]
        assert found.hypothesis.model.values["lower_cutoff.cutoff_hz"] == pytest.approx(1.5, rel=0.02)
    assert plain.hypothesis.fit.value == pytest.approx(full.hypothesis.fit.value, abs=0.1)
    assert (plain.phase, plain.turn, len(plain.rounds)) == (full.phase, full.turn, len(full.rounds))

    def dear(*_):
        raise AssertionError("asked for more than the plain round")

    monkeypatch.setattr(search, "name_effect", dear)
    assert [step.effect for step in search.name_next(state, CONTEXT).steps] == ["lower_cutoff"]


def test_nothing_settles_where_two_effects_are_missing():
    lights = [chirp(24.0, stop_hz=200.0), steps(24.0, seed=1), slow(24.0, seed=2), chirp(400.0, stop_hz=400.0)]
    camera = MODEL.with_effect("lower_cutoff", {"cutoff_hz": 1.5}).with_effect("leak", {"rate_hz": 5.0})
    state = undo_readout(begin(recorded(camera, lights, 3), MODEL, CONTEXT), CONTEXT)
    assert restart(state, CONTEXT) is not None
    assert name_what_settles(state, CONTEXT) is None


def attributed_beside(monkeypatch, attribution, fit, tried, chance):
    """Beside shot noise, of so many effects tried, what an attribution says;  chance: of the excess of a gain."""
    monkeypatch.setattr(beside, "settled_under_noise", lambda evidence, model, cache: (evidence, fit))
    monkeypatch.setattr(beside, "missing", lambda model: [str(k) for k in range(tried)])
    monkeypatch.setattr(beside, "candidates_of", lambda *given: None)
    monkeypatch.setattr(beside, "attribute", lambda *given: attribution)
    monkeypatch.setattr(beside, "may_be_named", lambda candidate, options: True)
    monkeypatch.setattr(
        beside, "beyond_sessions_without",
        lambda evidence, truth, able, *rest: [replace(c, p=chance(c.gain)) for c in able],
    )  # fmt: skip


@pytest.mark.parametrize(
    ("alone", "left", "named"),
    [
        *[(1e-4, 300.0, True), (8e-4, 200.0, True), (8e-4, 295.0, False), (8e-4, 320.0, False)],
        *[(0.02, 0.0, True), (0.02, 260.0, False)],
    ],
)
def test_an_excess_beside_shot_noise_is_borne_out_by_replicates_or_not(complete, monkeypatch, alone, left, named):
    """alone: chance of the excess of one effect;  left: by shot noise beside it, 300 without."""
    hypothesis, effects = complete.hypothesis, 10
    seen = replace(hypothesis.seen, p=1e-3)
    corrected = Corrected(hypothesis.fit.model, np.zeros_like(hypothesis.fit.x), seen, np.ones_like(hypothesis.fit.x))
    before, after = (ShotNoise(1e-4, (0.0, 1.0), corrected, 1000.0, amount) for amount in (300.0, left))
    winner = Candidate("polarity_memory", hypothesis.fit, 600.0, effects * alone, 0.0 * hypothesis.fit.x)
    attribution = Attribution((winner,), {}, winner, (), {})
    step = NamedStep(winner, attribution, "", True, hypothesis)
    state = replace(complete, hypothesis=hypothesis, steps=(), rounds=(), shot_noise=before)
    attributed_beside(monkeypatch, attribution, hypothesis.fit, effects, lambda gain: effects * alone)
    monkeypatch.setattr(beside, "_with", lambda *given: replace(state, steps=(step,), shot_noise=after))
    found = beside.name_beside_shot_noise(state, CONTEXT)
    assert [one.effect for one in found.steps] == (["polarity_memory"] if named else [])
    assert found.phase is (Phase.BESIDE_SHOT_NOISE if named else Phase.DISCOUNT)
    assert found.shot_noise is (after if named else before)
    if named:
        assert found.steps[0].winner.p < CONTEXT.options.alpha_each
    else:
        assert beside.NO_EXCESS in found.rounds[-1]["refused"]


@pytest.mark.parametrize(
    ("chances", "left", "asked", "named"),
    [
        ((0.5, 1e-9), (50.0, 280.0), ["dark_current", "polarity_memory"], "polarity_memory"),
        ((0.5, 1e-9), (None, 280.0), ["dark_current", "polarity_memory"], "dark_current"),
        ((0.5, 0.5), (50.0, None), ["polarity_memory"], "polarity_memory"),
        ((1e-9, 0.5), (50.0, None), ["polarity_memory"], "polarity_memory"),
    ],
)
def test_what_gains_most_beside_shot_noise_is_asked_by_replicates(complete, monkeypatch, chances, left, asked, named):
    """An effect that does what the noise does gains as much in sessions without it, as one is sure to without doing so.

    chances: of the excess of a gain of 3000 nats and of one of 200;  left: with each in the model, 300 without
    """
    hypothesis, given = complete.hypothesis, []
    seen = replace(hypothesis.seen, p=1e-3)
    corrected = Corrected(hypothesis.fit.model, np.zeros_like(hypothesis.fit.x), seen, np.ones_like(hypothesis.fit.x))
    candidates = [
        Candidate(name, hypothesis.fit, gain, 1e-9, np.zeros(4))
        for name, gain in (("polarity_memory", 3000.0), ("dark_current", 200.0))
    ]
    attribution = Attribution(tuple(candidates), {}, candidates[0], (), {})
    before = ShotNoise(1e-4, (0.0, 1.0), corrected, 1000.0, 300.0)
    state = replace(complete, hypothesis=hypothesis, steps=(), rounds=(), shot_noise=before)

    def with_it(one, *rest):
        given.append(one.effect)
        amount = dict(zip(("polarity_memory", "dark_current"), left, strict=True))[one.effect]
        step = NamedStep(one, attribution, "", True, hypothesis)
        return None if amount is None else replace(state, steps=(step,), shot_noise=replace(before, left=amount))

    attributed_beside(
        monkeypatch, attribution, hypothesis.fit, 2, lambda gain: chances[0] if gain > 1e3 else chances[1]
    )
    monkeypatch.setattr(beside, "_with", with_it)
    found = beside.name_beside_shot_noise(state, CONTEXT)
    assert given == asked
    assert [one.effect for one in found.steps] == [named]


@pytest.mark.parametrize(("at_these", "afresh", "left"), [(0.3, None, 0.3), (1e-4, 0.4, 0.4), (1e-4, 1e-3, 1e-4)])
def test_times_are_drawn_afresh_where_more_is_left_than_of_a_simulated_session(
    complete, monkeypatch, at_these, afresh, left
):
    """at_these, afresh: chance of what is left at the times of the search, and at others; None: not to be asked."""
    windows: Any = (None,)
    imputation = Imputation(QUEUE, (), (), windows, (), {}, {})
    hypothesis = replace(complete.hypothesis, seen=replace(complete.hypothesis.seen, p=1e-6))
    state = replace(complete, hypothesis=hypothesis, imputation=imputation)
    again, other = replace(hypothesis, seen=replace(hypothesis.seen, p=1e-5)), replace(imputation, effect=TICK)

    def imputed(made, *rest):
        return (imputation, complete.hypothesis) if made is None else (other, again)

    def subtracted(seen, shown):
        chance = at_these if seen is hypothesis.seen else afresh
        assert chance is not None, "drawn afresh though nothing is left"
        return seen.maps.cells, chance

    monkeypatch.setattr(discounting, "simulate_again", lambda *given: None)
    monkeypatch.setattr(discounting, "split_pixels", lambda *given: complete.split)
    monkeypatch.setattr(discounting, "_imputed_alike", imputed)
    monkeypatch.setattr(discounting, "subtract_replicates", subtracted)
    found = discounting.discount_imputation_noise(state, CONTEXT)
    assert found.phase is Phase.WITHDRAW
    assert found.hypothesis.seen.p == left
    assert found.imputation is (other if left == afresh else imputation)


@pytest.mark.parametrize(("named", "p_afresh", "taken"), [(True, 0.4, True), (True, 1e-9, False), (False, 0.4, False)])
def test_times_behind_a_queue_are_drawn_afresh_once_an_effect_is_named(complete, monkeypatch, named, p_afresh, taken):
    """Nothing significant is left at the times of the search."""
    windows: Any = (None,)
    imputation = Imputation(QUEUE, (), (), windows, (), {}, {})
    hypothesis = complete.hypothesis
    winner = Candidate("leak", hypothesis.fit, 600.0, 0.0, hypothesis.fit.x)
    step = NamedStep(winner, Attribution((), {}, None, (), {}), "", True, hypothesis)
    queue = TimestampSignature(QUEUE, "", 3e-6, (3e-6, 3e-6), 0.0, 1.0, 1, "")
    state = replace(complete, imputation=imputation, undone=(queue,), steps=(step,) if named else ())
    again, other = replace(hypothesis, seen=replace(hypothesis.seen, p=p_afresh)), replace(imputation, effect=TICK)
    monkeypatch.setattr(discounting, "_imputed_alike", lambda *given: (other, again))
    found = discounting.discount_imputation_noise(state, CONTEXT)
    assert (found.imputation is other) == taken
    assert (found.hypothesis is again) == taken


@pytest.mark.slow
def test_a_memory_of_the_polarity_is_named_beside_shot_noise():
    """Deviations reverse under either: replicates made from the first fit are hardly nearer than without noise."""
    strength, density = 0.12, 2.7e-4
    camera = MODEL.with_effect("polarity_memory", {"strength": strength})
    camera = camera.with_effect("shot_noise", {"density": density})
    lights = [chirp(24.0, stop_hz=200.0), steps(24.0, seed=1), slow(24.0, seed=2), chirp(400.0, stop_hz=400.0)]
    report = gap(recorded(camera, lights, side=4), MODEL, alpha=0.01, seed=1, recommend=False)
    assert (report.verdict, {effect.name for effect in report.effects}) == ("named", {"polarity_memory", "shot_noise"})
    for effect in report.effects:
        for name, (value, (low, high)) in effect.parameters.items():
            truth = {"polarity_memory.strength": strength, "shot_noise.density": density}[name]
            assert low <= truth <= high, (name, value, low, high)
