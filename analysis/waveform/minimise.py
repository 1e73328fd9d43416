"""Maximum-likelihood fit of the tied series from given start values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.waveform.geometric_series import LARGEST_RATIO, RATIO_CLASSES, Series, ratio_classes
from analysis.waveform.normal_equations import Step
from analysis.waveform.sampled_equations import equations_by_samples
from analysis.waveform.tied_equations import equations_by_sums

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Indices = NDArray[np.intp]
Samples = NDArray[Any]
"""float32 or float64"""

NEWTON_ITERATIONS = 10
MARQUARDT_ITERATIONS = 40

CURVATURE = 0.06
"""A Gauss-Newton step is wrong by about the square of its length. It is the last one when that square is below
this share of the standard uncertainty."""

ROUNDING = {np.dtype(np.float32): 3e-6, np.dtype(np.float64): 1e-12}
"""Share of the power of a record to which its residual power is computed."""


def sums_of_squares(values: Samples) -> Floats:
    """Sum over the last axis; (R, N) -> (R,)."""
    return np.asarray(np.vecdot(values, values).astype(np.float64))


@dataclass(frozen=True)
class Task:
    """Records to fit.

    values : (R, N) centred, 0 where missing; weights : (R, N) or None, of the same precision
    power : (R,) sum of squares
    """

    values: Samples
    weights: Samples | None
    power: Floats

    @staticmethod
    def of(values: Samples, weights: Samples | None) -> Task:
        """A task with its power."""
        return Task(values, weights, sums_of_squares(values))

    @property
    def rounding(self) -> Floats:
        """Error of a residual power, (R,)."""
        return self.power * ROUNDING[self.values.dtype]

    def take(self, part: Indices) -> Task:
        """Some of the records; all of them without a copy."""
        if part.size == len(self.power):
            return self
        return Task(self.values[part], None if self.weights is None else self.weights[part], self.power[part])

    def equations(self, series: Series) -> Step:
        """Normal equations at the given parameters."""
        n_records = series.omega.size
        step = Step(np.empty((n_records, 6, 6)), np.empty((n_records, 6)), np.empty(n_records))
        for number, part in ratio_classes(series.ratio):
            some, here = self.take(part), series.take(part)
            if number == len(RATIO_CLASSES):
                # the samples are cheaper than so many harmonics
                step.put(part, equations_by_samples(some.values, some.weights, here))
            else:
                step.put(part, equations_by_sums(some.values, some.weights, some.power, here))
        return step


def gauss_newton(task: Task, start: Series) -> tuple[Series, Step, Bools]:
    """From a start that is close already: mostly one step.

    Returns
    -------
    Series, Step, converged (R,) of bool
        The step is that from which the last change came, with the residual power expected after it.
    """
    n_records, n_samples = task.values.shape
    series = start
    step = Step(np.zeros((n_records, 6, 6)), np.zeros((n_records, 6)), np.zeros(n_records))
    active = np.arange(n_records)
    for _ in range(NEWTON_ITERATIONS):
        here = series.take(active)
        now = task.take(active).equations(here)
        change = now.solve()
        moved = here.moved(change, n_samples)
        now = Step(now.normal, now.gradient, now.predicted_residual(change))
        if active.size == n_records:
            series, step = moved, now
        else:
            series.put(active, moved)
            step.put(active, now)
        active = active[_must_go_on(change, moved, now, n_samples)]
        if active.size == 0:
            break
    converged = np.abs(series.ratio) < LARGEST_RATIO
    converged[active] = False
    return series, step, converged


def _must_go_on(change: Floats, series: Series, step: Step, n_samples: int) -> Bools:
    size = np.maximum(np.abs(series.first), 1e-300)
    by_first = np.hypot(change[:, 1], change[:, 2]) / size
    by_ratio = np.hypot(change[:, 3], change[:, 4])
    # Near lock-in the waveform is a narrow spike, which bends the more.
    narrowness = 1 / np.maximum(1 - np.abs(series.ratio) ** 2, 1e-3)
    curvature = (change[:, 5] ** 2 + by_ratio * (by_ratio + by_first)) * narrowness**6
    noise = np.sqrt(step.residual_power * 2) / (n_samples * size)
    return np.asarray(curvature > CURVATURE * noise + 1e-22)


def levenberg_marquardt(task: Task, start: Series) -> tuple[Series, Step]:
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
        gain = np.abs(np.einsum("rp,rp->r", change, old.gradient))
        small = gain < (1e-3 if single else 1e-9) * old.residual_power / n_samples
        if not single:
            small |= gain < 1e-22
        active = active[~((small & better) | (damping[active] > 1e9))]
        if active.size == 0:
            break
    return series, best
