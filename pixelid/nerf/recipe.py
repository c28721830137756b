"""How a scene is trained: steps, batches, grid sizes, learning rates and weights."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from pixelid.nerf.contraction import SIDE
from pixelid.nerf.given import one_of, whole_number
from pixelid.nerf.harmonics import HIGHEST_DEGREE
from pixelid.nerf.intervals import CHAIN
from pixelid.nerf.losses import Weights
from pixelid.nerf.poses import Refinement
from pixelid.nerf.regularisation import CHOICES, USUAL
from pixelid.nerf.trajectory import BETWEEN_POSES

MOST_CELLS = (32, 512)  # per side, of a sensor that leaves them open
MOST_AT_ONCE = 160  # cells per side up to which a field is refined by halves, beyond by doubling
# Of `--steps auto`.  The default recipe (1200 steps of 320 chains) was chosen on scenes of 64 × 64 pixels with some
# 1e5 changes: the same batch per change and as many looks at each, within what a training may take.
VISITS = 60
BATCH_SHARE = 320 / 1e5
SMALLEST_BATCH, LARGEST_BATCH = 320, 4096
STEPS = (600, 30_000)
# Of memory, so that all batches fit: a step takes 2 kB per sample on the CPU, and a chain has 24 samples and 2.4 for
# each of the past (measured at 1, 30 and 100 of them); three quarters are left to events, field and everybody else.
BYTES_PER_SAMPLE, SAMPLES_PER_CHAIN, SAMPLES_PER_PAST = 2000, 24.0, 2.4
MEMORY_SHARE = 0.25
AUTO = "auto"  # steps by the number of changes
CELLS, MOST_STEPS, MOST_BATCH = (8, 512), 1_000_000_000, 10_000_000  # what may be asked for
MOST_SEED = 2**32 - 1  # of `cli.options.SEED`
ELSEWHERE = ("iterations", "seed")  # in reconstruction.json


@dataclass(frozen=True)
class Recipe:
    """How to train.

    iterations: steps, 0 for as many as the data ask for;  batch: chains per step (over all processes), 0 likewise;
    vertices: grid sizes, each for an equal share of the steps (empty: `for_sensor` chooses);  rate, last_rate: learning
    rate, decaying exponentially;  weights: λ;  roughness, density_roughness: λ of the total variation of
    log radiance and of log density;  regularisation: "usual", or "auto" where held-out events choose a factor of both;
    emptiness: λ of the mean log density, which clears what no event asks for;  quiet: λ of changes where nothing fired;
    degree: of the harmonics by which colour depends on the direction;  stiffness: λ of their mean square;  level: λ of
    the mean log radiance when the gauge needs it;  between_poses: "linear" or "cubic", how the camera went;
    refinement: of the poses;  engine: of `render` and `respond`;  supersample: rays per pixel and side;  unbounded:
    whether space beyond the box is part of the field, contracted (`contraction`);  revival: whether bricks that
    events ask for come back (`revival`)
    """

    iterations: int = 1200
    batch: int = 320
    vertices: tuple[int, ...] = ()
    rate: float = 0.1
    last_rate: float = 0.01
    weights: Weights = dataclasses.field(default_factory=Weights)
    roughness: float = 0.05
    density_roughness: float = 0.0
    regularisation: str = USUAL
    emptiness: float = 0.01
    quiet: float = 0.1
    degree: int = 1
    stiffness: float = 10.0
    level: float = 10.0
    between_poses: str = "linear"
    refinement: Refinement = dataclasses.field(default_factory=Refinement)
    engine: str = "auto"
    supersample: int = 1
    unbounded: bool = False
    revival: bool = False
    seed: int = 0

    def __post_init__(self) -> None:
        one_of("regularisation", self.regularisation, CHOICES)
        one_of("between_poses", self.between_poses, BETWEEN_POSES)
        whole_number("seed", self.seed, 0, MOST_SEED)

    @classmethod
    def asked(
        cls, *, steps: int | str | None = None, batch: int | None = None, cells: int | None = None, harmonics: int = 1,
        between_poses: str = "linear", refinement: Refinement | None = None, regularisation: str = USUAL,
        unbounded: bool = False,
    ) -> Recipe:  # fmt: skip
        """The recipe that a user asks for, the rest as usual.

        Args:
            steps: of training; `AUTO` for steps, and a batch that is not given, by the data.
            batch: chains per step.
            cells: of the field per side; by default one per pixel.
            harmonics: degree by which colours depend on the direction.
            between_poses: "linear" or "cubic".
            refinement: of the poses.
            regularisation: "usual", or "auto" where held-out events choose.
            unbounded: whether the scene goes on beyond the box.

        Raises:
            InputError: a value that cannot be.
        """
        limits = (
            ("iterations", None if steps == AUTO else steps, (1, MOST_STEPS)), ("batch", batch, (1, MOST_BATCH)),
            ("cells", cells, CELLS), ("harmonics", harmonics, (0, HIGHEST_DEGREE)),
        )  # fmt: skip
        for name, value, (least, most) in limits:
            if value is not None:
                whole_number(name, value, least, most, f" or {AUTO!r}" if name == "iterations" else "")
        usual = cls(
            degree=int(harmonics), between_poses=between_poses, refinement=refinement or Refinement(),
            regularisation=regularisation, unbounded=unbounded,
        )  # fmt: skip
        if steps == AUTO:
            usual = dataclasses.replace(usual, iterations=0, batch=0)
        elif steps is not None:
            usual = dataclasses.replace(usual, iterations=int(steps))
        recipe = dataclasses.replace(usual, batch=int(batch or usual.batch))
        return recipe if cells is None else recipe.with_cells(int(cells))

    def for_sensor(self, width: int) -> Recipe:
        """The recipe with grid sizes for a sensor `width` pixels wide: about one cell per pixel in the end.

        Of an unbounded field the inner box has half the cells of a side.
        """
        cells = min(max(width, MOST_CELLS[0]) * (round(SIDE) if self.unbounded else 1), MOST_CELLS[1])
        return self if self.vertices else self.with_cells(cells)

    def with_cells(self, cells: int) -> Recipe:
        """The recipe that ends with so many cells per side."""
        quarters = (2, 3, 4) if cells <= MOST_AT_ONCE else (1, 2, 4)
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
        steps = self.iterations or int(np.clip(wanted, *STEPS))
        return dataclasses.replace(self, batch=batch, iterations=steps)

    def as_dict(self) -> dict[str, Any]:
        """What reconstruction.json says of it; steps and seed are stated elsewhere."""
        content = {name: value for name, value in dataclasses.asdict(self).items() if name not in ELSEWHERE}
        return content | {"vertices": list(self.vertices), "weights": self.weights._asdict()}

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
