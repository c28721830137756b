"""Known answers where every pixel has a gain and a background that the fit is not told.

The test applies them to the light before it simulates, and gives the fit the light without them, every sixteenth frame.
"""

import numpy as np
import pytest
from interval_coverage import hidden_circuit
from pixel_light import grating

from pixelid.fit import fit
from pixelid.model.shipped import find_model
from pixelid.recordings.recording import Recording
from pixelid.simulate import simulate
from pixelid.stimuli.stimulus import Stimulus

SIDE, LEVELS, FRAME_S, SECONDS = 5, (10.0, 300.0), 1e-4, 0.5
SUBFRAMES = 16  # the simulator linearises once per frame of a video: gains are known to 1e-3, as in `pixel_light.py`
GAIN_SPREAD, MOST_BACKGROUND = 0.2, 0.1  # standard deviation of ln gain; of the dim recording's level
SEEDS = range(1, 6)


def session(seed: int):
    """(truth, ln gain (25,), background (25,), recordings) of 25 pixels under gratings at two levels."""
    rng, truth = np.random.default_rng(seed), hidden_circuit(seed)
    t = np.arange(round(SUBFRAMES * SECONDS / FRAME_S) + 1) * FRAME_S / SUBFRAMES
    log_gain = GAIN_SPREAD * rng.standard_normal(SIDE**2)
    background = LEVELS[0] * MOST_BACKGROUND * rng.random(SIDE**2)
    recordings = []
    for k, level in enumerate(LEVELS):
        light = grating(level, SIDE, t)
        seen = light.radiance * np.exp(log_gain).reshape(SIDE, SIDE) + background.reshape(SIDE, SIDE)
        made = simulate(truth, Stimulus(t, seen), seed=4 * seed + k, sensor_seed=seed)
        shown = Stimulus(t[::SUBFRAMES], light.radiance[::SUBFRAMES])
        recordings.append(Recording(made.events, shown, condition=f"grating_{level:g}", sensor=f"simulated {seed}"))
    return truth, log_gain, background, recordings


def covered(truth, result) -> dict[str, bool]:
    """Of every free parameter, whether its interval holds the truth."""
    held = {}
    for name, estimate in result.estimates.items():
        if not estimate.fixed:
            low, high = estimate.interval_95
            value = truth.values[name]
            held[name] = (low is None or low <= value) and (high is None or value <= high)
    return held


@pytest.mark.slow
def test_without_levels_parameters_are_wrong():
    truth, _, _, recordings = session(SEEDS[0])
    result = fit(recordings, find_model("dvs128"), starts=0)
    held = covered(truth, result)
    assert not held["alpha"]
    assert not held["threshold_sigma"]
    assert not held["gamma"]
    assert result.status in ("misfit", "not_converged")  # and it says so


@pytest.mark.slow
def test_levels_and_parameters_are_within_their_errors():
    held, gains, backgrounds, scales = [], [], [], []
    for seed in SEEDS:
        truth, log_gain, background, recordings = session(seed)
        result = fit(recordings, find_model("dvs128"), starts=0, pixel_levels="both")
        assert result.status == "converged"
        held += covered(truth, result).values()
        levels = result.pixel_levels
        place = SIDE * levels.y + levels.x
        about_mean = np.log(levels.gain) - (log_gain - log_gain.mean())[place]
        gains.append(about_mean / levels.ln_gain_sd)
        backgrounds.append((levels.background - background[place]) / levels.background_sd)
        for kind, true in (("gain", GAIN_SPREAD), ("background", np.sqrt(np.mean(background**2)))):
            low, high = levels.scales[kind]["interval_95"]
            scales.append(low < true < high)
    assert np.mean(held) > 0.85  # 50 intervals, within a session not independent
    assert 0.85 < np.sqrt(np.mean(np.square(gains))) < 1.2
    assert 0.85 < np.sqrt(np.mean(np.square(backgrounds))) < 1.2
    assert np.mean(scales) > 0.8
