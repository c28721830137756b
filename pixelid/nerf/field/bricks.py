"""Where the vertices of a field are held: bricks of 4 × 4 × 4, of which those in clear space may be missing.

A field of n vertices per side is cut into ⌈n/4⌉³ bricks.  Those that are there lie one behind the other, 64 rows each;
`index` says where.  The first 64 rows belong to no place: a brick that is missing reads them, clear and without
gradient, so that the renderer has one way to find a corner.  Memory and the work of a step then grow with the surface
of what is shown, not with the volume of the box.  Source: Museth, ACM TOG 32, 27, 2013 (a tree over such bricks).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from numba import njit
from scipy.ndimage import maximum_filter

SIDE, ROWS = 4, 64  # vertices per side of a brick, and in it
CLEAR_DENSITY = -30.0  # log density where no brick is


@dataclass(frozen=True, eq=False)
class Bricks:
    """vertices: n per side of the field;  index: (b, b, b) int32 number of the brick, from 1, and 0 where none is."""

    vertices: int
    index: np.ndarray

    @staticmethod
    def every(vertices: int) -> Bricks:
        """All bricks of a field."""
        number = -(-vertices // SIDE)
        return Bricks.where(vertices, np.ones((number,) * 3, bool))

    @staticmethod
    def where(vertices: int, there: np.ndarray) -> Bricks:
        """Only those marked in there (b, b, b)."""
        index = np.zeros(there.shape, np.int32)
        index[there] = np.arange(1, np.count_nonzero(there) + 1, dtype=np.int32)
        return Bricks(vertices, index)

    @staticmethod
    def of_index(vertices: int, index: np.ndarray) -> Bricks:
        """Those of an index that was written down.

        Raises:
            ValueError: it is none of so many vertices, or its bricks are not numbered in their order.
        """
        number = -(-vertices // SIDE)
        most_vertices = 1025  # per side, of fields that are read: twice those that a reconstruction has by itself
        if not 2 <= vertices <= most_vertices or index.dtype.kind not in "iu" or index.shape != (number,) * 3:
            raise ValueError(f"bricks {index.shape} of {vertices} vertices")
        bricks = Bricks.where(vertices, index > 0)
        if not np.array_equal(bricks.index, index):
            raise ValueError("bricks: expected numbers from 1 in the order of their places, 0 where none is")
        return bricks

    @property
    def number(self) -> int:
        """How many are there."""
        return int(np.count_nonzero(self.index))

    @property
    def rows(self) -> int:
        """Of the arrays that hold values, those of no place included."""
        return ROWS * (self.number + 1)

    @property
    def whole(self) -> bool:
        """Whether none is missing."""
        return self.number == self.index.size

    def places(self) -> np.ndarray:
        """(number, 3) where the bricks are, in the order in which they lie."""
        return np.argwhere(self.index > 0)

    def vertex_of_rows(self) -> np.ndarray:
        """(rows, 3) vertex of every row; beyond the field at its far sides, and anywhere for those of no place."""
        inside = np.argwhere(np.ones((SIDE,) * 3, bool))
        every = (SIDE * self.places()[:, None] + inside).reshape(-1, 3)
        return np.concatenate([np.zeros((ROWS, 3), every.dtype), every])

    @cached_property
    def _kept(self) -> dict[tuple[str, torch.device], tuple[torch.Tensor, ...]]:
        """What was brought to a device."""
        return {}

    def index_on(self, device: torch.device) -> torch.Tensor:
        """The index on a device, brought there once."""
        if ("index", device) not in self._kept:
            self._kept["index", device] = (torch.as_tensor(self.index, device=device),)
        return self._kept["index", device][0]

    def neighbours_on(self, device: torch.device) -> tuple[torch.Tensor, ...]:
        """Per axis (2, k), on a device: rows of vertices that are held, and of those next to them along the axis."""
        if ("neighbours", device) not in self._kept:
            pairs, vertex = [], torch.as_tensor(self.vertex_of_rows()[ROWS:], device=device)
            row = torch.arange(ROWS, self.rows, device=device)
            inside = (vertex < self.vertices).all(dim=1)
            for axis in range(3):
                after = vertex.clone()
                after[:, axis] += 1
                both = inside & (after[:, axis] < self.vertices)
                pair = torch.stack([row[both], self.rows_of(after[both])])
                pairs.append(pair[:, pair[1] >= ROWS])
            self._kept["neighbours", device] = tuple(pairs)
        return self._kept["neighbours", device]

    def corner_rows(self, cell: torch.Tensor) -> torch.Tensor:
        """(8, n) rows of the corners of cells (n, 3), z fastest."""
        corner = torch.tensor([[a, b, c] for a in (0, 1) for b in (0, 1) for c in (0, 1)], device=cell.device)
        return self.rows_of(cell + corner[:, None])

    def rows_of(self, vertex: torch.Tensor) -> torch.Tensor:
        """(…,) row of vertices (…, 3), on their device."""
        index = self.index_on(vertex.device)
        brick, inside = vertex // SIDE, vertex % SIDE
        number = index[brick[..., 0], brick[..., 1], brick[..., 2]].long()
        return ROWS * number + (inside[..., 0] * SIDE + inside[..., 1]) * SIDE + inside[..., 2]

    def gathered(self, dense: torch.Tensor) -> torch.Tensor:
        """(rows, …) of values (n, n, n, …) at the vertices, differentiable; rows beyond the field repeat its side."""
        at = torch.as_tensor(np.minimum(self.vertex_of_rows(), self.vertices - 1), device=dense.device)
        return dense[at[:, 0], at[:, 1], at[:, 2]]

    def spread_out(self, values: np.ndarray) -> np.ndarray:
        """(n, n, n, …) of values (rows, …); where no brick is, those of the first row."""
        vertex = self.vertex_of_rows()[ROWS:]
        inside = (vertex < self.vertices).all(axis=1)
        dense = np.empty((self.vertices,) * 3 + values.shape[1:], values.dtype)
        dense[:] = values[0]
        dense[tuple(vertex[inside].T)] = values[ROWS:][inside]
        return dense

    def around(self, occupied: np.ndarray) -> np.ndarray:
        """(b, b, b) which bricks are those of an occupied block of cells, or lie next to one."""
        wide = np.zeros(self.index.shape, np.uint8)
        wide[tuple(slice(0, k) for k in occupied.shape)] = occupied
        return maximum_filter(wide, size=3, mode="constant") > 0


@njit(inline="always", error_model="numpy")
def corners(index, ix, iy, iz):
    """(8,) rows of the corners of a cell, z changing fastest.

    All are looked up: whether a cell lies within one brick, as two in five do, cannot be foreseen.
    """
    jx, jy, jz = ix + 1, iy + 1, iz + 1
    x, y, z, up_x, up_y, up_z = (ix & 3) * 16, (iy & 3) * 4, iz & 3, (jx & 3) * 16, (jy & 3) * 4, jz & 3
    a, b, c = np.uintp(ix >> 2), np.uintp(iy >> 2), np.uintp(iz >> 2)
    d, e, f = np.uintp(jx >> 2), np.uintp(jy >> 2), np.uintp(jz >> 2)
    return (
        np.int64(index[a, b, c]) * 64 + (x + y + z), np.int64(index[a, b, f]) * 64 + (x + y + up_z),
        np.int64(index[a, e, c]) * 64 + (x + up_y + z), np.int64(index[a, e, f]) * 64 + (x + up_y + up_z),
        np.int64(index[d, b, c]) * 64 + (up_x + y + z), np.int64(index[d, b, f]) * 64 + (up_x + y + up_z),
        np.int64(index[d, e, c]) * 64 + (up_x + up_y + z), np.int64(index[d, e, f]) * 64 + (up_x + up_y + up_z),
    )  # fmt: skip


@njit(inline="always", error_model="numpy")
def row(index, ix, iy, iz):
    """The row of a vertex.

    Compiled code looks at every signed subscript whether it counts from the end, which takes a sixth of the time of a
    march; here and in the renderer subscripts are therefore unsigned.
    """
    brick = index[np.uintp(ix >> 2), np.uintp(iy >> 2), np.uintp(iz >> 2)]
    return np.int64(brick) * 64 + ((ix & 3) * 16 + (iy & 3) * 4 + (iz & 3))
