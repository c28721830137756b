"""`expression.Operations` for torch tensors: float64 vectors on any device, differentiable."""

from __future__ import annotations

import numpy as np
import torch


class TorchOperations:
    """Vectors are float64 tensors of shape (n,) on `device`."""

    exp, log, sqrt, sin, cos, abs = (
        staticmethod(f) for f in (torch.exp, torch.log, torch.sqrt, torch.sin, torch.cos, torch.abs)
    )
    where = staticmethod(torch.where)
    normal_cdf = staticmethod(torch.special.ndtr)
    total = staticmethod(torch.sum)
    join = staticmethod(torch.cat)

    def __init__(self, device: str | torch.device = "cpu") -> None:
        self.device = torch.device(device)

    def constant(self, values):
        return torch.tensor(np.asarray(values, dtype=float), device=self.device)

    def _index(self, index):
        return torch.tensor(np.asarray(index, dtype=np.int64), device=self.device)

    def take(self, x, index):
        return x[self._index(index)]

    def spread(self, x, at, size):
        return torch.zeros(size, dtype=torch.float64, device=self.device).index_put((self._index(at),), x)

    def sum_by(self, index, x, size):
        return torch.zeros(size, dtype=torch.float64, device=self.device).index_add(0, self._index(index), x)

    @staticmethod
    def cumulate(x):
        return torch.cat([x.new_zeros(1), torch.cumsum(x, 0)])

    @staticmethod
    def recur(A, c):
        """The recurrence by halving: pairs of steps compose to one, the half-length recurrence is solved likewise,
        and the odd states follow from the even ones.  2 n small products in log2 n rounds, no loop over n.
        """
        n = c[0].shape[0]
        zero = c[0].new_zeros(n)
        rows = [torch.stack([zero if isinstance(a, float) else a.expand(n) for a in row], dim=-1) for row in A]
        states = _halving(torch.stack(rows, dim=-2), torch.stack([part.expand(n) for part in c], dim=-1))
        return list(torch.cat([states.new_zeros(1, 4), states]).unbind(-1))


def _halving(A, c):
    """States (n, 4) after each of n steps x ← A x + c from x = 0;  A (n, 4, 4), c (n, 4)."""
    n = len(c)
    if n == 1:
        return c
    pairs = n // 2
    A0, c0, A1, c1 = A[0 : 2 * pairs : 2], c[0 : 2 * pairs : 2], A[1 : 2 * pairs : 2], c[1 : 2 * pairs : 2]
    second = _halving(A1 @ A0, (A1 @ c0[..., None])[..., 0] + c1)  # states after steps 2, 4, …
    before = torch.cat([c.new_zeros(1, 4), second])[: (n + 1) // 2]  # states before steps 1, 3, …
    first = (A[0::2] @ before[..., None])[..., 0] + c[0::2]
    out = c.new_empty(0)
    if n % 2:
        out = torch.stack([first[:-1], second], dim=1).reshape(-1, 4)
        return torch.cat([out, first[-1:]])
    return torch.stack([first, second], dim=1).reshape(-1, 4)
