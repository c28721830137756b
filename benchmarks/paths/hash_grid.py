"""A multi-resolution hash grid with a small network in plain torch: the field that the dense grid was chosen over."""

from __future__ import annotations

import torch

LEVELS, TABLE = 8, 1 << 14
PRIMES = (1, 2_654_435_761, 805_459_861)


class Hash(torch.nn.Module):
    """Müller et al., SIGGRAPH 2022: eight levels, two features each, a network of one hidden layer of 32."""

    def __init__(self) -> None:
        super().__init__()
        self.tables = torch.nn.Parameter(1e-2 * torch.randn(LEVELS, TABLE, 2))
        self.network = torch.nn.Sequential(torch.nn.Linear(2 * LEVELS, 32), torch.nn.ReLU(), torch.nn.Linear(32, 2))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """(n, 2) of points x (n, 3) in the unit cube."""
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
