"""The past of a pixel is sampled over what it remembers in the light that it saw, and as finely as its image moves."""

import math

import numpy as np
import pytest
import torch

from pixelid.model.shipped import find_model
from pixelid.nerf.data.calibration import in_unit
from pixelid.nerf.events.intervals import CHAIN, chains, intervals, own_past, rows_of
from pixelid.nerf.pixel.model import Bandwidth, Pixel
from pixelid.nerf.pixel.past import FEWEST, past_of
from pixelid.nerf.pixel.scan import respond
from pixelid.nerf.training.losses import changes

DARK = 0.002
BRIGHT = Pixel(in_unit(find_model("dvs128").circuit(), 2_000.0), Bandwidth())  # fA at white
DIM = Pixel(in_unit(find_model("dvs128").circuit(), 20.0), Bandwidth())


def events(number=400, duration_s=4.0):
    """Stretches of events at random times, ten milliseconds apart on average."""
    rng = np.random.default_rng(0)
    t = np.sort(rng.uniform(0.0, duration_s, number))
    return intervals(t, np.zeros(number, int), np.zeros(number, int), rng.random(number) < 0.5, 1, dead=1e-4)


def scene(t, pixel):
    """Bright bands that pass every 40 ms, 13 ms wide, before grey, for a while before black."""
    grey = np.where(np.asarray(t) < 0.5, DARK, 0.2)
    return grey + 0.4 * (1.0 + np.tanh(8.0 * (np.sin(2 * np.pi * 25.0 * t) - 0.5)))


def asked(t, pixel):
    raise AssertionError("the scene was asked")


def test_where_even_white_needs_all_samples_memory_is_that_of_the_darkest_light():
    spans = events()
    rate, points = past_of(DIM, spans, np.arange(9), 30, DARK, 2.5e-3, asked)
    assert (rate, points) == (DIM.slowest(DARK), own_past(30))
    assert past_of(BRIGHT, spans, np.arange(9), 30, DARK, 0.0, asked)[1] == own_past(30)  # of a speed not known


def test_every_output_has_the_memory_of_the_light_beside_it():
    spans, starts = events(), np.arange(0, 300, 7)
    rate, points = past_of(BRIGHT, spans, starts, 30, DARK, 2.5e-3, scene)
    assert rate.shape == points.shape == (len(starts), CHAIN)
    rows = rows_of(spans, starts)
    ends = scene(spans.stretches.end[rows], 0)
    for run, k in ((0, 3), (5, 0), (20, 15)):
        before = spans.stretches.begin[rows[run, 0]] if k == 0 else spans.stretches.end[rows[run, k - 1]]
        least = max(min(scene(before, 0), ends[run, k]) / 4, DARK)
        assert rate[run, k] == pytest.approx(BRIGHT.slowest(float(least)))
        moved = -math.log(0.05) / rate[run, k] / 2.5e-3
        assert points[run, k] == min(max(math.ceil(8 * moved), FEWEST), own_past(30))
    assert points.min() == FEWEST
    assert points.max() == own_past(30)  # in the dark as many as ever


def test_fewer_samples_tell_changes_as_well():
    """Against 1500 samples over the memory of the darkest light: 30 over that are more, and 20 of them are worse."""
    spans, starts = events(), np.arange(0, 380, 5)
    numbers, slowest = BRIGHT.dynamics, BRIGHT.slowest(DARK)

    def change(samples, rate, points=None):
        batch = chains(spans, starts, samples, rate, np.random.default_rng(1), points)
        level, output = respond(torch.tensor(np.log(scene(batch.t, 0))), numbers, batch.t, batch.first)
        return changes(level, output, batch, numbers[6]).numpy()[batch.weight > 0], len(batch.t)

    exact, _ = change(1500, slowest)
    (usual, many), (coarse, fewer) = change(30, slowest), change(20, slowest)
    own, few = change(30, *past_of(BRIGHT, spans, starts, 30, DARK, 2.5e-3, scene))
    error, of_usual, of_coarse = (np.sqrt(np.mean((x - exact) ** 2)) for x in (own, usual, coarse))
    assert few < fewer < 0.85 * many
    assert error < 1.1 * of_usual
    assert error < 0.7 * of_coarse
