"""Evenness of the field: gains of pixels found where they differ, none where they do not, and exact gradients."""

from dataclasses import replace

import numpy as np
import pytest

from pixelid.errors import InputError
from pixelid.fit.bench import with_bench
from pixelid.fit.coordinates import Coordinates
from pixelid.fit.event_times import EventTimesObjective
from pixelid.fit.field import field_of
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.shipped import find_model
from pixelid.recordings.bench import Bench, gains_of_pixels, on_bench, with_pixel_gains
from pixelid.recordings.own_light import with_fine_light
from pixelid.simulate import simulate
from pixelid.stimuli.pixel_lights import PixelLights
from pixelid.stimuli.shapes import chirp

MODEL = find_model("dvs128")
LIGHT = chirp(60.0, 1.0, 5.0, 150.0, duration_s=0.8, dt=1e-4)
PIXELS = 9


def recorded(gains: np.ndarray, seed: int):
    """A recording whose pixels see so much of the light, which it does not know."""
    lights = [LIGHT.brighter_by(float(np.exp(gain))) for gain in gains]
    made = simulate(MODEL, PixelLights.of_groups(lights, np.arange(PIXELS).reshape(3, 3)), seed=seed)
    return replace(made, stimulus=LIGHT, condition="uneven")


def objective_of(recordings):
    model = with_bench(MODEL, recordings)
    fine = [with_fine_light(r, "linear") for r in recordings]
    return EventTimesObjective(EventTimes(fine), Coordinates.of(model))


def at_start(objective):
    return field_of(objective.likelihood, objective.circuit(objective.coordinates.start))


def test_gains_are_found_and_explain_the_events():
    gains = 0.05 * np.random.default_rng(4).normal(size=PIXELS)
    gains -= gains.mean()
    recording = recorded(gains, 1)
    objective = objective_of([recording])
    field = at_start(objective)
    assert field is not None
    assert field.sd == pytest.approx(0.05, rel=0.6)
    np.testing.assert_allclose(field.gains, gains, atol=0.015)
    known = objective_of(field.on([recording]))
    x = objective.coordinates.start
    truly = objective_of([recording.with_stimulus(
        PixelLights.of_groups([LIGHT.brighter_by(float(np.exp(g))) for g in field.gains],
                              np.arange(PIXELS).reshape(3, 3)))])  # fmt: skip
    gained = known.value(x) - objective.value(x)
    assert gained > 20.0
    exactly = truly.value(x) - objective.value(x)
    assert gained == pytest.approx(exactly, rel=0.1)  # to first order
    to_second = known.near(x).value(x) - objective.value(x)
    assert abs(to_second - exactly) < 0.2 * abs(gained - exactly)


def test_an_even_field_has_none():
    objectives = [objective_of([recorded(np.zeros(PIXELS), k)]) for k in range(6)]
    flagged = [at_start(objective) for objective in objectives]
    assert flagged == [None] * 6  # one in 170 such runs has one of six by chance


def test_gradients_hold_with_gains_and_clocks():
    gains = np.linspace(-0.05, 0.05, PIXELS)
    recording = with_pixel_gains(on_bench(recorded(gains, 2), Bench(0.03)), np.arange(PIXELS), gains)
    objective = objective_of([recording, replace(recorded(gains, 3), condition="even")])
    x = objective.coordinates.start
    gradient, information = objective.gradient(x), np.diag(objective.local(x).information)
    for i, name in enumerate(objective.coordinates.names):
        if name not in ("alpha", "beta", "on_threshold", "light_gain[uneven]"):
            continue
        up, down = x.copy(), x.copy()
        up[i] += 1e-5
        down[i] -= 1e-5
        slope = (objective.value(up) - objective.value(down)) / 2e-5
        assert gradient[i] == pytest.approx(slope, abs=0.02 * np.sqrt(information[i]))  # 0.02 standard errors


def test_gains_are_by_pixel_and_checked():
    recording = with_pixel_gains(recorded(np.zeros(PIXELS), 5), np.array([7, 2]), np.array([0.1, -0.2]))
    np.testing.assert_allclose(gains_of_pixels(recording, np.array([2, 3, 7])), [-0.2, 0.0, 0.1])
    damaged = replace(recording, attributes={"pixel_gain": {"pixel": [1], "ln_gain": []}})
    with pytest.raises(InputError, match="pixel_gain"):
        gains_of_pixels(damaged, np.array([1]))
