"""The practice session from 20 random starts within a factor 3 of the truth: at least 18 reach the same optimum."""

import json

import numpy as np
import pytest

from pixelid.fit import fit
from pixelid.model.shipped import find_model
from pixelid.recordings import open_recordings

FACTOR, STARTS = 3.0, 20


@pytest.mark.slow
def test_random_starts_reach_the_same_optimum(shared):
    truth = json.loads((shared / "gap_cases" / "truth.json").read_text())["null"]
    recordings = open_recordings(sorted((shared / "gap_cases" / "null").glob("*.h5")))
    model = find_model("dvs128")
    near = model.set({name: truth[name] for name in model.free if name in truth})
    rng = np.random.default_rng(0)
    starts = []
    for _ in range(STARTS):
        moves = rng.uniform(-np.log(FACTOR), np.log(FACTOR), len(near.free))
        start = {}
        for name, move in zip(near.free, moves, strict=True):
            p = near.parameter(name)
            start[name] = float(np.clip(p.value * np.exp(move), p.lower, p.upper))
        starts.append(fit(recordings, near.set(start), starts=0, between="smooth"))
    best = max(starts, key=lambda result: result.log_likelihood)
    sd = np.sqrt(np.diag(best.covariance))
    same = [np.abs((result.x - best.x) / sd).max() < 0.1 for result in starts]
    assert sum(same) >= 18
    for name, tolerance in (("alpha", 0.02), ("beta", 0.02), ("gamma", 0.02), ("sf_cutoff_hz", 0.02),
                            ("diff_cutoff_hz", 0.05)):  # fmt: skip
        assert best.estimates[name].value == pytest.approx(truth[name], rel=tolerance)
