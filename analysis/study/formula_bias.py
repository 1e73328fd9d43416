"""Bias of the paper's formulas, and the error of the exact relation on exact records."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.arrays import Floats
from analysis.lockin_equation import harmonic_ratio, lock_in_from_rate
from analysis.study.simulation import Gyros, errors_by_fit

RATE_RATIOS = (0.01, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.98)


@dataclass(frozen=True)
class BiasTable:
    """Arrays of shape (n,)."""

    rate_ratio: Floats  # x = WL/W
    ratio: Floats  # r = A2/A1 = tan(asin(x)/2)
    # relative bias of the paper's equations, the ratio being exact: (1 + r^2)/sqrt(1 + 4 r^2) - 1 and r^2
    formula_13: Floats
    formula_10: Floats
    # largest relative error of the whole exact method on records of the exact solution, several phases
    ours: Floats


def bias_table(rate_ratios: tuple[float, ...] = RATE_RATIOS) -> BiasTable:
    """Compute the table for W = 1 deg/s and K = 2000 pulses per degree."""
    x = np.asarray(rate_ratios, dtype=np.float64)
    r = harmonic_ratio(x)
    gyros = Gyros.of(1.0, x[:, np.newaxis], np.array([0.0, 1.0, 4.0]))
    return BiasTable(
        rate_ratio=x,
        ratio=r,
        formula_13=np.asarray(lock_in_from_rate(r, 1.0, "paper-13") / x - 1),
        formula_10=np.asarray(lock_in_from_rate(r, 1.0, "paper-10") / x - 1),
        ours=np.asarray(np.abs(errors_by_fit(gyros)).max(axis=-1)),
    )
