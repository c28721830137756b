"""Silence after an event whose reference stays: events, density, gradient and recovery by independent arithmetic."""

from __future__ import annotations

import numpy as np
import pytest
from oracles import event_time_density as plain
from oracles import silent_events

from pixelid.fit.coordinates import Coordinates
from pixelid.fit.event_times import EventTimesObjective
from pixelid.fit.fit import fit
from pixelid.gap.detect.covariates import sort_events
from pixelid.gap.detect.residuals import residuals
from pixelid.likelihood.density import NUMBERS
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.shipped import find_model
from pixelid.simulate import simulate
from pixelid.stimuli.stimulus import Stimulus

MODEL = find_model("dvs128")
SILENT_S = 2e-3


def sine(duration_s=0.12, level=200.0, contrast=1.0, hz=23.0, dt=2e-5):
    """Light whose logarithm swings by ±contrast, samples joined by straight lines of the logarithm."""
    t = np.arange(0.0, duration_s + dt / 2, dt)
    return Stimulus.from_arrays(t, level * np.exp(contrast * np.sin(2 * np.pi * hz * t)))


def written_out(circuit, stimulus, **changes):
    """(times, signs) of the pixel of a circuit by the oracle."""
    logs = np.log(stimulus.radiance)
    numbers = {
        "alpha": circuit.alpha, "beta": circuit.beta, "gamma": circuit.gamma, "follower": circuit.follower,
        "differencing": circuit.differencing, "thresholds": (circuit.on_threshold, circuit.off_threshold),
        "dead_s": circuit.refractory, "silent_s": circuit.silent, "leak_hz": circuit.leak_hz,
    }  # fmt: skip
    return silent_events.events(
        lambda t: float(np.interp(t, stimulus.t, logs)), stimulus.end_s, **{**numbers, **changes}
    )


@pytest.mark.parametrize("shape", ["full_field", "video"])
@pytest.mark.parametrize(
    ("silent", "dead", "leak"), [(2e-3, 0.0, 0.0), (2e-3, 1e-4, 0.0), (2.1e-3, 1e-4, 20.0), (5e-5, 1e-3, 0.0)]
)
def test_events_are_those_written_out_step_by_step(silent, dead, leak, shape):
    circuit = MODEL.circuit().with_(noise=0.0, mismatch=0.0, refractory=dead, silent=silent, leak_hz=leak)
    light = sine()
    seen = light if shape == "full_field" else Stimulus(light.t, light.radiance[:, None, None], "fA")
    events = simulate(circuit, seen, synchronous=True, as_sampled=True).events
    times, signs = written_out(circuit, light)
    assert len(times) > 15
    np.testing.assert_array_equal(np.where(events.p == 1, 1.0, -1.0), signs)
    np.testing.assert_allclose(events.t * 1e-9, times, rtol=0, atol=5e-8)
    if silent > dead:
        assert (np.abs(np.diff(times) - silent) < 1e-12).sum() >= 3  # at release at once


def test_no_interval_is_shorter_and_many_are_exactly_as_long():
    circuit = MODEL.circuit().with_(refractory=1e-4, silent=SILENT_S)
    events = simulate(circuit, sine(contrast=2.0), width=8, height=8, seed=2).events
    order = np.lexsort((events.t, events.pixel))
    gaps = np.diff(events.t[order])[np.diff(events.pixel[order]) == 0]
    assert gaps.min() >= round(1e9 * SILENT_S) - 1
    assert (np.abs(gaps - 1e9 * SILENT_S) <= 1).mean() > 0.2


def recorded(circuit, seed=0, side=3, contrast=1.5, duration_s=0.4):
    return simulate(circuit, sine(duration_s, contrast=contrast), width=side, height=side, seed=seed, sensor_seed=1)


SILENT = MODEL.with_effect("dead_time_without_reset", {"s": SILENT_S}).set(
    {"threshold_sigma": 0.05, "threshold_mismatch.sigma": 0.03, "refractory_s": 1e-4}
)


@pytest.mark.parametrize("noise", [0.05, 0.15])
@pytest.mark.parametrize(
    "more", [{}, {"leak_hz": 5.0, "threshold_drift": 0.3, "jitter": 2e-6}, {"jitter": 4e-5, "polarity_memory": 0.1}]
)
def test_every_piece_and_its_gradient_equal_the_plain_statement(more, noise):
    circuit = SILENT.circuit().with_(noise=noise, **more)
    likelihood = EventTimes([recorded(circuit, seed) for seed in (0, 1)]).weighed(circuit)
    for silent in (SILENT_S, SILENT_S * (1.0 + 1e-3), 3e-3):
        here = circuit.with_(silent=silent)
        changes = likelihood.changes(here)
        terms, expected = likelihood.terms(here, changes), plain.terms(likelihood, here, changes.vector)
        assert (terms.at_release.sum() > 100) == (silent < 2.9e-3)
        for name in vars(expected):
            ours, theirs = getattr(terms, name), getattr(expected, name)
            if name in ("log_rate", "scale"):
                ours, theirs = ours[~terms.at_release], theirs[~terms.at_release]
            np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-12, err_msg=name)
        gradient = terms.gradient()
        rng = np.random.default_rng(0)
        for rows in ("events", "ends"):
            for name in getattr(changes, rows)._fields:
                along = np.zeros(len(changes.vector))
                row = getattr(getattr(likelihood.layout.stacked(along), rows), name)
                row[:] = rng.normal(size=len(row))
                stepped = plain.terms(likelihood, here, changes.vector + 1e-30j * along).total.imag / 1e-30
                size = np.abs(gradient.by_changes.vector * along).sum()
                assert abs(gradient.by_changes.vector @ along - stepped) <= 1e-10 * size + 1e-12, name
        for i, name in enumerate(NUMBERS):
            stepped = here.with_(**{name: complex(getattr(here, name), 1e-30)})
            slope = plain.terms(likelihood, stepped, changes.vector.astype(complex)).total.imag / 1e-30
            if name != "lost":
                assert gradient.by_numbers[i] == pytest.approx(slope, rel=1e-8), name


