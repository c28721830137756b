"""Where a model stands in the coordinates of a fit, and replicates that tell nothing of the noise in them."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from pixelid.fit.coordinates import Coordinates
from pixelid.gap.options import Options
from pixelid.gap.shot_noise import shot_noise
from pixelid.gap.shot_noise.replicates import NOTHING_TOLD, Corrected, Replicate
from pixelid.gap.shot_noise.shares import Guess, vector
from pixelid.gap.steps import numbers
from pixelid.likelihood.shot_noise import Division
from pixelid.model.shipped import find_model
from pixelid.parameters.parameter import Parameter
from pixelid.statistics import Z95


def test_phases_of_recordings_are_the_models_and_delays_the_fits():
    model = find_model("dvs128").with_effect("mains_flicker", {"modulation": 0.05})
    model = model.with_nuisances({"mains_flicker.phase_rad": {"dim": 0.4, "bright": 1.1}})
    delay = Parameter("delay_s[dim]", 2e-4, "s", -1.0, 1.0)
    coordinates = Coordinates.of(model, (delay,))
    fit: Any = SimpleNamespace(coordinates=coordinates, x=coordinates.start + 0.01)
    moved = model.set({"alpha": 1.1 * model.values["alpha"]})
    at = dict(zip(coordinates.names, vector(moved, fit), strict=True))
    start = dict(zip(coordinates.names, coordinates.start, strict=True))
    assert at["mains_flicker.phase_rad[dim]"] == start["mains_flicker.phase_rad[dim]"]
    assert at["mains_flicker.phase_rad[bright]"] == start["mains_flicker.phase_rad[bright]"]
    assert at["delay_s[dim]"] == start["delay_s[dim]"] + 0.01
    np.testing.assert_allclose(at["alpha"] - start["alpha"], np.log(1.1))


def well_known_fit(model) -> Any:
    """At the model's own values, each coordinate known to a thousandth."""
    coordinates = Coordinates.of(model)
    return SimpleNamespace(
        coordinates=coordinates, x=coordinates.start.copy(), model=model, values=model.values,
        information=1e6 * np.eye(len(coordinates.names)),
    )  # fmt: skip


CELLS = [("level", str(k)) for k in range(100)]


def at_score(score: float):
    return dict.fromkeys(CELLS, score)


def replicate_in_which(fit, density, score):
    division = Division(density, 0.5, 0.1, 500.0, 1e3)
    return Replicate(fit.x, at_score(score), np.zeros(2), division)


@pytest.mark.parametrize("told", [3e-12, NOTHING_TOLD.density])
@pytest.mark.parametrize("lost_from", [1, 3])
def test_replicates_whose_noise_is_not_found_again_end_the_attempt(monkeypatch, lost_from, told):
    """Their correction once made a density of 7e4, which no model can have: the search ended with an error."""
    model, made = find_model("dvs128"), []
    fit = well_known_fit(model)
    found = Division(3e-4, 0.5, 0.1, 500.0, 1e3)

    def make(evidence, truth, fit, seen, criteria, seed, cache=None):
        turn = len(made)
        made.append(truth.values.get("shot_noise.density", 0.0))
        return replicate_in_which(fit, told if turn >= lost_from else 3e-4, 0.0 if turn == 0 else 20.0)

    monkeypatch.setattr(shot_noise, "can_be_simulated", lambda *given: True)
    monkeypatch.setattr(shot_noise, "share_out", lambda *given, **how: found)
    monkeypatch.setattr(shot_noise, "background_by_polarity", lambda *given: np.zeros(2))
    monkeypatch.setattr(shot_noise, "make_replicate", make)
    monkeypatch.setattr(shot_noise, "map_fits", lambda work, one, jobs, cache: [one(job, cache) for job in jobs])
    evidence: Any = SimpleNamespace(training=SimpleNamespace(recordings=()))
    seen: Any = SimpleNamespace(maps=SimpleNamespace(scores=at_score(20.0)), residual=SimpleNamespace(background=None))
    assert shot_noise.find_shot_noise(evidence, fit, seen, Options()) is None
    assert len(made) == (2 if lost_from == 1 else 2 + shot_noise.REPLICATES)
    assert max(made) == pytest.approx(3e-4)


