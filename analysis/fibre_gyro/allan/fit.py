"""The noise model by maximum likelihood: no slope of a curve is read.

The words are seen in two ways that share next to no information. Slow noise: the increments of the means of some
hundred blocks have a normal distribution whose covariance the model gives exactly, with blocks missing where
words are. Fast noise: the spectrum of the increments of words above the frequency of the blocks is exponentially
distributed about the model's (Whittle); a taper of a few per cent at the ends keeps the slow noise out of it.
The sum of both log-likelihoods is maximised over the squares of the coefficients by Fisher's scoring, which
gives their covariance too.

A term stands in the model if it improves the likelihood by more than the Bayesian information criterion asks
for; of those that do not, the interval says how large they may be. A ramp and a drift with the temperature are
no noise: they are fitted to the increments of the blocks, with their covariance.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike

from analysis.arrays import Floats
from analysis.fibre_gyro.allan.terms import RANDOM, block_covariance, increment_spectrum
from analysis.fibre_gyro.rate_table.outliers import outliers
from analysis.fibre_gyro.rate_table.scatter import NORMAL_95

_MOST_BLOCKS = 256
_FEWEST_WORDS = 512
_BINS = 1500
_TAPER = 0.02  # of a stretch, at each end
_ROUNDS = 40


@dataclass(frozen=True)
class NoiseFit:
    """Coefficients of the noise model, in deg and s.

    Attributes
    ----------
    coefficients, coefficients_u : dict of str to float
        Of the terms in the model; `TERMS` has their units.
    low_95, high_95 : dict of str to float
        Of every term; of one that is not in the model up to where it may be hidden, from 0.
    chosen : tuple of str
        Terms in the model.
    temperature_slope, temperature_slope_u : float
        deg/s per unit of the temperature; nan where it was not asked for.
    words, missing, outliers : int
    """

    coefficients: dict[str, float]
    coefficients_u: dict[str, float]
    low_95: dict[str, float]
    high_95: dict[str, float]
    chosen: tuple[str, ...]
    temperature_slope: float
    temperature_slope_u: float
    words: int
    missing: int
    outliers: int


def fit_noise(words: ArrayLike, interval_s: float, *, temperature: ArrayLike | None = None) -> NoiseFit:
    """Fit the noise model to words at rest.

    Parameters
    ----------
    words : (n,)
        Means of the rate over each interval, deg/s; nan where one is missing. Outliers are left out.
    temperature : (n,), optional
        Its drift is taken out; nan as above.

    Raises
    ------
    ValueError
        Fewer than 512 words, a fifth of them missing, or words that do not move.
    """
    values = np.array(words, dtype=np.float64)
    if values.size < _FEWEST_WORDS:
        raise ValueError(f"a noise model needs at least {_FEWEST_WORDS} output words, not {values.size}")
    missing = int(np.isnan(values).sum())
    far = outliers(values)
    values[far] = np.nan
    if np.isnan(values).mean() > 0.2:
        raise ValueError(f"{int(np.isnan(values).sum())} of {values.size} output words are missing")
    spread = float(np.nanstd(values))
    if not spread > 0:
        raise ValueError("the output does not move: its noise is below its smallest step")
    values = (values - np.nanmean(values)) / spread
    heat = None if temperature is None else np.asarray(temperature, dtype=np.float64)
    slope, slope_u = float("nan"), float("nan")
    if heat is not None:
        slope, slope_u = _Likelihood(values, interval_s, heat).temperature_slope()
        values = values - slope * (heat - np.nanmean(heat))
    seen = _Likelihood(values, interval_s, None)
    chosen, ramp = seen.choose()
    found = seen.coefficients(chosen, ramp)
    value, u, low, high = ({name: spread * one for name, one in part.items()} for part in found)
    terms = (*chosen, *(["rate_ramp"] if ramp else []))
    return NoiseFit(
        value, u, low, high, terms, spread * slope, spread * slope_u, values.size, missing, int(far.sum())
    )


class _Likelihood:
    """Likelihood under squares of coefficients: by blocks where the words are slow, by spectrum where fast."""

    def __init__(self, values: Floats, interval_s: float, heat: Floats | None) -> None:
        self._known: dict[tuple[tuple[str, ...], tuple[str, ...]], tuple[dict[str, float], float]] = {}
        width = max(1, -(-values.size // _MOST_BLOCKS))
        count = values.size // width
        self._block_s = width * interval_s
        blocks = values[: count * width].reshape(count, width)
        there = np.mean(~np.isnan(blocks), axis=1) >= 0.5
        self._places = np.flatnonzero(there)
        means = np.nanmean(blocks[there], axis=1)
        self._increments = np.diff(means)
        steps = np.diff(self._places) * self._block_s
        self._regressors = {"ramp": steps}
        if heat is not None:
            self._regressors["heat"] = np.diff(
                np.nanmean(heat[: count * width].reshape(count, width)[there], axis=1)
            )
        self._parts = {name: self._covariance(name) for name in RANDOM}
        self._omega, self._power, self._number = _spectrum(values, width)
        self._shapes = {name: increment_spectrum(name, self._omega, interval_s) for name in RANDOM}

    def _covariance(self, name: str) -> Floats:
        """Covariance of the increments of the block means, for a coefficient of 1."""
        lags = (self._places[:, np.newaxis] - self._places).astype(np.float64)
        of_means = block_covariance(name, lags, self._block_s)
        rows = of_means[1:] - of_means[:-1]
        return np.asarray(rows[:, 1:] - rows[:, :-1])

    def temperature_slope(self) -> tuple[float, float]:
        """Slope with the temperature under the best model, and its standard uncertainty."""
        squares, _ = self._maximum(list(RANDOM), ["ramp", "heat"])
        value, covariance = self._regression(squares, ["ramp", "heat"])
        return float(value[1]), float(np.sqrt(covariance[1, 1]))

    def choose(self) -> tuple[tuple[str, ...], bool]:
        """Terms that the data ask for: one after the other, the one that helps most, while it helps enough."""
        chosen, drift = ["angle_random_walk"], False
        best = self._maximum(chosen, [])[1]
        enough = 0.5 * np.log(self._increments.size)
        while True:
            trials = [([*chosen, name], drift) for name in RANDOM if name not in chosen]
            if not drift:
                trials.append((chosen, True))
            gains = [self._maximum(names, ["ramp"] if ramp else [])[1] - best for names, ramp in trials]
            if not gains or max(gains) <= enough:
                break
            (chosen, drift), best = trials[int(np.argmax(gains))], best + max(gains)
        # one that came first may have stood for another one that came later
        for name in [one for one in chosen if len(chosen) > 1]:
            without = [one for one in chosen if one != name]
            if without and best - self._maximum(without, ["ramp"] if drift else [])[1] <= enough:
                chosen, best = without, self._maximum(without, ["ramp"] if drift else [])[1]
        return tuple(name for name in RANDOM if name in chosen), drift

    def coefficients(
        self, chosen: tuple[str, ...], ramp: bool
    ) -> tuple[dict[str, float], dict[str, float], dict[str, float], dict[str, float]]:
        """Values, standard uncertainties and 95 % intervals of the terms, and upper bounds of the others."""
        columns = ["ramp"] if ramp else []
        squares, _ = self._maximum(list(chosen), columns)
        covariance = np.linalg.inv(self._information(squares, list(chosen)))
        value, u, low, high = {}, {}, {}, {}
        for place, name in enumerate(chosen):
            value[name] = float(np.sqrt(squares[name]))
            u[name] = float(np.sqrt(covariance[place, place])) / (2 * value[name])
            wide = float(np.exp(NORMAL_95 * u[name] / value[name]))
            low[name], high[name] = value[name] / wide, value[name] * wide
        for name in RANDOM:
            if name not in chosen:
                with_it = [*chosen, name]
                more, _ = self._maximum(with_it, columns)
                own = np.linalg.inv(self._information(more, with_it))[-1, -1]
                low[name], high[name] = 0.0, float(np.sqrt(more[name] + NORMAL_95 * np.sqrt(own)))
        slope, spread = self._regression(squares, ["ramp"])
        size, size_u = abs(float(slope[0])), float(np.sqrt(spread[0, 0]))
        low["rate_ramp"] = max(size - NORMAL_95 * size_u, 0.0) if ramp else 0.0
        high["rate_ramp"] = size + NORMAL_95 * size_u
        if ramp:
            value["rate_ramp"], u["rate_ramp"] = size, size_u
        return value, u, low, high

    def _maximum(self, names: list[str], columns: list[str]) -> tuple[dict[str, float], float]:
        """Squares of the coefficients at the maximum of the likelihood, and its logarithm there."""
        asked = (tuple(names), tuple(columns))
        if asked in self._known:
            return self._known[asked]
        squares = self._start(names)
        level, share = -np.inf, 1.0
        for _ in range(_ROUNDS):
            now, score, information = self._scored(squares, names, columns)
            # in the logarithms the squares stay positive
            scale = np.array([squares[name] for name in names])
            curve = information * np.outer(scale, scale)
            curve += 1e-9 * np.trace(curve) * np.eye(scale.size)
            step = np.linalg.solve(curve, score * scale)
            if now < level - 1e-9:
                share *= 0.5
            done = abs(now - level) < 1e-5 and share > 0.1
            level = now
            if done or share < 1e-3:
                break
            step = np.clip(share * step, -1.5, 1.5)
            squares = {name: squares[name] * float(np.exp(one)) for name, one in zip(names, step, strict=True)}
        self._known[asked] = squares, level
        return squares, level

    def _start(self, names: list[str]) -> dict[str, float]:
        """Squares that explain what is seen at one end of the spectrum or the other, each alone."""
        start = {}
        for name in names:
            fast = float(
                np.median(self._power[-self._power.size // 4 :] / self._shapes[name][-self._power.size // 4 :])
            )
            slow = float(np.mean(self._increments**2) / np.mean(np.diag(self._parts[name])))
            start[name] = {"quantization": 0.3 * fast, "angle_random_walk": min(fast, slow)}.get(name, 0.1 * slow)
        return start

    def _regression(self, squares: dict[str, float], columns: list[str]) -> tuple[Floats, Floats]:
        """Slopes of the increments with the columns, and their covariance."""
        factor = scipy.linalg.cho_factor(self._total(squares))
        design = np.column_stack([self._regressors[name] for name in columns])
        covariance = np.linalg.inv(design.T @ scipy.linalg.cho_solve(factor, design))
        slopes = covariance @ (design.T @ scipy.linalg.cho_solve(factor, self._increments))
        return np.asarray(slopes, dtype=np.float64), np.asarray(covariance, dtype=np.float64)

    def _total(self, squares: dict[str, float]) -> Floats:
        return np.asarray(sum(value * self._parts[name] for name, value in squares.items()))

    def _scored(
        self, squares: dict[str, float], names: list[str], columns: list[str]
    ) -> tuple[float, Floats, Floats]:
        """Logarithm of the likelihood, its derivatives with the squares, and Fisher's information."""
        root = np.linalg.cholesky(self._total(squares))
        inverse = scipy.linalg.cho_solve((root, True), np.eye(root.shape[0]))
        left = self._increments
        if columns:
            design = np.column_stack([self._regressors[name] for name in columns])
            weighted = inverse @ design
            left = left - design @ np.linalg.solve(design.T @ weighted, weighted.T @ left)
        seen = inverse @ left
        level = -float(np.log(np.diag(root)).sum()) - 0.5 * float(left @ seen)
        products = [inverse @ self._parts[name] for name in names]
        score = np.array(
            [0.5 * (seen @ self._parts[n] @ seen - np.trace(p)) for n, p in zip(names, products, strict=True)]
        )
        information = np.array([[0.5 * np.sum(one * other.T) for other in products] for one in products])
        model = np.asarray(sum(value * self._shapes[name] for name, value in squares.items()))
        ratio = self._power / model
        level -= float(self._number @ (np.log(model) + ratio))
        shares = np.array([self._shapes[name] / model for name in names])
        score += shares @ (self._number * (ratio - 1))
        information += (shares * self._number) @ shares.T
        return level, score, information

    def _information(self, squares: dict[str, float], names: list[str]) -> Floats:
        return self._scored(squares, names, [])[2]


