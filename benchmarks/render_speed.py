"""Which field: ray samples per second, forward and backward, of the candidates on this computer.

    python benchmarks/render_speed.py

compiled    the dense grid, marched by compiled loops (what a CPU trains with)
tensors     the same grid through torch's grid_sample (what CUDA trains with)
hash        a multi-resolution hash grid with a small network, in plain torch: the features alone, no compositing
"""

from __future__ import annotations

import time

import numpy as np
import torch

from pixelid.nerf.camera import pinhole
from pixelid.nerf.render import Box, Rays, render
from pixelid.nerf.scenes import spiral

SIDE, RAYS, LEVELS, TABLE = 65, 20_000, 8, 1 << 14
PRIMES = (1, 2_654_435_761, 805_459_861)


class Hash(torch.nn.Module):
    """Müller et al., SIGGRAPH 2022: eight levels, two features each, a network of one hidden layer of 32."""

    def __init__(self) -> None:
        super().__init__()
        self.tables = torch.nn.Parameter(1e-2 * torch.randn(LEVELS, TABLE, 2))
        self.network = torch.nn.Sequential(torch.nn.Linear(2 * LEVELS, 32), torch.nn.ReLU(), torch.nn.Linear(32, 2))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        features = []
        for level in range(LEVELS):
            scaled = x * (16 * 1.4**level)
            low = scaled.floor()
            part, low = scaled - low, low.long()
            total = torch.zeros(len(x), 2)
            for corner in range(8):
                bits = torch.tensor([corner & 1, corner >> 1 & 1, corner >> 2])
                weight = torch.where(bits.bool(), part, 1 - part).prod(dim=1, keepdim=True)
                at = (low + bits) * torch.tensor(PRIMES)
                index = (at[:, 0] ^ at[:, 1] ^ at[:, 2]) % TABLE
                total = total + weight * self.tables[level][index]
            features.append(total)
        return self.network(torch.cat(features, dim=1))


def rays() -> Rays:
    rng = np.random.default_rng(0)
    inside = pinhole(64, 64, 0.69).all_directions()[rng.integers(0, 4096, RAYS)]
    origins, directions = spiral(1.0, 1.0).rays(rng.random(RAYS), inside)
    return Rays(origins, directions, np.zeros(RAYS, np.int64), rng.random(RAYS, dtype=np.float32))


def rate(work, samples: int) -> float:
    """Samples per second of the faster of three runs, the first of which compiles."""
    best = np.inf
    for _ in range(4):
        begin = time.perf_counter()
        work()
        best = min(best, time.perf_counter() - begin)
    return samples / best


def main() -> None:
    high = np.full(3, 1.44)
    box = Box(-high, high, 2.88 / (SIDE - 1), np.ones((16, 16, 16), np.uint8))
    some, behind = rays(), torch.tensor([0.4])
    grid = (0.3 * torch.randn(SIDE, SIDE, SIDE, 2) - 1.5).requires_grad_()
    near = np.maximum(
        np.minimum((-high - some.origins) / some.directions, (high - some.origins) / some.directions).max(1), 0
    )
    far = np.maximum((-high - some.origins) / some.directions, (high - some.origins) / some.directions).min(1)
    samples = int((np.maximum(far - near, 0) / box.step).sum())
    for engine in ("compiled", "tensors"):
        per_second = rate(lambda engine=engine: render(grid, behind, some, box, engine)[0].sum().backward(), samples)
        print(f"{engine:10} {per_second / 1e6:7.2f} M samples/s, {RAYS * per_second / samples / 1e3:7.0f} k rays/s")
    network, points = Hash(), torch.rand(100_000, 3)
    per_second = rate(lambda: network(points).sum().backward(), len(points))
    print(f"{'hash':10} {per_second / 1e6:7.2f} M samples/s, {RAYS * per_second / samples / 1e3:7.0f} k rays/s")


if __name__ == "__main__":
    main()
