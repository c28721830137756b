"""Bursts of events as one change of the light, dead times included; the comparator trained with the scene."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from pixelid.dynamics.trajectory import Dynamics, integrate
from pixelid.model.shipped import find_model
from pixelid.nerf.data.camera import pinhole
from pixelid.nerf.data.scenes import FIELD_OF_VIEW, spiral
from pixelid.nerf.events.gauge import CLOSE_PIXELS, crossing_time, time_resolution
from pixelid.nerf.events.intervals import chains, intervals
from pixelid.nerf.events.stretches import stretches
from pixelid.nerf.pixel.model import Bandwidth, Pixel
from pixelid.nerf.pixel.scan import respond
from pixelid.nerf.training.losses import changes, quiet_change, terms

QUICK = Dynamics(alpha=2.5e7, beta=1851.0, gamma=450.0, follower=19616.1, differencing=100531.0)


def comparator(log_light, t, on: float, off: float, dead: float):
    """(times, polarities) of events of an ideal pixel without a filter at finely sampled light."""
    times, polarity, release, level = [], [], -math.inf, log_light[0]
    held = False
    for now, value in zip(t, log_light, strict=True):
        if held and now >= release:
            level, held = value, False
        if not held and (value - level >= on or level - value >= off):
            times.append(now)
            polarity.append(value > level)
            release, held = now + dead, True
    return np.array(times), np.array(polarity)


def test_an_edge_with_dead_times_keeps_its_contrast():
    """A ramp of 6 in ln L within 8 ms, thresholds of 0.25, dead times of 0.1 ms: a quarter of it goes unseen.

    The ends are open to a threshold each: what came after the last event, and where in the quiet it came.
    """
    t = np.arange(0, 0.1, 1e-6)
    light = 0.3 * np.sin(40 * t) + 6 * np.clip((t - 0.05) / 8e-3, 0, 1)
    when, on = comparator(light, t, 0.25, 0.25, 1e-4)
    spans = stretches(when, np.zeros(len(when), int), on, 1e-4, 0.0, 2e-3)
    assert spans.burst.sum() == 1
    burst = int(np.flatnonzero(spans.burst)[0])
    inside = (when > spans.begin[burst]) & (when < spans.end[burst])
    truth = np.interp(spans.end[burst], t, light) - np.interp(spans.begin[burst], t, light)
    assert truth > 5.9
    assert 0.25 * inside.sum() < 0.8 * truth  # what events alone say
    assert 0.25 * (spans.rise - spans.fall)[burst] == pytest.approx(truth, abs=0.5)
    assert spans.variance[burst] > 0.03**2 * inside.sum()


@pytest.mark.parametrize(("dead", "most"), [(0.0, 0.25), (1e-3, 0.3)])
def test_edges_between_flat_surfaces_keep_their_contrast(dead, most):
    """Nothing moves until the edge comes: its first threshold is the burst's, and part of one after its last event."""
    t, rng, left = np.arange(0, 0.2, 1e-5), np.random.default_rng(0), []
    for height in rng.uniform(2.5, 6.0, 40):
        light = 0.25 * height * (np.clip((t - 0.05) / 4e-3, 0, 1) - np.clip((t - 0.15) / 4e-3, 0, 1))
        light += 0.3 * np.clip((0.02 - t) / 0.02, 0, 1)  # an event before both edges
        when, on = comparator(light, t, 0.25, 0.25, dead)
        spans = stretches(when, np.zeros(len(when), int), on, dead, 0.0, 4e-3)
        said = (spans.rise - spans.fall)[spans.burst]
        at = np.interp(spans.end, t, light) - np.interp(spans.begin, t, light)
        left += list((said - at[spans.burst] / 0.25) * np.sign(said))
    assert len(left) >= 40
    # thresholds: what each says beyond the truth; −1.6 where time alone shares the quiet, and −0.4 beside the dead
    # time if nothing went on in that of the last event
    assert abs(np.mean(left)) < most
    assert np.std(left) < 0.5