@pytest.mark.parametrize("more_than_chance", [0.0, 40.0])
def test_a_density_far_off_is_put_right_by_events_without_a_cause(more_than_chance):
    """Where the filter finds nearly the same noise whatever there is, as it does with poles that are far off."""
    model = find_model("dvs128").set({"on_threshold": 0.2, "off_threshold": 0.2})
    truth, measured = 7e-4, np.full(2, 4000.0)
    fit = well_known_fit(model)
    rounds = []

    def made(at, turn=0):
        rounds.append(at.density)
        found = Division(8e-4 * (at.density / truth) ** 0.1, 0.5, 0.01, 500.0, 8.5)
        background = measured * (at.density / truth) ** at.background_per_density()
        return [Replicate(fit.x, {}, background, found)] * shot_noise.REPLICATES

    def judged(at, final):
        left = more_than_chance + abs(math.log(rounds[-1] / truth))
        p = 0.5 if left < 0.05 else 1e-6
        return SimpleNamespace(left=left, density=at.density, corrected=SimpleNamespace(seen=SimpleNamespace(p=p)))

    guess = Guess(fit, Division(8e-4, 0.5, 0.01, 500.0, 8.5), fit.x, 9e-4)
    noise = shot_noise._put_right(guess, made(guess), measured, made, judged, 0.05)
    assert noise is not None
    assert noise.density == pytest.approx(truth, rel=0.05 if more_than_chance else 0.03)
    assert len(rounds) <= (4 if more_than_chance else 5)  # what stays comes no nearer; what is alike is asked once more


@pytest.mark.parametrize("factor", [1.0, 3.0, 10.0])
def test_intervals_widened_by_the_scatter_of_replicates_hold_what_was_there(factor):
    """Coordinates that err by several times what the likelihood says, put right by the median of four replicates."""
    coordinates = Coordinates.of(find_model("dvs128"))
    rng, said, d = np.random.default_rng(0), 0.01, len(coordinates.names)
    found = Division(3e-4, 0.5, 0.1, 500.0, 1e3)
    inside, width = [], []
    for _ in range(400):
        x = factor * said * rng.normal(size=d)
        fit: Any = SimpleNamespace(coordinates=coordinates, x=x, information=np.eye(d) / said**2)
        made = [Replicate(factor * said * rng.normal(size=d), {}, np.zeros(2), found) for _ in range(4)]
        widened = Guess(fit, found, x, 3e-4).widened(made)
        corrected = x - np.median([one.x for one in made], axis=0)
        inside.append(np.abs(corrected) < Z95 * widened * said)
        width.append(widened)
    assert 0.93 < np.mean(inside) < 0.985
    assert np.mean(width) == pytest.approx(factor * np.sqrt(1.0 + np.pi / 8.0), rel=0.15)


def test_what_events_hold_little_of_is_not_widened():
    coordinates = Coordinates.of(find_model("dvs128"))
    d = len(coordinates.names)
    information = np.diag([1.0, *[1e4] * (d - 1)])  # an error of a factor e, and of 1 %
    fit: Any = SimpleNamespace(coordinates=coordinates, x=np.zeros(d), information=information)
    found = Division(3e-4, 0.5, 0.1, 500.0, 1e3)
    rng = np.random.default_rng(0)
    made = [Replicate(rng.normal(size=d), {}, np.zeros(2), found) for _ in range(4)]
    widened = Guess(fit, found, np.zeros(d), 3e-4).widened(made)
    assert widened[0] == 1.0
    assert (widened[1:] > 10.0).all()


@pytest.mark.parametrize("answer", [0.6, 1.0, 1.7, 2.6])
def test_corrections_settle_where_refits_answer_a_step_by_more_than_its_length(answer):
    """Full steps would go farther off with each from an answer of 2 on; a memory of the polarity answered by 1.7."""
    model = find_model("dvs128")
    coordinates, rng = Coordinates.of(model), np.random.default_rng(0)
    start = coordinates.start
    i = coordinates.names.index("beta")
    truth = start.copy()
    truth[i] += 0.15
    fit = well_known_fit(model)
    fit.x[i] = start[i] + 0.35  # where the likelihood that knows no shot noise ends in the measurement
    found = Division(3e-4, 0.5, 0.1, 500.0, 1e3)
    guess = Guess(fit, found, fit.x, 3e-4)

    def refitted(at):
        x = at.copy()
        x[i] = fit.x[i] + answer * (at[i] - truth[i]) + 0.003 * rng.normal()
        return Replicate(x, {}, np.zeros(2), found)

    for _ in range(6):
        guess = guess.corrected([refitted(vector(guess.model, fit))])
    assert guess.x[i] == pytest.approx(truth[i], abs=0.01)


@pytest.mark.parametrize(
    ("off", "tried"),
    [
        ([1000.0, 100.0], 1),  # near at once
        ([3000.0, 3700.0, 2600.0, 400.0], 3),  # the first correction leads away
        ([3000.0, 3000.0, 3000.0, 100.0], None),  # two come no nearer
        ([3950.0, 3550.0, 3190.0, 2870.0, 2580.0, 2450.0, 2430.0, 100.0], None),  # too slow
    ],
)
def test_single_replicates_lead_on_as_long_as_they_come_nearer(off, tried):
    turns = []

    def made(job):
        turns.append(job[1])
        return [off[len(turns)]]

    start: Any = SimpleNamespace(is_told=True, model=None)
    start.corrected = lambda replicates: start
    found: Any = shot_noise._approached(start, off[0], lambda one: one, 2420.0, made)
    assert (None if found is None else len(turns)) == tried
    assert len(set(turns)) == len(turns)


