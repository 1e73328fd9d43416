"""The 2 pi error from an open-loop injection: what the self-calibration in closed loop cannot see.

The feedback is held, and steps large enough to make the staircase fall are injected. With the phase of a step
phi = 2 pi s (1 + eps)/2^N + phi_0, phi_0 the phase at rest, the mean errors of the demodulated sample pairs are

    without a fall    e_n = -2 A sin(phi)                                                                  (18)
    with one          e_r = -A [ sin(phi) + sin(phi -+ 2 pi eps) ]      - for s > 0, + for s < 0           (19)

Their ratio does not hold A, so that the light level need not be known; both senses separate phi_0. A, eps and
phi_0 are fitted to all segments by weighted least squares. What the segments scatter beyond their noise counts in
the uncertainties, as for the runs of a rate table (`rate_table/scatter.py`).
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from analysis.arrays import Floats
from analysis.fibre_gyro.scatter import find_run_scatter

_ITERATIONS = 20
_CONVERGED = 1e-9  # of the standard uncertainty


@dataclass(frozen=True)
class TwoPiError:
    """Result of the fit."""

    two_pi_error: float  # eps: the converter's range spans 2 pi (1 + eps); with its uncertainty
    two_pi_error_u: float
    amplitude: float  # A, in the unit of the errors; with its uncertainty
    amplitude_u: float
    rest_phase_rad: float  # phi_0: rotation, and the feedback step that was held
    rest_phase_u_rad: float
    chi_square: float
    degrees_of_freedom: int  # two errors a segment less the three parameters
    # to the uncertainty of eps: "normal" and "reset" noise of either kind of pairs, "scatter" beyond both
    contributions: Mapping[str, float]


def estimate_two_pi_error(
    steps: ArrayLike,
    normal_error: ArrayLike,
    reset_error: ArrayLike,
    normal_u: ArrayLike,
    reset_u: ArrayLike,
    *,
    dac_bits: int,
) -> TwoPiError:
    """Fit eps to open-loop segments.

    Choose steps of an odd number of codes, below an eighth of the range: falls then meet both halves of the bias
    equally often, and the sensitivity, cos(phi), is high. At a step of a quarter of the range it is zero.

    Parameters
    ----------
    steps : array_like, shape (n,)
        Injected steps, codes, of both senses.
    normal_error, reset_error : array_like, shape (n,)
        Mean errors of the sample pairs without and with a fall of the staircase, in any one unit.
    normal_u, reset_u : array_like, shape (n,)
        Their standard uncertainties; the scatter that the segments show beyond them counts too. 1.96 of what is
        given are half a 95 % interval.
    dac_bits : int
        N.

    Raises
    ------
    ValueError
        Only one sense, a step beyond half of the range, a segment without falls, or errors that are not those of
        an open loop.

    Examples
    --------
    A step of an eighth of a turn, eps = 0.001, A = 1, no phase at rest. Two segments hardly show what scatter
    there is, so u is wider than by the noise alone (1.6e-06):

    >>> phi = 2 * np.pi * 1.001 / 8 * np.array([1, -1])
    >>> normal, reset = -2 * np.sin(phi), -np.sin(phi) - np.sin(phi - 0.002 * np.pi * np.array([1, -1]))
    >>> result = estimate_two_pi_error([8192, -8192], normal, reset, 1e-6, 1e-5, dac_bits=16)
    >>> round(result.two_pi_error, 9), round(result.amplitude, 9), f"{result.two_pi_error_u:.1e}"
    (0.001, 1.0, '2.9e-06')
    """
    step = np.atleast_1d(np.asarray(steps, dtype=np.float64))
    error = np.stack([np.broadcast_to(np.asarray(v, np.float64), step.shape) for v in (normal_error, reset_error)])
    error_u = np.stack([np.broadcast_to(np.asarray(v, np.float64), step.shape) for v in (normal_u, reset_u)])
    turns = step / 2.0**dac_bits
    _check(step, turns, error, error_u)
    # start without a phase at rest: the ratio of the errors gives eps, then A
    base = 2.0 * np.pi * turns
    ratio = float(np.median((1.0 - error[1] / error[0]) * np.tan(np.abs(base))))
    parameters = np.array([float(np.median(-error[0] / (2.0 * np.sin(base)))), ratio / np.pi, 0.0])
    weight = 1.0 / error_u
    for _ in range(_ITERATIONS):
        model, slopes = _model(parameters, turns)
        matrix = (slopes * weight[..., None]).reshape(-1, 3)
        change, *_rest = np.linalg.lstsq(matrix, ((error - model) * weight).ravel(), rcond=None)
        parameters = parameters + change
        covariance = np.linalg.inv(matrix.T @ matrix)
        if np.all(np.abs(change) <= _CONVERGED * np.sqrt(np.diag(covariance))):
            break
    else:
        raise ValueError("the errors do not fit an open loop: no 2 pi error agrees with them")
    model, slopes = _model(parameters, turns)
    design, left = slopes.reshape(-1, 3), (error - model).ravel()
    scatter = find_run_scatter(design, left + design @ parameters, error_u.ravel(), 0.0)
    factors = scatter.estimator(design, by_known=True)
    u = [scatter.standard_u(row) for row in factors]
    normal_part, reset_part = np.linalg.norm(factors[1].reshape(error.shape) * error_u, axis=1)
    values = [float(v) for pair in zip(parameters, u, strict=True) for v in pair]
    amplitude, amplitude_u, eps, eps_u, rest, rest_u = values
    return TwoPiError(
        two_pi_error=eps,
        two_pi_error_u=eps_u,
        amplitude=amplitude,
        amplitude_u=amplitude_u,
        rest_phase_rad=rest,
        rest_phase_u_rad=rest_u,
        chi_square=float(np.sum((left * weight.ravel()) ** 2)),
        degrees_of_freedom=error.size - 3,
        contributions={
            "normal": float(normal_part),
            "reset": float(reset_part),
            "scatter": scatter.parts(factors[1])["scatter"],
        },
    )


def _check(step: Floats, turns: Floats, error: Floats, error_u: Floats) -> None:
    if step.size < 2 or not (np.any(step > 0) and np.any(step < 0)):
        raise ValueError("the 2 pi error needs injected steps of both senses: at least one of each")
    if np.any(np.abs(turns) >= 0.5) or np.any(step == 0):
        raise ValueError("every injected step must be less than half of the converter's range, and not zero")
    without = step[~np.isfinite(error[1])]
    if without.size:
        raise ValueError(
            f"no sample pair with a fall of the staircase at a step of {without[0]:g} codes: "
            f"use a larger step or a longer record"
        )
    if not (np.all(np.isfinite(error)) and np.all(error_u > 0)):
        raise ValueError("every mean error must be finite, with a positive standard uncertainty")
    if np.any(error[0] * step >= 0):
        raise ValueError(
            "the errors without a fall do not have the sign of the steps reversed: the injection does not "
            "reach the modulator, or the loop is closed"
        )


def _model(parameters: Floats, turns: Floats) -> tuple[Floats, Floats]:
    """Equations (18) and (19), shape (2, n), and their derivatives to A, eps, phi_0, shape (2, n, 3)."""
    amplitude, eps, rest = parameters
    two_pi, sense = 2.0 * np.pi, np.sign(turns)
    phase = two_pi * turns * (1.0 + eps) + rest
    fallen = phase - sense * two_pi * eps
    shape = np.stack([2.0 * np.sin(phase), np.sin(phase) + np.sin(fallen)])
    by_phase = np.stack([2.0 * np.cos(phase), np.cos(phase) + np.cos(fallen)])
    by_eps = two_pi * turns * by_phase
    by_eps[1] -= two_pi * sense * np.cos(fallen)
    slopes = -np.stack([shape, amplitude * by_eps, amplitude * by_phase], axis=-1)
    return np.asarray(-amplitude * shape), slopes
