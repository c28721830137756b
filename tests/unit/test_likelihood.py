"""The event-time likelihood against independent arithmetic: integrals, quadrature, differences, brute force."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from oracles import event_time_density as plain
from oracles.changes import plain_changes
from oracles.event_time_density import log_ndtr
from scipy.integrate import quad, solve_ivp
from scipy.stats import norm

from pixelid.dynamics.of_circuit import dynamics_of
from pixelid.dynamics.trajectory import integrate
from pixelid.errors import InputError
from pixelid.fit.coordinates import Coordinates
from pixelid.fit.event_times import EventTimesObjective
from pixelid.fit.maximise import maximise
from pixelid.likelihood.changes import PER_EVENT, PER_PIXEL, ChangeEvaluator
from pixelid.likelihood.density import BACKGROUND_HZ, NUMBERS
from pixelid.likelihood.event_times import EventTimes
from pixelid.likelihood.layout import EndRows, EventRows
from pixelid.likelihood.sections import sections_of
from pixelid.model.shipped import find_model
from pixelid.recordings import Events, Recording
from pixelid.simulate import simulate
from pixelid.stimuli.stimulus import Stimulus

MODEL = find_model("dvs128")


def sine_light(level=200.0, frequency=20.0, modulation=0.6, duration=0.1, dt=2e-5):
    t = np.arange(0.0, duration, dt)
    return Stimulus(t, level * (1 + modulation * np.sin(2 * np.pi * frequency * t)))


def recording_of(times_s, polarities, stimulus, pixels=None, width=4):
    order = np.argsort(times_s, kind="stable")
    n = len(times_s)
    x = np.zeros(n, int) if pixels is None else np.asarray(pixels)
    events = Events.from_columns(
        np.round(np.asarray(times_s)[order] * 1e9).astype(np.int64), x[order], np.zeros(n, int),
        np.asarray(polarities)[order], width, 1,
    )  # fmt: skip
    return Recording(events, stimulus, sensor="test")


def whole(recording):
    """The one section of a recording under full-field light."""
    (section,) = sections_of(recording)[1]
    return section


def brute_force_change(circuit, stimulus, t_previous, t_event):
    """change(t_event) by an adaptive ODE solver on the same piecewise log-linear light."""
    u = lambda t: np.interp(t, stimulus.t, np.log(stimulus.radiance))  # noqa: E731

    def rhs(t, x):
        light = np.exp(u(t)) + circuit.bandwidth_floor
        v, y, s, d = x
        return [
            circuit.alpha * light * (u(t) - y) - (circuit.beta + circuit.gamma * light) * v,
            v,
            circuit.follower * (y - s),
            circuit.differencing * (s - d),
        ]

    u0 = u(0.0)
    release = t_previous + circuit.refractory
    solution = solve_ivp(
        rhs, (0, t_event), [0, u0, u0, u0], method="LSODA", rtol=1e-10, atol=1e-12, max_step=2e-5, dense_output=True
    )
    s_r, d_r = solution.sol(release)[2:]
    return solution.sol(t_event)[3] - s_r - (d_r - s_r) * np.exp(-circuit.differencing * (t_event - release))


def test_changes_equal_an_adaptive_solver_and_the_leak_integral():
    stimulus = sine_light(duration=0.05)
    circuit = MODEL.circuit().with_(leak_hz=3.0, leak_hz_per_radiance=0.02)
    recording = recording_of([0.0101, 0.0153, 0.0302, 0.0411], [1, 1, 0, 1], stimulus)
    changes = ChangeEvaluator(whole(recording))(circuit)
    for k, (a, b) in enumerate([(0.0101, 0.0153), (0.0153, 0.0302), (0.0302, 0.0411)]):
        assert changes.change[k] == pytest.approx(brute_force_change(circuit, stimulus, a, b), abs=2e-6)
        light = quad(lambda t: np.interp(t, stimulus.t, stimulus.radiance), a + 1e-4, b, epsabs=1e-9, limit=500)[0]
        assert changes.drift[k] == pytest.approx(3.0 * (b - a - 1e-4) + 0.02 * light, rel=1e-4)


def test_changes_with_a_bandwidth_floor_equal_an_adaptive_solver():
    """A floor enters the rates of the photoreceptor, not ln L."""
    stimulus = sine_light(level=8.0, duration=0.05)
    circuit = MODEL.circuit().with_(bandwidth_floor=20.0)
    recording = recording_of([0.0101, 0.0153, 0.0302], [1, 1, 0], stimulus)
    changes = ChangeEvaluator(whole(recording))(circuit)
    for k, (a, b) in enumerate([(0.0101, 0.0153), (0.0153, 0.0302)]):
        assert changes.change[k] == pytest.approx(brute_force_change(circuit, stimulus, a, b), abs=2e-6)
        without = brute_force_change(circuit.with_(bandwidth_floor=0.0), stimulus, a, b)
        assert abs(changes.change[k] - without) > 1e-2


def test_polarity_memory_divides_each_level_by_the_factor_of_its_threshold():
    """Each polarity q is held against C_q (1 + strength · q · before): the event's, the other's, censored ones'."""
    model, recordings = small_session()
    strength = 0.2
    likelihood = EventTimes(recordings[:1])
    (iv,) = likelihood.intervals
    pairs = list(zip(iv.sign, iv.previous_sign, strict=True))
    same, other = (np.array([1.0 + which * strength * p * q for p, q in pairs]) for which in (1, -1))
    assert len(set(same)) == 2
    circuit = model.circuit().with_(polarity_memory=strength)
    terms, without = likelihood.terms(circuit), likelihood.terms(model.circuit())
    np.testing.assert_allclose(terms.z, without.z / same, rtol=1e-12)
    np.testing.assert_allclose(np.exp(terms.log_rate), np.exp(without.log_rate) / same, rtol=1e-12)
    searched = plain_changes(likelihood.evaluators[0], circuit)  # whether or not it comes near a threshold
    near = terms.reached != 0
    assert near.sum() > 5
    np.testing.assert_allclose(terms.reached[near], (searched["opposite"] / other)[near], atol=1e-10)


