"""Weighted least squares of equation (1) of `ratio_model`, with what is known beforehand as further data."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.arrays import Bools, Complexes, Floats, Indices
from analysis.several_rates.ratio_model import N_PARAMETERS, Prior, RatioData, predicted

ITERATIONS = 80
SETTLED = 1e-10
"""A step that changes chi-square by less, relatively, was the last one."""

SINGULAR = 1e-11
"""A normal matrix (unit diagonal) with a smaller eigenvalue means unknowns that the data cannot tell apart."""

_RATIOS = np.geomspace(0.004, 0.93, 22)
_PHASES = np.arange(24) * (2 * np.pi / 24)
_GAIN_TIMES = np.array([-1.0, 0.0, 1.0, 3.0])
"""Sizes of r at the slowest rate, phases, and gain times (over the time of the fastest beat) from which the best
starts are taken."""

_BESIDE = np.array([0.92, 0.97, 1.03, 1.08])
"""Lock-in rates over those found first, from which a second minimum close by is looked for."""

_FIRST_ITERATIONS, _FINISHED = 15, 5
"""All starts go a little way, the best of them to the end."""

_PROFILE_ITERATIONS = 25

_NO_WAY_DOWN = 1e5
"""Damping with which a step that still does not go down ends the search."""

_CLOSE = 1e-3
_LARGEST = 0.999
"""The slowest rate with a beat is faster than the lock-in rate by at least this share."""


@dataclass(frozen=True)
class RatioFit:
    """parameters (B, P) and covariance (B, P, P), zero where held; chi_square (B,), what is known beforehand
    included; singular (B,).
    """

    parameters: Floats
    covariance: Floats
    chi_square: Floats
    singular: Bools

    @property
    def fields(self) -> tuple[Floats, Floats, Floats, Bools]:
        """All four, in order."""
        return self.parameters, self.covariance, self.chi_square, self.singular

    def __getitem__(self, key: slice | Indices) -> RatioFit:
        """Some of the sets."""
        return RatioFit(self.parameters[key], self.covariance[key], self.chi_square[key], self.singular[key])


def fit_ratios(data: RatioData, prior: Prior, start: Floats) -> RatioFit:
    """Weighted least squares for every set, from a start for each."""
    return _minimised(data, prior, np.array(start, dtype=np.float64), ITERATIONS)


def profile(data: RatioData, prior: Prior, start: Floats, sizes: Floats) -> Floats:
    """Least chi-square for every lock-in rate of `sizes` (S,), deg/s, the other parameters free."""
    points = np.tile(start, (sizes.size, 1))
    points[:, :2] *= (sizes / np.hypot(*start[:2]))[:, np.newaxis]
    both = np.concatenate([points, with_distortion_alone(points, data, prior)])
    lowest = _minimised(data, prior, both, _PROFILE_ITERATIONS, np.tile(sizes, 2)).chi_square
    return np.asarray(lowest.reshape(2, -1).min(axis=0))


def _minimised(
    data: RatioData, prior: Prior, point: Floats, iterations: int, held: Floats | None = None
) -> RatioFit:
    """Damped Gauss-Newton; `held` (B,): lock-in rates that stay, deg/s."""
    here = _linearised(point, data, prior, held)
    damping = np.full(len(point), 1e-4)
    for _ in range(iterations):
        ridge = damping[:, np.newaxis, np.newaxis] * np.eye(len(here.ways))
        step = here.unit * np.linalg.solve(here.normal + ridge, here.gradient[..., np.newaxis])[..., 0]
        moved = here.point + np.einsum("bw,wbp->bp", step, here.ways)
        trial = _linearised(_bounded(moved, data) if held is None else _of_size(moved, held), data, prior, held)
        better = trial.cost <= here.cost
        settled = np.abs(here.cost - trial.cost) <= SETTLED * (1 + here.cost)
        settled |= ~better & (damping >= _NO_WAY_DOWN)
        here = here.where(better, trial)
        damping = np.where(better, np.maximum(damping * 0.2, 1e-13), np.minimum(damping * 8, 1e6))
        if np.all(settled):
            break
    return _finished(here)


@dataclass(frozen=True)
class _Linearised:
    """Chi-square about points (B, N_PARAMETERS): its value and slope, see `_linearised`."""

    point: Floats
    ways: Floats
    cost: Floats
    normal: Floats
    gradient: Floats
    unit: Floats

    def where(self, chosen: Bools, other: _Linearised) -> _Linearised:
        """The same with some of the sets (B,) from another."""
        rows, matrices = chosen[:, np.newaxis], chosen[:, np.newaxis, np.newaxis]
        return _Linearised(
            np.where(rows, other.point, self.point),
            np.where(rows, other.ways, self.ways),
            np.where(chosen, other.cost, self.cost),
            np.where(matrices, other.normal, self.normal),
            np.where(rows, other.gradient, self.gradient),
            np.where(rows, other.unit, self.unit),
        )


def all_solutions(data: RatioData, prior: Prior) -> RatioFit:
    """Every minimum that is found from many starts, for one set of data; the best first.

    Lock-in rate and phase are tried on a grid, and the gain time where it is free, with the best distortion for
    each; the lowest points of that map are the starts.
    """
    tried = _minimised(data, prior, _starts(data, prior), _FIRST_ITERATIONS)
    tried = _apart(tried, np.zeros(len(tried.chi_square)))[:_FINISHED]
    near = _minimised(data, prior, _around(tried.parameters, data, prior), _FIRST_ITERATIONS)
    tried = RatioFit(*(np.concatenate(pair) for pair in zip(tried.fields, near.fields, strict=True)))
    tried = _apart(tried, np.zeros(len(tried.chi_square)))[:_FINISHED]
    found = fit_ratios(data, prior, tried.parameters)
    return _apart(found, 0.5 * np.sqrt(np.trace(found.covariance[:, :2, :2], axis1=-2, axis2=-1)))


def _apart(found: RatioFit, u: Floats) -> RatioFit:
    """Those that are not one minimum found twice, within `u` (B,) of their lock-in rates; the best first."""
    z = found.parameters[:, 0] + 1j * found.parameters[:, 1]
    kept: list[int] = []
    for row in np.argsort(found.chi_square):
        if not np.any(np.abs(z[kept] - z[row]) < _CLOSE * np.abs(z[row]) + u[row]):
            kept.append(int(row))
    return found[np.array(kept)]


def whitened(parameters: Floats, data: RatioData) -> tuple[Floats, Floats]:
    """What the model leaves in standard uncertainties: of the ratios (B, n, 2), of the third harmonics (B, n)."""
    ratio, third = predicted(parameters, data)
    return in_standard_uncertainties(data.ratio - ratio, data.third - third, data)


def in_standard_uncertainties(ratio: Complexes, third: Floats, data: RatioData) -> tuple[Floats, Floats]:
    """Differences of ratios and of third harmonics (B, n) in their standard uncertainties, as :func:`whitened`."""
    parts = np.stack([ratio.real, ratio.imag], axis=-1)
    return np.einsum("...ji,...j->...i", data.whitening, parts), third * data.third_weight


def _finished(found: _Linearised) -> RatioFit:
    eigenvalues, vectors = np.linalg.eigh(found.normal)
    inverse = np.einsum("bij,bj,bkj->bik", vectors, 1 / np.maximum(eigenvalues, 1e-15), vectors)
    inverse = inverse * found.unit[:, :, np.newaxis] * found.unit[:, np.newaxis, :]
    covariance = np.einsum("vbp,bvw,wbq->bpq", found.ways, inverse, found.ways)
    return RatioFit(found.point, covariance, found.cost, eigenvalues[:, 0] < SINGULAR)


def _residual(parameters: Floats, data: RatioData, prior: Prior) -> Floats:
    """Whitened residuals of ratios, third harmonics and of what is known beforehand, (B, 3n + known)."""
    ratios, thirds = whitened(parameters, data)
    known = np.isfinite(prior.sd) & (prior.sd > 0)
    before = (prior.mean[known] - parameters[..., known]) / prior.sd[known]
    return np.concatenate([ratios.reshape(*ratios.shape[:-2], -1), thirds, before], axis=-1)


def _cost(parameters: Floats, data: RatioData, prior: Prior) -> Floats:
    return np.asarray(np.sum(_residual(parameters, data, prior) ** 2, axis=-1))


def _bounded(point: Floats, data: RatioData) -> Floats:
    """The same with the lock-in rate below the slowest rate that shows a beat."""
    there = np.abs(data.whitening).sum(axis=(-1, -2)) > 0
    # a beat f belongs to the rate W with (f/K)^2 = W^2 - WL^2
    by_beat = data.reference == "beat"
    rate = data.beat_rate / np.sqrt(1 - _LARGEST**2) if by_beat else np.abs(data.rate)
    slowest = np.where(there, rate, np.inf).min(axis=-1)
    size = np.hypot(point[:, 0], point[:, 1])
    return _of_size(point, np.minimum(size, _LARGEST * slowest))


def _of_size(point: Floats, size: Floats) -> Floats:
    """The same with lock-in rates (B,) of a given size, deg/s."""
    bounded = point.copy()
    bounded[:, :2] *= (size / np.maximum(np.hypot(point[:, 0], point[:, 1]), 1e-300))[:, np.newaxis]
    return bounded


def _ways(point: Floats, data: RatioData, chosen: Indices, held: Floats | None) -> Floats:
    """Directions in which every set may go, (ways, B, N_PARAMETERS), each of the length of its scale."""
    scale = _scales(data)
    ways = np.repeat(np.diag(scale)[chosen, np.newaxis], len(point), axis=1)
    if held is None:
        return ways
    across = np.stack([-point[:, 1], point[:, 0]], axis=-1) / held[:, np.newaxis]
    ways[0, :, :2] = scale[0] * across
    return np.delete(ways, 1, axis=0)


def _linearised(point: Floats, data: RatioData, prior: Prior, held: Floats | None) -> _Linearised:
    """Normal matrix scaled to a unit diagonal, gradient in the same units, and the units (B, ways)."""
    ways = _ways(point, data, np.flatnonzero(prior.sd > 0), held)
    shift = 1e-5 * ways
    both = _residual(np.concatenate([point - shift, point + shift, point[np.newaxis]]), data, prior)
    jacobian = np.moveaxis(both[: len(ways)] - both[len(ways) : -1], 0, -1) / 2e-5
    size = np.linalg.norm(jacobian, axis=1)
    size = np.where(size > 0, size, 1.0)
    jacobian = jacobian / size[:, np.newaxis, :]
    normal = jacobian.swapaxes(-1, -2) @ jacobian
    gradient = np.einsum("bnp,bn->bp", jacobian, both[-1])
    return _Linearised(point, ways, np.sum(both[-1] ** 2, axis=-1), normal, gradient, 1 / size)


def _scales(data: RatioData) -> Floats:
    """Change of each parameter that changes rho of the slowest point by about one, (N_PARAMETERS,)."""
    slowest, fastest = float(np.min(data.beat_rate)), float(np.max(data.angular))
    return np.array([slowest, slowest, 1.0, 1 / fastest, 1 / fastest**2, 1.0])


def _starts(data: RatioData, prior: Prior) -> Floats:
    """The lowest points of a map of chi-square over lock-in rate and phase, (S, N_PARAMETERS)."""
    slowest = float(np.min(np.abs(data.rate) if data.reference == "rate" else data.beat_rate))
    square = _RATIOS**2
    sizes = slowest * 2 * _RATIOS / (1 + square if data.reference == "rate" else 1 - square)
    times = _GAIN_TIMES / np.max(data.angular) if prior.sd[3] > 0 else np.array([prior.mean[3]])
    size, phase, time = np.meshgrid(sizes, _PHASES, times, indexing="ij")
    grid = np.tile(np.where(prior.sd > 0, prior.mean, 0.0), (*size.shape, 1))
    grid[..., 0], grid[..., 1], grid[..., 3] = size * np.cos(phase), size * np.sin(phase), time
    flat = grid.reshape(-1, N_PARAMETERS)
    if prior.sd[2] > 0:
        flat[:, 2] = _best_distortion(flat, data, prior)
    cost = _cost(flat, data, prior).reshape(size.shape)
    best = cost.argmin(axis=-1)
    lowest = np.take_along_axis(cost, best[..., np.newaxis], axis=-1)[..., 0]
    # a valley may be narrower than the steps of the map: the best phase of every size is a start too
    chosen = lowest == lowest.min(axis=1, keepdims=True)
    edged = np.pad(lowest, ((1, 1), (0, 0)), constant_values=np.inf)
    around = [np.roll(edged, (i, j), axis=(0, 1))[1:-1] for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j]
    chosen |= lowest <= np.min(around, axis=0)
    sizes_chosen, phases_chosen = np.nonzero(chosen)
    starts = flat.reshape(*size.shape, -1)[sizes_chosen, phases_chosen, best[chosen]]
    return np.asarray(starts)


def _around(found: Floats, data: RatioData, prior: Prior) -> Floats:
    """Starts beside what was found (B, N_PARAMETERS): another lock-in rate, and nothing but distortion."""
    starts = np.repeat(found, _BESIDE.size, axis=0)
    starts[:, :2] *= np.tile(_BESIDE, len(found))[:, np.newaxis]
    return _bounded(with_distortion_alone(starts, data, prior), data)


def with_distortion_alone(points: Floats, data: RatioData, prior: Prior) -> Floats:
    """The same lock-in rates and phases (B, N_PARAMETERS), with the best distortion for each and nothing else."""
    alone = points.copy()
    alone[:, 2:] = np.where(prior.sd > 0, prior.mean, points)[:, 2:]
    if prior.sd[2] > 0:
        alone[:, 2] = _best_distortion(alone, data, prior)
    return alone


def _best_distortion(points: Floats, data: RatioData, prior: Prior) -> Floats:
    """D for every point of a grid, the other parameters given: the model is linear in it."""
    with_one = points.copy()
    with_one[:, 2] = 1.0
    at_zero = _residual(points, data, prior)
    column = at_zero - _residual(with_one, data, prior)
    return np.asarray(np.vecdot(column, at_zero) / np.maximum(np.vecdot(column, column), 1e-300))
