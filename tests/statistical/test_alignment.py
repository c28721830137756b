"""Clock offsets found from events alone: their intervals hold the truth as often as they say."""

import numpy as np
import pytest
from oracles.cameras import on_its_own_clock
from scipy.stats import binom

from pixelid.model.shipped import find_model
from pixelid.recordings.alignment import find_alignment
from pixelid.simulate import simulate
from pixelid.stimuli import shapes

SESSIONS = 40


@pytest.mark.slow
def test_intervals_of_offset_and_clock_rate_cover_the_truth():
    base, rng = find_model("dvs128"), np.random.default_rng(11)
    scores = []
    for seed in range(SESSIONS):
        filters = ("alpha", "beta", "gamma", "sf_cutoff_hz", "diff_cutoff_hz")
        values = {name: base.values[name] * float(np.exp(rng.uniform(-0.4, 0.4))) for name in filters}
        values |= {name: float(rng.uniform(0.15, 0.3)) for name in ("on_threshold", "off_threshold")}
        model = base.set({**values, "refractory_s": float(rng.uniform(2e-5, 5e-4))})
        level = float(np.exp(rng.uniform(np.log(20), np.log(1000))))
        light = shapes.steps(level, seed=seed) if seed % 2 else shapes.chirp(level, stop_hz=200 + level / 2)
        offset, ppm = float(rng.uniform(0, 100)), float(rng.normal(0, 50))
        recording = simulate(model, light, width=4, height=4, seed=seed, sensor_seed=seed)
        alignment = find_alignment(on_its_own_clock(recording, offset, ppm), light, "auto")
        row = []
        for truth, value, interval in (
            (offset, alignment.offset_s, alignment.offset_interval_95),
            (1e-6 * ppm, alignment.rate_error, alignment.rate_interval_95),
        ):
            assert interval is not None
            row.append((value - truth) / ((interval[1] - interval[0]) / 3.92))
        scores.append(row)
    inside = (np.abs(scores) < 1.96).sum(axis=0)
    # 95 % coverage would give fewer in one of 2000 runs
    assert inside.min() >= binom.ppf(5e-4, SESSIONS, 0.95)
    # and intervals are no wider than they must be
    assert np.sqrt(np.mean(np.square(scores), axis=0)).min() > 0.4