def test_the_derivative_by_the_silence_is_a_difference_of_values():
    objective = EventTimesObjective(EventTimes([recorded(SILENT.circuit())]), Coordinates.of(SILENT))
    x = objective.coordinates.start
    i = objective.coordinates.names.index("dead_time_without_reset.s")
    for off in (0.0, 3e-4, -7e-4):
        x[i] = np.log(SILENT_S) + off
        up, down = x.copy(), x.copy()
        up[i], down[i] = x[i] + 1e-7, x[i] - 1e-7
        slope = (objective.value(up) - objective.value(down)) / 2e-7
        assert objective.gradient(x)[i] == pytest.approx(slope, rel=1e-3, abs=1.0)


def log_density(circuit, light, previous, time, sign):
    """Of one event of one pixel after another, nothing unfinished (a recording that ends with it)."""
    from pixelid.recordings import Events, Recording

    t = np.round(np.array([previous, time]) * 1e9).astype(np.int64)
    events = Events.from_columns(t, np.zeros(2, int), np.zeros(2, int), np.array([1, sign > 0], int), 1, 1)
    terms = EventTimes([Recording(events, light, sensor="one")]).terms(circuit)
    return terms.event.term[0] + terms.group.term.sum()


@pytest.mark.parametrize(("previous", "turns"), [(2e-3, 2.2e-2), (6e-3, 2.2e-2), (2e-2, 5e-2), (2.1e-2, 5e-2)])
def test_the_density_of_the_next_event_integrates_to_one(previous, turns):
    """Both polarities, the atom at the end of the silence, and what is left at the end of a monotone stretch."""
    circuit = MODEL.circuit().with_(noise=0.08, mismatch=0.0, refractory=1e-4, silent=SILENT_S)
    light = sine(0.06, contrast=1.0, hz=15.0, dt=1e-5)
    ends = previous + SILENT_S
    atom = ends + np.linspace(-1.1e-5, 1.1e-5, 4401)
    beyond = ends + 1.0001e-5 + np.geomspace(1e-9, turns - ends, 1500)
    total = 0.0
    for sign in (1.0, -1.0):
        at_once = np.exp([log_density(circuit, light, previous, t, sign) for t in atom[::8]])
        later = np.exp([log_density(circuit, light, previous, t, sign) for t in beyond])
        later = np.where(later > 2e-3, later, 0.0)  # events that no threshold explains
        at_once = np.where(at_once > 2e-3, at_once, 0.0)
        total += np.trapezoid(at_once, atom[::8]) + np.trapezoid(later, beyond)
    assert total == pytest.approx(1.0, abs=2e-3)


def test_residuals_of_a_true_model_are_standard_normal():
    likelihood = EventTimes([recorded(SILENT.circuit(), seed, side=6) for seed in (3, 4)])
    here = residuals(likelihood, SILENT.circuit())
    terms = likelihood.terms(SILENT.circuit())
    assert terms.background.mean() < 2e-3
    for chosen in (terms.at_release, ~terms.at_release & ~terms.background):
        e = here.e[chosen]
        assert len(e) > 500
        assert abs(e.mean()) < 4.0 / np.sqrt(len(e)) + 0.03
        assert e.std() == pytest.approx(1.0, abs=4.0 / np.sqrt(2 * len(e)) + 0.03)


def test_cells_of_a_true_model_scatter_as_normals_do():
    """Cells of speeds, which are blurred at random, were once cut by the draws behind residuals at a silence's end."""
    likelihood = EventTimes([recorded(SILENT.circuit(), seed, side=6) for seed in (3, 4)])
    circuit = SILENT.circuit()
    here = residuals(likelihood, circuit)
    for factor in sort_events(likelihood, circuit, here):
        for k in np.unique(factor.cell):
            e = here.e[(factor.cell == k) & ~here.background]
            if len(e) > 100:
                assert abs(np.mean(e**2) - 1.0) < 4.5 * np.sqrt(2.0 / len(e)), (factor.name, factor.labels[k])


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow), pytest.param(2, marks=pytest.mark.slow)])
def test_the_silence_and_the_circuit_come_back(seed):
    """Simulated events, whose simulator is held to the oracle above, from a start five times off."""
    lights = sine(0.4, contrast=1.5), sine(0.4, level=40.0, contrast=0.8, hz=11.0)
    made = [simulate(SILENT, light, width=3, height=3, seed=10 * seed + i, sensor_seed=seed) for i, light in
            enumerate(lights)]  # fmt: skip
    end = fit(made, SILENT.set({"dead_time_without_reset.s": 4e-4}), starts=0, seed=seed)
    assert end.status == "converged"
    silence = end.estimates["dead_time_without_reset.s"]
    assert silence.value == pytest.approx(SILENT_S, rel=1e-3)
    assert abs(silence.value - SILENT_S) < 4.0 * (silence.std or 0.0)
    for name in ("alpha", "on_threshold", "off_threshold"):
        estimate = end.estimates[name]
        assert abs(estimate.value - SILENT.values[name]) < 4.0 * (estimate.std or 0.0), name
