"""The noise model by maximum likelihood, no slope of a curve is read; the Allan deviation beside it.

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
(`missing_words`). A filtered output is seen up to a fifth of the filter's corner, where a first-order low-pass is
nearly what any filter is, and its transfer function is taken out.

Where the spectrum shows a line, a sinusoid of constant amplitude is taken out. Where it is not that of the five
terms, exponentially correlated noise (a Markov process of first order) is offered too, of any correlation time:
its models stand at times ever closer together, until more than one of them counts. What then still is not that of
the model is told.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import scipy.fft
import scipy.linalg
import scipy.special
from numpy.typing import ArrayLike
from scipy.sparse.linalg import LinearOperator, cg

from analysis.arrays import NORMAL_95, Bools, Floats
from analysis.fibre_gyro.noise_terms import (
    CORRELATED,
    CORRELATION_TIME,
    RANDOM,
    TERMS,
    block_covariance,
    correlated,
    increment_spectrum,
    low_passed,
    term_of,
)
from analysis.fibre_gyro.scatter import outliers

_MOST_BLOCKS = 256
_FEWEST_WORDS = 512
_BINS = 1500
_FILLINGS = 8  # at most
_SETTLED = 0.03  # standard uncertainties that the model still moves
_MOST_UNKNOWN = 0.7
_BOUND_ROUNDS = 3
_TAPER = 0.02  # of a stretch, at each end
_OF_CORNER = 0.2  # of a filter: above it a first-order low-pass is not what every filter is
_FORM = (
    0.004  # of the angle random walk, by the form of the filter: half of what a low-pass takes there, at random
)
_WIDEST = 5.0  # the spectrum that is looked at, in that of the blocks
_ROUNDS = 40
_RAMP = "rate_ramp"
_SLOW = ("bias_instability", "rate_random_walk", _RAMP)  # one may be taken for another
_OPEN = 0.1  # of the probability of the best model: what is like one that has so much is tried too
_COUNTS = 1e-3  # of all
_BESIDE = 12  # bins on either side of a line that tell the noise about it
_LINE_CHANCE, _STANDS_OUT = 1e-6, 1.5  # of all spectra of noise with such a line; its power over that beside it
_BANDS = 12
_OFF, _OFF_AT_LEAST = 6.0, 0.03  # standard deviations, and share of the power, by which no model is off
_FEWEST_MEANS = 12
_SLOW_BANDS, _SLOW_CHANCE = 6, 1e-5
_PARTS, _FEWEST_IN_PART = 8, 24
_JUMP = 6.0  # standard deviations of one whitened increment of the blocks, that none of noise has
_LOUDER = 0.25  # of the power, by which parts that differ matter
_INDEPENDENT = 2 / 3  # of increments of white noise
_SHORTEST_S, _SHORTEST = 5.0, 20  # correlation time: s, words
_FAR, _FINE = 1.0, 1 / 64  # steps of the logarithm of a correlation time: at first, and at last
_SAME = 0.5  # logarithm of the probability by which the next correlation time is no worse
_BETWEEN = 0.4  # of a step, for the correlation times between two
_MOST_LINES, _LINE_ROUNDS = 12, 3
_HANN_NOISE = 1.5  # of a mean under a Hann window, in that of a plain one
Model = frozenset[str]  # terms, the ramp too; "correlated_noise 3.4" is that of such a correlation time (s)


@dataclass(frozen=True)
class Sinusoid:
    """A line of constant amplitude in the output."""

    frequency_hz: float
    amplitude: float  # of the words, and its standard uncertainty
    amplitude_u: float


@dataclass(frozen=True)
class NoiseFit:
    """Coefficients of the noise model, in deg and s."""

    # of the terms in the model; `TERMS` has their units. 1.96 of the uncertainty are half the 95 % interval.
    # "correlated_noise" is there where the data ask for it: with it "correlation_time", which is no term.
    coefficients: dict[str, float]
    coefficients_u: dict[str, float]
    low_95: dict[str, float]  # of every term; of one that is not in the model up to where it may be hidden, from 0
    high_95: dict[str, float]
    chosen: tuple[str, ...]  # terms in the model
    # deg/s per unit of the temperature; nan where it was not asked for; with its uncertainty
    temperature_slope: float
    temperature_slope_u: float
    words: int
    missing: int
    outliers: int
    sinusoids: tuple[Sinusoid, ...] = ()  # that were taken out
    lines_hz: tuple[float, ...] = ()  # where a line stands in the spectrum that neither noise nor a sinusoid has
    # where the spectrum is not that of the model: from, to (Hz), and its power over the model's
    bands: tuple[tuple[float, float, float], ...] = ()
    # power of the loudest of some parts of the record over that of all; nan where all are alike
    loudness: float = float("nan")
    slow_loudness: float = float("nan")  # the same of the slow noise


def fit_noise(
    words: ArrayLike, interval_s: float, *, temperature: ArrayLike | None = None, filter_hz: float = np.inf
) -> NoiseFit:
    """Fit the noise model to words at rest, behind a low-pass of such a corner."""
    corner = 2 * np.pi * filter_hz * interval_s
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
        slope, slope_u = _Likelihood(on_lines(values), interval_s, heat, corner).temperature_slope()
        values = values - slope * (heat - np.nanmean(heat))
    seen = _with_gaps_filled(values, interval_s, corner)
    models = seen.likely_models()
    lines, bands = seen.misfit(next(iter(models)))
    smooth, at, left = values, np.arange(values.size), lines
    sinusoids: list[Sinusoid] = []
    with_lines = seen, models, bands
    for _ in range(_LINE_ROUNDS):
        if not left or len(sinusoids) + len(left) > _MOST_LINES:
            break
        for line, turn in _sinusoids(smooth, left, seen.density(next(iter(models)))):
            smooth = smooth - (turn * np.exp(2j * np.pi * line.frequency_hz * at)).real
            sinusoids.append(line)
        seen = _with_gaps_filled(smooth, interval_s, corner)
        models = seen.likely_models()
        left, bands = seen.misfit(next(iter(models)))
    if left:
        # their amplitudes or frequencies are not constant: nothing was taken out, and they are told
        sinusoids, (seen, models, bands) = [], with_lines
    values = smooth if sinusoids else values
    if bands:
        # not for every record: beside 1/f noise and a walk a Markov process is always nearly as likely
        wider = seen.likely_models(with_correlated=True)
        if "angle_random_walk" in next(iter(wider)) and not seen.misfit(next(iter(wider)))[1]:
            models, bands = wider, []
    found = seen.coefficients(models)
    value, u, low, high = (
        {name: (1.0 if name == CORRELATION_TIME else spread) * one for name, one in part.items()} for part in found
    )
    walk = "angle_random_walk"
    if np.isfinite(filter_hz) and walk in value:
        form = _FORM * value[walk]
        u[walk] = float(np.hypot(u[walk], form))
        low[walk] = value[walk] - float(np.hypot(value[walk] - low[walk], NORMAL_95 * form))
        high[walk] = value[walk] + float(np.hypot(high[walk] - value[walk], NORMAL_95 * form))
    chosen = tuple(name for name in (*TERMS, CORRELATED) if name in map(term_of, next(iter(models))))
    return NoiseFit(
        value, u, low, high, chosen, spread * slope, spread * slope_u, values.size, missing, int(far.sum()),
        tuple(
            Sinusoid(one.frequency_hz / interval_s, spread * one.amplitude, spread * one.amplitude_u)
            for one in sorted(sinusoids, key=lambda one: one.frequency_hz)
        ),
        tuple(one / interval_s for one in (lines if left else [])),
        tuple((low / interval_s, high / interval_s, power) for low, high, power in bands),
        loudest_part(np.diff(values), _INDEPENDENT),
        loudest_part(seen.whitened(next(iter(models))), 1.0),
    )  # fmt: skip


def loudest_part(values: Floats, independent: float) -> float:
    """Power of the loudest of some parts of noise over that of all; nan where chance makes such differences."""
    # `independent`: share of the values (nan where missing) that are
    parts = [part[np.isfinite(part)] for part in np.array_split(values, _PARTS)]
    sizes = np.array([part.size for part in parts])
    if sizes.min() < _FEWEST_IN_PART:
        return float("nan")
    power = np.array([float(np.mean(part**2)) for part in parts]) / float(np.nanmean(values**2))
    if independent == 1.0 and float(np.nanmax(np.abs(values))) > _JUMP:
        return float(power.max())
    off = np.abs(np.log(np.maximum(power, 1e-300))) * np.sqrt(independent * sizes / 2)
    return float(power.max()) if off.max() > _OFF and np.ptp(power) > _LOUDER else float("nan")


def _sinusoids(
    values: Floats, lines: list[float], density: Callable[[Floats], Floats]
) -> list[tuple[Sinusoid, complex]]:
    """Sinusoids at lines (cycles a word), one for neighbours, and the turn of each; by least squares."""
    # A Hann window keeps slow noise out, whose spectrum is steep. `density`: spectrum of the words' noise.
    there = np.isfinite(values)
    window = np.where(there, np.sin(np.pi * (np.arange(values.size) + 0.5) / values.size) ** 2, 0.0)
    seen = window * np.where(there, values - np.nanmean(values), 0.0)
    power = np.abs(scipy.fft.rfft(seen)) ** 2
    at, bin_width = np.arange(values.size) - (values.size - 1) / 2, 0.5 / _BINS
    groups = np.split(np.array(lines), np.flatnonzero(np.diff(lines) > 2.5 * bin_width) + 1)
    found = []
    for group in groups:
        first = max(1, int((group[0] - bin_width) * values.size))
        last = min(power.size, int((group[-1] + bin_width) * values.size) + 2)
        frequency = (first + int(power[first:last].argmax())) / values.size
        for _ in range(4):
            # the turn of the amplitude over the record is what the frequency is off
            wave = seen * np.exp(-2j * np.pi * frequency * at)
            level, tilt = wave.sum() / window.sum(), (at * wave).sum() / (at**2 * window).sum()
            frequency += float((tilt / level).imag) / (2 * np.pi)
        turn = 2 * complex((seen * np.exp(-2j * np.pi * frequency * np.arange(values.size))).sum() / window.sum())
        noise = float(density(np.array([2 * np.pi * frequency]))[0])
        u = float(np.sqrt(2 * _HANN_NOISE * noise / there.sum()))
        found.append((Sinusoid(frequency, abs(turn), u), turn))
    return found


def _with_gaps_filled(values: Floats, interval_s: float, corner: float) -> _Likelihood:
    """Likelihood of the words with the missing ones put in, by the model of all terms that it gives itself."""
    # What one round leaves of the step of the round before is the share of the information that is missing.
    seen = _Likelihood(on_lines(values), interval_s, None, corner)
    if not fillable(values).any():
        return seen
    squares, unknown, last = seen.of_all_terms(), 0.0, 0.0
    for _ in range(_FILLINGS):
        seen = _Likelihood(with_words_put_in(values, squares, interval_s, corner), interval_s, None, corner)
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
    random = [name for name in RANDOM if name in model] + [name for name in model if term_of(name) == CORRELATED]
    return random, ["ramp"] if _RAMP in model else []


def _like(model: Model, step: float) -> Iterator[Model]:
    """Models with a term more, a term less, or a slow term in the place of another one."""
    for name in TERMS:
        if name not in model:
            yield model | {name}
            yield from (model - {other} | {name} for other in _SLOW if name in _SLOW and other in model)
        elif len(model - {name, _RAMP}) > 0:
            yield model - {name}
    yield from _beside(model, step)


def _beside(model: Model, step: float) -> Iterator[Model]:
    """The same model with a shorter and a longer correlation time."""
    for name in model:
        if term_of(name) == CORRELATED:
            time = float(name.split(" ")[1])
            yield from (model - {name} | {correlated(time * np.exp(one))} for one in (-step, step))


class _Likelihood:
    """Likelihood under squares of coefficients: by blocks where the words are slow, by spectrum where fast."""

    def __init__(self, values: Floats, interval_s: float, heat: Floats | None, corner: float = np.inf) -> None:
        self._known: dict[tuple[tuple[str, ...], tuple[str, ...]], tuple[dict[str, float], float]] = {}
        width = max(1, -(-values.size // _MOST_BLOCKS))
        count = values.size // width
        self._block_s, self._width = width * interval_s, width
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
        self._omega, self._power, self._number = _spectrum(values, width, _OF_CORNER * corner)
        self._corner, self._interval_s, self._size, self._step = corner, interval_s, values.size, _FAR
        self._shapes = {name: self._shape(name, self._omega) for name in RANDOM}

    def _shape(self, name: str, omega: Floats) -> Floats:
        return low_passed(omega, self._corner) * increment_spectrum(name, omega, self._interval_s)

    def density(self, model: Model) -> Callable[[Floats], Floats]:
        """Spectrum of the words under a model; its mean is their variance."""
        squares = self._maximum(*_names_of(model))[0]

        def at(omega: Floats) -> Floats:
            total = sum(value * self._shape(name, omega) for name, value in squares.items())
            return np.asarray(total / (4 * np.sin(omega / 2) ** 2))

        return at

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

    def likely_models(self, *, with_correlated: bool = False) -> dict[Model, float]:
        """Models that the data leave open and their probabilities; the most probable one first."""
        best, offered, step = Model({"angle_random_walk"}), list(TERMS), _FAR
        if with_correlated:
            # noise of a short correlation time cannot be told from white noise behind a filter
            shortest, longest = max(_SHORTEST_S, _SHORTEST * self._interval_s), self._size * self._interval_s / 4
            times = np.exp(np.arange(np.log(shortest), np.log(longest), step))
            for name in map(correlated, times):
                self._parts[name] = self._covariance(name)
                self._shapes[name] = self._shape(name, self._omega)
                offered.append(name)
        while True:
            # one term after the other, the one that helps most, while it helps enough
            kinds = {term_of(name) for name in best}
            more = (best | {name} for name in offered if term_of(name) not in kinds)
            larger = max(more, key=self._score, default=best)
            if self._score(larger) <= self._score(best):
                break
            best = larger
        scores, waiting = {best: self._score(best)}, [best]
        while waiting:
            for other in _like(waiting.pop(), step):
                if other not in scores:
                    scores[other] = self._score(other)
                    if scores[other] > max(scores.values()) + np.log(_OPEN):
                        waiting.append(other)
            best = max(scores, key=lambda model: scores[model])
            near = [scores[one] for one in _beside(best, step) if one in scores]
            if not waiting and near and step > _FINE and max(near) < scores[best] - _SAME:
                # correlation times between two that are worse
                step, waiting = step / 2, [best]
        self._step = step
        highest = max(scores.values())
        weight = {model: float(np.exp(score - highest)) for model, score in scores.items()}
        total = sum(weight.values())
        likely = {model: one / total for model, one in weight.items() if one > _COUNTS * total}
        ranked = sorted(likely, key=lambda model: -likely[model])
        return {model: likely[model] / sum(likely.values()) for model in ranked}

    def _score(self, model: Model) -> float:
        """Logarithm of the probability of a model by the Bayesian information criterion, up to a constant."""
        unknown = len(model) + (CORRELATED in map(term_of, model))
        return self._maximum(*_names_of(model))[1] - 0.5 * float(np.log(self._increments.size)) * unknown

    def coefficients(
        self, models: dict[Model, float]
    ) -> tuple[dict[str, float], dict[str, float], dict[str, float], dict[str, float]]:
        """Values and standard uncertainties of the terms of the first model, and 95 % intervals of all terms."""
        chosen, value, u, low, high = next(iter(models)), {}, {}, {}, {}
        known = [self._parts_of(model, probability) for model, probability in models.items()]
        of_time = (CORRELATED, CORRELATION_TIME) if CORRELATED in map(term_of, chosen) else ()
        for name in (*TERMS, *of_time):
            parts = [of_model[name] for of_model in known if name in of_model]
            low[name], high[name] = (_quantile(parts, probability) for probability in (0.025, 0.975))
            if name in chosen or name in of_time:
                value[name] = known[0][name].value
                if name in of_time:
                    # each model has a correlation time of its own: the mean over all of them
                    total = sum(one.probability for one in parts)
                    value[name] = sum(one.probability * one.value for one in parts) / total
                u[name] = (high[name] - low[name]) / (2 * NORMAL_95)
            else:
                # a term that is not asked for may be as large as the data allow beside the others
                high[name] = max(high[name], self._bound(chosen | {name}, name))
        return value, u, low, high

    def _bound(self, model: Model, name: str) -> float:
        """Upper end of the 95 % interval of a term that may be 0: the size that would hardly show so little."""
        # The square of a random term scatters the more the larger it is; so its uncertainty is that at the bound.
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
            found[term_of(name)] = _Part(probability, size, float(one) / (2 * size), squares[name], float(one))
            if term_of(name) == CORRELATED:
                time = float(name.split(" ")[1])
                found[CORRELATION_TIME] = _Part(probability, time, time * _BETWEEN * self._step)
        if columns:
            slope, covariance = self._regression(squares, columns)
            found[_RAMP] = _Part(probability, abs(float(slope[0])), float(np.sqrt(covariance[0, 0])))
        return found

    def _maximum(self, names: list[str], columns: list[str]) -> tuple[dict[str, float], float]:
        """Squares of the coefficients at the maximum of the likelihood, and its logarithm there."""
        asked = (tuple(sorted(names)), tuple(columns))
        if asked in self._known:
            return self._known[asked]
        for name in names:
            if name not in self._parts:
                self._parts[name], self._shapes[name] = self._covariance(name), self._shape(name, self._omega)
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
            done = abs(now - level) < 1e-6 and share > 0.1
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

    def whitened(self, model: Model) -> Floats:
        """Increments of the block means, each with a variance of 1 and independent if the model holds."""
        names, columns = _names_of(model)
        squares = self._maximum(names, columns)[0]
        left = self._increments
        if columns:
            left = left - self._regressors["ramp"] * self._regression(squares, columns)[0][0]
        root = np.linalg.cholesky(self._total(squares))
        return np.asarray(scipy.linalg.solve_triangular(root, left, lower=True))

    def misfit(self, model: Model) -> tuple[list[float], list[tuple[float, float, float]]]:
        """Lines, and bands in which the spectrum is not that of the model; frequencies in cycles a word."""
        squares = self._maximum(*_names_of(model))[0]
        ratio = self._power / np.asarray(sum(value * self._shapes[name] for name, value in squares.items()))
        frequency, number = self._omega / (2 * np.pi), self._number
        # a line stands alone: its neighbours say how much noise there is
        around = np.array([np.median(ratio[max(0, i - _BESIDE) : i + _BESIDE + 1]) for i in range(ratio.size)])
        chance = scipy.special.gammaincc(number, number * ratio / np.maximum(around, 1e-300))
        lines = np.flatnonzero((chance < _LINE_CHANCE / ratio.size) & (ratio > _STANDS_OUT * around))
        free = np.ones(ratio.size, dtype=bool)
        for line in lines:
            free[max(0, line - 1) : line + 2] = False
        bands = []
        for part in np.array_split(np.flatnonzero(free), _BANDS):
            freedom = float(number[part].sum())
            power = float(number[part] @ ratio[part]) / max(freedom, 1e-300)
            if abs(power - 1) * np.sqrt(freedom) > _OFF and abs(power - 1) > _OFF_AT_LEAST:
                bands.append((float(frequency[part[0]]), float(frequency[part[-1]]), power))
        # below the blocks' own frequency: whitened increments have a flat spectrum
        left = self.whitened(model)
        lines_of_blocks = np.abs(np.fft.rfft(left)[1:]) ** 2 / left.size
        edges = np.unique(np.geomspace(1, lines_of_blocks.size, _SLOW_BANDS + 1).astype(int)) - 1
        for first, last in (*itertools.pairwise(edges), *((0, last) for last in edges[2:])):
            power, freedom = float(lines_of_blocks[first:last].mean()), float(last - first)
            tails = (
                scipy.special.gammainc(freedom, freedom * power),
                scipy.special.gammaincc(freedom, freedom * power),
            )
            if min(tails) < _SLOW_CHANCE:
                whole = left.size * self._width
                bands.append((float(first + 1) / whole, float(last) / whole, power))
        return [float(frequency[line]) for line in lines], bands

    def _total(self, squares: dict[str, float]) -> Floats:
        return np.asarray(sum(value * self._parts[name] for name, value in squares.items()))

    def _scored(
        self, squares: dict[str, float], names: list[str], columns: list[str]
    ) -> tuple[float, Floats, Floats]:
        """Logarithm of the likelihood, its derivatives with the squares, and about the information on them."""
        # The mean of what the record shows and of what is expected needs no product of matrices, as either would.
        root, inverse = self._inverse(squares)
        left = self._increments
        if columns:
            design = np.column_stack([self._regressors[name] for name in columns])
            weighted = inverse @ design
            left = left - design @ np.linalg.solve(design.T @ weighted, weighted.T @ left)
        seen = inverse @ left
        level = -float(np.log(np.diag(root)).sum()) - 0.5 * float(left @ seen)
        moved = np.array([self._parts[name] @ seen for name in names])
        score = 0.5 * (moved @ seen - [np.vdot(inverse, self._parts[name]) for name in names])
        model = np.asarray(sum(value * self._shapes[name] for name, value in squares.items()))
        ratio = self._power / model
        level -= float(self._number @ (np.log(model) + ratio))
        shares = np.array([self._shapes[name] / model for name in names])
        score += shares @ (self._number * (ratio - 1))
        return level, score, 0.5 * moved @ inverse @ moved.T + (shares * self._number) @ shares.T

    def _information(self, squares: dict[str, float], names: list[str]) -> Floats:
        """Fisher's information on the squares."""
        inverse = self._inverse(squares)[1]
        products = [inverse @ self._parts[name] for name in names]
        of_blocks = np.array([[0.5 * np.vdot(one, other.T) for other in products] for one in products])
        model = np.asarray(sum(value * self._shapes[name] for name, value in squares.items()))
        shares = np.array([self._shapes[name] / model for name in names])
        return np.asarray(of_blocks + (shares * self._number) @ shares.T)

    def _inverse(self, squares: dict[str, float]) -> tuple[Floats, Floats]:
        """Lower root of the covariance of the increments, and its inverse."""
        root = np.asarray(np.linalg.cholesky(self._total(squares)))
        half = scipy.linalg.lapack.dpotri(root, lower=True)[0]
        inverse = np.asarray(half + half.T)
        np.fill_diagonal(inverse, half.diagonal())
        return root, inverse


