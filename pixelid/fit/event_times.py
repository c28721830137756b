"""The log posterior of a circuit under the event-time likelihood, with its gradient and information matrix.

The changes are differentiated along each coordinate once, by a difference; everything after them (thresholds,
background events, survival) by the backward pass of the density.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np
from numba import njit

from pixelid.fit.coordinates import Coordinates
from pixelid.fit.objective import Local, Objective
from pixelid.likelihood.density import NUMBERS, Gradient, Terms
from pixelid.likelihood.event_times import EventTimes
from pixelid.likelihood.information import Information, Tangent
from pixelid.likelihood.shot_noise import under_shot_noise
from pixelid.stages.circuit import Circuit
from pixelid.stages.modulation import at_reset, since_event

# Circuit numbers that leave the trajectories and changes alone and act in the density only.
DENSITY_ONLY = (*(name for name in NUMBERS if name not in ("silent", "refractory")), "tick")
# Difference in fitting coordinates.  Of the changes one-sided: they bend by about themselves per unit, so the error is
# 1e-6 relative, and their own error 1e-14 adds 1e-8.  Of the circuit's numbers central: elementary functions of the
# coordinates, whose rounding leaves 1e-10.
STEP = 1e-6
# Steps per rounding (s) of the latest event: one moves a dead time of 0.1 ms by a thousand roundings, after days, too.
OF_ROUNDING = 1e7

LEVELS_TAKEN_AT = "levels_taken_at"  # of a fit under shot noise: coordinates that its levels were moved for


class EventTimesObjective(Objective):
    """The log posterior of a model under the event-time likelihood.

    off: parameter → by how much its coordinate comes out too large where the likelihood is approximate: the likelihood
        at x is that of x + off, so that its maximum is corrected
    """

    def __init__(
        self, likelihood: EventTimes, coordinates: Coordinates, off: Mapping[str, float] = MappingProxyType({})
    ) -> None:
        self.likelihood = likelihood
        self.coordinates = coordinates
        self.off = off
        self._step = max(STEP, OF_ROUNDING * float(np.spacing(likelihood.time_s.max(initial=0.0))))
        self._latest: tuple[bytes, Terms] | None = None

    def terms(self, x: np.ndarray) -> Terms:
        """The likelihood's pieces at x; the latest are remembered."""
        key = np.asarray(x, dtype=float).tobytes()
        if self._latest is None or self._latest[0] != key:
            self._latest = key, self.at(x).terms(self.circuit(x))
        return self._latest[1]

    def on(self, coordinates: Coordinates) -> EventTimesObjective:
        return EventTimesObjective(self.likelihood, coordinates, self.off)

    def circuit(self, x: np.ndarray) -> Circuit:
        """The circuit that the likelihood at x is of."""
        if not self.off:
            return self.coordinates.circuit(x)
        values = self.coordinates.values(x)
        for name, off in self.off.items():
            p = self.coordinates.model.parameters[name]
            values[name] = p.from_coordinate(p.to_coordinate(values[name]) + off)
        return self.coordinates.model.circuit(values)

    def under_shot_noise(self, x: np.ndarray, density: float | None = None) -> EventTimesObjective:
        """The same of events whose levels shot noise has moved, by as much as at x, to be maximised near there.

        density: where it is no parameter
        """
        circuit = self.circuit(x) if density is None else self.circuit(x).with_(shot_density=density)
        return EventTimesObjective(under_shot_noise(self.at(x), circuit), self.coordinates, self.off)

    def near(self, x: np.ndarray) -> EventTimesObjective:
        """The same with what the noise of stamps and the gains of pixels add to levels held as at x.

        Noise of stamps counts at the reset as well as at the event where stamps are jittered or coarse.  Itself where
        shot noise has moved levels, which are held anyway.
        """
        likelihood = self.at(x)
        if likelihood.shift is not None:
            return self
        if weighs_stamps(likelihood, self.coordinates):
            likelihood = likelihood.weighed(self.circuit(x))
        elif likelihood.is_uneven:
            likelihood = likelihood.with_gains_held(self.circuit(x))
        else:
            return self
        return EventTimesObjective(likelihood, self.coordinates, self.off)

    def following(self, x: np.ndarray) -> EventTimesObjective:
        carried = self.likelihood.carried
        return self if carried is None or not carried.nearly_straight else self.near(x)

    def at(self, x: np.ndarray) -> EventTimes:
        """The likelihood as it is at x."""
        return self.likelihood

    def value(self, x: np.ndarray) -> float:
        return self.terms(x).total + self.coordinates.log_prior(x)

    def gradient(self, x: np.ndarray) -> np.ndarray:
        here, circuit = self.terms(x).gradient(), self.circuit(x)
        slopes = [along(here, self._tangent(x, i, circuit)) for i in range(len(x))]
        return self.coordinates.prior_gradient_and_curvature(x)[0] + slopes

    def hessian(self, x: np.ndarray, here: Local | None = None) -> np.ndarray:
        """As any objective's.  Coordinates that act in the density alone leave changes and their tangents as at x.

        So their rows cost no trajectory, and hold no noise of extremes and samples that changes move across; the rows
        of all others take their part from them.
        """
        base, steps = self.gradient(x) if here is None else here.gradient, self.difference_steps()
        circuit, moved = self.circuit(x), [_moved(x, i, step) for i, step in enumerate(steps)]
        sharing = [
            i for i, at in enumerate(moved) if only_density_differs(circuit, self.circuit(at))
        ]  # fmt: skip
        others = [i for i in range(len(x)) if i not in sharing]
        H = np.empty((len(x), len(x)))
        H[sharing] = self._rows_sharing_changes(x, circuit, sharing, moved)
        H[sharing] = (H[sharing] - base) / steps[sharing, None]
        for i in others:
            H[i] = (self.gradient(moved[i]) - base) / steps[i]
        H[np.ix_(others, sharing)] = H[np.ix_(sharing, others)].T
        return 0.5 * (H + H.T)

    def _rows_sharing_changes(
        self, x: np.ndarray, circuit: Circuit, which: Sequence[int], moved: Sequence[np.ndarray]
    ) -> np.ndarray:
        """(k, d) gradients at `moved[i]`, i of `which`, where changes and their tangents are those at x."""
        changes = self.terms(x).changes
        circuits = {i: self.circuit(moved[i]) for i in which}
        there = [self.at(moved[i]).terms(circuits[i], changes).gradient() for i in which]
        rows = np.array([self.coordinates.prior_gradient_and_curvature(moved[i])[0] for i in which])
        for j in range(len(x)):
            changes = self._tangent(x, j, circuit).changes
            for row, gradient, i in zip(rows, there, which, strict=True):
                row[j] += along(gradient, Tangent(changes, self._numbers_along(moved[i], j, circuits[i])))
        return rows.reshape(len(which), len(x))

    def local(self, x: np.ndarray) -> Local:
        terms, circuit = self.terms(x), self.circuit(x)
        here, information = terms.gradient(), Information(terms, len(x))
        gradient, curvature = self.coordinates.prior_gradient_and_curvature(x)
        gradient = gradient.copy()
        for i in range(len(x)):
            tangent = self._tangent(x, i, circuit)
            gradient[i] += along(here, tangent)
            information.add(i, tangent)
        return Local(self.value(x), gradient, information.matrix() + np.diag(curvature))

    def tangent(self, x: np.ndarray, i: int) -> Tangent:
        """How changes and numbers move along coordinate i at x."""
        return self._tangent(x, i, self.circuit(x))

    def _tangent(self, x: np.ndarray, i: int, circuit: Circuit) -> Tangent:
        up = _moved(x, i, self._step * self.coordinates.longest_moves()[i])
        there = self.circuit(up)
        numbers = self._numbers_along(x, i, circuit, there)
        moved = self._moved_recording(i, circuit, there)
        if moved is None and only_density_differs(circuit, there):
            return Tangent(None, numbers)
        here, likelihood = self.terms(x).changes, self.at(x)
        if moved is None:
            difference = likelihood.changes(there, here)
        else:
            difference = likelihood.changes_of_one(there, here, moved)
        slope = difference.vector
        with np.errstate(over="ignore", invalid="ignore"):  # intervals whose density is zero
            slope -= here.vector
            slope /= up[i] - x[i]
        if not np.isfinite(slope.sum()):
            np.nan_to_num(slope, copy=False, posinf=0.0, neginf=0.0)
        return Tangent(difference, numbers)

    def _numbers_along(self, x: np.ndarray, i: int, circuit: Circuit, there: Circuit | None = None) -> np.ndarray:
        """(10,) how the circuit's `NUMBERS` move along coordinate i at x;  there: the circuit a step up, if known."""
        step = self._step * self.coordinates.longest_moves()[i]
        up, down = _moved(x, i, step), _moved(x, i, -step)
        there = self.circuit(up) if there is None else there
        numbers = np.zeros(len(NUMBERS))
        if any(getattr(there, name) != getattr(circuit, name) for name in NUMBERS):
            back = self.circuit(down)
            numbers[:] = [getattr(there, name) - getattr(back, name) for name in NUMBERS]
            numbers /= up[i] - down[i]
        return numbers

    def _moved_recording(self, i: int, here: Circuit, there: Circuit) -> int | None:
        """The recording that coordinate i belongs to, where it is one recording's own."""
        if "[" not in self.coordinates.parameters[i].name:
            return None
        names = [recording.name for recording in self.likelihood.recordings]
        moved = [k for k, name in enumerate(names) if here.in_recording(name) != there.in_recording(name)]
        return moved[0] if len(moved) == 1 else None


