"""Gauges: what must be assumed before physical circuit values can be quoted (docs/model.md, "Invariants").

Data fix α, β, γ.  The six physical values need three more statements, each a fixed value ("q_in = 0.875") or a
ratio ("A_loop = 0.7 A_amp").  Fewer leave flat directions, more (or repeated ones) over-determine; both are
refused, with the reason in words.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from pixelid.errors import InputError, did_you_mean
from pixelid.parameters.invariants import INVARIANTS, PHYSICAL_NAMES, Physical, log_jacobian

_RELATION = re.compile(r"^\s*([0-9.eE+-]+)\s*\*?\s*([A-Za-z_]+)\s*$")


@dataclass(frozen=True)
class Gauge:
    """Fixed physical values and ratios.

    fixed: name → value;  ratios: name → (factor, other name), meaning name = factor · other.
    """

    fixed: Mapping[str, float] = field(default_factory=dict)
    ratios: Mapping[str, tuple[float, str]] = field(default_factory=dict)

    @staticmethod
    def parse(statements: Mapping[str, str | float]) -> Gauge:
        """A gauge from {"q_in": 0.875, "A_loop": "0.7 A_amp"}.

        Raises InputError for unknown names and values that are neither positive numbers nor ratios.
        """
        fixed: dict[str, float] = {}
        ratios: dict[str, tuple[float, str]] = {}
        for name, value in statements.items():
            if name not in PHYSICAL_NAMES:
                known = f"{', '.join(PHYSICAL_NAMES)}{did_you_mean(name, PHYSICAL_NAMES)}"
                raise InputError(f"gauge: unknown name {name!r}; known: {known}")
            number = _number(value)
            if number is not None:
                fixed[name] = number
            else:
                match = _RELATION.match(str(value))
                number = _number(match[1]) if match else None
                if match is None or number is None or match[2] not in PHYSICAL_NAMES or match[2] == name:
                    raise InputError(f"gauge: {name} = {value!r} is neither a number nor a ratio like '0.7 A_amp'")
                ratios[name] = (number, match[2])
            if not (number > 0 and np.isfinite(number)):
                raise InputError(f"gauge: {name} = {value} must be positive and finite")
        return Gauge(fixed, ratios)

    def statements(self) -> dict[str, str | float]:
        """The gauge as it is written in files and JSON."""
        return {**self.fixed, **{name: f"{factor:g} {other}" for name, (factor, other) in self.ratios.items()}}

    def _rows(self) -> np.ndarray:
        rows = np.zeros((len(self.fixed) + len(self.ratios), len(PHYSICAL_NAMES)))
        for i, name in enumerate(self.fixed):
            rows[i, PHYSICAL_NAMES.index(name)] = 1.0
        for i, (name, (_, other)) in enumerate(self.ratios.items(), start=len(self.fixed)):
            rows[i, PHYSICAL_NAMES.index(name)] = 1.0
            rows[i, PHYSICAL_NAMES.index(other)] = -1.0
        return rows

    def flat_directions(self, around: Physical) -> list[str]:
        """The directions of physical space that data and gauge leave free, one sentence each."""
        rows = np.vstack([log_jacobian(around), self._rows()])
        _, singular, vt = np.linalg.svd(rows)
        rank = int((singular > 1e-9).sum())
        null = vt[rank:]
        return [_in_words(direction) for direction in _sparse_basis(null)]

    def check(self, around: Physical) -> None:
        """Raise InputError unless data plus gauge fix every physical value exactly once."""
        rows = self._rows()
        everything = np.vstack([log_jacobian(around), rows])
        flat = self.flat_directions(around)
        redundant = len(everything) - np.linalg.matrix_rank(everything, tol=1e-9)
        if redundant > 0:
            raise InputError(
                f"gauge: over-determined by {redundant}: the data already fix {', '.join(INVARIANTS)}, so "
                f"exactly three independent statements are needed, found {len(rows)}: "
                + ", ".join(f"{k} = {v}" for k, v in self.statements().items())
            )
        if flat:
            raise InputError(
                f"gauge: incomplete, {len(flat)} direction{'s' * (len(flat) > 1)} left flat: " + "; ".join(flat)
            )

    def physical(self, alpha: float, beta: float, gamma: float, around: Physical) -> Physical:
        """The unique physical values with these invariants under this gauge.

        Raises InputError when the gauge is incomplete, over-determined, or admits no positive solution.
        """
        self.check(around)
        target = np.log([alpha, beta, gamma])

        def residual(logs: np.ndarray) -> np.ndarray:
            values = dict(zip(PHYSICAL_NAMES, np.exp(logs), strict=True))
            invariants = np.log(Physical(**values).invariants()) - target
            fixed = [np.log(values[name] / value) for name, value in self.fixed.items()]
            ratio = [np.log(values[name] / (factor * values[other])) for name, (factor, other) in self.ratios.items()]
            return np.concatenate([invariants, fixed, ratio])

        start = np.log([around.as_dict()[name] for name in PHYSICAL_NAMES])
        from scipy.optimize import least_squares  # takes longer to import than all of the model's files

        solution = least_squares(residual, start, xtol=1e-15, ftol=1e-15, gtol=1e-15)
        if np.abs(solution.fun).max() > 1e-8:
            raise InputError(
                f"gauge: no positive circuit values have alpha {alpha:.4g}, beta {beta:.4g}, gamma {gamma:.4g} with "
                + ", ".join(f"{k} = {v}" for k, v in self.statements().items())
            )
        return Physical(**dict(zip(PHYSICAL_NAMES, np.exp(solution.x).tolist(), strict=True)))

    def response(self, at: Physical) -> np.ndarray:
        """How the physical values follow the invariants under this gauge.

        Args:
            at: the physical values.

        Returns:
            (6, 3) derivatives of their logs, in `PHYSICAL_NAMES` order, by (ln α, ln β, ln γ).

        Raises:
            InputError: the gauge is incomplete or over-determined.
        """
        self.check(at)
        return np.linalg.inv(np.vstack([log_jacobian(at), self._rows()]))[:, : len(INVARIANTS)]


def _number(value: object) -> float | None:
    """`value` as a number, None when it is none."""
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        return None
    try:
        return float(value)
    except ValueError:
        return None


def _sparse_basis(null: np.ndarray) -> np.ndarray:
    """The null space in reduced row-echelon form, so that each direction names few parameters."""
    basis = null.copy()
    row = 0
    for column in range(basis.shape[1]):
        if row == len(basis):
            break
        pivot = row + int(np.argmax(np.abs(basis[row:, column])))
        if abs(basis[pivot, column]) < 1e-9:
            continue
        basis[[row, pivot]] = basis[[pivot, row]]
        basis[row] /= basis[row, column]
        for other in range(len(basis)):
            if other != row:
                basis[other] -= basis[other, column] * basis[row]
        row += 1
    return basis


def _in_words(direction: np.ndarray) -> str:
    """'scaling A_amp × k together with tau_out × k^0.82, q_mil × k^-0.4 changes no event'."""
    terms = [
        f"{name} × k^{power:.3g}" if abs(power - 1) > 1e-6 else f"{name} × k"
        for name, power in zip(PHYSICAL_NAMES, direction, strict=True)
        if abs(power) > 1e-6
    ]
    return f"scaling {terms[0]}" + (f" together with {', '.join(terms[1:])}" if terms[1:] else "") + " changes no event"