def _spectrum(values: Floats, width: int) -> tuple[Floats, Floats, Floats]:
    """Angular frequency, mean power of the increments, number of independent values, above the blocks' own."""
    lowest = np.pi / width if width > 1 else np.pi / 8
    edges = np.linspace(lowest, np.pi, _BINS + 1)
    power, place, number = np.zeros(_BINS), np.zeros(_BINS), np.zeros(_BINS)
    for stretch in _stretches(values, 4 * width + 64):
        increments = np.diff(stretch)
        size = increments.size
        taper = np.ones(size)
        rise = max(2, int(_TAPER * size))
        taper[:rise] = np.sin(0.5 * np.pi * (np.arange(rise) + 0.5) / rise) ** 2
        taper[-rise:] = taper[:rise][::-1]
        periodogram = np.abs(np.fft.rfft(taper * increments)) ** 2 / float(taper @ taper)
        omega = 2 * np.pi * np.arange(periodogram.size) / size
        independent = float(taper @ taper) ** 2 / (size * float(np.sum(taper**4)))
        kept = (omega > lowest) & (omega < np.pi * (1 - 1e-9))
        into = np.minimum(np.searchsorted(edges, omega[kept], side="right") - 1, _BINS - 1)
        power += np.bincount(into, periodogram[kept], _BINS)
        place += np.bincount(into, omega[kept], _BINS)
        number += np.bincount(into, minlength=_BINS).astype(np.float64)
        share = independent
    full = number > 0
    if not full.any():
        raise ValueError("there is no stretch without missing words that is long enough for a noise model")
    return place[full] / number[full], power[full] / number[full], share * number[full]


def _stretches(values: Floats, shortest: int) -> list[Floats]:
    """Stretches without missing words; up to three in a row are put in on a straight line."""
    gone = np.isnan(values)
    if not gone.any():
        return [values]
    ends = np.flatnonzero(np.diff(np.concatenate([[False], gone, [False]]).astype(np.int8)))
    filled = values.copy()
    there = np.flatnonzero(~gone)
    for begin, end in zip(ends[::2], ends[1::2], strict=True):
        if end - begin <= 3 and begin > 0 and end < values.size:
            filled[begin:end] = np.interp(np.arange(begin, end), there, values[there])
    edges = np.concatenate([[-1], np.flatnonzero(np.isnan(filled)), [values.size]])
    cut = [filled[begin + 1 : end] for begin, end in itertools.pairwise(edges)]
    return [one for one in cut if one.size >= shortest]
