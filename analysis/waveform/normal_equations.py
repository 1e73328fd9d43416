"""Normal equations of a batch of least-squares fits, and their solution."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Step:
    """One Gauss-Newton step: normal matrix and gradient, frequency last (its unit: rad at the record's ends)."""

    normal: Floats
    gradient: Floats
    residual_power: Floats

    def solve(self, damping: Floats | None = None) -> Floats:
        """Change of the parameters, (R, P); `damping` (R,) adds that share of each diagonal element."""
        scaled, scale = self._scaled()
        if damping is not None:
            scaled += damping[:, np.newaxis, np.newaxis] * np.eye(scale.shape[-1])
        return np.asarray(scale * np.linalg.solve(scaled, (scale * self.gradient)[..., np.newaxis])[..., 0])

    def covariance(self) -> Floats:
        """Inverse of the normal matrix, (R, P, P): the covariance for unit noise."""
        scaled, scale = self._scaled()
        return np.asarray(np.linalg.inv(scaled) * scale[:, :, np.newaxis] * scale[:, np.newaxis, :])

    def predicted_residual(self, change: Floats) -> Floats:
        """Residual power after a full step, as the linear model predicts it, (R,)."""
        gained = np.einsum("rp,rp->r", change, self.gradient)
        return np.asarray(np.maximum(self.residual_power - gained, 0.0))

    def take(self, part: NDArray[np.intp]) -> Step:
        """Some of the records."""
        return Step(self.normal[part], self.gradient[part], self.residual_power[part])

    def where(self, chosen: NDArray[np.bool_], other: Step) -> Step:
        """This step where chosen, the other elsewhere."""
        return Step(
            np.where(chosen[:, np.newaxis, np.newaxis], self.normal, other.normal),
            np.where(chosen[:, np.newaxis], self.gradient, other.gradient),
            np.where(chosen, self.residual_power, other.residual_power),
        )

    def put(self, part: NDArray[np.intp] | NDArray[np.bool_], other: Step) -> None:
        """Write the other's records into the places `part` of this one."""
        self.normal[part], self.gradient[part] = other.normal, other.gradient
        self.residual_power[part] = other.residual_power

    def _scaled(self) -> tuple[Floats, Floats]:
        diagonal = np.diagonal(self.normal, axis1=-2, axis2=-1)
        scale = 1 / np.sqrt(np.where(diagonal > 1e-100, diagonal, 1.0))  # a constant record has zeros
        # The tiny ridge keeps an exactly singular case (a harmonic on another's alias) solvable; its variance
        # then comes out enormous, as it should.
        ridge = 1e-13 * np.eye(scale.shape[-1])
        return self.normal * scale[:, :, np.newaxis] * scale[:, np.newaxis, :] + ridge, scale
