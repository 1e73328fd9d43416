"""How fast the output follows: bandwidth and delay from injected steps, or from a sine of the rate table.

A gyro's filter is one of four forms, H(f) its transfer function, S(t) its answer to a step, w = 2 pi f:

    no filter                                H = 1
    low-pass of first order                  H = 1/(1 + i w T)
    low-pass of second order                 H = w_0^2/(w_0^2 - w^2 + 2 i z w_0 w)
    sliding mean over T                      H = (1 - exp(-i w T))/(i w T)

all behind a pure delay. A word is the mean over its interval h, so a step a_j at s_j gives

    y_k = B + R t_k + g sum_j a_j [I(e_k - s_j - d_j) - I(e_k - h - s_j - d_j)]/h,      I the integral of S,

e_k the end of the word: exact at any time of the step within a word. Steps whose time nobody knows to a word,
since a command takes its way, have a delay d_j of their own. Which form it is the data say (Bayesian criterion).

A sine gives the ratio of output and input at its frequency; both are means over the same words, which takes the
mean out. The delay is that at low frequency, -(d arg H/dw) at 0, with the pure one in it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from analysis.arrays import NORMAL_95, Bools, Complexes, Floats, Ints

_STARTS = 14
_AFTER = 4.0  # delays and time constants behind a step, within which the words see its shape
_OFF, _OFF_AT_LEAST = 5.0, 0.05  # standard deviations and share of the power by which no form is off
_FINE = 0.02  # of the smallest time constant that is tried, in the interval of the words
_WIDEST = 0.25  # of the time between two steps, that a form may take
_DECAYED = 40.0  # time constants
_UNTOLD = 1e-13
_ROUNDED, _FOLLOWS = 1e-9, 6.0  # part of a step that is rounding; u of the gain that an output that follows has
_ODD, _ODD_U = 0.02, 8.0  # part of a step by which the output may go another way, and in u
_FEWEST_BETWEEN = 8  # outputs
_MOST_STEPS, _MOST_LATE, _MOST_WORDS = 400, 24, 20_000  # steps, those with a delay of their own, and words
_TRIES = 3  # beginnings of a fit
_UNSEEN, _SCAN = 4.0, 25  # square of the standard deviations by which a low-pass is not seen; times that are tried
_SETTLED = 0.25  # of the words behind steps, where the output should be at rest
_LAGS = 40  # words over which errors may go together


Params = Sequence[float] | Floats  # logarithms of a form's times, and of its damping


@dataclass(frozen=True)
class Form:
    """A form of filter."""

    name: str
    start: Callable[[float], list[float]]  # parameters for a delay of so many seconds
    integral: Callable[[Floats, Params], Floats]  # of the step response, at times of 0 and more
    transfer: Callable[[Floats, Params], Complexes]
    bandwidth_hz: Callable[[Params], float]  # where the power is half
    delay_s: Callable[[Params], float]  # at low frequency
    rests_s: Callable[[Params], float]  # from when on nothing of a step is to come


def _second_integral(t: Floats, p: Params) -> Floats:
    natural, damping = np.exp(-p[0]), np.exp(p[1])
    root = np.sqrt(complex(damping**2 - 1)) or 1e-6
    first, second = natural * (-damping + root), natural * (-damping - root)
    inner = second / first * np.expm1(first * t) - first / second * np.expm1(second * t)
    return np.asarray(t - (inner / (second - first)).real)


def _second_bandwidth(p: Params) -> float:
    inner = 1 - 2 * np.exp(2 * p[1])
    return float(np.exp(-p[0]) * np.sqrt(inner + np.sqrt(inner**2 + 1)) / (2 * np.pi))


FORMS = (
    Form(
        "no filter", lambda d: [], lambda t, p: t, lambda f, p: np.ones(f.shape, dtype=np.complex128),
        lambda p: float("nan"), lambda p: 0.0, lambda p: 0.0,
    ),
    Form(
        "low-pass of first order", lambda d: [float(np.log(d))],
        lambda t, p: t + np.exp(p[0]) * np.expm1(-t / np.exp(p[0])),
        lambda f, p: 1 / (1 + 2j * np.pi * f * np.exp(p[0])),
        lambda p: float(np.exp(-p[0]) / (2 * np.pi)), lambda p: float(np.exp(p[0])),
        lambda p: _DECAYED * float(np.exp(p[0])),
    ),
    Form(
        "low-pass of second order", lambda d: [float(np.log(d / 1.4)), float(np.log(0.7))], _second_integral,
        lambda f, p: 1 / (1 - (2 * np.pi * f * np.exp(p[0])) ** 2 + 4j * np.pi * f * np.exp(p[0] + p[1])),
        _second_bandwidth, lambda p: float(2 * np.exp(p[0] + p[1])),
        lambda p: _DECAYED * float(np.exp(p[0]) * max(2 * np.exp(p[1]), np.exp(-p[1]))),
    ),
    Form(
        "sliding mean", lambda d: [float(np.log(2 * d))],
        lambda t, p: np.where(t < np.exp(p[0]), t**2 / (2 * np.exp(p[0])), t - np.exp(p[0]) / 2),
        lambda f, p: np.sinc(f * np.exp(p[0])) * np.exp(-1j * np.pi * f * np.exp(p[0])),
        lambda p: float(0.44295 * np.exp(-p[0])), lambda p: float(np.exp(p[0]) / 2),
        lambda p: float(np.exp(p[0])),
    ),
)  # fmt: skip


@dataclass(frozen=True)
class StepTrain:
    """Steps of the input."""

    at_s: Floats  # since the begin of the first word, and by how much the output should go on
    height: Floats
    exact: bool  # whether the times are those of the steps, not of commands that take their way


@dataclass(frozen=True)
class FilterResponse:
    """What was found of the filter."""

    form: Form
    parameters: Floats
    gain: float
    gain_u: float
    bandwidth_hz: float  # where nothing is seen of a filter: at least so much; its u is nan then
    bandwidth_u_hz: float
    delay_s: float  # at low frequency; nan where the times of the steps are not known
    delay_u_s: float
    jitter_s: float  # standard deviation of the times that commands took; nan where those of the steps are known
    misfit: float  # power of what the form leaves behind the steps over that elsewhere; nan where it fits
    settled: bool  # whether the output comes to rest between the steps
    odd_step_s: float  # when the first step was that the output did not follow; nan where it followed all
    since_s: Floats  # (m,): time of words since their step, and where between 0 and 1 they are
    risen: Floats

    def transfer(self, frequency_hz: ArrayLike) -> Complexes:
        """Transfer function of the filter without the pure delay."""
        return self.form.transfer(np.asarray(frequency_hz, dtype=np.float64), self.parameters)


def step_response(words: ArrayLike, interval_s: float, steps: StepTrain) -> FilterResponse:
    """Find the filter by steps of the input.

    Parameters
    ----------
    words : array_like, shape (n,)
        Output; nan where a word is missing.
    interval_s : float
    steps : StepTrain
        Several, each long after the one before. Of very many the first ones are used.

    Raises
    ------
    ValueError
        The output does not follow the steps, there are fewer than two, or they follow one another too fast.
    """
    if steps.at_s.size < 2:
        raise ValueError(f"two steps of the input are needed, not {steps.at_s.size}")
    if float(np.diff(steps.at_s).min()) < _FEWEST_BETWEEN * interval_s:
        raise ValueError(f"between two steps of the input there are not {_FEWEST_BETWEEN} outputs")
    number = min(steps.at_s.size, _MOST_STEPS if steps.exact else _MOST_LATE)
    end = float(steps.at_s[number]) if number < steps.at_s.size else np.inf
    # however many words there are: those of two steps and what is behind them
    least = steps.at_s[3] if steps.at_s.size > 3 else 2 * steps.at_s[-1] - steps.at_s[-2]
    end = min(end, max(_MOST_WORDS * interval_s, float(least)))
    y = np.asarray(words, dtype=np.float64)[: int(min(end / interval_s, 1e15))]
    inside = steps.at_s < y.size * interval_s
    steps = StepTrain(steps.at_s[inside], steps.height[inside], steps.exact)
    ends = interval_s * np.arange(1, y.size + 1, dtype=np.float64)
    seen = _StepWords(y, np.isfinite(y), ends, interval_s, steps)
    apart = float(np.diff(steps.at_s).min())
    lag = _half_risen(seen, apart)
    fits = []
    for form in FORMS:
        number = len(form.start(1.0))
        starts = []
        for delay in np.geomspace(_FINE * interval_s, _WIDEST * apart, _STARTS) if number else [interval_s]:
            for shift in (-0.5, 0.0, 0.5):
                start = form.start(delay)
                begin = np.array([lag + shift * interval_s - 0.7 * form.delay_s(start), *start])
                starts.append((float(np.sum(seen.left(begin, form)[0] ** 2)), begin))
        starts.sort(key=lambda one: one[0])
        free = 0 if steps.exact else steps.at_s.size  # times of their own
        bounds = [(-apart, apart), *[(np.log(_FINE * interval_s / 4), np.log(apart))] * min(number, 1)]
        bounds += [(np.log(0.05), np.log(20.0))] * (number - 1) + [(-apart / 4, apart / 4)] * free
        low, high = np.array(bounds).T
        tries = [
            least_squares(
                partial(seen.left_over, form),
                np.clip(np.concatenate([begin, np.zeros(free)]), low + 1e-9, high - 1e-9),
                jac=partial(seen.jacobian, form),
                bounds=(low, high),
                max_nfev=60,
                x_scale=np.concatenate([[interval_s], np.full(number, 0.1), np.full(free, interval_s)]),
            )
            for _, begin in starts[:_TRIES]
        ]
        best = min(tries, key=lambda one: float(one.cost))
        penalty = np.log(seen.there.sum()) * number * (1 if steps.exact else 2)
        score = seen.there.sum() * np.log(max(float(best.cost), 1e-300)) + penalty
        fits.append((score, form, np.asarray(best.x)))
    return _as_response(seen, *min(fits, key=lambda one: one[0])[1:])


def _half_risen(seen: _StepWords, apart: float) -> float:
    """When the mean step is half done, s behind it."""
    since, steps = np.arange(0.0, apart, seen.h), seen.steps
    rows = [
        np.interp(at + since, seen.ends[seen.there], seen.y[seen.there]) * np.sign(by)
        for at, by in zip(steps.at_s, steps.height, strict=True)
    ]
    mean = np.mean(rows, axis=0)
    first, last = float(mean[0]), float(np.median(mean[mean.size // 2 :]))
    if last == first:
        raise ValueError("the output does not follow the steps of the input")
    return float(since[int(np.argmax((mean - first) / (last - first) > 0.5))] - seen.h / 2)


@dataclass(frozen=True)
class _StepWords:
    """Output words and the steps of the input."""

    y: Floats
    there: Bools
    ends: Floats
    h: float
    steps: StepTrain

    @property
    def scale(self) -> float:
        return float(np.nanstd(self.y)) or 1.0

    @property
    def others(self) -> Floats:
        """Constant and drift."""
        return np.column_stack([np.ones(self.ends.size), (self.ends - self.ends.mean()) / self.ends[-1]])

    def windows(self, at: Floats, form: Form) -> tuple[Ints, Floats, Floats]:
        """Words behind each step until it is over, their ends since the step (n of steps, m), and parameters."""
        number = len(form.start(1.0))
        filter_of, own = at[1 : 1 + number], at[1 + number :]
        begun = self.steps.at_s + at[0] + (own if own.size else 0.0)
        count = min(int(form.rests_s(filter_of) / self.h) + 4, self.ends.size + 1)
        words = np.floor(begun / self.h).astype(np.int64)[:, np.newaxis] + np.arange(count)
        return words, (words + 1) * self.h - begun[:, np.newaxis], filter_of

    def means(self, form: Form, since: Floats, filter_of: Floats) -> Floats:
        """Of the words that end then, one after the other, for a step of 1 at 0."""
        ends = np.maximum(np.column_stack([since[:, 0] - self.h, since]), 0.0)
        return np.diff(form.integral(ends, filter_of)) / self.h

    def shape(self, at: Floats, form: Form) -> Floats:
        """Output of all steps for a gain of 1."""
        words, since, filter_of = self.windows(at, form)
        added = np.diff(self.means(form, since, filter_of), prepend=0.0, append=1.0)
        place = np.clip(np.column_stack([words, words[:, -1] + 1]), 0, self.ends.size)
        added *= self.steps.height[:, np.newaxis]
        return np.cumsum(np.bincount(place.ravel(), added.ravel(), self.ends.size + 1)[:-1])

    def of_delays(self, at: Floats, form: Form) -> Floats:
        """How the shape goes with the delay of each step, (n, steps), or of all together, (n, 1)."""
        words, since, filter_of = self.windows(at, form)
        near = 1e-4 * self.h
        slope = self.means(form, since - near, filter_of) - self.means(form, since + near, filter_of)
        slope *= self.steps.height[:, np.newaxis] / (2 * near)
        place = np.where(words < 0, self.ends.size, np.minimum(words, self.ends.size))
        if self.steps.exact:
            together = np.bincount(place.ravel(), slope.ravel(), self.ends.size + 1)[:-1]
            return np.asarray(together[:, np.newaxis], dtype=np.float64)
        found = np.zeros((self.ends.size + 1, len(words)))
        found[place.T, np.arange(len(words))] = slope.T
        return found[:-1]

    def left(self, at: Floats, form: Form) -> tuple[Floats, Floats]:
        """What the best constant, drift and gain leave; and those."""
        design = np.column_stack([self.others, self.shape(at, form)])[self.there]
        linear = np.asarray(np.linalg.lstsq(design, self.y[self.there], rcond=None)[0], dtype=np.float64)
        return np.asarray(self.y[self.there] - design @ linear), linear

    def slopes(self, at: Floats, form: Form, gain: float) -> Floats:
        """How the output goes with each parameter."""
        number, of_delays = len(form.start(1.0)), self.of_delays(at, form)
        columns = [of_delays.sum(axis=1)]
        for place in range(1, 1 + number):
            step = np.zeros(at.size)
            step[place] = 1e-4
            columns.append((self.shape(at + step, form) - self.shape(at - step, form)) / 2e-4)
        own = [of_delays] if at.size > 1 + number else []  # none where the times are exact
        return gain * np.column_stack([*columns, *own])[self.there]

    def left_over(self, form: Form, at: Floats) -> Floats:
        """What is left, in the scatter of the words."""
        return self.left(at, form)[0] / self.scale

    def jacobian(self, form: Form, at: Floats) -> Floats:
        """Its derivatives, constant, drift and gain always being the best (Kaufman)."""
        shape, (_, linear) = self.shape(at, form), self.left(at, form)
        basis = np.linalg.qr(np.column_stack([self.others, shape])[self.there])[0]
        slopes = self.slopes(at, form, float(linear[2]))
        return np.asarray(basis @ (basis.T @ slopes) - slopes) / self.scale

    def covariance(self, at: Floats, form: Form) -> Floats:
        """Of the parameters and, last, constant, drift and gain; errors of neighbours may go together."""
        residual, linear = self.left(at, form)
        others = np.column_stack([self.others, self.shape(at, form)])[self.there]
        design = np.column_stack([self.slopes(at, form, float(linear[2])), others])
        inner = _inverse(design)
        scores = design * residual[:, np.newaxis]
        middle = scores.T @ scores
        for lag in range(1, min(_LAGS, residual.size // 10)):
            part = scores[lag:].T @ scores[:-lag] * (1 - lag / _LAGS)
            middle = middle + part + part.T
        plain = float(residual @ residual) / max(residual.size - design.shape[1], 1) * inner
        # of few words what goes together may be small by chance
        robust = np.diag(inner @ middle @ inner) / np.maximum(np.diag(plain), 1e-300)
        larger = np.sqrt(np.maximum(robust, 1.0))
        return np.asarray(plain * np.outer(larger, larger))


def _as_response(seen: _StepWords, form: Form, at: Floats) -> FilterResponse:
    residual, linear = seen.left(at, form)
    covariance, steps, h = seen.covariance(at, form), seen.steps, seen.h
    count = 1 + len(form.start(1.0))
    own = at[count:]
    bandwidth, bandwidth_u = _with_u(lambda p: form.bandwidth_hz(p[1:count]), at, covariance)
    if count == 1:  # as slow as a low-pass may be that would not be seen
        most = float(residual @ residual) * (1 + _UNSEEN / residual.size)
        bandwidth, bandwidth_u = 1 / (2 * np.pi * _FINE * h), float("nan")
        for time in np.geomspace(_FINE * h, h, _SCAN):
            trials = (
                np.array([at[0] - time + shift * h, np.log(time), *own]) for shift in np.linspace(-0.2, 0.2, 9)
            )
            if min(float(np.sum(seen.left(trial, FORMS[1])[0] ** 2)) for trial in trials) < most:
                bandwidth = FORMS[1].bandwidth_hz([float(np.log(time))])
    delay, delay_u = _with_u(lambda p: p[0] + form.delay_s(p[1:count]), at, covariance)
    ends = seen.ends[seen.there]
    last = np.searchsorted(steps.at_s, ends - h, side="right") - 1  # the step before each word
    since = ends - steps.at_s[last] - (own[last] if own.size else 0.0)
    before = np.concatenate([[0.0], np.cumsum(steps.height)])[last]
    level = (seen.y - seen.others @ linear[:2])[seen.there] / linear[2]
    behind, window = last >= 0, _AFTER * max(delay, h) + 2 * h
    inside = behind & (since < window)
    shown = behind & (since < 3 * window)
    of_shape, usual = residual[inside], residual[behind & ~inside]
    power = float("nan")
    settled = usual.size > _SETTLED * residual[behind].size
    if settled:
        least = (_ROUNDED * linear[2] * float(np.abs(steps.height).max())) ** 2
        power = float(np.mean(of_shape**2)) / (float(np.mean(usual**2)) + least)
        if power - 1 < max(_OFF * np.sqrt(2 / of_shape.size + 2 / usual.size), _OFF_AT_LEAST):
            power = float("nan")
    gain, gain_u = float(linear[2]), float(np.sqrt(covariance[-1, -1]))
    if not abs(gain) > _FOLLOWS * gain_u:
        raise ValueError("the output does not follow the steps of the input: its noise is as large, or none came")
    # where the output rests before and behind each step
    off, size = np.full(steps.at_s.size + 1, np.nan), np.ones(steps.at_s.size + 1)
    for place in range(-1, steps.at_s.size):
        rests = residual[(last == place) & ((since > window) | (place < 0))] / gain
        if rests.size > 3:
            off[place + 1], size[place + 1] = np.median(rests), np.std(rests) / np.sqrt(rests.size)
    jumps = np.abs(np.diff(off)) / np.abs(steps.height)
    usual_jump = float(np.nanmedian(jumps)) if np.isfinite(jumps).any() else 0.0
    odd = np.flatnonzero(jumps > np.maximum(_ODD, _ODD_U * (np.hypot(size[1:], size[:-1]) + usual_jump)))
    nothing = float("nan"), float("nan")
    return FilterResponse(
        form, at[1:count], gain, gain_u, bandwidth, bandwidth_u,
        *((delay, delay_u) if steps.exact else nothing), float(np.std(own, ddof=1)) if own.size else nothing[0],
        power, bool(settled), float(steps.at_s[odd[0]]) if odd.size else nothing[0], since[shown],
        ((level - before) / steps.height[last])[shown],
    )  # fmt: skip


def _with_u(of: Callable[[Floats], float], at: Floats, covariance: Floats) -> tuple[float, float]:
    """A function of parameters and its standard uncertainty."""
    moves = 1e-5 * np.maximum(np.abs(at), 1e-4)
    slope = np.array([of(at + one) - of(at - one) for one in np.diag(moves)]) / (2 * moves)
    return of(at), float(np.sqrt(max(float(slope @ covariance[: at.size, : at.size] @ slope), 0.0)))


# --------------------
# A sine of the rate table


@dataclass(frozen=True)
class SinePoint:
    """Response at one frequency: output over input."""

    frequency_hz: float
    ratio: complex
    ratio_u: float  # of each of its parts


def sine_point(input_rate: ArrayLike, words: ArrayLike, interval_s: float) -> SinePoint:
    """Compare output words with the input, means over the same intervals in the same unit, at its frequency.

    Raises
    ------
    ValueError
        The input is no sine.
    """
    x, y = (np.asarray(one, dtype=np.float64) for one in (input_rate, words))
    there, at = np.isfinite(x) & np.isfinite(y), (np.arange(x.size) - (x.size - 1) / 2) * interval_s
    x, y, at = x[there], y[there], at[there]
    window = np.sin(np.pi * (np.arange(x.size) + 0.5) / x.size) ** 2
    lines = np.abs(np.fft.rfft(window * (x - x.mean())))
    frequency = float(lines.argmax()) / (x.size * interval_s)
    for _ in range(6):
        wave = np.exp(-2j * np.pi * frequency * at) * window * (x - x.mean())
        level, tilt = wave.sum() / window.sum(), (at * wave).sum() / (at**2 * window).sum()
        frequency += float((tilt / level).imag) / (2 * np.pi)
    turns = 2 * np.pi * frequency * at
    design = np.column_stack([np.ones(at.size), at / np.ptp(at), np.cos(turns), np.sin(turns)])
    parts = [np.linalg.lstsq(design, one, rcond=None)[0] for one in (x, y)]
    of_input, of_output = (complex(one[2], -one[3]) for one in parts)
    left = [one - design @ part for one, part in zip((x, y), parts, strict=True)]
    if np.std(left[0]) > 0.1 * abs(of_input) or frequency * np.ptp(at) < 2:
        raise ValueError("the input is no sine of one frequency over two periods and more")
    noise = np.hypot(np.std(left[1]), np.std(left[0]) * abs(of_output / of_input))
    return SinePoint(frequency, of_output / of_input, float(noise * np.sqrt(2 / at.size) / abs(of_input)))


def sine_response(points: Sequence[SinePoint]) -> FilterResponse:
    """Find the filter by sines.

    Raises
    ------
    ValueError
        There are fewer than four.
    """
    if len(points) < 4:
        raise ValueError(f"sines of four frequencies are needed to tell the filter, not {len(points)}")
    f = np.array([one.frequency_hz for one in points])
    ratio, u = np.array([one.ratio for one in points]), np.array([one.ratio_u for one in points])
    slope = float(np.polyfit(2 * np.pi * f, np.unwrap(np.angle(ratio)), 1, w=np.abs(ratio) / u)[0])

    def off(p: Floats, form: Form) -> Floats:
        model = p[0] * np.exp(-2j * np.pi * f * p[1]) * form.transfer(f, p[2:])
        return np.concatenate([((ratio - model) / u).real, ((ratio - model) / u).imag])

    fits = []
    for form in FORMS:
        delays = np.geomspace(1e-3, 3.0, _STARTS) / f.max() if form.start(1.0) else [0.0]
        starts = [
            np.array([sense * abs(ratio[0]), -slope - form.delay_s(p), *p])
            for p in map(form.start, delays)
            for sense in (1.0, -1.0)
        ]
        start = min(starts, key=lambda p: float(np.sum(off(p, form) ** 2)))
        found = least_squares(off, start, args=(form,), x_scale=np.maximum(np.abs(start), 1e-6))
        fits.append((2 * found.cost + np.log(2 * f.size) * start.size, form, found))
    _, form, best = min(fits, key=lambda one: one[0])
    freedom = 2 * f.size - best.x.size
    chi_square = 2 * best.cost / freedom
    covariance = _inverse(best.jac) * max(chi_square, 1.0)

    bandwidth, bandwidth_u = _with_u(lambda p: form.bandwidth_hz(p[2:]), best.x, covariance)
    if not form.start(1.0):
        first = next(one for one in fits if one[1] is FORMS[1])[2]
        wide = np.sqrt(_inverse(first.jac)[2, 2])
        bandwidth, bandwidth_u = FORMS[1].bandwidth_hz([first.x[2] + 2 * min(wide, 2.0)]), float("nan")
    misfit = chi_square if chi_square > 2 + 2 * NORMAL_95 * np.sqrt(2 / freedom) else float("nan")
    return FilterResponse(
        form, best.x[2:], *_with_u(lambda p: float(p[0]), best.x, covariance), bandwidth, bandwidth_u,
        *_with_u(lambda p: float(p[1]) + form.delay_s(p[2:]), best.x, covariance), float("nan"),
        misfit, True, float("nan"), np.empty(0), np.empty(0),
    )  # fmt: skip


def _inverse(jacobian: Any) -> Floats:
    """Covariance of parameters by the derivatives of what is left, in its standard deviations."""
    # what the data do not tell has next to no end, and not none
    rows = np.asarray(jacobian, dtype=np.float64)
    size = np.linalg.norm(rows, axis=0)
    size[size == 0] = 1.0
    squares, directions = np.linalg.eigh((rows / size).T @ (rows / size))
    inverse = directions / np.maximum(squares, _UNTOLD) @ directions.T
    return np.asarray(inverse / np.outer(size, size), dtype=np.float64)