def _spectrum(values: Floats, width: int, highest: float) -> tuple[Floats, Floats, Floats]:
    """Angular frequency, mean power of the increments, number of independent values, above the blocks' own."""
    lowest, highest = np.pi / width if width > 1 else np.pi / 8, min(highest, np.pi)
    if highest < min(np.pi, _WIDEST * lowest):
        raise ValueError("the output is filtered so slowly that a log so short does not show its fast noise")
    edges = np.linspace(lowest, highest, _BINS + 1)
    power, place, number = np.zeros(_BINS), np.zeros(_BINS), np.zeros(_BINS)
    missing = np.concatenate([[-1], np.flatnonzero(np.isnan(values)), [values.size]])
    for begin, end in itertools.pairwise(missing):
        if end - begin <= 4 * width + 64:
            continue
        increments = np.diff(values[begin + 1 : end])
        size = increments.size
        taper = np.ones(size)
        rise = max(2, int(_TAPER * size))
        taper[:rise] = np.sin(0.5 * np.pi * (np.arange(rise) + 0.5) / rise) ** 2
        taper[-rise:] = taper[:rise][::-1]
        periodogram = np.abs(np.fft.rfft(taper * increments)) ** 2 / float(taper @ taper)
        omega = 2 * np.pi * np.arange(periodogram.size) / size
        independent = float(taper @ taper) ** 2 / (size * float(np.sum(taper**4)))
        kept = (omega > lowest) & (omega < highest * (1 - 1e-9))
        into = np.minimum(np.searchsorted(edges, omega[kept], side="right") - 1, _BINS - 1)
        power += np.bincount(into, periodogram[kept], _BINS)
        place += np.bincount(into, omega[kept], _BINS)
        number += np.bincount(into, minlength=_BINS).astype(np.float64)
        share = independent
    full = number > 0
    if not full.any():
        raise ValueError("there is no stretch without missing words that is long enough for a noise model")
    return place[full] / number[full], power[full] / number[full], share * number[full]


