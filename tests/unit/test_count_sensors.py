"""Counts of sensors simulated under shot noise, against sensors simulated one by one."""

import numpy as np
import pytest

from pixelid.gap.confirm.counts import count_events, wait_edges
from pixelid.gap.confirm.simulated import count_sensors
from pixelid.model.shipped import find_model
from pixelid.simulate import simulate
from pixelid.stimuli.shapes import chirp

NOISY = find_model("dvs128").with_effect("shot_noise", {"density": 3e-4})
COPIES = 40


@pytest.mark.parametrize("model", [NOISY, NOISY.with_effect("hot_pixels", {"rate_hz": 300.0, "count": 1})])
def test_sensors_in_one_row_count_as_sensors_apart(model):
    """Thresholds of their own, one hot pixel in each."""
    light = chirp(24.0, stop_hz=60.0, duration_s=0.3)
    apart = [simulate(model, light, width=3, height=1, seed=900 + k, sensor_seed=900 + k) for k in range(COPIES)]
    edges, pixels = [wait_edges(apart[0])], np.arange(3)
    expected = np.stack([count_events([one], pixels, edges).table for one in apart])
    found = count_sensors(apart[:1], pixels, pixels, model, edges, COPIES, 5)
    assert found.shape == expected.shape
    totals = [table[:, :, :2].sum(axis=(1, 2)) for table in (found, expected)]
    error = np.hypot(*(total.std(ddof=1) / np.sqrt(COPIES) for total in totals))
    assert abs(totals[0].mean() - totals[1].mean()) < 4.0 * error
    # pixels of a sensor differ as its thresholds do: to a fourth by so many
    spreads = [table[:, :, 0].std(axis=0).mean() for table in (found, expected)]
    assert spreads[0] == pytest.approx(spreads[1], rel=0.35)
