"""A recording whose camera stopped at an unknown time ends at the first sample after its last event."""

import numpy as np

from pixelid.bench.check import _until_last_event
from pixelid.recordings.events import Events
from pixelid.recordings.recording import Recording
from pixelid.stimuli.stimulus import Stimulus
from pixelid.stimuli.trace_noise import noise_sd


def test_the_light_is_cut_at_a_sample_so_that_its_noise_is_still_read():
    rng = np.random.default_rng(1)
    t = 5e-5 * np.arange(4000)
    light = Stimulus(t, 400.0 * np.exp(0.003 * rng.standard_normal(len(t))), "fA")
    times = np.array([1_000_000, 100_012_345], np.int64)
    zeros = np.zeros(2, np.uint16)
    events = Events(t=times, x=zeros, y=zeros, p=np.ones(2, np.uint8), width=1, height=1)
    cut = _until_last_event(Recording(events, light), light).stimulus
    assert isinstance(cut, Stimulus)
    assert 0.0 < cut.end_s - 1e-9 * times[-1] < 5e-5
    np.testing.assert_allclose(cut.t, t[: len(cut.t)])
    np.testing.assert_allclose(cut.radiance, light.radiance[: len(cut.t)])
    assert abs(noise_sd(cut) / noise_sd(light) - 1.0) < 0.1
    late = Events(t=np.array([0, 300_000_000]), x=zeros, y=zeros, p=np.ones(2, np.uint8), width=1, height=1)
    assert _until_last_event(Recording(late, light), light).stimulus is light
