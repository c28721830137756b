"""Arrays have the shapes and types that their annotations state."""

import dataclasses

import jaxtyping
import numpy as np
import pytest

from pixelid.recordings import Events
from pixelid.recordings.recording import Recording
from pixelid.stimuli.shapes import SHAPES
from pixelid.stimuli.stimulus import Stimulus

NAMES = {"np": np, **{name: getattr(jaxtyping, name) for name in ("Float", "Float64", "Int64", "UInt8", "UInt16")}}


def check(value) -> int:
    """Check every annotated array of a dataclass, axes of one name having one length; how many there were."""
    checked = 0
    with jaxtyping.jaxtyped("context"):
        for field in dataclasses.fields(value):
            if "[np.ndarray" in str(field.type):
                array = getattr(value, field.name)
                wanted = eval(str(field.type), NAMES)
                assert isinstance(array, wanted), (
                    f"{field.name}: expected {field.type}, found {array.dtype}{array.shape}"
                )
                checked += 1
    return checked


def some_events(n: int = 5) -> Events:
    return Events.from_columns(np.arange(n), np.zeros(n, int), np.zeros(n, int), np.zeros(n, int), 2, 2)


@pytest.mark.parametrize("name", SHAPES)
def test_stimuli(name):
    assert check(SHAPES[name]()) == 2


def test_events():
    assert check(some_events()) == 4
    assert check(Events.empty(2, 2)) == 4
    assert check(some_events().select(np.array([1, 3]))) == 4


def test_what_is_simulated_and_read_back(tmp_path):
    import pixelid as px
    from pixelid.recordings import write_recording

    recording = px.simulate("ideal", "sine", pixels=4)
    write_recording(recording, tmp_path / "a.h5")
    for one in (recording, px.open(tmp_path / "a.h5")):
        assert isinstance(one, Recording)
        assert check(one.events) == 4
        assert one.stimulus is not None
        assert check(one.stimulus) == 2


@pytest.mark.parametrize(
    "wrong",
    [
        dataclasses.replace(some_events(), x=np.zeros(4, np.uint16)),
        dataclasses.replace(some_events(), t=np.zeros(5)),
        dataclasses.replace(some_events(), p=np.zeros((5, 1), np.uint8)),
        Stimulus(np.zeros(3), np.zeros(4)),
    ],
)
def test_wrong_shapes_and_types_are_noticed(wrong):
    with pytest.raises(AssertionError, match="expected"):
        check(wrong)
