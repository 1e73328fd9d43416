"""Error over bound, bias and wrong frequencies of every method on random records of the grid."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from analysis.arrays import Bools, Floats
from benchmarks.estimator.bound import Bound, cramer_rao_bound
from benchmarks.estimator.gyros import Gyros, codes_of, draw_gyros, white_noise
from benchmarks.estimator.methods import METHODS, Method
from benchmarks.estimator.progress import Progress

BATCH = 1000
SIGNIFICANT = 5.0
"""Records whose ratio is below so many of its own bounds do not count: their errors are not Gaussian."""

OUTLIER = 6.0
"""A frequency further than this many bounds from the truth is a wrong line, not noise."""

GAUSSIAN_MEDIAN = 0.6745
"""Median of |z| of a Gaussian of unit standard deviation."""

RATE_EDGES = (1.02, 1.1, 1.5, 3.0, 10.0, 30.0, 100.0)
PERIOD_EDGES = (2.5, 5.0, 20.0, 100.0, 595.0)


@dataclass(frozen=True)
class Errors:
    """Errors of one method on the first records of the grid.

    normalised, frequency : (R,) errors of lock-in rate and frequency over their bounds; nan where none was given
    relative : (R,) lock-in rate over truth, less one
    seconds : per record, on one core
    """

    method: str
    normalised: Floats
    frequency: Floats
    relative: Floats
    seconds: float


@dataclass(frozen=True)
class GridResult:
    """The gyros of the grid, which of them count for efficiency, and the errors of each method."""

    gyros: Gyros
    significant: Bools
    errors: tuple[Errors, ...]


@dataclass(frozen=True)
class Cell:
    """Statistics of some records: rms and mean error over bound, their standard errors, median |relative error|.

    robust is the median |error| over bound, scaled so that it equals rms for a Gaussian: it ignores wild values.
    given is the share of records to which the method gave a number.
    """

    records: int
    rms: float
    rms_u: float
    robust: float
    bias: float
    bias_u: float
    relative_median: float
    relative_rms: float
    given: float


def measure_grid(n_records: int, seed: int) -> GridResult:
    """Draw the grid and run every method on it, a slow one on the first few records only."""
    rng = np.random.default_rng(seed)
    gyros = draw_gyros(rng, n_records)
    bounds: list[Bound] = []
    tallies = [_Tally(method) for method in METHODS]
    with Progress("accuracy on the grid", n_records) as progress:
        for start in range(0, n_records, BATCH):
            part = gyros.take(slice(start, start + BATCH))
            bound = cramer_rao_bound(part)
            bounds.append(bound)
            codes = codes_of(part, white_noise(rng, part))
            for tally in tallies:
                if start < tally.method.at_most:
                    tally.read(codes, part, bound)
            progress.done(len(part))
    ratio_bound = np.concatenate([bound.ratio for bound in bounds])
    return GridResult(gyros, gyros.ratio > SIGNIFICANT * ratio_bound, tuple(t.errors() for t in tallies))


class _Tally:
    """Errors of one method as they come in."""

    def __init__(self, method: Method) -> None:
        self.method = method
        self._parts: list[tuple[Floats, Floats, Floats]] = []
        self._seconds = 0.0

    def read(self, codes: Floats, gyros: Gyros, bound: Bound) -> None:
        before = time.perf_counter()
        with np.errstate(all="ignore"):
            reading = self.method.read(codes, np.abs(gyros.input_rate))
        self._seconds += time.perf_counter() - before
        error = reading.lock_in_rate - gyros.lock_in_rate
        wrong = (reading.frequency - gyros.frequency) / bound.frequency
        self._parts.append((error / bound.lock_in_rate, wrong, error / gyros.lock_in_rate))

    def errors(self) -> Errors:
        normalised, frequency, relative = (np.concatenate(column) for column in zip(*self._parts, strict=True))
        return Errors(self.method.name, normalised, frequency, relative, self._seconds / len(normalised))


def cell_of(errors: Errors, chosen: Bools) -> Cell:
    """Statistics of the chosen records, as far as the method has read them."""
    picked = np.flatnonzero(chosen[: len(errors.normalised)])
    given = picked[np.isfinite(errors.normalised[picked])]
    z, relative = errors.normalised[given], errors.relative[given]
    if not given.size:
        nan = np.nan
        return Cell(0, nan, nan, nan, nan, nan, nan, nan, 0.0)
    square = z * z
    rms = float(np.sqrt(square.mean()))
    return Cell(
        records=int(picked.size),
        rms=rms,
        rms_u=float(square.std() / (2 * rms * np.sqrt(given.size))),
        robust=float(np.median(np.abs(z)) / GAUSSIAN_MEDIAN),
        bias=float(z.mean()),
        bias_u=float(z.std() / np.sqrt(given.size)),
        relative_median=float(np.median(np.abs(relative))),
        relative_rms=float(np.sqrt(np.mean(relative**2))),
        given=given.size / picked.size,
    )


def cells_of(result: GridResult, errors: Errors) -> list[list[Cell]]:
    """Cells by |W|/WL (rows) and periods (columns)."""
    ratio, periods = result.gyros.rate_over_lock_in, result.gyros.periods
    return [
        [
            cell_of(
                errors, result.significant & within(ratio, RATE_EDGES, row) & within(periods, PERIOD_EDGES, column)
            )
            for column in range(len(PERIOD_EDGES) - 1)
        ]
        for row in range(len(RATE_EDGES) - 1)
    ]


def within(values: Floats, edges: tuple[float, ...], number: int) -> Bools:
    """Which values lie between edge `number` and the next."""
    return np.asarray((values >= edges[number] * (1 - 1e-9)) & (values < edges[number + 1]))


def outliers(errors: Errors) -> tuple[int, int, int]:
    """Frequencies further than OUTLIER bounds from the truth, records without a number, records read."""
    finite = np.isfinite(errors.frequency)
    return int((np.abs(errors.frequency[finite]) > OUTLIER).sum()), int((~finite).sum()), finite.size
