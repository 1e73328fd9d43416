"""Which level of the converter each value of a file is, where the file does not give the scale itself."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from instrument.errors import FileFormatError

_NICE = {"time": (1.0, 2.0, 4.0), "level": (2.0, 4.0, 8.0)}
"""Leading digits of the interval at 1-2.5-5 s/div over 250 points, and of a level at 1-2-5 V/div over 25."""

_TIME_CLOSE, _LEVEL_CLOSE = 2e-4, 0.05

_PARTS, _OFF = 8, 0.15


def spacing_of(values: NDArray[np.float64]) -> float:
    """Spacing of the levels on which values lie; nan where all are equal."""
    levels = np.unique(values)
    if levels.size < 2:
        return math.nan
    gaps = np.diff(levels)
    # decimals that were cut make one level look like two very close ones
    gaps = gaps[gaps > 1e-3 * gaps.max()] if gaps.min() < 1e-6 * (levels[-1] - levels[0]) else gaps
    above = levels - levels[0]
    for part in range(1, _PARTS + 1):  # records that skip levels show several of them as the least gap
        spacing = float(gaps.min()) / part
        for _ in range(3):
            steps = np.rint(above / spacing)
            spacing = float(np.dot(steps, above) / np.dot(steps, steps))
        if np.abs(above / spacing - np.rint(above / spacing)).max() < _OFF:
            return spacing
    raise FileFormatError("the values do not lie on the levels of a converter: they were edited or calculated")


def nice_level(spacing: float) -> float:
    """The level of a 1-2-5 scale next to a spacing that a few decimals give; FileFormatError if there is none."""
    return _nearest(spacing, "level", _LEVEL_CLOSE)


def nice_interval(interval: float) -> float:
    """The sample interval of a 1-2.5-5 time base next to a measured one; the same where there is none."""
    try:
        return _nearest(interval, "time", _TIME_CLOSE)
    except FileFormatError:
        return interval


def _nearest(value: float, kind: str, close: float) -> float:
    if not (math.isfinite(value) and value > 0):
        raise FileFormatError(
            "the row 'Vertical Scale' is missing, and the values do not tell it; restore the file"
        )
    exponent = math.floor(math.log10(value))
    candidates = [
        float(f"{digit:g}e{power}") for power in (exponent - 1, exponent, exponent + 1) for digit in _NICE[kind]
    ]
    best = min(candidates, key=lambda one: abs(math.log(one / value)))
    if abs(best / value - 1) > close:
        raise FileFormatError(
            f"the row 'Vertical Scale' is missing, and levels {value:.4g} apart fit no scale; restore the file"
        )
    return best