def test_levels_of_a_pixel_with_polarity_memory_scatter_about_one_threshold():
    """After events of either polarity, under the truth; and not where the memory is left out."""
    truth = MODEL.without_effect("threshold_mismatch").with_effect("polarity_memory", {"strength": 0.1})
    stimulus = sine_light(frequency=15.0, duration=1.0)
    likelihood = EventTimes([simulate(truth, stimulus, width=4, height=4, seed=3, as_sampled=True)])
    before = np.concatenate([iv.previous_sign for iv in likelihood.intervals])
    for sign, threshold in ((1, truth.values["on_threshold"]), (-1, truth.values["off_threshold"])):
        for earlier in (1, -1):
            which = (likelihood.sign == sign) & (before == earlier)
            z = likelihood.terms(truth.circuit()).z[which] / threshold
            error = truth.values["threshold_sigma"] / np.sqrt(which.sum())
            assert which.sum() > 100
            factor = 1.0 + 0.1 * sign * earlier  # which a draw's noise does not have
            assert abs(z.mean() - 1.0) < 4 * error / factor
            plain = likelihood.terms(truth.circuit().with_(polarity_memory=0.0)).z[which] / threshold
            assert abs(plain.mean() - 1.0 - 0.1 * sign * earlier) < 4 * 1.1 * error
            assert abs(factor * z.std() / truth.values["threshold_sigma"] - 1.0) < 4 / np.sqrt(2 * which.sum())


@pytest.mark.parametrize("ratio", [1.0, 1.00002, 1.003])
def test_an_extra_pole_close_to_the_follower_is_as_good_as_a_little_apart(ratio):
    """What the likelihood reads of two coinciding poles, beside the trajectory that lets them coincide."""
    circuit = MODEL.with_effect("extra_pole", {"cutoff_hz": ratio * MODEL.values["sf_cutoff_hz"]}).circuit()
    recording = recording_of([0.01, 0.05], [1, 0], sine_light(frequency=200.0))
    read = ChangeEvaluator(whole(recording)).trajectory(circuit)
    exact = integrate(read.t, read.radiance, dynamics_of(circuit))
    assert read.dynamics != dynamics_of(circuit)
    np.testing.assert_allclose(read.at(exact.t)[:, 3:], exact.states[:, 3:], atol=4e-6)