def weighs_stamps(likelihood: EventTimes, coordinates: Coordinates) -> bool:
    """Whether the noise of stamps counts at the reset as well: where they are jittered or coarse."""
    return "timestamp_jitter" in coordinates.model.effects or likelihood.has_coarse_stamps


def _moved(x: np.ndarray, i: int, by: float) -> np.ndarray:
    moved = x.copy()
    moved[i] += by
    return moved


def along(gradient: Gradient, tangent: Tangent) -> float:
    """The derivative of the log-likelihood along a tangent."""
    total = float(gradient.by_numbers @ tangent.numbers)
    return total if tangent.changes is None else total + _dot(gradient.by_changes.vector, tangent.changes.vector)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract", "nsz"})
def _dot(a, b):
    """Σ a b in this thread: linear algebra wakes one per core for a product that takes microseconds."""
    total = 0.0
    for i in range(len(a)):
        total += a[i] * b[i]
    return total


def _set_by_events(circuit: Circuit) -> tuple:
    """What of a described effect depends on other numbers of the circuit."""
    return at_reset(circuit).tolist(), since_event(circuit), circuit.threshold_drift


def only_density_differs(a: Circuit, b: Circuit) -> bool:
    """Whether two circuits have the same trajectories and changes."""
    if (a.described or b.described) and _set_by_events(a) != _set_by_events(b):
        return False
    return a.with_(**{name: getattr(b, name) for name in DENSITY_ONLY}) == b