# --------------------
# Words that are missing, put in as the noise model says of them, given all that are there.
#
# A straight line over a gap takes power out of the fast noise and tears apart what quantization keeps together:
# the sum of its words is the difference of two angles. A draw from the conditional distribution keeps both: under
# the model the whole series then has the distribution that it would have had. The model is found from the series
# with its gaps put in, so both are found in turn; each time some of the error of the model is left.
#
# The words are drawn all at once: a series of the model with no gaps, plus what is expected of the missing words
# if it differs from the true one by what is seen where words are. That expectation makes the energy of the series,
# each frequency weighted by the inverse of its spectrum, the least (conjugate gradients, products by Fourier
# transforms)


_LONGEST = 64  # words in a row that are put in
_MARGIN = 256  # words behind the last one that nobody has seen: the transform joins both ends
_POINTS = 4096  # of the spectrum, joined by lines in its logarithm
_TOLERANCE = 1e-3
_MOST_STEPS = 60


def fillable(values: Floats) -> Bools:
    """Tell which words are missing in so short a gap that they are put in."""
    gone = np.isnan(values)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], gone, [False]]).astype(np.int8)))
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        if end - begin > _LONGEST:
            gone[begin:end] = False
    return gone


def on_lines(values: Floats) -> Floats:
    """Put missing words on straight lines, to begin with; nan stays where a gap is too long."""
    put_in, there = fillable(values), ~np.isnan(values)
    filled = values.copy()
    filled[put_in] = np.interp(np.flatnonzero(put_in), np.flatnonzero(there), values[there])
    return filled


