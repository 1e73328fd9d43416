"""The noise model by maximum likelihood: no slope of a curve is read.

The words are seen in two ways that share next to no information. Slow noise: the increments of the means of some
hundred blocks have a normal distribution whose covariance the model gives exactly, with blocks missing where
words are. Fast noise: the spectrum of the increments of words above the frequency of the blocks is exponentially
distributed about the model's (Whittle); a taper of a few per cent at the ends keeps the slow noise out of it.
The sum of both log-likelihoods is maximised over the squares of the coefficients by Fisher's scoring, which
gives their covariance too.

A term stands in the model if it improves the likelihood by more than the Bayesian information criterion asks
for; of those that do not, the interval says how large they may be. A record that ends within the slow noise
cannot tell bias instability from a random walk or a ramp: every model that is nearly as likely counts in
uncertainties and intervals, with its probability. A ramp and a drift with the temperature are no noise: they are
fitted to the increments of the blocks, with their covariance. Missing words are put in by the model itself
(`missing_words`).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.special
from numpy.typing import ArrayLike

from analysis.arrays import Floats
from analysis.fibre_gyro.allan.missing_words import fillable, on_lines, with_words_put_in
from analysis.fibre_gyro.allan.terms import RANDOM, TERMS, block_covariance, increment_spectrum
from analysis.fibre_gyro.rate_table.outliers import outliers
from analysis.fibre_gyro.rate_table.scatter import NORMAL_95

_MOST_BLOCKS = 256
_FEWEST_WORDS = 512
_BINS = 1500
_FILLINGS = 8  # at most
_SETTLED = 0.03  # standard uncertainties that the model still moves
_MOST_UNKNOWN = 0.7
_BOUND_ROUNDS = 3
_TAPER = 0.02  # of a stretch, at each end
_ROUNDS = 40
_RAMP = "rate_ramp"
_SLOW = ("bias_instability", "rate_random_walk", _RAMP)  # one may be taken for another
_OPEN = 0.1  # of the probability of the best model: what is like one that has so much is tried too
_COUNTS = 1e-3  # of all

Model = frozenset[str]
"""Terms, the ramp among them."""


@dataclass(frozen=True)
class NoiseFit:
    """Coefficients of the noise model, in deg and s.

    Attributes
    ----------
    coefficients, coefficients_u : dict of str to float
        Of the terms in the model; `TERMS` has their units. 1.96 of the uncertainty are half the 95 % interval.
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
        slope, slope_u = _Likelihood(on_lines(values), interval_s, heat).temperature_slope()
        values = values - slope * (heat - np.nanmean(heat))
    seen = _with_gaps_filled(values, interval_s)
    models = seen.likely_models()
    found = seen.coefficients(models)
    value, u, low, high = ({name: spread * one for name, one in part.items()} for part in found)
    chosen = tuple(name for name in TERMS if name in next(iter(models)))
    return NoiseFit(
        value, u, low, high, chosen, spread * slope, spread * slope_u, values.size, missing, int(far.sum())
    )


def _with_gaps_filled(values: Floats, interval_s: float) -> _Likelihood:
    """Likelihood of the words with the missing ones put in, by the model of all terms that it gives itself.

    What one round leaves of the step of the round before is the share of the information that is missing.
    """
    seen = _Likelihood(on_lines(values), interval_s, None)
    if not fillable(values).any():
        return seen
    squares, unknown, last = seen.of_all_terms(), 0.0, 0.0
    for _ in range(_FILLINGS):
        seen = _Likelihood(with_words_put_in(values, squares, interval_s), interval_s, None)
        before, squares = squares, seen.of_all_terms()
        step = seen.distance(before, squares)
        unknown, last = max(unknown, step / last if last else 0.0), step
        if step < _SETTLED:
            break
    seen.forgo(min(unknown, _MOST_UNKNOWN))
    return seen


@dataclass(frozen=True)
class _Part:
    """What one model says of one coefficient."""

    probability: float  # of the model
    value: float
    u: float
    square: float = float("nan")  # of a random term its square, which is what is fitted; nan for the ramp
    square_u: float = float("nan")

    def below(self, size: float) -> float:
        """Probability that the coefficient is below some size, given the model."""
        if not np.isfinite(self.square):
            inside = scipy.special.ndtr([(size - self.value) / self.u, (-size - self.value) / self.u])
            return float(inside[0] - inside[1])
        if self.square > 2 * self.square_u:
            return float(scipy.special.ndtr(self.value / self.u * np.log(max(size, 1e-300) / self.value)))
        cut, upto = scipy.special.ndtr(np.array([0.0, size**2]) / self.square_u - self.square / self.square_u)
        return float((upto - cut) / (1 - cut))


def _quantile(parts: list[_Part], probability: float) -> float:
    """Quantile of a coefficient over all models; those without it say that it is 0."""
    without = 1 - sum(one.probability for one in parts)
    if without >= probability:
        return 0.0
    low, high = 0.0, max(one.value + 10 * one.u + np.sqrt(10 * np.nan_to_num(one.square_u)) for one in parts)
    for _ in range(60):
        middle = (low + high) / 2
        inside = without + sum(one.probability * one.below(middle) for one in parts)
        low, high = (middle, high) if inside < probability else (low, middle)
    return float((low + high) / 2)


def _names_of(model: Model) -> tuple[list[str], list[str]]:
    """Random terms of a model, and the columns that are fitted beside them."""
    return [name for name in RANDOM if name in model], ["ramp"] if _RAMP in model else []


