"""Normal equations of a batch of least-squares fits, and their solution."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.arrays import Bools, Floats, Indices

RIDGE = 1e-13
"""Added to the scaled diagonal: an exactly singular case (a harmonic on another's alias) stays solvable, and its
variance comes out enormous, as it should."""


ROUNDING = 1e-3
"""Relative error of an inverse that is still no sign of a singular matrix."""


def empty_matrices(n_records: int, size: int) -> Floats:
    """Room for (R, P, P) matrices of which each element lies side by side for all records."""
    return np.empty((size, size, n_records)).transpose(2, 0, 1)


@dataclass(frozen=True)
class Step:
    """One Gauss-Newton step: normal matrix and gradient, frequency last (its unit: rad at the record's ends)."""

    normal: Floats
    gradient: Floats
    residual_power: Floats

    def solve(self, damping: Floats | None = None) -> Floats:
        """Change of the parameters, (R, P); `damping` (R,) adds that share of each diagonal element."""
        return self.solve_and_invert(damping)[0]

    def covariance(self) -> Floats:
        """Inverse of the normal matrix, (R, P, P): the covariance for unit noise."""
        return self.solve_and_invert()[1]

    def solve_and_invert(self, damping: Floats | None = None) -> tuple[Floats, Floats]:
        """Change of the parameters, (R, P), and inverse of the normal matrix, (R, P, P)."""
        normal = self.normal.transpose(1, 2, 0)
        each = np.arange(normal.shape[0])
        diagonal = normal[each, each]
        scale = 1 / np.sqrt(np.where(diagonal > 1e-100, diagonal, 1.0))  # a constant record has zeros
        inverse = normal * scale
        inverse *= scale[:, np.newaxis]
        inverse[each, each] += RIDGE if damping is None else RIDGE + damping
        smallest = (1 - ROUNDING) / inverse[each, each]
        _invert(inverse)
        # No diagonal element of the inverse is less than the reciprocal; rounding breaks that in singular cases.
        variances = inverse[each, each]
        inverse[each, each] = np.where(variances > smallest, variances, 1 / RIDGE)
        inverse *= scale
        inverse *= scale[:, np.newaxis]
        change = np.zeros((len(inverse), len(self.gradient)))
        for column, slope in enumerate(self.gradient.T):  # in one order, however many records there are
            change += inverse[:, column] * slope
        return np.ascontiguousarray(change.T), inverse.transpose(2, 0, 1)

    def predicted_residual(self, change: Floats) -> Floats:
        """Residual power after a full step, as the linear model predicts it, (R,)."""
        gained = np.vecdot(change, self.gradient)
        return np.asarray(np.maximum(self.residual_power - gained, 0.0))

    def take(self, part: Indices) -> Step:
        """Some of the records."""
        return Step(self.normal[part], self.gradient[part], self.residual_power[part])

    def where(self, chosen: Bools, other: Step) -> Step:
        """This step where chosen, the other elsewhere."""
        return Step(
            np.where(chosen[:, np.newaxis, np.newaxis], self.normal, other.normal),
            np.where(chosen[:, np.newaxis], self.gradient, other.gradient),
            np.where(chosen, self.residual_power, other.residual_power),
        )

    def put(self, part: Indices | Bools, other: Step) -> None:
        """Write the other's records into the places `part` of this one."""
        self.normal[part], self.gradient[part] = other.normal, other.gradient
        self.residual_power[part] = other.residual_power


def _invert(matrix: Floats) -> None:
    """Replace positive definite matrices with a unit diagonal, (P, P, R), by their inverses.

    Gauss-Jordan elimination of all records in step: for many small matrices it is several times faster than a
    call of LAPACK for each, and for few it must give the same digits. Positive definite matrices need no pivoting.
    """
    for row in range(len(matrix)):
        reciprocal = 1 / np.maximum(matrix[row, row], RIDGE / 10)
        column = matrix[:, row].copy()
        matrix[:, row] = 0.0
        column[row] = -1.0
        matrix[row, row] = 1.0
        pivot_row = matrix[row] * reciprocal
        matrix[row] = 0.0
        matrix -= column[:, np.newaxis] * pivot_row