def test_slope_is_the_derivative_of_change():
    stimulus = sine_light()
    circuit = MODEL.circuit().with_(leak_hz=2.0)
    at = np.linspace(0.012, 0.09, 23)
    recording = recording_of([0.01, *at], [1] * 24, stimulus)
    section = whole(recording)
    intervals = replace(section.intervals, previous_s=np.full(23, 0.01))
    values = {
        h: ChangeEvaluator(replace(section, intervals=replace(intervals, time_s=intervals.time_s + h)))(circuit)
        for h in (-1e-8, 0.0, 1e-8)
    }
    difference = (values[1e-8].change - values[-1e-8].change) / 2e-8
    np.testing.assert_allclose(values[0.0].slope, difference, rtol=1e-5, atol=1e-4)


def test_rate_of_the_level_counts_the_drift_of_the_threshold():
    """dz/dt of each pixel's one interval, by moving its event, where light and thresholds move about as fast."""
    model = MODEL.with_effect("leak", {"rate_hz": 0.5}).with_effect("threshold_drift", {"per_s": 0.4})
    stimulus = Stimulus(np.array([0.0, 2.0]), np.array([100.0, 105.0]))

    def level(later_s):
        at = [0.5, 0.5, 1.5 + later_s, 1.8 + later_s]
        r = recording_of(at, [1, 1, 1, 1], stimulus, pixels=[0, 1, 0, 1])
        return EventTimes([r]).terms(model.circuit())

    here, difference = level(0.0), (level(1e-4).z - level(-1e-4).z) / 2e-4
    assert np.all(np.abs(here.z * 0.4 / 1.6) > 0.3 * np.abs(difference))  # the drift's part is no trifle
    np.testing.assert_allclose(np.exp(here.log_rate), difference, rtol=1e-4)


def test_thresholds_that_drift_to_zero_are_impossible_and_no_fit_ends_there():
    recording = simulate(MODEL, sine_light(duration=0.5), width=4, height=2, seed=1)
    end_s = float(EventTimes([recording]).layout.last_time_s.max())
    model = MODEL.with_effect("threshold_drift", {"per_s": 0.05})
    likelihood = EventTimes([recording])
    for left, possible in ((0.009, False), (0.02, True)):
        circuit = model.set({"threshold_drift.per_s": (left - 1.0) / end_s}).circuit()
        assert np.isfinite(likelihood.log_likelihood(circuit)) == possible
    # seen from a model that can hardly explain anything: thresholds many times too high, at any price to be lowered
    far = model.set({"on_threshold": 2.0, "off_threshold": 2.0, "threshold_drift.per_s": -0.9 / end_s})
    held = far.fix({name: None for name in far.free if name != "threshold_drift.per_s"})
    fitted = maximise(likelihood, held, tolerance=0.01, max_steps=60).model
    assert np.isfinite(likelihood.log_likelihood(fitted.circuit()))
    simulate(fitted, recording.stimulus)  # which refuses thresholds at zero


def test_what_the_end_cuts_off_is_held_against_the_threshold_of_then():
    """A change of 1.5 thresholds without an event: hopeless, but for a threshold that has doubled meanwhile."""
    model = MODEL.without_effect("threshold_mismatch").set({"on_threshold": 0.2, "threshold_sigma": 0.1})
    t = np.array([0.0, 1.0, 9.0, 10.0])

    def log_survival(per_s, change=0.3):
        circuit = model.with_effect("threshold_drift", {"per_s": per_s}).circuit()
        rising, flat = (Stimulus(t, 1000.0 * np.exp(np.array([0.0, 0.0, end, end]))) for end in (change, 0.0))
        events = [0.4, 0.5], [1, 1]  # before it begins
        totals = [EventTimes([recording_of(*events, light)]).terms(circuit).total for light in (rising, flat)]
        return totals[0] - totals[1]

    assert log_survival(0.0) < -5.0
    for change, sign in ((0.3, 1), (-0.3, -1)):
        threshold = model.values["on_threshold" if sign > 0 else "off_threshold"]
        expected = norm.logcdf((threshold - 0.3 / 2.0) / (0.1 * threshold))
        assert log_survival(0.1, change) == pytest.approx(expected, abs=2e-3)


