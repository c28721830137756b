"""Trajectories: the state of the pixel at every stimulus sample, and exactly in between.

The state does not depend on the events, so one trajectory serves every pixel that sees the same light and
every candidate threshold.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar, NamedTuple

import numpy as np

from pixelid.dynamics import equations, kernels, vectorised
from pixelid.errors import InputError

STAGES = ("photoreceptor_slope", "photoreceptor", "source_follower", "extra_pole", "lower_cutoff", "differencing")


class Dynamics(NamedTuple):
    """The linear dynamics of a pixel; angular cutoffs in rad/s.  Values may be symbols or tensors of an engine.

    photoreceptor: ωn² = alpha·L', 2ζωn = beta + gamma·L' with L' = L + floor;  follower, extra_pole, differencing:
    first-order low-pass;  lower_cutoff: first-order high-pass, 0 when absent.
    """

    alpha: float
    beta: float
    gamma: float
    follower: float = equations.ABSENT_FOLLOWER
    extra_pole: float = equations.ABSENT_EXTRA
    lower_cutoff: float = 0.0
    differencing: float = equations.ABSENT_DIFFERENCING
    floor: float = 0.0

    @staticmethod
    def low_light(corner_per_radiance, **stages) -> Dynamics:
        """One-pole photoreceptor, ωc = corner_per_radiance · L: the limit of low light."""
        far = equations.ABSENT_PHOTORECEPTOR
        return Dynamics(corner_per_radiance * far, far, corner_per_radiance, **stages)

    @staticmethod
    def unlimited(**stages) -> Dynamics:
        """A photoreceptor without a bandwidth limit: its output is ln L."""
        far = equations.ABSENT_PHOTORECEPTOR
        return Dynamics(far * far, far, 0.0, **stages)

    def uniform(self) -> Dynamics:
        """All values as float64, as the kernels want them."""
        return Dynamics(*(float(value) for value in self))


@dataclass(frozen=True)
class Trajectory:
    """States (n, 6) at the times t (n,) under log radiance u (n,), see `STAGES`."""

    t: np.ndarray
    u: np.ndarray
    radiance: np.ndarray
    dynamics: Dynamics
    midpoint: bool
    states: np.ndarray

    linear: ClassVar[bool] = True

    def stage(self, name: str) -> np.ndarray:
        """(n,) output of one stage of `STAGES` at the stimulus samples, log radiance units."""
        return self.states[:, STAGES.index(name)]

    def at(self, times, step=None) -> np.ndarray:
        """(m, 6) states at `times` (m,) seconds, by the closed form of the step that holds each.

        step: (m,) the sample at which that step begins, where it is known
        """
        times = np.asarray(times, dtype=np.float64)
        if step is None:
            step = np.maximum(np.searchsorted(self.t, times, side="right") - 1, 0)
        out = np.empty((len(times), 6))
        run = vectorised.states_at if vectorised.applicable(self.dynamics) else kernels.states_at
        run(times, step, self.t, self.u, self.radiance, self.dynamics, self.midpoint, self.states, out)
        return out

    def outputs_at(self, times: np.ndarray, step: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(reset level, amplifier output), (m,) each, at `times` (m,), in the steps that begin at `step` (m,)."""
        if self.plain:
            level, output = np.empty((2, len(times)))
            vectorised.stages_at(
                times, step, self.t, self.u, self.radiance, self.dynamics, self.midpoint, self.states,
                *np.empty((2, 0)), level, output,
            )  # fmt: skip
            return level, output
        return self.slopes_at(times, step)[:2]

    def slopes_at(self, times: np.ndarray, step: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """As `outputs_at`, and the slope of the output."""
        level, output, slope = np.empty((3, len(times)))
        if self.plain:
            level, output = self.outputs_at(times, step)
            np.subtract(level, output, out=slope)
            slope *= self.dynamics.differencing
        else:
            kernels.outputs_of(self.at(times, step), step, self.t, self.u, self.dynamics, level, output, slope)
        return level, output, slope

    @property
    def plain(self) -> bool:
        """Whether the follower drives the amplifier, which has a pole, and the vector form serves."""
        return (
            self.linear
            and self.dynamics.differencing < equations.PRESENT_BELOW
            and vectorised.applicable(self.dynamics)
        )


def integrate(
    t,
    radiance,
    dynamics: Dynamics,
    *,
    linearisation: str = "midpoint",
    log_radiance: np.ndarray | None = None,
    first: Sequence[int] | np.ndarray | None = None,
) -> Trajectory:
    """The trajectory under radiance (n,) at times t (n,), log radiance linear between samples.

    Steady state at the first sample.  Two samples may share a time (a jump).  `linearisation`: "midpoint"
    (second order in the step) or "newer" (the newer sample, as in the paper; first order).  `log_radiance` (n,):
    where it is known, or the pixel responds with something else.  `first`: where the samples of several lights, one
    after the other, begin and end; each has a trajectory of its own.

    Raises InputError for radiance ≤ 0 or an unknown linearisation.
    """
    if linearisation not in ("midpoint", "newer"):
        raise InputError(f"linearisation must be 'midpoint' or 'newer', found {linearisation!r}")
    t, radiance = np.ascontiguousarray(t, np.float64), np.ascontiguousarray(radiance, np.float64)
    if not (radiance > 0).all():
        raise InputError(f"radiance must be positive, found {radiance.min():g}")
    u = np.log(radiance) if log_radiance is None else log_radiance
    values, states = dynamics.uniform(), np.empty((len(t), 6))
    midpoint = linearisation == "midpoint"
    run = vectorised.scan if vectorised.applicable(values) else kernels.scan
    for begin, end in pairwise((0, len(t)) if first is None else first):
        run(t[begin:end], u[begin:end], radiance[begin:end], values, midpoint, states[begin:end])
    return Trajectory(t, u, radiance, values, midpoint, states)
