"""How a scene is trained: steps, batches, grid sizes, learning rates and weights."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from pixelid.nerf.events.intervals import CHAIN
from pixelid.nerf.field.contraction import SIDE
from pixelid.nerf.options import BATCH, STEPS, Options
from pixelid.nerf.training.losses import Weights
from pixelid.nerf.training.poses import Refinement

MOST_CELLS = (32, 512)  # per side, of a sensor that leaves them open
# Of `--steps auto`.  The default recipe (1200 steps of 320 chains) was chosen on scenes of 64 × 64 pixels with some
# 1e5 changes: the same batch per change and as many looks at each, within what a training may take.
VISITS = 60
BATCH_SHARE = BATCH / 1e5
SMALLEST_BATCH, LARGEST_BATCH = BATCH, 4096
LEAST_STEPS, MOST_STEPS = 600, 30_000
# Of memory, so that all batches fit: a step takes 2 kB per sample on the CPU, and a chain has 24 samples and 2.4 for
# each of the past (measured at 1, 30 and 100 of them); three quarters are left to events, field and everybody else.
BYTES_PER_SAMPLE, SAMPLES_PER_CHAIN, SAMPLES_PER_PAST = 2000, 24.0, 2.4
MEMORY_SHARE = 0.25
ELSEWHERE = ("iterations", "seed")  # in reconstruction.json
FIXED = {
    "density_roughness": 0.0,
    "engine": "auto",
    "supersample": 1,
    "revival": False,
}  # of its format: what no recipe changes


@dataclass(frozen=True)
class Recipe:
    """How to train.

    iterations: steps, 0 for as many as the data ask for;  batch: chains per step (over all processes), 0 likewise;
    vertices: grid sizes, each for an equal share of the steps (empty: `for_sensor` chooses);  rate, last_rate: learning
    rate, decaying exponentially;  weights: λ;  roughness: λ of the total variation of
    log radiance;  regularisation: "usual", or "auto" where held-out events choose a factor of it;
    emptiness: λ of the mean log density, which clears what no event asks for;  quiet: λ of changes where nothing fired;
    degree: of the harmonics by which colour depends on the direction;  stiffness: λ of their mean square;  level: λ of
    the mean log radiance when the gauge needs it;  between_poses: "linear" or "cubic", how the camera went;
    refinement: of the poses;  unbounded: whether space beyond the box is part of the field, contracted (`contraction`)
    """

    iterations: int = STEPS
    batch: int = BATCH
    vertices: tuple[int, ...] = ()
    rate: float = 0.1
    last_rate: float = 0.01
    weights: Weights = dataclasses.field(default_factory=Weights)
    roughness: float = 0.05
    regularisation: str = "usual"
    emptiness: float = 0.01
    quiet: float = 0.1
    degree: int = 1
    stiffness: float = 10.0
    level: float = 10.0
    between_poses: str = "linear"
    refinement: Refinement = dataclasses.field(default_factory=Refinement)
    unbounded: bool = False
    seed: int = 0

    @classmethod
    def of(cls, options: Options) -> Recipe:
        """The recipe that options ask for; `AUTO` leaves steps, and a batch that is not given, to the data."""
        auto = isinstance(options.iterations, str)
        recipe = cls(
            iterations=0 if isinstance(options.iterations, str) else options.iterations,
            batch=options.batch or (0 if auto else BATCH), degree=options.harmonics,
            between_poses=options.between_poses, refinement=Refinement.of(options.refine_time, options.refine_poses),
            regularisation=options.regularisation, unbounded=options.unbounded, seed=options.seed,
        )  # fmt: skip
        return recipe if options.cells is None else recipe.with_cells(options.cells)

    def for_sensor(self, width: int) -> Recipe:
        """The recipe with grid sizes for a sensor `width` pixels wide: about one cell per pixel in the end.

        Of an unbounded field the inner box has half the cells of a side.
        """
        cells = min(max(width, MOST_CELLS[0]) * (round(SIDE) if self.unbounded else 1), MOST_CELLS[1])
        return self if self.vertices else self.with_cells(cells)

    def with_cells(self, cells: int) -> Recipe:
        """The recipe that ends with so many cells per side."""
        most_at_once = 160  # cells per side up to which a field is refined by halves, beyond by doubling
        quarters = (2, 3, 4) if cells <= most_at_once else (1, 2, 4)
        return dataclasses.replace(self, vertices=tuple(max(cells * k // 4, 1) + 1 for k in quarters))

    def for_data(self, changes: int, samples: int = 1, memory: int | None = None) -> Recipe:
        """The recipe with steps and batch for so many changes of light, where they were left open.

        Batches grow with the data up to `LARGEST_BATCH`, and to what fits into a share of the memory; steps are as many
        as show every change `VISITS` times.

        Args:
            changes: to train on.
            samples: of the pixel's past.
            memory: of the computer or the device, bytes; by default any.

        Returns:
            The recipe.
        """
        chain = BYTES_PER_SAMPLE * (SAMPLES_PER_CHAIN + SAMPLES_PER_PAST * samples)
        most = LARGEST_BATCH if memory is None else min(LARGEST_BATCH, max(int(MEMORY_SHARE * memory / chain), 1))
        batch = self.batch or min(int(np.clip(changes * BATCH_SHARE, SMALLEST_BATCH, LARGEST_BATCH)), most)
        wanted = math.ceil(VISITS * changes / (CHAIN * batch) / 100) * 100
        steps = self.iterations or int(np.clip(wanted, LEAST_STEPS, MOST_STEPS))
        return dataclasses.replace(self, batch=batch, iterations=steps)

    def as_dict(self) -> dict[str, Any]:
        """What reconstruction.json says of it; steps and seed are stated elsewhere."""
        content = {name: value for name, value in dataclasses.asdict(self).items() if name not in ELSEWHERE}
        return content | FIXED | {"vertices": list(self.vertices), "weights": self.weights._asdict()}

    @property
    def cells(self) -> int:
        """Per side of the box in the end; of an unbounded field the inner box."""
        return round((self.vertices[-1] - 1) / (SIDE if self.unbounded else 1.0))

    @property
    def last_stage(self) -> int:
        """The first step on the finest grid."""
        stages = max(len(self.vertices), 1)
        return -(-(stages - 1) * self.iterations // stages)

    def vertices_at(self, iteration: int) -> int:
        """The grid size in use at a step."""
        stage = min(iteration * len(self.vertices) // max(self.iterations, 1), len(self.vertices) - 1)
        return self.vertices[stage]

    def rate_at(self, iteration: int) -> float:
        """The learning rate of a step."""
        return self.rate * (self.last_rate / self.rate) ** (iteration / max(self.iterations, 1))