def test_density_of_the_next_event_integrates_to_one():
    """ON density + OFF density over all times + chance of no event = 1: rate factor, survival and censoring agree."""
    stimulus = sine_light(level=400.0, frequency=40.0, modulation=0.25, duration=0.06, dt=1e-5)
    model = MODEL.without_effect("threshold_mismatch").set(
        {"threshold_sigma": 0.15, "on_threshold": 0.3, "off_threshold": 0.25}
    )
    circuit = model.circuit()
    first = 0.0101

    def log_likelihood(events):
        return EventTimes([recording_of(*zip(*events, strict=True), stimulus)]).terms(circuit)

    def conditional(t, p):
        """Density of the event (t, p) after `first`, without the interval after it."""
        terms = log_likelihood([(first, 1), (t, p)])
        return 0.0 if terms.background.any() else float(np.exp(terms.total - _censored_part(circuit, t, stimulus)))

    def _censored_part(circuit, t, stimulus):
        changes = ChangeEvaluator(whole(recording_of([first, t], [1, 1], stimulus)))(circuit)
        sd_on, sd_off = circuit.noise * circuit.on_threshold, circuit.noise * circuit.off_threshold
        return float(
            log_ndtr((circuit.on_threshold - changes.rise) / sd_on)[0]
            + log_ndtr((circuit.off_threshold - changes.fall) / sd_off)[0]
        )

    grid = np.arange(first + 1.2e-4, 0.0599, 2e-5)
    # an event of a polarity can only happen at a new extreme of its own change
    changes = [
        float(ChangeEvaluator(whole(recording_of([first, t], [1, 1], stimulus)))(circuit).change[0]) for t in grid
    ]
    running_high = np.maximum.accumulate(np.maximum(changes, 0.0))
    running_low = np.minimum.accumulate(np.minimum(changes, 0.0))
    total = 0.0
    for i, t in enumerate(grid):
        if changes[i] >= running_high[i] > 0:
            total += conditional(t, 1) * 2e-5
        if changes[i] <= running_low[i] < 0:
            total += conditional(t, 0) * 2e-5
    none = np.exp(
        norm.logcdf((0.3 - running_high[-1]) / (0.15 * 0.3)) + norm.logcdf((0.25 + running_low[-1]) / (0.15 * 0.25))
    )
    assert none < 0.5  # the integral has something to do
    assert total + none == pytest.approx(1.0, abs=0.01)


def small_session(seed=3, effects=()):
    from pixelid.stimuli.shapes import chirp, steps

    model = MODEL.set({"on_threshold": 0.2, "off_threshold": 0.22})
    for name in effects:
        model = model.with_effect(name)
    return model, [
        simulate(model, chirp(level=100.0, duration_s=0.3, stop_hz=200.0), width=2, height=2, seed=seed),
        simulate(model, steps(level=10.0, duration_s=0.3), width=2, height=2, seed=seed),
    ]


def test_marginal_threshold_equals_quadrature():
    """The closed-form integral over pixel thresholds equals a numerical one, pixel by pixel."""
    model, recordings = small_session()
    likelihood = EventTimes(recordings)
    circuit = model.circuit()
    marginal = likelihood.terms(circuit)
    assert not marginal.background.any()
    for group in range(2 * likelihood.pixels):
        chosen = likelihood.group == group
        if chosen.sum() < 2:
            continue
        C = circuit.on_threshold if group % 2 else circuit.off_threshold
        z, s = marginal.z[chosen], marginal.scale[chosen]
        best = marginal.group_mean[group]

        grid = best + np.linspace(-12, 12, 4001) * np.sqrt(marginal.group_variance[group])
        at_best = norm.logpdf(z, best, s).sum()
        exponent = (-0.5 * ((z - grid[:, None]) / s) ** 2 + 0.5 * ((z - best) / s) ** 2).sum(axis=1)
        numeric = at_best + np.log(np.trapezoid(np.exp(exponent) * norm.pdf(grid, C, circuit.mismatch * C), grid))
        W, mean = marginal.weight_sum[group], marginal.weighted_mean[group]
        closed = norm.logpdf(z, mean, s).sum() + 0.5 * np.log(2 * np.pi / W)
        closed += norm.logpdf(mean, C, np.sqrt(marginal.mean_variance[group]))
        assert closed == pytest.approx(numeric, abs=1e-6)


