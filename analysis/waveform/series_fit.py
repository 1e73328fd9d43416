"""Maximum-likelihood fit of the lock-in waveform: at once where the start is plain, else by a search."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.arrays import Bools, Complexes, Floats, Indices, Samples, Stacked
from analysis.waveform.frequency import Spectra, SpectralStart, are_all, never_alone, sums, sums_of_squares
from analysis.waveform.series import (
    LARGEST_RATIO,
    Series,
    SeriesSums,
    Step,
    data_sums,
    empty_matrices,
    equations_by_samples,
    equations_of_sums,
    ratio_classes,
    uniform_kernels,
)

PLAIN_RATIO = 0.6  # up to this ratio of the two lines the spectrum's start is good enough for Gauss-Newton

UNEXPLAINED = 0.12
"""The strongest line is the fundamental if it and its ratio explain the power of the record to this share: one
of the harmonics of a gyro close to lock-in would explain less than half of it."""


def fit_series(values: Samples, weights: Samples | None) -> SeriesFit:
    """Fit the waveform to each record, of two at least."""
    n_records, n_samples = values.shape
    task = Task.of(values, weights)
    line = SpectralStart.of(values)
    size = np.abs(line.first)
    ratio = line.second / np.where(size > 0, line.first, 1.0)
    explained = size**2 / 2 * n_samples / (1 - np.minimum(np.abs(ratio), 0.9) ** 2)
    plain = (np.abs(ratio) < PLAIN_RATIO) & (np.abs(explained - task.power) < UNEXPLAINED * task.power)

    start = Series(np.zeros(n_records), line.first, np.where(plain, ratio, 0.0), line.omega)
    chosen = never_alone(np.flatnonzero(plain))
    if plain.all():
        fit, plain = gauss_newton(task, start)
    else:
        fit = SeriesFit.empty(start)
        fitted, plain[chosen] = gauss_newton(task.take(chosen), start.take(chosen))
        fit.put(chosen, fitted)
    hard = never_alone(np.flatnonzero(~plain))
    if hard.size:
        some = task.take(hard)
        fit.put(hard, levenberg_marquardt(some, start_of_series(some.values, some.weights)))
    return fit


def fit_series_again(values: Samples, weights: Samples | None, before: Series) -> SeriesFit:
    """Fit records of which a few samples have changed since `before` was found."""
    task = Task.of(values, weights)
    fit, converged = gauss_newton(task, before)
    far = never_alone(np.flatnonzero(~converged))
    if far.size:
        fit.put(far, levenberg_marquardt(task.take(far), before.take(far)))
    return fit


# --------------------
# Start values of the tied series where the strongest line of the spectrum may not be the fundamental


LINES = 6
BESIDE = (-0.5, -0.25, 0.25, 0.5)
"""Where two harmonics fold almost onto each other their common line stands between them: so many bins away from
the strongest lines the fundamental is looked for too."""

FEW_PERIODS = 8.0
SLOW_GRID = np.arange(1.75, FEW_PERIODS, 0.25)
"""Periods in a record that has so few of them that its lines are not apart."""

REFINEMENTS = (0.12, 0.06)  # the start is then improved to within about this many bins


def start_of_series(values: Samples, weights: Samples | None) -> Series:
    """Best of many candidate frequencies, each with the linear fit of `_equation_error_fit`."""
    n_samples = values.shape[1]
    one_bin = 2 * np.pi / n_samples
    search = _Search(values, weights)
    lines = Spectra.of(values).candidates(LINES)
    beside = lines[:, : LINES // 2, np.newaxis] + np.array(BESIDE) * one_bin
    search.try_at(np.concatenate([lines, beside.reshape(len(lines), -1)], axis=1))
    slow = never_alone(np.flatnonzero(lines[:, 0] < FEW_PERIODS * one_bin))
    if slow.size:
        search.try_at(np.broadcast_to(SLOW_GRID * one_bin, (slow.size, SLOW_GRID.size)), slow)
    for bins in REFINEMENTS:
        search.try_at(search.best.omega[:, np.newaxis] + np.array([-bins, bins]) * one_bin)
    return search.best


class _Search:
    """The best start found so far for each record, and what it leaves."""

    def __init__(self, values: Samples, weights: Samples | None) -> None:
        n_records = len(values)
        self.values, self.weights, self.squares = values, weights, values * values
        self.best = Series(*(np.zeros(n_records, kind) for kind in (float, complex, complex, float)))
        self.left = np.full(n_records, np.inf)

    def try_at(self, omega: Floats, part: slice | Indices = slice(None)) -> None:
        """Some more frequencies (R, C) for each record, or for some of them."""
        n_samples = self.values.shape[1]
        omega = np.clip(omega, np.pi / n_samples, np.pi)
        of_values, of_squares = (data_sums(v[part], omega, 2, 0)[:, :, 0] for v in (self.values, self.squares))
        if self.weights is None:
            ones = uniform_kernels(omega.ravel(), n_samples, 2)[:, 0].astype(np.complex128)
        else:
            ones = data_sums(self.weights[part], omega, 2, 0)[:, :, 0]
        sums = (part.reshape(-1, 3) for part in (ones, of_values, of_squares))
        tried, left = _equation_error_fit(omega.ravel(), *sums)
        rows = np.arange(len(omega))
        chosen = left.reshape(omega.shape).argmin(axis=1)
        best, left = tried.take(rows * omega.shape[1] + chosen), left.reshape(omega.shape)[rows, chosen]
        better = left < self.left[part]
        self.best.put(part, best.where(better, self.best.take(part)))
        self.left[part] = np.where(better, left, self.left[part])


def _equation_error_fit(
    omega: Floats, ones: Complexes, of_values: Complexes, of_squares: Complexes
) -> tuple[Series, Floats]:
    """Start values from a linear fit that needs no harmonics and no first guess of q, and what it leaves."""
    # Multiplied by |1 - q e|^2 the waveform becomes linear in its unknowns: v = a + Re(b e) + v Re(s e), with s =
    # 2q/(1 + |q|^2), whose size is WL/W itself. All inner products are sums of 1, v and v^2 times exp(-i k w m), k
    # = 0, 1, 2: the arguments, (R, 3) each.
    normal = np.empty((omega.size, 5, 5))
    normal[:, :3, :3] = _products(ones)
    normal[:, :3, 3:] = _products(of_values)[:, :, 1:]
    normal[:, 3:, :3] = normal[:, :3, 3:].swapaxes(-1, -2)
    normal[:, 3:, 3:] = _products(of_squares)[:, 1:, 1:]
    gradient = np.concatenate([_columns(of_values), _columns(of_squares)[:, 1:]], axis=-1)
    step = Step(normal, gradient, of_squares[:, 0].real)
    solution = step.solve()
    s = solution[:, 3] + 1j * solution[:, 4]
    size = np.abs(s)
    limited = np.minimum(size, 0.9999)
    s = s * (limited / np.maximum(size, 1e-300))
    q = s / (1 + np.sqrt(1 - limited**2))
    # The linear fit's a and b are c0 - Re(H conj q)/(1+|q|^2) and H/(1+|q|^2) - c0 s: solved for c0 and H.
    square = np.abs(q) ** 2
    b = solution[:, 1] + 1j * solution[:, 2]
    offset = (solution[:, 0] + (b * np.conj(q)).real) * (1 + square) / (1 - square)
    first = (b + offset * s) * (1 + square)
    return Series(offset, first, q, omega), step.predicted_residual(solution) / (1 + limited**2 / 2)


def _products(sums: Complexes) -> Floats:
    """Inner products of 1, Re e, -Im e under a weight, from its sums times exp(-i k w m), k = 0, 1, 2."""
    zero, one, two = sums[:, 0].real, np.conj(sums[:, 1]), np.conj(sums[:, 2])
    products = np.empty((len(sums), 3, 3))
    products[:, 0, 0] = zero
    products[:, 0, 1] = products[:, 1, 0] = one.real
    products[:, 0, 2] = products[:, 2, 0] = -one.imag
    products[:, 1, 1], products[:, 2, 2] = (zero + two.real) / 2, (zero - two.real) / 2
    products[:, 1, 2] = products[:, 2, 1] = -two.imag / 2
    return products


def _columns(sums: Complexes) -> Floats:
    one = np.conj(sums[:, 1])
    return np.stack([sums[:, 0].real, one.real, -one.imag], axis=-1)


# --------------------
# Maximum-likelihood fit of the tied series from given start values


NEWTON_ITERATIONS = 10
MARQUARDT_ITERATIONS = 40
HOPEFUL, HOPELESS = 15, 0.5  # of them, after which what leaves so much of the power is no beat at a steady rate

CURVATURE = 0.06
"""A Gauss-Newton step is wrong by about a fifth of the square of its length. It is the last one when that square
is below this share of the standard uncertainty."""

ROUNDING = {np.dtype(np.float32): 3e-6, np.dtype(np.float64): 1e-12}
"""Share of the power of a record to which its residual power is computed."""


@dataclass(frozen=True)
class Task:
    """Records to fit."""

    values: Samples  # (R, N) centred, 0 where missing; weights : (R, N) or None, of the same precision
    weights: Samples | None
    power: Floats  # (R,) sums of squares, and of the samples
    total: Floats

    @staticmethod
    def of(values: Samples, weights: Samples | None) -> Task:
        """A task with its sums."""
        return Task(values, weights, sums_of_squares(values), sums(values))

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
class SeriesFit(Stacked):
    """Fitted series, with the covariance (R, 6, 6) for unit noise and the residual power (R,) that go with it."""

    # The order is c0, Re H, Im H, Re q, Im q, w (rad at the record's ends).

    series: Series
    covariance: Floats
    residual_power: Floats

    @staticmethod
    def empty(series: Series) -> SeriesFit:
        """Room for the fit that starts at `series`."""
        n_records = series.omega.size
        return SeriesFit(series, empty_matrices(n_records, 6), np.zeros(n_records))


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
        series = now.series
        size = np.maximum(np.abs(series.first), 1e-300)
        by_first = np.hypot(change[:, 1], change[:, 2]) / size
        by_ratio = np.hypot(change[:, 3], change[:, 4])
        # Near lock-in the waveform is a narrow spike, which bends the more.
        narrowness = 1 / np.maximum(1 - np.abs(series.ratio) ** 2, 1e-3)
        curvature = (change[:, 5] ** 2 + by_ratio * (by_ratio + by_first)) * narrowness**6
        noise = np.sqrt(now.residual_power * 2) / (n_samples * size)
        active = never_alone(np.unique(active[np.asarray(curvature > CURVATURE * noise + 1e-22)]))
        if active.size == 0:
            break
    converged = np.abs(fit.series.ratio) < LARGEST_RATIO
    converged[active] = False
    return fit, converged


def levenberg_marquardt(task: Task, start: Series) -> SeriesFit:
    """From a start that may be far: each record keeps its own damping and stops by itself."""
    n_samples = task.values.shape[1]
    series = start.take(np.arange(start.omega.size))
    best = task.equations(series)
    damping = np.zeros(series.omega.size)
    active = np.arange(damping.size)
    single = task.values.dtype == np.float32
    for iteration in range(MARQUARDT_ITERATIONS):
        here, old, some = series.take(active), best.take(active), task.take(active)
        change = old.solve(damping[active])
        trial_series = here.moved(change, n_samples)
        trial = some.equations(trial_series)
        # At the optimum the residual repeats to rounding; that must count as a step forward.
        better = trial.residual_power <= old.residual_power + some.power * ROUNDING[some.values.dtype]
        series.put(active, trial_series.where(better, here))
        best.put(active, trial.where(better, old))
        tried = damping[active]
        damping[active] = np.where(better, np.where(tried < 1e-4, 0.0, tried / 10), np.maximum(tried * 10, 1e-3))
        gain = np.abs(np.vecdot(change, old.gradient))
        small = gain < (1e-3 if single else 1e-9) * old.residual_power / n_samples
        if not single:
            small |= gain < 1e-22
        ended = (small & better) | (damping[active] > 1e9)
        ended |= (iteration >= HOPEFUL) & (best.residual_power[active] > HOPELESS * some.power)
        active = never_alone(np.unique(active[~ended]))
        if active.size == 0:
            break
    return SeriesFit(series, best.covariance(), best.residual_power)
