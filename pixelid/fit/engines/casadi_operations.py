"""`expression.Operations` for CasADi symbols: MX column vectors."""

from __future__ import annotations

import casadi as ca
import numpy as np


class CasadiOperations:
    """Vectors are MX (or DM) columns.  Only `ca.*` functions: NumPy's on symbols can be silently wrong."""

    exp, log, sqrt, sin, cos = (staticmethod(f) for f in (ca.exp, ca.log, ca.sqrt, ca.sin, ca.cos))
    abs = staticmethod(ca.fabs)

    @staticmethod
    def constant(values):
        return ca.DM(np.asarray(values, dtype=float))

    @staticmethod
    def where(condition, a, b):
        return ca.if_else(condition, a, b)

    @staticmethod
    def normal_cdf(x):
        """Absolute error 1e-16, which is what the chance of a missed event leaves of it."""
        return 0.5 * (1.0 + ca.erf(x * np.sqrt(0.5)))

    @staticmethod
    def take(x, index):
        return x[np.asarray(index).tolist()] if len(index) else ca.DM(0, 1)

    @staticmethod
    def join(parts):
        return ca.vertcat(*parts)

    @staticmethod
    def spread(x, at, size):
        at = np.asarray(at)
        if len(at) == 0:
            return ca.DM.zeros(size, 1)
        return ca.mtimes(_selection(at, np.arange(len(at)), size, len(at)), x)

    @staticmethod
    def sum_by(index, x, size):
        return ca.mtimes(_selection(np.asarray(index), np.arange(len(index)), size, len(index)), x)

    @staticmethod
    def total(x):
        return ca.sum1(x)

    @staticmethod
    def cumulate(x):
        return ca.vertcat(0.0, ca.cumsum(x))

    @staticmethod
    def recur(A, c):
        """The four-state recurrence as a mapped accumulation of one scalar-expression step."""
        n = c[0].shape[0]
        present = [(i, j) for i in range(4) for j in range(4) if not isinstance(A[i][j], float)]
        x, coefficients = ca.SX.sym("x", 4), ca.SX.sym("c", len(present) + 4)
        moved = [coefficients[len(present) + i] for i in range(4)]
        for p, (i, j) in enumerate(present):
            moved[i] += coefficients[p] * x[j]
        step = ca.Function("step", [x, coefficients], [ca.vertcat(*moved)])
        rows = ca.horzcat(*(A[i][j] for i, j in present), *c).T
        states = ca.horzcat(ca.DM.zeros(4, 1), step.mapaccum(n)(ca.DM.zeros(4, 1), rows)).T
        return [states[:, i] for i in range(4)]


def _selection(row, column, rows, columns):
    """Sparse (rows, columns) matrix of ones."""
    return ca.DM.triplet(row.tolist(), column.tolist(), ca.DM.ones(len(row)), rows, columns)
