"""A grid of rates, at whose points a beat is worked out once, and the interpolation between them.

The grid is even in the logarithm of sqrt(W^2 - WL^2), on which everything about a beat depends smoothly.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeVar

import numpy as np

from analysis.arrays import Floats, Indices

X = TypeVar("X", float, Floats)

STEP = 0.05
FINER = 100
"""Points of a finer grid in one step: between them straight lines are good to 1e-7 of a second harmonic."""
_OFFSETS = (-2.0, -1.0, 0.0, 1.0, 2.0, 3.0)  # six points around a place between 0 and 1
_LOWEST_DPS = 1e-9


def beat_rate_at(point: int) -> float:
    """Value of sqrt(W^2 - WL^2) in deg/s at a point of the grid."""
    return math.exp(STEP * point)


def rate_at(point: int, lock_in_rate: float) -> float:
    """Rate W in deg/s, positive, at a point of the grid."""
    return math.hypot(beat_rate_at(point), lock_in_rate)


def interpolate(rates: Floats, lock_in_rate: float, at_point: Callable[[int, Indices], Floats | float]) -> Floats:
    """Interpolate between the points of the grid, by polynomials of the fifth degree.

    Shapes: rates (n,).
    """
    place = grid_place(np.abs(rates), lock_in_rate)
    cells = np.floor(place).astype(np.intp)
    values = np.empty(rates.shape)
    for cell in np.unique(cells):
        inside = np.flatnonzero(cells == cell)
        weights = six_weights(place[inside] - cell)
        values[inside] = sum(
            weight * at_point(int(cell + offset), inside) for offset, weight in zip(_OFFSETS, weights, strict=True)
        )
    return values


def weights_at(place: float) -> list[tuple[int, float]]:
    """Points of the grid around one place, and their weights."""
    cell = math.floor(place)
    weights = six_weights(place - cell)
    return [(int(cell + offset), weight) for offset, weight in zip(_OFFSETS, weights, strict=True)]


def grid_place(size: Floats, lock_in_rate: float) -> Floats:
    """Places on the grid, in steps of it, of rates (deg/s, positive) beyond the lock-in rate."""
    beat_rate = np.sqrt((size - lock_in_rate) * (size + lock_in_rate))
    return np.asarray(np.log(np.maximum(beat_rate, _LOWEST_DPS)) / STEP)


def six_weights(x: X) -> list[X]:
    """Weights of points -2, -1, ... 3 around places x between 0 and 1: of an array, or of a number (faster)."""
    weights = []
    for own in _OFFSETS:
        first, *rest = (other for other in _OFFSETS if other != own)
        weight = (x - first) / (own - first)
        for other in rest:
            weight = weight * ((x - other) / (own - other))
        weights.append(weight)
    return weights