@pytest.mark.parametrize("effects", [(), ("leak", "dark_current"), ("threshold_drift", "timestamp_jitter")])
def test_gradient_and_hessian_against_differences_of_the_value(effects):
    model, recordings = small_session(effects=effects)
    objective = EventTimesObjective(EventTimes(recordings), Coordinates.of(model))
    x = objective.coordinates.start + 0.01
    local = objective.local(x)
    assert local.value == pytest.approx(objective.value(x), rel=1e-13)
    scale = 1.0 / np.sqrt(np.diag(local.information))
    for i in range(len(x)):
        h = np.zeros(len(x))
        h[i] = min(0.05 * scale[i], 1e-4)
        quotient = (objective.value(x + h) - objective.value(x - h)) / (2 * h[i])
        assert local.gradient[i] == pytest.approx(quotient, abs=2e-3 / scale[i])
    assert np.linalg.eigvalsh(local.information).min() > -1e-9 * np.linalg.eigvalsh(local.information).max()


def test_a_background_event_costs_a_bounded_price():
    model, recordings = small_session()
    likelihood = EventTimes(recordings)
    base = likelihood.log_likelihood(model.circuit())
    events = recordings[1].events
    quiet = int(np.argmax(np.diff(events.t)))
    t = np.insert(events.t, quiet + 1, (events.t[quiet] + events.t[quiet + 1]) // 2)
    extra = Events(
        t, np.insert(events.x, quiet + 1, events.x[quiet]), np.insert(events.y, quiet + 1, events.y[quiet]),
        np.insert(events.p, quiet + 1, 1), events.width, events.height, events.tick_ns,
    )  # fmt: skip
    spoiled = EventTimes([recordings[0], Recording(extra, recordings[1].stimulus)])
    lost = base - spoiled.log_likelihood(model.circuit())
    terms = spoiled.terms(model.circuit())
    background = int(terms.background.sum())
    best = np.max((terms.log_rate - np.log(terms.scale))[~terms.background])  # the log density of the sharpest event
    assert 1 <= background <= 4  # the false event, and those whose reference it took away
    assert 0 < lost < (background + 1) * (best - np.log(BACKGROUND_HZ))


def test_no_event_is_called_background_under_the_truth():
    model, recordings = small_session()
    assert EventTimes(recordings).terms(model.circuit()).background.sum() == 0


@pytest.mark.parametrize("noise", [0.02, 0.3, 1.0, 3.0])
def test_an_event_the_circuit_cannot_have_fired_is_background_however_wide_the_noise(noise):
    likelihood, circuit = noisy_likelihood()
    terms = likelihood.terms(circuit.with_(refractory=3e-3, noise=noise))
    early = terms.changes.events.early > 0
    assert early.sum() > 5
    assert terms.background[early].all()
    np.testing.assert_array_equal(terms.event.weight[early], 0.0)


def test_log_ndtr_complex_step():
    x = np.array([-40.0, -5.0, 0.0, 3.0])
    step = log_ndtr(x + 1e-30j).imag / 1e-30
    np.testing.assert_allclose(step, (log_ndtr(x + 1e-6) - log_ndtr(x - 1e-6)) / 2e-6, rtol=1e-6)


def test_pooled_or_empty_recordings_are_refused():
    stimulus = sine_light()
    with pytest.raises(InputError, match="no pixels"):
        EventTimes([Recording(recording_of([0.01, 0.02], [1, 1], stimulus).events, stimulus, pooled=True)])
    with pytest.raises(InputError, match="two events"):
        EventTimes([recording_of([0.01], [1], stimulus)])


def test_a_likelihood_weighed_or_with_factors_is_another_one():
    model, recordings = small_session(effects=("timestamp_jitter",))
    circuit = model.circuit()
    likelihood = EventTimes(recordings)
    before = likelihood.log_likelihood(circuit)
    weighed = likelihood.weighed(circuit)
    assert weighed.clock_share.max() > 1.01
    np.testing.assert_array_equal(likelihood.clock_share, 1.0)
    assert weighed.log_likelihood(circuit) != before
    raised = weighed.with_threshold_factor(np.full(likelihood.events, 1.02))
    assert raised.clock_share is weighed.clock_share
    assert weighed.threshold_factor is None
    assert raised.log_likelihood(circuit) != weighed.log_likelihood(circuit)
    assert raised.with_threshold_factor(None).log_likelihood(circuit) == weighed.log_likelihood(circuit)
    assert raised.evaluators is weighed.evaluators
    assert likelihood.log_likelihood(circuit) == before
    with pytest.raises(ValueError, match="read-only"):
        likelihood.layout.sign[0] = 0.0


def test_rows_have_the_names_of_the_changes():
    assert (EventRows._fields, EndRows._fields) == (PER_EVENT, PER_PIXEL)
    _, recordings = small_session()
    likelihood = EventTimes(recordings)
    circuit = MODEL.circuit()
    stacked, each = likelihood.changes(circuit), [evaluate(circuit) for evaluate in likelihood.evaluators]
    for rows in (stacked.events, stacked.ends):
        for name, row in rows._asdict().items():
            shown = row >= 0 if name == "early" else row
            np.testing.assert_array_equal(shown, np.concatenate([getattr(part, name) for part in each]), err_msg=name)
            assert np.shares_memory(row, stacked.vector)
    assert stacked.vector.shape == (likelihood.layout.size,)


NOISY = MODEL.set({"threshold_sigma": 0.15})  # so that many extremes come near a threshold
EFFECTS = ("leak", "parasitic_photocurrent", "threshold_drift", "timestamp_jitter", "polarity_memory")


def noisy_likelihood(effects=()):
    """(likelihood, circuit) of two recordings, clock weighed and with factors of the thresholds."""
    from pixelid.simulate import simulate
    from pixelid.stimuli.shapes import chirp, steps

    lights = chirp(level=100.0, duration_s=0.4, stop_hz=100.0), steps(level=50.0, duration_s=0.4)
    recordings = [simulate(NOISY, light, width=3, height=2, seed=seed) for seed, light in enumerate(lights)]
    model = NOISY
    for effect in effects:
        model = model.with_effect(effect)
    likelihood = EventTimes(recordings).weighed(model.circuit())
    factor = np.exp(0.02 * np.random.default_rng(1).normal(size=likelihood.events))
    return likelihood.with_threshold_factor(factor), model.circuit()


@pytest.mark.parametrize("effects", [(), *((name,) for name in EFFECTS), EFFECTS])
def test_every_piece_equals_the_plain_statement(effects):
    likelihood, circuit = noisy_likelihood(effects)
    # a long dead time makes background events, before their pixel's release: wide noise would allow them their level
    for refractory, noise in ((1e-4, 0.15), (3e-3, 0.15), (3e-3, 1.0)):
        here = circuit.with_(refractory=refractory, noise=noise)
        changes = likelihood.changes(here)
        terms, expected = likelihood.terms(here, changes), plain.terms(likelihood, here, changes.vector)
        assert expected.background.any() == (refractory > 1e-3)
        assert (expected.reached > 0).sum() > 5
        for name in vars(expected):
            np.testing.assert_allclose(getattr(terms, name), getattr(expected, name), rtol=1e-10, err_msg=name)
        assert terms.total == pytest.approx(expected.total, rel=1e-12)
        assert likelihood.log_likelihood(here) == terms.total


@pytest.mark.parametrize(("refractory", "noise"), [(1e-4, 0.15), (3e-3, 0.15), (3e-3, 1.0)])
@pytest.mark.parametrize("effects", [(), EFFECTS])
def test_gradient_equals_complex_steps_of_the_plain_statement(effects, refractory, noise):
    likelihood, circuit = noisy_likelihood(effects)
    circuit = circuit.with_(refractory=refractory, noise=noise)
    changes = likelihood.changes(circuit)
    gradient = likelihood.terms(circuit, changes).gradient()
    rng = np.random.default_rng(0)
    for rows in ("events", "ends"):
        for name in getattr(changes, rows)._fields:
            if name == "early":  # not differentiable
                continue
            along = np.zeros(len(changes.vector))
            row = getattr(getattr(likelihood.layout.stacked(along), rows), name)
            row[:] = rng.normal(size=len(row))
            stepped = plain.terms(likelihood, circuit, changes.vector + 1e-30j * along).total.imag / 1e-30
            size = np.abs(gradient.by_changes.vector * along).sum()
            assert abs(gradient.by_changes.vector @ along - stepped) < 1e-11 * size, name
    for i, name in enumerate(NUMBERS):
        stepped = circuit.with_(**{name: complex(getattr(circuit, name), 1e-30)})
        total = plain.terms(likelihood, stepped, changes.vector.astype(complex)).total
        assert gradient.by_numbers[i] == pytest.approx(total.imag / 1e-30, rel=1e-9), name
