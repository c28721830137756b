"""Recordings simulated again: the events that a model would have given under the same light."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pixelid.dynamics.equations import PRESENT_BELOW
from pixelid.likelihood.clocks import light_on_clock
from pixelid.likelihood.light_drawn import light_in_a_row
from pixelid.model.model import Model
from pixelid.parallel import map_threads
from pixelid.recordings.bench import gains_of_pixels, with_pixel_gains
from pixelid.recordings.own_light import with_fine_light
from pixelid.recordings.recording import Recording
from pixelid.recordings.sensor_light import is_measured
from pixelid.simulate import simulate
from pixelid.simulate.laws import rules_of
from pixelid.simulate.light import noise_step
from pixelid.stimuli.pixel_lights import in_a_row, lights_in


def simulate_again(
    recordings: Sequence[Recording], truth: Model, pixels: np.ndarray, between: str | None, seed: int
) -> list[Recording]:
    """The recordings with the events that a sensor of a row of these pixels, flat indices, would have given.

    between: how their stimuli run between samples; None: as they are
    """

    def simulated(job: tuple[int, Recording]) -> Recording:
        i, r = job
        light = r.stimulus if between is None else with_fine_light(r, between).stimulus
        assert light is not None
        here = truth.in_recording(r.name)
        seen = light_in_a_row(r, light_on_clock(r, light, here.circuit()), pixels, seed + 101 * i)
        run = simulate(here, seen, width=len(pixels), height=1, seed=seed + 101 * i, sensor_seed=seed)
        as_came = in_a_row(light if r.stimulus is None else r.stimulus, pixels)
        gains = gains_of_pixels(r, pixels)
        r = with_pixel_gains(r, np.arange(len(pixels)), gains) if gains.any() else r
        made = replace(r, events=replace(run.events, tick_ns=r.events.tick_ns), stimulus=as_came)
        late = is_measured(r) or here.circuit().delay != 0.0  # a delay that is free carries events past the end
        return made.within_stimulus() if late else made

    return map_threads(simulated, enumerate(recordings))


def can_be_simulated(recordings: Sequence[Recording], model: Model) -> bool:
    """Whether the model limits the bandwidth of white noise, and so that its steps are not too many to simulate."""
    circuit = model.circuit()
    rules = rules_of(circuit, 0, False, 0.0)
    if circuit.photoreceptor == "unlimited" and min(rules.chain[0], rules.chain[1], rules.chain[3]) > PRESENT_BELOW:
        return False
    steps = 0.0
    for recording in recordings:
        light = recording.stimulus
        assert light is not None
        brightest = max(float(one.radiance.max()) for one in lights_in(light))
        steps += light.duration_s / float(noise_step(rules, brightest + circuit.dark))
    # Of all recordings together.  The shipped pixel needs 1e5 a second in bright light; a bandwidth hundreds of times
    # as high, which only a fit that ran away has, would take hours, and its noise would look like the thresholds'.
    most_steps = 5e7
    return steps < most_steps
