"""The simulator's events of the whole pixel are those written out from its equations, to 10 µs."""

import numpy as np
import pytest
from oracles.whole_pixel import MOST, NOTHING, Oddity, Pixel, signals, walk
from scipy.interpolate import CubicSpline

from pixelid.model.shipped import find_model
from pixelid.simulate import simulate
from pixelid.stimuli.resample import resampled
from pixelid.stimuli.shapes import chirp, slow, steps

PIXEL = Pixel(5e4, 1500.0, 1.12, 2 * np.pi * 3000.0, 2 * np.pi * 16e3, 0.19, 0.22, 2e-4)
MODEL = (
    find_model("dvs128")
    .set({
        "alpha": PIXEL.alpha, "beta": PIXEL.beta, "gamma": PIXEL.gamma, "sf_cutoff_hz": 3000.0, "diff_cutoff_hz": 16e3,
        "on_threshold": PIXEL.on, "off_threshold": PIXEL.off, "refractory_s": PIXEL.dead_s,
    })
    .without_effect("threshold_mismatch")
    .without_effect("threshold_noise")
)  # fmt: skip
LIGHTS = {
    "slow": slow(3.0, seed=1), "chirp": chirp(24.0, stop_hz=200.0), "steps": steps(400.0, seed=5),
}  # fmt: skip
EFFECTS = {
    "nothing": ({}, NOTHING),
    "leak": ({"leak": {"rate_hz": 3.0}}, Oddity(leak_hz=lambda t, light, speed: 3.0)),
    "dark current": ({"dark_current": {"radiance": 4.0}}, None),
    "after an ON event": (
        {"described.on_threshold.previous_polarity.constant": {"strength": -0.06}}, Oddity(after=(-0.06, 0.0, 0.0)),
    ),
    "relaxing": (
        {"described.off_threshold.time_since_event.relaxation": {"strength": 0.2, "scale": 0.02}},
        Oddity(relaxing=(0.0, 0.2, 0.02)),
    ),
    "at speed": (
        {"described.on_threshold.speed.step": {"strength": 0.1, "edge": 20.0}},
        Oddity(on=lambda t, light, speed: 0.1 * (speed > 20.0)),
    ),
    "dead time by light": (
        {"described.dead_time.radiance.power": {"strength": 1e-3, "exponent": -0.5, "reference": 100.0}},
        Oddity(dead_s=lambda t, light, speed: 1e-3 * np.sqrt(100.0 / light)),
    ),
}  # fmt: skip


@pytest.mark.parametrize("light", LIGHTS)
@pytest.mark.parametrize("effect", EFFECTS)
def test_simulated_events_are_those_written_out(light, effect):
    added, odd = EFFECTS[effect]
    model, dark = MODEL, 4.0 if odd is None else 0.0
    for name, values in added.items():
        model = model.with_effect(name, values)
    stimulus, odd = LIGHTS[light], odd or NOTHING
    smooth = CubicSpline(stimulus.t, np.log(stimulus.radiance))
    seen = signals(PIXEL, lambda t: np.exp(smooth(t)) + dark, stimulus.duration_s, odd)
    from_zero = PIXEL.off / (PIXEL.on + PIXEL.off)
    times, signs = walk(PIXEL, (PIXEL.on, PIXEL.off), seen, np.ones((MOST, 2)), from_zero, odd)
    found = simulate(model, resampled(stimulus, "smooth"), synchronous=True).events
    assert len(times) > 10
    assert len(found) == len(times)
    np.testing.assert_array_equal(np.where(found.p == 1, 1.0, -1.0), signs)
    # a sample of the light is 50 µs, and what an event sees of it sets the dead time
    np.testing.assert_allclose(1e-9 * found.t, times, atol=1e-5)