def with_words_put_in(
    values: Floats, squares: Mapping[str, float], interval_s: float, corner: float = np.inf
) -> Floats:
    """Draw missing words, with the same random numbers each time."""
    size = int(scipy.fft.next_fast_len(values.size + _MARGIN, real=True))
    known = np.zeros(size)
    gone = np.ones(size, dtype=np.bool_)
    gone[: values.size] = np.isnan(values)
    known[~gone] = values[~np.isnan(values)]
    omega = 2 * np.pi * np.arange(1, size // 2 + 1) / size
    grid = np.geomspace(omega[0], np.pi, _POINTS)
    shape = sum(square * increment_spectrum(name, grid, interval_s) for name, square in squares.items())
    shape = shape * low_passed(grid, corner)
    spectrum = np.exp(np.interp(np.log(omega), np.log(grid), np.log(shape / (4 * np.sin(grid / 2) ** 2))))
    weight = np.concatenate([[0.0], float(np.median(spectrum)) / spectrum])  # the level may be anything
    white = scipy.fft.rfft(np.random.default_rng(0).normal(size=size))
    drawn = scipy.fft.irfft(white * np.concatenate([[0.0], np.sqrt(spectrum)]), size)

    def weighted(series: Floats) -> Floats:
        return np.asarray(scipy.fft.irfft(weight * scipy.fft.rfft(series), size)[gone])

    def of_the_missing(words: Floats) -> Floats:
        series = np.zeros(size)
        series[gone] = words
        return weighted(series)

    count = int(gone.sum())
    operator = LinearOperator((count, count), matvec=of_the_missing, dtype=np.float64)
    expected, _ = cg(operator, -weighted(np.where(gone, 0.0, known - drawn)), rtol=_TOLERANCE, maxiter=_MOST_STEPS)
    known[gone] = drawn[gone] + expected
    return np.where(np.isnan(values) & ~fillable(values), np.nan, known[: values.size])


# --------------------
# Overlapping Allan deviation of output words, for a picture: the fit does not read it


_CURVE_POINTS = 60


@dataclass(frozen=True)
class AllanCurve:
    """Overlapping Allan deviation."""

    tau_s: Floats  # (m,): s, and the unit of the words; the uncertainty by the number of independent differences
    deviation: Floats
    deviation_u: Floats

    @property
    def lowest(self) -> int:
        """Place of the smallest deviation, among those that are known to a third."""
        known = self.deviation_u < self.deviation / 3
        return int(np.where(known, self.deviation, np.inf).argmin())


def deviation_of_means(words: ArrayLike, interval_s: float, tau_s: float) -> tuple[float, float]:
    """Standard deviation of means over `tau_s`, and its standard uncertainty; nan where they are fewer than 12.

    It is what data sheets call bias stability (GJB 2426A), and grows with a record whose bias walks.
    """
    values, width = np.asarray(words, dtype=np.float64), round(tau_s / interval_s)
    count = values.size // max(width, 1)
    if width < 1 or count < _FEWEST_MEANS:
        return float("nan"), float("nan")
    blocks = values[: count * width].reshape(count, width)
    there = np.mean(np.isfinite(blocks), axis=1) >= 0.5
    means = np.nanmean(blocks[there], axis=1)
    if means.size < _FEWEST_MEANS:
        return float("nan"), float("nan")
    deviation = float(np.std(means, ddof=1))
    # Neighbours that are alike say less: the number of independent ones by the means' own correlations. These and
    # the deviation are both low because the mean is that of the same values.
    scatter = means - means.mean()
    lags = np.correlate(scatter, scatter, "full")[means.size :] / max(float(scatter @ scatter), 1e-300)
    kept = lags[: int(np.argmax(lags < 0)) if np.any(lags < 0) else lags.size]
    low = min((1 + 2 * float(kept.sum())) / means.size, 0.5)
    independent = max(means.size / (1 + 2 * float(np.sum((kept + low) ** 2))) - 2, 1.0)
    return deviation / (1 - low) ** 0.5, deviation / (1 - low) ** 0.5 / (2 * independent) ** 0.5


def allan_curve(
    words: ArrayLike, interval_s: float, coefficients: Mapping[str, float] | None = None
) -> AllanCurve:
    """Overlapping Allan deviation at times spaced evenly in their logarithm, up to a quarter of the record."""
    import allantools  # type: ignore[import-untyped]

    values = np.asarray(words, dtype=np.float64)
    if coefficients:
        values = _whole(values, interval_s, coefficients)
    most = max(1, values.size // 4)
    steps = np.unique(np.geomspace(1, most, _CURVE_POINTS).round().astype(np.int64))
    tau, deviation, _, _ = allantools.oadev(
        values - values.mean(), rate=1 / interval_s, data_type="freq", taus=steps * interval_s
    )
    independent = np.maximum(values.size * interval_s / tau - 1, 1.0)
    return AllanCurve(
        np.asarray(tau, dtype=np.float64), np.asarray(deviation), np.asarray(deviation / np.sqrt(2 * independent))
    )


def _whole(values: Floats, interval_s: float, coefficients: Mapping[str, float]) -> Floats:
    """Words without gaps: short ones filled by the noise model, long ones by a straight line."""
    level = float(np.nanmean(values))
    seen = np.where(outliers(values), np.nan, values - level)
    if not np.isnan(seen).any():
        return values
    squares = {name: value**2 for name, value in coefficients.items() if name in RANDOM}
    filled = with_words_put_in(seen, squares, interval_s)
    there = np.flatnonzero(~np.isnan(filled))
    return np.asarray(level + np.interp(np.arange(values.size), there, filled[there]))
