"""Lock-in rate, bias, its drift, hysteresis and noise from all steps of a sweep: the corner as a whole."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.special

from analysis.arrays import Bools, Floats
from analysis.dead_band.noisy_corner import LEAST_WALK, falling, rounded_pulse_rate

FEWEST_FOR_CORNER = 6
FEWEST_BOTH_WAYS = 4
"""Steps on the way out and on the way in from which a drift is told from hysteresis."""

FEWEST_DEGREES = 3.0

COUNTED_U = 6**-0.5
"""Standard uncertainty of a count of whole pulses: rounding at either end."""

_NEAR = 3.0
"""Steps below so many lock-in rates are fitted: beyond, the beat hardly depends on it."""

# in lock-in rates, but for the logarithm of the walk in sqrt(WL/K): lock-in rate, bias, walk, drift, hysteresis
_START = np.array([1.0, 0.0, np.log(0.02), 0.0, 0.0])
_LOW = np.array([0.1, -1.0, np.log(LEAST_WALK), -1.0, -0.5])
_HIGH = np.array([3.0, 1.0, np.log(10.0), 1.0, 0.5])
_SCALE = np.array([0.01, 0.01, 0.3, 0.01, 0.01])
_NOT_THE_WALK = np.array([True, True, False, True, True])
_STEP = 1e-6


@dataclass(frozen=True)
class Sweep:
    """Steps as they were taken, (n,): deg/s, pulses and their uncertainty, and the time from -1/2 to 1/2."""

    rates: Floats
    pulses: Floats
    pulses_u: Floats
    time: Floats
    dwell: float
    scale_factor: float


@dataclass(frozen=True)
class Corner:
    """Fitted corner: lock-in rate (deg/s), random walk (deg/sqrt(s)) and drift over the sweep (deg/s)."""

    rate: float = float("nan")
    rate_u: float = float("nan")
    random_walk: float = float("nan")
    random_walk_u: float = float("nan")
    drift: float = float("nan")
    drift_u: float = float("nan")


def fit_corner(swept: Sweep, start: float) -> Corner:
    """Fit the steps below three times the lock-in rate `start`, deg/s; all nan where they are too few.

    Drift and hysteresis are fitted where the steps go both ways.
    """
    from scipy.optimize import least_squares  # costs more to import than all else here

    near = np.abs(swept.rates) < _NEAR * start
    if near.sum() < FEWEST_FOR_CORNER:
        return Corner()
    inwards = falling(swept.rates)[near]
    both_ways = min(inwards.sum(), (~inwards).sum()) >= FEWEST_BOTH_WAYS
    count = 5 if both_ways and np.any(swept.time) else 3
    seen = swept.pulses[near]

    def expected(points: Floats) -> Floats:
        return _expected(points, swept, near, start)

    def slopes(point: Floats) -> Floats:
        # all points of the difference at once: the closed form's cost is in its loop, not in its arrays
        aside = point + np.vstack([np.zeros(count), _STEP * np.eye(count)])
        at, *beside = expected(aside)
        return np.asarray((np.stack(beside, axis=-1) - at[:, np.newaxis]) / _STEP)

    def left(point: Floats) -> Floats:
        return np.asarray(expected(point[np.newaxis])[0] - seen)

    fit = least_squares(
        left,
        _START[:count],
        jac=slopes,
        bounds=(_LOW[:count], _HIGH[:count]),
        x_scale=_SCALE[:count],
        max_nfev=60,
    )
    if np.any(fit.active_mask[_NOT_THE_WALK[:count]]):
        return Corner()  # no such corner: another scale factor, or steps that do not show it
    jacobian = np.asarray(fit.jac)
    # Slips scatter most at the corner itself: each step's own residual says how much, less what the fit took of it
    # (MacKinnon and White, J. Econometrics 29, 305, third estimate), and a count no less than its uncertainty.
    inverse = np.linalg.pinv(jacobian.T @ jacobian)
    kept = np.maximum(1 - np.einsum("ni,ij,nj->n", jacobian, inverse, jacobian), 1 / near.sum())
    spread = np.maximum(fit.fun / kept, swept.pulses_u[near]) ** 2
    us = _known_from_few(inverse @ jacobian.T, spread)
    walk = float(np.exp(fit.x[2])) * _usual_walk(swept, start)
    drift, drift_u = (float(fit.x[3]), float(us[3])) if count > 3 else (float("nan"), float("nan"))
    return Corner(
        rate=float(fit.x[0]) * start,
        rate_u=float(us[0]) * start,
        random_walk=walk,
        random_walk_u=walk * float(us[2]),
        drift=drift * start,
        drift_u=drift_u * start,
    )


def _known_from_few(weights: Floats, spread: Floats) -> Floats:
    """Standard uncertainties of parameters (P,), made of steps (n,) by `weights` (P, n).

    `spread` : (n,) variances of the steps.

    Each of these is that of a single residual, and where slips are strong few steps at the corner count. The sum
    of their shares then has few degrees of freedom (Satterthwaite; the square of a squared residual is three times
    that of its mean): the uncertainty is enlarged to what Student's distribution asks for.
    """
    shares = weights**2 * spread
    total = shares.sum(axis=1)
    squares = np.maximum(np.sum(shares**2, axis=1), 1e-300)
    degrees = np.maximum(3 * total**2 / squares, FEWEST_DEGREES)
    student = scipy.special.stdtrit(degrees, 0.975) / scipy.special.ndtri(0.975)
    return np.asarray(np.sqrt(np.maximum(total, 0.0)) * student)


def _usual_walk(swept: Sweep, start: float) -> float:
    return float(np.sqrt(start / swept.scale_factor))


def _expected(points: Floats, swept: Sweep, near: Bools, start: float) -> Floats:
    """Pulses (P, n) of the steps fitted, for points (P, 3) or (P, 5)."""
    columns = np.zeros((5, len(points), 1))
    columns[: points.shape[1], :, 0] = points.T
    lock_in, bias, walk, drift, hysteresis = columns
    way = np.where(falling(swept.rates)[near], -0.5, 0.5)
    turning = rounded_pulse_rate(
        swept.rates[near] - (bias + drift * swept.time[near]) * start,
        scale_factor=swept.scale_factor,
        lock_in_rate=np.maximum(lock_in + way * hysteresis, 0.0) * start,
        random_walk=np.exp(walk) * _usual_walk(swept, start),
    )
    return np.asarray(np.abs(turning) * swept.dwell)
