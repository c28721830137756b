"""Where fits start is inside the parameters' bounds, whatever the events are."""

import numpy as np
import pytest

from pixelid.fit.starts import feasible, upright
from pixelid.likelihood.event_times import EventTimes
from pixelid.model.shipped import find_model
from pixelid.recordings import Events, Recording
from pixelid.stimuli.stimulus import Stimulus


@pytest.fixture(scope="module")
def unrelated() -> EventTimes:
    """Events that have nothing to do with the light: the levels at them scatter about 0."""
    rng, n = np.random.default_rng(3), 200
    t = np.sort(rng.choice(12 * 10**5, n, replace=False)) * 1000
    events = Events.from_columns(t, *rng.integers(0, 2, (3, n)), 2, 2, tick_ns=1000)
    light = Stimulus.from_arrays(np.linspace(0, 1.2, 50), 20 + rng.random(50), "fA")
    return EventTimes([Recording(events, light)])


@pytest.mark.parametrize("threshold", [0.00101, 0.25, 9.9])
@pytest.mark.parametrize("name", ["dvs128", "ideal"])
def test_feasible_values_lie_within_their_bounds(name, threshold, unrelated):
    model = find_model(name)
    model = model.set({"on_threshold": threshold, "off_threshold": threshold})
    started = feasible(model, unrelated)
    assert all(p.lower <= p.value <= p.upper for p in started.parameters.values())
    assert started.values["on_threshold"] != threshold


def test_light_of_unknown_levels_is_brighter_where_on_events_come():
    rng = np.random.default_rng(2)
    bits = rng.integers(0, 2, 200).astype(float)
    light = Stimulus.from_arrays(2e-3 * np.arange(200), bits, "shape", "previous")
    rises = np.repeat(light.t[1:][np.diff(bits) > 0], 5)
    falls = np.repeat(light.t[1:][np.diff(bits) < 0], 5)
    t = np.concatenate([rises, falls]) - 1e-4 + rng.exponential(3e-4, len(rises) + len(falls))
    order, p = np.argsort(t), np.repeat([1, 0], [len(rises), len(falls)])
    zeros = np.zeros(len(t), np.uint16)
    stamps = (1e9 * np.sort(np.maximum(t, 0.0))).astype(np.int64)
    as_is, swapped = (
        Recording(Events(stamps, zeros, zeros, codes[order].astype(np.uint8), 1, 1), light, pooled=True)
        for codes in (p, 1 - p)
    )
    assert upright(as_is) is as_is
    assert np.array_equal(upright(swapped).stimulus.radiance, 1.0 - bits)