def test_events_that_stand_alone_are_left_alone():
    t = np.arange(20) * 1e-2
    on = np.arange(20) % 3 > 0
    spans = stretches(t, np.zeros(20, int), on, 1e-3, 1e-5, 5e-3)
    assert spans.reset.all()
    np.testing.assert_allclose(spans.begin, t[:-1] + 1e-3)
    np.testing.assert_allclose(spans.end, t[1:])
    np.testing.assert_array_equal(spans.rise, on[1:])
    np.testing.assert_array_equal(spans.fall, ~on[1:])


def test_merging_loses_no_threshold():
    """Without dead time the counts of a pixel sum to those of its events after the first, however they are merged."""
    rng = np.random.default_rng(0)
    pixel = np.repeat([3, 5, 9], [50, 1, 80])
    t = np.concatenate([np.sort(rng.exponential(size=n).cumsum()) for n in (50, 1, 80)])
    on = rng.random(131) < 0.5
    for shortest in (0.0, 0.3, 1.0, 100.0):
        spans = stretches(t, pixel, on, 0.0, 0.0, shortest)
        for one in (3, 9):
            some, events = spans.pixel == one, np.flatnonzero(pixel == one)[1:]
            assert spans.rise[some].sum() == pytest.approx(on[events].sum())
            assert spans.fall[some].sum() == pytest.approx((~on[events]).sum())
            assert (spans.begin[some][1:] >= spans.end[some][:-1] - 1e-12).all()
        assert not (spans.pixel == 5).any()
        assert (spans.end > spans.begin).all()


def test_crossing_time_is_that_of_the_image():
    """A scene seen at 4 units from an orbit of 2 turns per second crosses a pixel in a few milliseconds."""
    camera, box = pinhole(64, 64, FIELD_OF_VIEW), np.full(3, 1.4)
    crossed_s = crossing_time(spiral(0.5, 1.0), camera, -box, box)
    assert 2e-3 < crossed_s < 1e-2
    assert crossing_time(spiral(0.25, 1.0), camera, -box, box) == pytest.approx(crossed_s / 2, rel=1e-6)


def test_an_offset_between_clocks_shows_by_what_no_motion_of_the_scene_does():
    """At an even speed a circle, a line and an approach hide it; at an uneven one its variation shows."""
    camera, box = pinhole(64, 64, FIELD_OF_VIEW), np.full(3, 1.4)
    circle = spiral(0.5, 1.0, 0.4, 0.4)
    shown = crossing_time(circle, camera, -box, box), time_resolution(circle, camera, -box, box)
    assert shown[1] > 100 * CLOSE_PIXELS * shown[0]
    share = np.linspace(0.0, 1.0, len(circle.t))
    one_way = np.tile(circle.orientation[:1], (len(share), 1))
    towards = -circle.position[0] / np.linalg.norm(circle.position[0])
    line = circle.position[0] + np.outer(share - 0.5, np.cross(towards, [0.0, 0.0, 1.0]))
    approach = np.outer(np.exp(-0.3 * share), circle.position[0])  # a scene that grows about the origin
    for position in (line, approach):
        straight = replace(circle, position=position, orientation=one_way)
        shown = crossing_time(straight, camera, -box, box), time_resolution(straight, camera, -box, box)
        assert shown[1] > 100 * CLOSE_PIXELS * shown[0]
    uneven = replace(circle, t=0.5 * (share + 0.7 * np.sin(10 * np.pi * share) / (10 * np.pi)))
    shown = crossing_time(uneven, camera, -box, box), time_resolution(uneven, camera, -box, box)
    slowness = 1 + 0.7 * np.cos(10 * np.pi * np.linspace(0, 1, 10_001))  # dt over the way; times are drawn evenly
    mean, square = 1 / slowness.mean(), np.mean(1 / slowness) / slowness.mean()
    assert shown[1] == pytest.approx(CLOSE_PIXELS * shown[0] / np.sqrt(1 - mean**2 / square), rel=0.05)


