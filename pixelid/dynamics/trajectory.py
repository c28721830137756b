"""Trajectories: the state of the pixel at every stimulus sample, and exactly in between.

The state does not depend on the events, so one trajectory serves every pixel that sees the same light and
every candidate threshold (DESIGN §1).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit

from pixelid.dynamics import equations, kernels, vectorised
from pixelid.errors import InputError

STAGES = ("photoreceptor_slope", "photoreceptor", "source_follower", "extra_pole", "lower_cutoff", "differencing")


class Dynamics(NamedTuple):
    """The linear dynamics of a pixel; angular cutoffs in rad/s.  Values may be complex (complex-step derivatives).

    photoreceptor: ωn² = alpha·L, 2ζωn = beta + gamma·L;  follower, extra_pole, differencing: first-order
    low-pass;  lower_cutoff: first-order high-pass, 0 when absent.
    """

    alpha: float
    beta: float
    gamma: float
    follower: float = equations.ABSENT_FOLLOWER
    extra_pole: float = equations.ABSENT_EXTRA
    lower_cutoff: float = 0.0
    differencing: float = equations.ABSENT_DIFFERENCING

    @staticmethod
    def low_light(corner_per_radiance, **stages) -> Dynamics:
        """One-pole photoreceptor, ωc = corner_per_radiance · L (DESIGN §1, low light)."""
        far = equations.ABSENT_PHOTORECEPTOR
        return Dynamics(corner_per_radiance * far, far, corner_per_radiance, **stages)

    @staticmethod
    def unlimited(**stages) -> Dynamics:
        """A photoreceptor without a bandwidth limit: its output is ln L."""
        far = equations.ABSENT_PHOTORECEPTOR
        return Dynamics(far * far, far, 0.0, **stages)

    def uniform(self) -> tuple:
        """All values as one type, float64 or complex128, as the kernels want them."""
        if any(isinstance(value, (complex, np.complexfloating)) for value in self):
            return tuple(complex(value) for value in self)
        return tuple(float(value) for value in self)


@dataclass(frozen=True)
class Trajectory:
    """States (n, 6) at the times t (n,) under log radiance u (n,), see `STAGES`."""

    t: np.ndarray
    u: np.ndarray
    radiance: np.ndarray
    dynamics: Dynamics
    midpoint: bool
    states: np.ndarray

    def stage(self, name: str) -> np.ndarray:
        """(n,) output of one stage of `STAGES` at the stimulus samples, log radiance units."""
        return self.states[:, STAGES.index(name)]

    def at(self, times) -> np.ndarray:
        """(m, 6) states at `times` (m,) seconds, by the closed form of the step that holds each."""
        times = np.asarray(times, dtype=np.float64)
        out = np.empty((len(times), 6), dtype=self.states.dtype)
        values = Dynamics(*self.dynamics).uniform()
        if self.states.dtype == np.float64 and vectorised.applicable(values):
            step = np.maximum(np.searchsorted(self.t, times, side="right") - 1, 0)
            vectorised.states_at(times, step, self.t, self.u, self.radiance, values, self.midpoint, self.states, out)
        else:
            _at(times, self.t, self.u, self.radiance, values, self.midpoint, self.states, out)
        return out


@njit(cache=True, nogil=True, error_model="numpy")
def _at(times, t, u, L, dynamics, midpoint, states, out):
    coincide = kernels.cutoffs_coincide(dynamics[3], dynamics[4], dynamics[5], dynamics[6])
    for i in range(len(times)):
        k = max(np.searchsorted(t, times[i], side="right") - 1, 0)
        state = kernels.within_step(times[i], k, t, u, L, dynamics, coincide, midpoint, states)
        for j in range(6):
            out[i, j] = state[j]


def integrate(t, radiance, dynamics: Dynamics, *, linearisation: str = "midpoint") -> Trajectory:
    """The trajectory under radiance (n,) at times t (n,), log radiance linear between samples.

    Steady state at the first sample.  Two samples may share a time (a jump).  `linearisation`: "midpoint"
    (second order in the step) or "newer" (the newer sample, as in the paper; first order).

    Raises InputError for radiance ≤ 0 or an unknown linearisation.
    """
    if linearisation not in ("midpoint", "newer"):
        raise InputError(f"linearisation must be 'midpoint' or 'newer', found {linearisation!r}")
    t = np.ascontiguousarray(t, dtype=np.float64)
    values = dynamics.uniform()
    dtype = np.complex128 if isinstance(values[0], complex) or np.iscomplexobj(radiance) else np.float64
    if dtype is np.complex128:
        values = tuple(complex(value) for value in values)
    radiance = np.ascontiguousarray(radiance, dtype=dtype)
    if not (radiance.real > 0).all():
        raise InputError(f"radiance must be positive, found {radiance.real.min():g}")
    u = np.log(radiance)
    states = np.empty((len(t), 6), dtype=dtype)
    midpoint = linearisation == "midpoint"
    run = vectorised.scan if dtype is np.float64 and vectorised.applicable(values) else kernels.scan
    run(t, u, radiance, values, midpoint, states)
    return Trajectory(t, u, radiance, Dynamics._make(values), midpoint, states)
