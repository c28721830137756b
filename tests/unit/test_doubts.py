"""One line names what speaks against a recording: one polarity, ON where light falls, times of another unit."""

from dataclasses import replace

import numpy as np
import pytest

from pixelid.inspection.health import inspect
from pixelid.model.shipped import find_model
from pixelid.recordings import Events, Recording
from pixelid.recordings.doubts import doubts
from pixelid.simulate import simulate
from pixelid.stimuli.shapes import chirp, constant, steps


@pytest.mark.parametrize("light", [chirp(100.0), steps(100.0)])
def test_right_recordings_raise_no_doubt(light):
    assert doubts(simulate(find_model("dvs128"), light, width=3, height=3, seed=1)) == []


def test_an_inverted_chirp_is_named():
    right = simulate(find_model("dvs128"), chirp(100.0), width=3, height=3, seed=1)
    inverted = replace(right, events=replace(right.events, p=1 - right.events.p))
    (line,) = doubts(inverted)
    assert "ON events where the light falls" in line


def test_one_polarity_and_times_of_another_unit_are_named():
    right = simulate(find_model("dvs128"), chirp(100.0), width=3, height=3, seed=1)
    only = replace(right, events=right.events.select(right.events.p == 1))
    assert any("only ON events" in line for line in doubts(only))
    assert any("only ON events" in line for line in inspect(only).doubts)
    short = replace(right, events=replace(right.events, t=right.events.t // 1000))
    assert any("--time-unit" in line for line in doubts(short))


def test_silence_under_constant_light_is_no_doubt():
    dark = Recording(Events.empty(2, 2), constant(5.0))
    assert doubts(dark) == []
    few = Events.from_columns(np.arange(5) * 10**8, [0] * 5, [0] * 5, [1] * 5, 2, 2)
    assert doubts(Recording(few, constant(5.0))) == []