def _like(model: Model) -> Iterator[Model]:
    """Models with a term more, a term less, or a slow term in the place of another one."""
    for name in TERMS:
        if name not in model:
            yield model | {name}
            yield from (model - {other} | {name} for other in _SLOW if name in _SLOW and other in model)
        elif len(model - {name, _RAMP}) > 0:
            yield model - {name}


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

    def of_all_terms(self) -> dict[str, float]:
        """Squares of the coefficients of all terms together."""
        return self._maximum(list(RANDOM), ["ramp"])[0]

    def distance(self, squares: dict[str, float], others: dict[str, float]) -> float:
        """How far two models are apart, in standard uncertainties."""
        apart = np.array([squares[name] - others[name] for name in RANDOM])
        return float(np.sqrt(apart @ self._information(others, list(RANDOM)) @ apart))

    def forgo(self, unknown: float) -> None:
        """Count so much of the information on fast noise as drawn: it says nothing, and its chance adds to u."""
        self._number = self._number * (1 - unknown) / (1 + unknown)
        self._known.clear()

    def temperature_slope(self) -> tuple[float, float]:
        """Slope with the temperature under the best model, and its standard uncertainty."""
        squares, _ = self._maximum(list(RANDOM), ["ramp", "heat"])
        value, covariance = self._regression(squares, ["ramp", "heat"])
        return float(value[1]), float(np.sqrt(covariance[1, 1]))

    def likely_models(self) -> dict[Model, float]:
        """Models that the data leave open and their probabilities; the most probable one first."""
        best = Model({"angle_random_walk"})
        while True:
            # one term after the other, the one that helps most, while it helps enough
            larger = max((best | {name} for name in TERMS if name not in best), key=self._score, default=best)
            if self._score(larger) <= self._score(best):
                break
            best = larger
        scores, waiting = {best: self._score(best)}, [best]
        while waiting:
            for other in _like(waiting.pop()):
                if other not in scores:
                    scores[other] = self._score(other)
                    if scores[other] > max(scores.values()) + np.log(_OPEN):
                        waiting.append(other)
        highest = max(scores.values())
        weight = {model: float(np.exp(score - highest)) for model, score in scores.items()}
        total = sum(weight.values())
        likely = {model: one / total for model, one in weight.items() if one > _COUNTS * total}
        ranked = sorted(likely, key=lambda model: -likely[model])
        return {model: likely[model] / sum(likely.values()) for model in ranked}

    def _score(self, model: Model) -> float:
        """Logarithm of the probability of a model by the Bayesian information criterion, up to a constant."""
        return self._maximum(*_names_of(model))[1] - 0.5 * float(np.log(self._increments.size)) * len(model)

    def coefficients(
        self, models: dict[Model, float]
    ) -> tuple[dict[str, float], dict[str, float], dict[str, float], dict[str, float]]:
        """Values and standard uncertainties of the terms of the first model, and 95 % intervals of all terms."""
        chosen, value, u, low, high = next(iter(models)), {}, {}, {}, {}
        known = [self._parts_of(model, probability) for model, probability in models.items()]
        for name in TERMS:
            parts = [of_model[name] for of_model in known if name in of_model]
            low[name], high[name] = (_quantile(parts, probability) for probability in (0.025, 0.975))
            if name in chosen:
                value[name] = known[0][name].value
                u[name] = (high[name] - low[name]) / (2 * NORMAL_95)
            else:
                # a term that is not asked for may be as large as the data allow beside the others
                high[name] = max(high[name], self._bound(chosen | {name}, name))
        return value, u, low, high

    def _bound(self, model: Model, name: str) -> float:
        """Upper end of the 95 % interval of a term that may be 0: the size that would hardly show so little.

        The square of a random term scatters the more the larger it is; so its uncertainty is that at the bound.
        """
        part = self._parts_of(model, 1.0)[name]
        if name == _RAMP:
            return part.value + NORMAL_95 * part.u
        names, columns = _names_of(model)
        squares, place, u = self._maximum(names, columns)[0], names.index(name), part.square_u
        for _ in range(_BOUND_ROUNDS):
            at = {**squares, name: part.square + NORMAL_95 * u}
            u = float(np.sqrt(np.linalg.inv(self._information(at, names))[place, place]))
        return float(np.sqrt(part.square + NORMAL_95 * u))

    def _parts_of(self, model: Model, probability: float) -> dict[str, _Part]:
        """What one model says of each of its coefficients."""
        names, columns = _names_of(model)
        squares, _ = self._maximum(names, columns)
        spread = np.sqrt(np.diag(np.linalg.inv(self._information(squares, names))))
        found = {}
        for name, one in zip(names, spread, strict=True):
            size = float(np.sqrt(squares[name]))
            found[name] = _Part(probability, size, float(one) / (2 * size), squares[name], float(one))
        if columns:
            slope, covariance = self._regression(squares, columns)
            found[_RAMP] = _Part(probability, abs(float(slope[0])), float(np.sqrt(covariance[0, 0])))
        return found

    def _maximum(self, names: list[str], columns: list[str]) -> tuple[dict[str, float], float]:
        """Squares of the coefficients at the maximum of the likelihood, and its logarithm there."""
        asked = (tuple(sorted(names)), tuple(columns))
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
    """Stretches without missing words."""
    edges = np.concatenate([[-1], np.flatnonzero(np.isnan(values)), [values.size]])
    return [values[begin + 1 : end] for begin, end in itertools.pairwise(edges) if end - begin - 1 >= shortest]
