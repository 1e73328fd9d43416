"""Runs of one axis on the rate table, as arrays, and what is fitted to all of them.

Model of the mean output over whole turns, gyro axis along the vertical table axis (end = +1) or against it (-1):

    N = end K (Omega + w_v) + B + D (t - t_0)

K counts per deg/s, Omega the table's signed rate, w_v the vertical earth rate, B the bias in counts at the middle
of the runs, D its drift.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from analysis.arrays import Floats, Ints

SAME_RATE = 1e-9
"""deg/s: rates that were asked for and differ by less are the same."""
_FREEDOM_FOR_DRIFT = 3
_HOUR = 3600.0


@dataclass(frozen=True)
class TableRuns:
    """Means over whole turns of one axis, one element a run.

    Attributes
    ----------
    nominal_dps : ndarray, shape (n,)
        Rate that was asked for, signed. Runs are paired by it.
    rate_dps : ndarray, shape (n,)
        Rate that the table had, signed.
    mean, mean_u : ndarray, shape (n,)
        Counts; the uncertainty is that of the noise within the run.
    duration_s : ndarray, shape (n,)
    end_up : ndarray of int, shape (n,)
        +1 where the axis points up, -1 where it points down.
    at_s : ndarray, shape (n,)
        Middle of the window; nan where nobody knows it.
    slow : ndarray, shape (n, n), or None
        Generalised covariance of the slow noise by a noise model, counts^2.
    """

    nominal_dps: Floats
    rate_dps: Floats
    mean: Floats
    mean_u: Floats
    duration_s: Floats
    end_up: Ints
    at_s: Floats
    slow: Floats | None = None

    def chosen(self, kept: ArrayLike) -> TableRuns:
        """Some of the runs; `kept` is a mask, shape (n,)."""
        of = np.asarray(kept, dtype=np.bool_)
        return replace(
            self,
            nominal_dps=self.nominal_dps[of],
            rate_dps=self.rate_dps[of],
            mean=self.mean[of],
            mean_u=self.mean_u[of],
            duration_s=self.duration_s[of],
            end_up=self.end_up[of],
            at_s=self.at_s[of],
            slow=None if self.slow is None else self.slow[np.ix_(of, of)],
        )


def table_runs(
    nominal_dps: ArrayLike,
    mean: ArrayLike,
    mean_u: ArrayLike,
    *,
    rate_dps: ArrayLike | None = None,
    duration_s: ArrayLike = np.nan,
    end_up: ArrayLike = 1,
    at_s: ArrayLike = np.nan,
    slow: Floats | None = None,
) -> TableRuns:
    """Put the means of one axis together; the fields are those of :class:`TableRuns`.

    Raises
    ------
    ValueError
        Shapes that do not fit, a rate of zero, or an uncertainty that is not positive.
    """
    nominal = np.atleast_1d(np.asarray(nominal_dps, dtype=np.float64))
    given = (nominal if rate_dps is None else rate_dps, mean, mean_u, duration_s, at_s)
    rate, means, u, duration, at = (np.broadcast_to(np.asarray(v, dtype=np.float64), nominal.shape) for v in given)
    ends = np.broadcast_to(np.asarray(end_up, dtype=np.int64), nominal.shape)
    if not np.all(np.abs(nominal) > 0):
        raise ValueError("a rate-table run needs rates other than zero")
    if not np.all(u > 0):
        raise ValueError("every mean needs a positive standard uncertainty: it is the weight of the run")
    return TableRuns(nominal, rate, means, u, duration, ends, at, slow)


def missing_senses(runs: TableRuns) -> list[float]:
    """Signed rates that lack their opposite, in the order of the runs.

    Examples
    --------
    >>> missing_senses(table_runs([20.0, -20.0, 21.0], [1.0, 1.0, 1.0], 1.0))
    [21.0]
    """
    alone = []
    for rate, end in zip(runs.nominal_dps, runs.end_up, strict=True):
        opposite = (np.abs(runs.nominal_dps + rate) < SAME_RATE) & (runs.end_up == end)
        if not opposite.any():
            alone.append(float(rate))
    return alone


def distinct_rates(rates: Floats) -> list[float]:
    """Rates that differ, in rising order."""
    found: list[float] = []
    for rate in np.sort(rates):
        if not found or rate - found[-1] > SAME_RATE:
            found.append(float(rate))
    return found


def design_of(runs: TableRuns) -> Floats:
    """Columns of scale factor and constants, (n, p): one constant, or with both ends up earth rate and bias."""
    columns = [runs.end_up * runs.rate_dps, runs.end_up, np.ones_like(runs.rate_dps)]
    both_ends = bool(np.any(runs.end_up > 0) and np.any(runs.end_up < 0))
    return np.column_stack(columns if both_ends else [columns[0], columns[2]])


def with_drift(design: Floats, at_s: Floats) -> Floats:
    """The design with a column for a drift of the bias, counts per hour, where the runs can bear one more."""
    known = bool(np.all(np.isfinite(at_s))) and float(np.ptp(at_s)) > 0
    if not known or at_s.size - design.shape[1] - 1 < _FREEDOM_FOR_DRIFT:
        return design
    return np.column_stack([design, (at_s - at_s.mean()) / _HOUR])
