"""Noise of a light's trace: found where it is, left alone where there is none, removed without moving the light."""

import numpy as np
import pytest

from pixelid.stimuli.stimulus import Stimulus
from pixelid.stimuli.trace_noise import noise_sd, without_noise

T = 5e-5 * np.arange(16_000)


def lights() -> dict[str, np.ndarray]:
    """ln L: a slow sine, a chirp to 680 Hz, random steps, a constant."""
    rng = np.random.default_rng(5)
    edges = np.sort(rng.uniform(0, T[-1], 40))
    return {
        "slow": np.sin(2 * np.pi * 1.3 * T),
        "chirp": np.sin(2 * np.pi * (5.0 * T + 420.0 * T**2)),
        "steps": rng.normal(0.0, 0.5, 41)[np.searchsorted(edges, T)],
        "constant": np.zeros(len(T)),
    }


def stimulus(logs: np.ndarray) -> Stimulus:
    return Stimulus(T, 24.0 * np.exp(logs), "fA", "linear")


@pytest.mark.parametrize("name", lights())
def test_white_noise_is_measured_and_mostly_removed(name):
    logs = lights()[name]
    noisy = logs + 0.003 * np.random.default_rng(1).standard_normal(len(T))
    assert noise_sd(stimulus(noisy)) == pytest.approx(0.003, rel=0.06)
    left = np.log(without_noise(stimulus(noisy)).radiance / 24.0) - logs
    assert np.std(left) < 0.4 * 0.003
    quiet = np.abs(np.diff(logs)) < 2e-3  # where the light barely moves, extremes would be those of the noise
    assert np.std(np.diff(left)[quiet]) < 0.25 * np.std(np.diff(noisy - logs))


@pytest.mark.parametrize("name", lights())
def test_exact_light_is_left_alone(name):
    light = stimulus(lights()[name])
    assert noise_sd(light) == 0.0
    assert without_noise(light) is light


def test_light_that_jumps_from_sample_to_sample_is_no_noise():
    rng = np.random.default_rng(2)
    assert noise_sd(stimulus(rng.normal(0.0, 0.3, len(T)))) == 0.0


def test_twelve_bits_are_noise():
    rng = np.random.default_rng(3)
    volts = np.exp(lights()["slow"]) * (1.0 + 0.003 * rng.standard_normal(len(T)))
    step = volts.max() / 4096
    digitised = Stimulus(T, np.maximum(np.round(volts / step), 1.0) * step, "V", "linear")
    assert noise_sd(digitised) == pytest.approx(0.003, rel=0.1)