@pytest.mark.parametrize(
    ("guessed", "p_again", "rounds", "density"),
    [
        (3.03e-4, 0.5, 1, 3e-4),  # off by less than its error
        (3.25e-4, 0.5, 2, 3e-4),
        (3.25e-4, 0.01, 2, None),  # then less like it: as it was before
    ],
)
def test_replicates_alike_but_off_in_the_density_are_made_once_more(guessed, p_again, rounds, density):
    model = find_model("dvs128")
    fit = well_known_fit(model)
    truth, measured, seen = 3e-4, Division(3e-4, 0.5, 0.03, 500.0, 8.5), []

    def made(at, turn=0):
        found = replace(measured, density=measured.density * at.density / truth)
        return [Replicate(fit.x, {}, np.zeros(2), found)] * shot_noise.REPLICATES

    def judged(at, final):
        seen.append(at.density)
        p = 0.5 if len(seen) == 1 else p_again
        return SimpleNamespace(left=1.0, density=at.density, corrected=SimpleNamespace(seen=SimpleNamespace(p=p)))

    guess = Guess(fit, measured, fit.x, guessed)
    noise = shot_noise._put_right(guess, made(guess), np.zeros(2), made, judged, 0.05)
    assert noise is not None
    assert len(seen) == rounds
    assert noise.density == pytest.approx(seen[0] if density is None else density, rel=1e-6)


@pytest.mark.parametrize(
    ("by_the_filter", "gained", "left_out", "more"),
    [
        *[(1050.0, 170.0, (), True), (0.0, 715.0, (), False), (15.0, 10.0, (), False)],
        (1050.0, 170.0, ("shot_noise",), False),
    ],
)
def test_an_effect_at_drawn_times_has_shot_noise_for_a_rival(monkeypatch, by_the_filter, gained, left_out, more):
    """Behind a queue a memory of the polarity stood in for it; one that was there left the filter nothing."""
    monkeypatch.setattr(shot_noise, "share_out", lambda *given, **how: Division(3e-4, 0.5, 0.1, by_the_filter, 1e3))
    evidence: Any = SimpleNamespace(training=None)
    options, model = Options(leave_out=left_out), find_model("dvs128")
    assert shot_noise.noise_explains_more(evidence, model, gained, options) == more
    with_noise = model.with_effect("shot_noise", {"density": 3e-4})
    assert not shot_noise.noise_explains_more(evidence, with_noise, gained, options)


@pytest.mark.parametrize("events", [0.0, 1e9])
def test_a_correction_beyond_all_densities_is_not_told(events):
    """Noise that replicates lack, weighed by events without a cause that hardly depend on it, is e to the 900 off."""
    model = find_model("dvs128").set({"on_threshold": 0.01, "off_threshold": 0.01})
    fit = well_known_fit(model)
    found = Division(3e-4, 0.5, 0.1, 500.0, 8.5)
    told = NOTHING_TOLD if events == 0.0 else Division(1e290, 0.5, 0.1, 500.0, 8.5)
    made = [Replicate(fit.x, {}, np.full(2, events), told)]
    guess = Guess(fit, found, fit.x, 3e-4).corrected(made, np.full(2, 4000.0))
    assert not guess.is_told
    assert np.isfinite(guess.density)


def test_an_interval_without_an_end_stays_one_when_it_is_widened(monkeypatch):
    """An interval that went beyond all numbers, widened beside shot noise, ended the search with an OverflowError."""
    model = find_model("dvs128")
    coordinates = Coordinates.of(model)
    plain = {p.name: (p.lower, min(p.upper, 1e80)) for p in coordinates.parameters}
    plain["beta"] = (model.values["beta"] / 1.01, model.values["beta"] * 1.01)
    monkeypatch.setattr(numbers, "interval_95", lambda *given: plain)
    d = len(coordinates.names)
    fit: Any = SimpleNamespace(coordinates=coordinates, x=coordinates.start)
    corrected = Corrected(model, np.full(d, 0.05), cast(Any, None), np.full(d, 80.0))
    hypothesis: Any = SimpleNamespace(
        evidence=SimpleNamespace(training=None), fit=fit, scatter=None, jitter=None, corrected=corrected
    )
    found = numbers.intervals_of(hypothesis)
    factor = math.exp(0.05) * np.array([1.01**-80, 1.01**80])
    np.testing.assert_allclose(found["beta"], model.values["beta"] * factor)
    for p in coordinates.parameters:
        low, high = found[p.name]
        assert p.lower <= low < high <= p.upper
