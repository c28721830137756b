"""What `paths.memory` runs in a process of its own: name → a function of the sizes that gives (warm up, work)."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from itertools import repeat
from pathlib import Path

import numpy as np

from pixelid.model.shipped import find_model

DT = 1e-4
Work = tuple[Callable[[], object], Callable[[], object]]


def _frames(width: int, height: int, steps: int):
    """A grating that moves, made frame by frame; one warp of columns serves every row."""
    column = 2 * np.pi * np.arange(width) / 32.0
    for k in range(steps + 1):
        line = (100.0 * (1 + 0.5 * np.sin(2 * np.pi * 50.0 * k * DT - column))).astype(np.float32)
        yield k * DT, np.repeat(line[None, :], height, axis=0)


def stream(width: int, height: int, steps: int) -> Work:
    """A video of so many frames, simulated as it is made; the events are counted and forgotten."""
    from pixelid.simulate import simulate_stream

    def run(count: int) -> int:
        frames = _frames(width, height, count)
        return sum(len(chunk) for chunk in simulate_stream(find_model("dvs128"), frames, threads=1))

    return lambda: run(20), lambda: run(steps)


def simulate(side: int, steps: int) -> Work:
    """A video of side × side pixels, held in memory as a stimulus."""
    from pixelid.simulate import simulate as work
    from pixelid.stimuli.shapes import grating

    few, video = (grating(width=n, height=n, duration_s=k * DT, dt=DT) for n, k in ((8, 20), (side, steps)))
    model = find_model("dvs128")
    return lambda: work(model, few, threads=1), lambda: work(model, video, threads=1)


def session(samples: int, recordings: int) -> list:
    """Full-field recordings of 8 × 8 pixels with about half an event per sample."""
    from pixelid.simulate import simulate as work
    from pixelid.stimuli.stimulus import Stimulus

    t = 4e-5 * np.arange(samples)
    light = np.exp(np.log(200.0) + np.sin(2 * np.pi * 6 * t) + 0.3 * np.sin(2 * np.pi * 31 * t))
    stimulus = Stimulus(t, light, "fA")
    return [work(find_model("dvs128"), stimulus, width=8, height=8, seed=k, threads=1) for k in range(recordings)]


def likelihood(samples: int, recordings: int) -> Work:
    """Value and gradient of so many recordings of so many samples each, the making of the likelihood included."""
    from pixelid.likelihood.event_times import EventTimes

    circuit = find_model("dvs128").circuit()

    def run(made: list) -> object:
        terms = EventTimes(made)
        return terms.terms(circuit, terms.changes(circuit)).gradient()

    few, many = session(500, 1), session(samples, recordings)
    return lambda: run(few), lambda: run(many)


def training(chains: int) -> Work:
    """Three steps of training with so many chains in a batch."""
    import torch

    from pixelid.nerf.data.dataset import read_dataset
    from pixelid.nerf.pixel.model import Bandwidth
    from pixelid.nerf.synthetic import make_dataset
    from pixelid.nerf.training.problem import problem_of
    from pixelid.nerf.training.recipe import Recipe
    from pixelid.nerf.training.state import start
    from pixelid.nerf.training.train import step

    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as folder:
        made = make_dataset(Path(folder) / "scene", "hard", side=24, revolutions=1.0, frames_per_turn=400)
        problem = problem_of(read_dataset(made))

    def run(batch: int, steps: int) -> None:
        recipe = Recipe(iterations=100, batch=batch).for_sensor(24)
        state = start(problem, recipe, Bandwidth())
        for _ in repeat(None, steps):
            step(problem, recipe, state)

    return lambda: run(16, 1), lambda: run(chains, 3)


JOBS: dict[str, Callable[..., Work]] = {
    "stream": stream,
    "simulate": simulate,
    "likelihood": likelihood,
    "training": training,
}
