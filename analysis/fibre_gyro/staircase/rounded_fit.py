"""A straight fit to a few numbers that a converter rounded.

Rounding is no noise where the true noise is less than about a third of a level: the same value is then rounded the
same way every time, and values that lie evenly are rounded in a pattern that can imitate a slope. What it does to
each result is computed for data of the kind at hand, instead of being taken as white.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.arrays import Floats
from analysis.waveform.quantisation import mean_rounding

_DRAWS = 200
_SEED = 20150513
_SAME = 1e-6  # of the span: two values closer than this are the same
_ON_LEVEL = 0.02  # of the spacing
_EUCLID = 8
_BEYOND = 0.01  # squared levels of scatter over more than two of them: 0.3 of noise
_MOST_LEVELS = 600  # twice as many as an eight-bit converter has: what stands on more was not rounded by one


@dataclass(frozen=True, eq=False)
class RoundedFit:
    """Result of `fit_rounded`."""

    values: dict[str, float]  # parameters by name
    model: Floats  # (K,)
    scatter: float  # variance of the data about the model, over the variance that was expected
    _columns: Floats
    _estimator: Floats
    _covariance: Floats
    _places: Floats  # of the model, in levels from a level
    _spacing: float
    _dither: float

    def u_of(self, **factors: float) -> float:
        """Standard uncertainty of a sum of parameters, each times its factor."""
        weights = np.array([factors.get(name, 0.0) for name in self.values])
        noise = float(weights @ self._covariance @ weights) * max(1.0, self.scatter)
        return float(np.hypot(np.sqrt(noise), self._rounding_u(weights @ self._estimator)))

    def _rounding_u(self, weights: Floats) -> float:
        """Rms effect of rounding on a sum of data, over data that could have been rounded to these."""
        if self._spacing == 0:
            return 0.0
        # By how far each parameter is wrong at most, if every number was rounded the worst way.
        reach = 0.5 * np.abs(self._estimator).sum(axis=-1)
        shifts = np.random.default_rng(_SEED).uniform(-1, 1, (_DRAWS, len(reach))) * reach
        places = self._places + shifts @ self._columns.T
        rms = np.full(_DRAWS, np.sqrt(self._dither**2 + 1 / 12))
        rounding = mean_rounding(places, np.zeros((_DRAWS, 1)), np.ones(_DRAWS), rms)
        return float(np.sqrt(np.mean((rounding @ weights) ** 2))) * self._spacing


def converter_spacing(values: Floats) -> float:
    """Spacing of the levels on which all values stand, 0 if they stand on none; nan is left out."""
    levels = np.unique(values[np.isfinite(values)])
    span = float(levels[-1] - levels[0])
    gaps = np.diff(levels)
    gaps = gaps[gaps > _SAME * span]
    if gaps.size < 2:
        return 0.0
    spacing = float(gaps.min())
    for _ in range(_EUCLID):
        places = (levels - levels[0]) / spacing
        rest = float(np.abs(places - np.rint(places)).max())
        if rest < _ON_LEVEL:
            steps = round(span / spacing)
            return span / steps if steps < _MOST_LEVELS else 0.0
        # No two levels were neighbours yet: as in Euclid's algorithm, the spacing divides what is left over.
        spacing *= rest
    return 0.0


def rounding_left(dither: float) -> float:
    """Part of a level that rounding is still wrong by, rms, with so much Gaussian noise; both in levels."""
    return float(np.exp(-2 * (np.pi * dither) ** 2) / np.sqrt(12))


def dither_of(noise: float, means: Floats, counts: Floats) -> float:
    """Noise before a converter, 0 where it is so small that only two neighbouring levels ever alternate."""
    part = means - np.floor(means)
    # Two levels scatter by p (1 - p), however small the noise is that flips between them near their threshold; a
    # mean of n samples takes its share of that.
    alternating = part * (1 - part) * counts / np.maximum(counts - 1, 1)
    beyond = noise**2 - float(np.average(alternating, weights=counts))
    return float(np.sqrt(beyond + 1 / 12)) if beyond > _BEYOND else 0.0


def fit_rounded(
    columns: dict[str, Floats], data: Floats, variance: Floats, *, spacing: float, origin: float, dither: float
) -> RoundedFit:
    """Weighted linear least squares."""
    matrix = np.stack(list(columns.values()), axis=-1)
    root = 1 / np.sqrt(variance)
    weighted = matrix * root[:, np.newaxis]
    scale = np.sqrt(np.sum(weighted**2, axis=0))
    if len(data) <= matrix.shape[1] or np.linalg.matrix_rank(weighted / scale) < matrix.shape[1]:
        raise ValueError("too few levels for a fit: use a slower time base")
    inverse = np.linalg.pinv(weighted)
    estimator = inverse * root
    parameters = estimator @ data
    model = matrix @ parameters
    degrees = len(data) - matrix.shape[1]
    return RoundedFit(
        values=dict(zip(columns, map(float, parameters), strict=True)),
        model=model,
        scatter=float(np.sum(((data - model) * root) ** 2) / degrees),
        _columns=matrix,
        _estimator=estimator,
        _covariance=inverse @ inverse.T,
        _places=(model - origin) / (spacing or 1.0),
        _spacing=spacing,
        _dither=dither,
    )
