"""A simulated recording as a camera with a clock of its own would have written it."""

from dataclasses import replace

import numpy as np

from pixelid.recordings.recording import Recording
from pixelid.recordings.triggers import Triggers


def on_its_own_clock(recording: Recording, offset_s: float, ppm: float) -> Recording:
    """Events in whole microseconds of a clock that is `ppm` fast and shows `offset_s` at the light's time zero.

    The stimulus is gone; triggers mark its first and last sample.
    """
    assert recording.stimulus is not None

    def clock(seconds):
        return (np.rint((np.asarray(seconds) * (1 + 1e-6 * ppm) + offset_s) * 1e6) * 1000).astype(np.int64)

    events = replace(recording.events, t=clock(recording.events.t * 1e-9), tick_ns=1000)
    edges = Triggers.from_columns(clock(recording.stimulus.t[[0, -1]]), [True, True], [0, 0])
    return replace(recording, events=events, stimulus=None, triggers=edges)
