"""How well the training model explains events at the true radiance: the floor that no field can go below.

    python benchmarks/reconstruction_residual.py --settings hard8 medium

Rays are cast into the scene itself.  The residual is that of single events, in thresholds; threshold noise and mismatch
of the simulated camera alone leave 0.03.  S: samples of the past;  rays: per pixel (the simulator's light has 4).
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import torch

from pixelid.nerf.data import raycast
from pixelid.nerf.data.camera import sub_pixel_directions
from pixelid.nerf.data.dataset import Dataset, read_dataset
from pixelid.nerf.data.scenes import procedural
from pixelid.nerf.events.intervals import chains
from pixelid.nerf.pixel.model import Bandwidth, Pixel
from pixelid.nerf.pixel.past import past_of
from pixelid.nerf.pixel.scan import respond
from pixelid.nerf.synthetic import SETTINGS, make_dataset
from pixelid.nerf.training.losses import changes, unexplained
from pixelid.nerf.training.predict import EPSILON
from pixelid.nerf.training.problem import problem_of

CHAINS = 200


def radiance(data: Dataset, seed: int, t, pixel, supersample: int) -> np.ndarray:
    """(n,) true radiance of pixels (n,) at times t (n,), averaged over `supersample`² rays."""
    scene, camera = procedural(seed), data.calibration.camera
    directions = sub_pixel_directions(camera, supersample).reshape(-1, supersample**2, 3)
    position, rotation = data.trajectory.at(t)
    out = np.empty(len(t))
    items = raycast.prepared(scene.items)
    for k in range(len(t)):
        turned = directions[pixel[k]] @ rotation[k].T
        along = [raycast.radiance(*position[k], *d, items, scene.light, scene.background) for d in turned]
        out[k] = np.mean(along)
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--settings", nargs="+", choices=list(SETTINGS), default=["hard8"])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--work", type=Path, default=Path("out/reconstruction"))
    options = parser.parse_args()
    options.work.mkdir(parents=True, exist_ok=True)
    for setting in options.settings:
        path = options.work / f"{setting}_{options.seed}"
        if not path.is_dir():
            make_dataset(path, setting, seed=options.seed)
        data = read_dataset(path)
        problem = problem_of(data, close=0.0)
        for bandwidth in (Bandwidth("off"), Bandwidth("on", 10), Bandwidth("on", 30), Bandwidth("on", 100)):
            pixel = Pixel(problem.circuit, bandwidth)
            samples = bandwidth.samples if pixel.filtering else 1
            rng = np.random.default_rng(0)
            starts = rng.integers(0, len(problem.training.starts), CHAINS)
            rate, points = past_of(
                pixel, problem.training, starts, samples, max(float(problem.dark.min()), EPSILON), problem.crossing_s,
                lambda t, pixel: radiance(data, options.seed, t, pixel, 1) + problem.dark[0],  # noqa: B023
            )  # fmt: skip
            batch = chains(problem.training, starts, samples, rate, rng, points)
            which = np.repeat(batch.pixel, np.diff(batch.first))
            residuals = []
            for supersample in (1, 2):
                u = torch.tensor(np.log(radiance(data, options.seed, batch.t, which, supersample) + problem.dark[0]))
                level, output, cutoff = u, u, None
                if pixel.filtering:
                    level, output = respond(u, pixel.dynamics, batch.t, batch.first)
                    cutoff = pixel.dynamics[6]
                change = changes(level, output, batch, cutoff).numpy()
                residuals.append(unexplained(change, batch, *(float(x) for x in pixel.thresholds)))
            rays = len(batch.t) / batch.weight.sum()
            print(
                f"{setting:7} {bandwidth.mode:3} S={samples:3}  1 ray {residuals[0]:.3f}  4 rays {residuals[1]:.3f}  "
                f"({rays:.1f} samples per event)",
                flush=True,
            )


if __name__ == "__main__":
    main()
