"""Maximum-likelihood fit of the tied series from given start values."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.arrays import Bools, Floats, Indices, Samples
from analysis.waveform.records import are_all, never_alone, sums, sums_of_squares
from analysis.waveform.series.geometric_series import LARGEST_RATIO, Series, ratio_classes
from analysis.waveform.series.normal_equations import Step, empty_matrices
from analysis.waveform.series.sampled_equations import equations_by_samples
from analysis.waveform.series.tied_equations import SeriesSums, equations_of_sums

NEWTON_ITERATIONS = 10
MARQUARDT_ITERATIONS = 40

CURVATURE = 0.06
"""A Gauss-Newton step is wrong by about a fifth of the square of its length. It is the last one when that square
is below this share of the standard uncertainty."""

ROUNDING = {np.dtype(np.float32): 3e-6, np.dtype(np.float64): 1e-12}
"""Share of the power of a record to which its residual power is computed."""


@dataclass(frozen=True)
class Task:
    """Records to fit.

    values : (R, N) centred, 0 where missing; weights : (R, N) or None, of the same precision
    power, total : (R,) sums of squares, and of the samples
    """

    values: Samples
    weights: Samples | None
    power: Floats
    total: Floats

    @staticmethod
    def of(values: Samples, weights: Samples | None) -> Task:
        """A task with its sums."""
        return Task(values, weights, sums_of_squares(values), sums(values))

    @property
    def rounding(self) -> Floats:
        """Error of a residual power, (R,)."""
        return self.power * ROUNDING[self.values.dtype]

    def take(self, part: Indices) -> Task:
        """Some of the records; all of them without a copy."""
        if are_all(part, len(self.power)):
            return self
        weights = None if self.weights is None else self.weights[part]
        return Task(self.values[part], weights, self.power[part], self.total[part])

    def equations(self, series: Series) -> Step:
        """Normal equations at the given parameters."""
        classes = dict(ratio_classes(series.ratio))
        narrow = classes.pop(LARGEST_RATIO, None)
        sums = SeriesSums.zeros(series.omega.size)
        for largest, part in classes.items():
            some = self.take(part)
            sums.put(part, SeriesSums.of(some.values, some.weights, series.take(part), largest))
        step = equations_of_sums(series, sums, self.power, self.total)
        if narrow is not None:
            # the samples are cheaper than so many harmonics
            some = self.take(narrow)
            step.put(narrow, equations_by_samples(some.values, some.weights, series.take(narrow)))
        return step


@dataclass(frozen=True)
class SeriesFit:
    """Fitted series, with the covariance (R, 6, 6) for unit noise and the residual power (R,) that go with it.

    The order is c0, Re H, Im H, Re q, Im q, w (rad at the record's ends).
    """

    series: Series
    covariance: Floats
    residual_power: Floats

    @staticmethod
    def empty(series: Series) -> SeriesFit:
        """Room for the fit that starts at `series`."""
        n_records = series.omega.size
        return SeriesFit(series, empty_matrices(n_records, 6), np.zeros(n_records))

    def put(self, part: Indices | Bools, other: SeriesFit) -> None:
        """Write the other's records into the places `part` of this one."""
        self.series.put(part, other.series)
        self.covariance[part], self.residual_power[part] = other.covariance, other.residual_power


def gauss_newton(task: Task, start: Series) -> tuple[SeriesFit, Bools]:
    """From a start that is close already: mostly one step."""
    n_records, n_samples = task.values.shape
    fit = SeriesFit.empty(start.take(np.arange(n_records)))
    active = np.arange(n_records)
    for _ in range(NEWTON_ITERATIONS):
        step = task.take(active).equations(fit.series.take(active))
        change, covariance = step.solve_and_invert()
        moved = fit.series.take(active).moved(change, n_samples)
        now = SeriesFit(moved, covariance, step.predicted_residual(change))
        if are_all(active, n_records):
            fit = now
        else:
            fit.put(active, now)
        active = never_alone(np.unique(active[_must_go_on(change, now, n_samples)]))
        if active.size == 0:
            break
    converged = np.abs(fit.series.ratio) < LARGEST_RATIO
    converged[active] = False
    return fit, converged


def _must_go_on(change: Floats, fit: SeriesFit, n_samples: int) -> Bools:
    series = fit.series
    size = np.maximum(np.abs(series.first), 1e-300)
    by_first = np.hypot(change[:, 1], change[:, 2]) / size
    by_ratio = np.hypot(change[:, 3], change[:, 4])
    # Near lock-in the waveform is a narrow spike, which bends the more.
    narrowness = 1 / np.maximum(1 - np.abs(series.ratio) ** 2, 1e-3)
    curvature = (change[:, 5] ** 2 + by_ratio * (by_ratio + by_first)) * narrowness**6
    noise = np.sqrt(fit.residual_power * 2) / (n_samples * size)
    return np.asarray(curvature > CURVATURE * noise + 1e-22)


def levenberg_marquardt(task: Task, start: Series) -> SeriesFit:
    """From a start that may be far: each record keeps its own damping and stops by itself."""
    n_samples = task.values.shape[1]
    series = start.take(np.arange(start.omega.size))
    best = task.equations(series)
    damping = np.zeros(series.omega.size)
    active = np.arange(damping.size)
    single = task.values.dtype == np.float32
    for _ in range(MARQUARDT_ITERATIONS):
        here, old, some = series.take(active), best.take(active), task.take(active)
        change = old.solve(damping[active])
        trial_series = here.moved(change, n_samples)
        trial = some.equations(trial_series)
        # At the optimum the residual repeats to rounding; that must count as a step forward.
        better = trial.residual_power <= old.residual_power + some.rounding
        series.put(active, trial_series.where(better, here))
        best.put(active, trial.where(better, old))
        tried = damping[active]
        damping[active] = np.where(better, np.where(tried < 1e-4, 0.0, tried / 10), np.maximum(tried * 10, 1e-3))
        gain = np.abs(np.vecdot(change, old.gradient))
        small = gain < (1e-3 if single else 1e-9) * old.residual_power / n_samples
        if not single:
            small |= gain < 1e-22
        active = never_alone(np.unique(active[~((small & better) | (damping[active] > 1e9))]))
        if active.size == 0:
            break
    return SeriesFit(series, best.covariance(), best.residual_power)