def test_light_and_thresholds_that_grow_together_change_no_loss():
    """They make the same events: a loss that fell with them would take every trained threshold along."""
    rng = np.random.default_rng(0)
    t, zero, on = np.cumsum(rng.uniform(1e-3, 1e-2, 400)), np.zeros(400, int), rng.random(400) < 0.5
    spans = intervals(t, zero, zero, on, 1, dead=1e-4)
    batch = chains(spans, np.arange(0, len(spans.starts) - 16, 8), 1, 1000.0, rng)
    circuit = find_model("dvs128").circuit().with_(on_threshold=0.3, off_threshold=0.2)
    pixel = Pixel(circuit, Bandwidth("off", trained=("threshold",)))
    level = pixel.growth * torch.tensor(rng.normal(0, 0.3, len(batch.t)))
    parts = terms(changes(level, level, batch, None), level, batch, *pixel.thresholds, pixel.growth)
    parts["quiet"] = quiet_change(level[:200].reshape(100, 2), *pixel.thresholds)
    for name, value in parts.items():
        (slope,) = torch.autograd.grad(value, pixel.factors, retain_graph=True)
        assert abs(float(slope[4])) < 1e-6 * float(value.detach()), name


def test_thresholds_and_dead_time_are_trained_with_the_rest():
    """On the true light, from a start 30 % off: mean threshold, ON/OFF ratio and dead time come back."""
    t = np.linspace(0.0, 1.0, 500_001)
    light = 1 + 0.6 * np.sin(2 * np.pi * 37 * t) + 0.3 * np.sin(2 * np.pi * 90 * t + 1)
    smooth = integrate(t[::10], light[::10], QUICK).at(t)[:, 2]  # the follower's output
    when, on = comparator(smooth, t, 0.18, 0.12, 4e-4)
    circuit = find_model("dvs128").circuit().with_(
        alpha=QUICK.alpha, beta=QUICK.beta, gamma=QUICK.gamma, follower=QUICK.follower, differencing=math.inf,
        on_threshold=0.19, off_threshold=0.17, refractory=5.2e-4,
    )  # fmt: skip
    zero = np.zeros(len(when), int)
    pixel = Pixel(circuit, Bandwidth("on", trained=("threshold", "ratio", "refractory")))
    spans = intervals(when, zero, zero, on, 1, dead=circuit.refractory)
    batch = chains(spans, np.arange(0, len(spans.starts) - 16, 8), 100, 1000.0, np.random.default_rng(0))
    u = torch.tensor(np.log(np.interp(batch.t, t, light)))
    optimiser = torch.optim.Adam([pixel.factors, pixel.added], lr=0.02)
    for _ in range(250):
        level, output = respond(u, pixel.dynamics, batch.t, batch.first)
        change = changes(level, output, batch, None, pixel.addition("refractory"))
        loss = terms(change, level, batch, *pixel.thresholds)["diff"]
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    values = pixel.values()
    assert values["on_threshold"] == pytest.approx(0.18, rel=0.02)
    assert values["off_threshold"] == pytest.approx(0.12, rel=0.02)
    assert values["refractory_s"] == pytest.approx(4e-4, rel=0.1)
    assert values["alpha"] == circuit.alpha  # was not to be trained


@pytest.mark.parametrize("gap", [30e-6, 40.56e-6, 41e-6])
def test_an_interval_as_long_as_the_dead_time_tells_no_hundred_thresholds(gap):
    """A stated dead time is an estimate; one such interval was the loudest of a recording."""
    t = np.cumsum([0.1, 200e-6, gap, 200e-6])
    found = stretches(t, np.zeros(4, int), np.ones(4, bool), 40.56e-6, 0.0, 0.01)
    assert found.burst.sum() == 1
    assert 3.0 < found.rise[found.burst][0] < 25.0
