"""One line names what speaks against a recording: one polarity, ON where light falls, times of another unit."""

from dataclasses import replace

import numpy as np
import pytest

from pixelid.bench.check import check
from pixelid.errors import InputError
from pixelid.inspection.health import inspect
from pixelid.model.shipped import find_model
from pixelid.recordings import Events, Recording, write_recording
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


def test_times_that_cannot_be_the_light_s_are_named():
    right = simulate(find_model("dvs128"), chirp(100.0), width=3, height=3, seed=1)
    same = replace(right.events, t=np.full(len(right.events), 7))
    assert any("one time" in line for line in doubts(replace(right, events=same)))
    coarse = replace(right.events, t=right.events.t // 10**8 * 10**8)
    assert any("times only" in line for line in doubts(replace(right, events=coarse)))
    late = replace(right.events, t=right.events.t + int(0.5e9 * right.stimulus.end_s))
    assert any("outside the light" in line for line in doubts(replace(right, events=late)))
    with pytest.raises(InputError, match=r"align trigger\|first.event\|auto"):
        replace(right, events=late).check_stimulus_covers_events()
    with pytest.raises(InputError, match=r"time.unit"):
        replace(right, events=replace(right.events, t=right.events.t * 1000)).check_stimulus_covers_events()


def test_one_polarity_is_not_called_an_exchanged_one(tmp_path):
    """ON events alone follow an edge of either kind half a period apart."""
    right = simulate(find_model("dvs128"), chirp(100.0), width=3, height=3, seed=1)
    write_recording(replace(right, events=right.events.select(right.events.p == 1)), tmp_path / "a.h5")
    report = check(tmp_path)
    assert any("only ON events" in line for line in report.sentences())
    assert not any(statement.statement == "polarity" for statement in report.statements)
