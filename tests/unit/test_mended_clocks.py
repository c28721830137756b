"""Clocks of aligned recordings before a gap search: the error that was put in is taken out, others stay as they are."""

from dataclasses import replace

import numpy as np
import pytest

from pixelid.gap.mended_clocks import MENDED, with_mended_clocks
from pixelid.model.shipped import find_model
from pixelid.recordings.recording import Recording
from pixelid.simulate import simulate
from pixelid.stimuli.shapes import chirp

TOLD = {"method": "auto", "offset_s": 0.0, "clock_rate_error": 0.0, "offset_interval_95": [-1e-3, 1e-3]}
DELAY_S = 4e-4


@pytest.fixture(scope="module")
def made() -> list[Recording]:
    light = chirp(300.0, modulation=0.6, stop_hz=400.0, duration_s=0.4, dt=1e-4)
    runs = [simulate(find_model("dvs128"), light, width=3, height=2, seed=k, sensor_seed=1) for k in range(2)]
    return [replace(run, condition=f"run {k}", sensor="one") for k, run in enumerate(runs)]


def test_a_wrong_alignment_is_mended(made):
    early = made[0].with_stimulus(made[0].stimulus.shifted(-DELAY_S))
    inside = early.events.t * 1e-9 <= early.stimulus.end_s
    early = replace(early, events=early.events.select(inside), attributes={"alignment": TOLD})
    mended, other = with_mended_clocks([early, made[1]], find_model("dvs128"), 0)
    assert other is made[1]
    assert mended.attributes[MENDED]["delay_s"] == pytest.approx(DELAY_S, abs=4e-5)
    np.testing.assert_allclose(mended.stimulus.t, made[0].stimulus.t, atol=5e-5)


def test_nothing_moves_without_an_alignment(made):
    assert all(a is b for a, b in zip(with_mended_clocks(made, find_model("dvs128"), 0), made, strict=True))
