"""How far the runs of one axis scatter beyond their noise, and the uncertainty of what is computed from them.

A mean over whole turns knows the noise within its run. Between runs scale factor, table rate and bias change by
amounts that nobody states well. The residuals of the fit over all runs show them, with a few degrees of freedom
only, so every size of that scatter which they allow is weighed with its likelihood:

    variance of a run     v = u^2 + (s_0 F)^2 + rho^2 [ (1 - a) (F/F_rms)^2 + a ]
    likelihood            of the residuals given v (restricted: freed of the fitted parameters)
    slow noise            where the noise model of the gyro is known, its covariance comes to v, window by window
    prior                 rho/(rho + u_rms)^2 and a part of 1.5 at rho = 0 (4 with a noise model); a from 0 to 1

F is the run's own output, s_0 what is stated, rho the scatter beyond it, a the part of it that does not grow with
the output (bias) while the rest does (scale factor, table). What is linear in the means has, given rho and a, a
normal error; over all of them it is a mixture, whose 95 % interval is given. Where the scatter between runs rules,
that is Student's t; where their noise does, the normal interval.
"""

import functools
from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.optimize
import scipy.special
from numpy.typing import ArrayLike

from analysis.arrays import NORMAL_95, Bools, Floats

_SIZES = 32
_PARTS = np.array([0.0, 0.001, 0.01, 0.1, 0.5, 1.0])
"""Shares of the variance that do not grow with the output; of three axes at once outputs differ a thousandfold."""
_NONE_BEYOND = 1.5  # weight of no scatter at all
_NONE_BEYOND_A_MODEL = 4.0  # where a noise model says what the gyro's slow noise makes of the runs
_ASSUMED = 10e-6
"""Scatter of scale factor and table from run to run where no run repeats another and nobody states it: of a table
that is neither the best (1 ppm) nor a cheap one (100 ppm)."""


def few_values_factor(freedom: int) -> float:
    """By how much a standard deviation of few values is widened, so that 1.96 of it hold 95 %.

    Examples
    --------
    >>> round(few_values_factor(5), 3), round(few_values_factor(10_000), 3)
    (1.312, 1.0)
    """
    return float(scipy.special.stdtrit(max(freedom, 1), 0.975)) / NORMAL_95


@dataclass(frozen=True)
class RunScatter:
    """Variances that the runs may have."""

    variance: Floats  # (h, n): of each run under each hypothesis, counts^2
    weight: Floats  # (h,): probability of each hypothesis
    assumed: bool  # whether the runs cannot show their scatter and nobody states it
    # (n,): parts of the variance that are known: noise within each run, and stated irreproducibility
    noise: Floats
    stated: Floats
    # (n, n): covariance of slow noise by a noise model, about its mean over all runs; zeros without one
    slow: Floats

    def mean_covariance(self) -> Floats:
        """Mean of the covariances, shape (n, n)."""
        return np.asarray(np.diag(self.weight @ self.variance) + self.slow, dtype=np.float64)

    def known_covariance(self) -> Floats:
        """Covariance without the scatter that the residuals show, shape (n, n)."""
        return np.asarray(np.diag(self.noise + self.stated) + self.slow, dtype=np.float64)

    def estimator(self, design: Floats, *, by_known: bool = False) -> Floats:
        """Factors of the means in each parameter by weighted least squares, shape (p, n)."""
        root = np.linalg.cholesky(self.known_covariance() if by_known else self.mean_covariance())
        weighted = np.asarray(scipy.linalg.solve_triangular(root, design, lower=True))
        # columns are scaled first, the rates and the ones differ
        scale = np.linalg.norm(weighted, axis=0)
        factors = np.linalg.pinv(weighted / scale) / scale[:, np.newaxis]
        return np.asarray(scipy.linalg.solve_triangular(root, factors.T, lower=True, trans="T").T)

    def standard_u(self, combination: Floats) -> float:
        """Standard uncertainty of a combination of the means: half the 95 % interval is 1.96 of it."""
        sigma = np.sqrt(self.variance @ combination**2 + combination @ self.slow @ combination)
        low, high = 0.0, 60.0 * float(sigma.max()) + 1e-300
        sigma = np.maximum(sigma, 1e-300)
        for _ in range(60):
            middle = (low + high) / 2
            inside = float(self.weight @ scipy.special.ndtr(middle / sigma))
            low, high = (middle, high) if inside < 0.975 else (low, middle)
        return (low + high) / 2 / NORMAL_95

    def parts(self, combination: Floats) -> dict[str, float]:
        """What each cause contributes to the standard uncertainty of a combination of the means, counts."""
        squares = {
            "noise": float(self.noise @ combination**2),
            "slow noise": float(combination @ self.slow @ combination),
            "stated": float(self.stated @ combination**2),
        }
        seen = self.standard_u(combination) ** 2 - sum(squares.values())
        return {name: float(np.sqrt(max(one, 0.0))) for name, one in {**squares, "scatter": seen}.items()}


def find_run_scatter(
    design: Floats,
    mean: Floats,
    noise_u: Floats,
    stated: float | None,
    *,
    slow: Floats | None = None,
    by_model: bool = False,
) -> RunScatter:
    """Weigh the scatter that the residuals of the runs allow."""
    noise, irreproducible = noise_u**2, ((stated or 0.0) * mean) ** 2
    known = noise + irreproducible
    covariance = np.zeros((mean.size, mean.size)) if slow is None else slow - slow.mean(axis=0)
    covariance -= covariance.mean(axis=1)[:, np.newaxis]  # without the mean over all
    parts = noise, irreproducible, covariance
    freedom = mean.size - design.shape[1]
    if freedom < 1:
        beyond = _ASSUMED if stated is None else 0.0
        return RunScatter((known + (beyond * mean) ** 2)[np.newaxis], np.ones(1), stated is None, *parts)
    scaled = design / np.linalg.norm(design, axis=0)
    left = mean - scaled @ np.linalg.lstsq(scaled, mean, rcond=None)[0]
    quiet = float(np.sqrt(np.mean(known + np.diag(covariance))))
    largest = 30.0 * float(np.sqrt(left @ left / freedom)) + 10.0 * quiet
    size = np.concatenate([[0.0], np.geomspace(2e-2 * quiet, largest, _SIZES)])
    width = np.gradient(size)
    square = (mean / np.sqrt(np.mean(mean**2))) ** 2
    shape = (1 - _PARTS[:, np.newaxis]) * square + _PARTS[:, np.newaxis]
    variance = (known + size[:, np.newaxis, np.newaxis] ** 2 * shape).reshape(-1, mean.size)
    likelihood = _log_likelihood(variance, scaled, left, None if slow is None else covariance)
    # with them 1.96 u hold 92 to 97 % whatever the scatter is, with five degrees of freedom and more
    share = width * size / (size + quiet) ** 2
    share[0] = _NONE_BEYOND_A_MODEL if by_model else _NONE_BEYOND
    prior = np.log(share)
    likelihood += np.repeat(prior, _PARTS.size)
    weight = np.exp(likelihood - likelihood.max())
    return RunScatter(variance, weight / weight.sum(), False, *parts)


def _log_likelihood(variance: Floats, design: Floats, left: Floats, slow: Floats | None) -> Floats:
    """Restricted likelihood of the residuals under each row of variances, shape (h,)."""
    if slow is not None:
        return _log_likelihood_with(variance, design, left, slow)
    heavy = 1 / variance
    normal = np.einsum("hn,ni,nj->hij", heavy, design, design, optimize=True)
    moment = np.einsum("hn,ni->hi", heavy * left, design)
    fitted = np.linalg.solve(normal, moment[..., np.newaxis])[..., 0]
    square = heavy @ left**2 - np.einsum("hi,hi->h", moment, fitted)
    determinant = np.linalg.slogdet(normal)[1]
    return np.asarray(-0.5 * (np.log(variance).sum(axis=1) + determinant + square), dtype=np.float64)


def _log_likelihood_with(variance: Floats, design: Floats, left: Floats, slow: Floats) -> Floats:
    """The same with a covariance that comes to each of them."""
    whole = slow + variance[:, :, np.newaxis] * np.eye(left.size)
    both = np.column_stack([design, left])
    solved = np.linalg.solve(whole, np.broadcast_to(both, (variance.shape[0], *both.shape)))
    products = both.T @ solved
    normal, moment = products[:, :-1, :-1], products[:, :-1, -1]
    fitted = np.linalg.solve(normal, moment[..., np.newaxis])[..., 0]
    square = products[:, -1, -1] - np.einsum("hi,hi->h", moment, fitted)
    determinant = np.linalg.slogdet(whole)[1] + np.linalg.slogdet(normal)[1]
    return np.asarray(-0.5 * (determinant + square), dtype=np.float64)


# --------------------
# How much of a power is no noise, where the variance of the noise was measured too and is uncertain itself.
#
# The interval of Feldman and Cousins: a size of the signal belongs to it if the power that was seen is among the
# 95 % that are likeliest under it, likeliest against the size that suits each power best. It holds as often as it
# says whatever the signal is, and is never empty: a power that chance made less than the noise has on the average
# would leave nothing of an interval with equal tails. (G. J. Feldman, R. D. Cousins, "Unified approach to the
# classical statistical analysis of small signals", Phys. Rev. D 57, 3873, 1998.)


_LEVELS = (np.arange(40) + 0.5) / 40
_CLEAR = 1e-4  # chance of noise alone to have so much power, below which equal tails are as good
_MOST_POWERS = 400.0  # with more degrees of freedom noise has no tail to speak of
_FEWEST = 4.0  # degrees of freedom of the measured variance
_NONE = 1e-9  # of the power of the noise
_FAR = 200.0  # argument of the Bessel function
_SIGNALS, _POWERS, _VARIANCES = 48, 180, 8


def signal_interval(power: float, own: float, freedom: float) -> tuple[float, float]:
    """95 % interval of the power of a signal."""
    # Power over the variance of the noise is chi-square with the signal's power over the same variance as
    # noncentrality; the variance is the one that was measured times `freedom` over chi-square.
    variance = _variances(freedom, _LEVELS)
    noise_alone = float(np.mean(scipy.special.chdtrc(own, power / variance)))
    if noise_alone < _CLEAR or own > _MOST_POWERS or freedom < _FEWEST:
        return _with_probability(power, own, variance, 0.975), _with_probability(power, own, variance, 0.025)
    plane = _plane(own, freedom)
    seen = _log_density(np.array([max(power, _NONE * own)]), plane.signal, own, plane.variances)
    favour = seen - seen.max()
    # of the powers that a signal favours more than the one that was seen
    before = np.sum(plane.share * (plane.favour > favour), axis=1)
    best = int(np.argmax(favour))
    falling, rising = (np.maximum.accumulate(one) for one in (before[best::-1], before[best:]))
    low = float(np.interp(0.95, falling, plane.signal[best::-1])) if falling[-1] > 0.95 else 0.0
    return low, float(np.interp(0.95, rising, plane.signal[best:]))


@dataclass(frozen=True)
class _Plane:
    """Signals against powers, for all powers that noise alone may have."""

    signal: Floats  # (s,)
    # (s, p): Logarithm of the density of a power over that under the signal that suits it best; probability
    favour: Floats
    share: Floats
    variances: Floats  # (v,)


@functools.lru_cache(maxsize=16)
def _plane(own: float, freedom: float) -> _Plane:
    every, variances = (_variances(freedom, (np.arange(n) + 0.5) / n) for n in (_LEVELS.size, _VARIANCES))
    most = 2.0 * own
    while float(np.mean(scipy.special.chdtrc(own, most / every))) > _CLEAR:
        most *= 1.2
    top = 2.0 * _with_probability(most, own, every, 0.005)
    signal = top * np.linspace(0.0, 1.0, _SIGNALS) ** 2
    most = 1.5 * (own + top) + 10.0 * float(np.sqrt(own + 2 * top))
    edges = most * np.linspace(0.0, 1.0, _POWERS + 1) ** 2
    chance = _log_density((edges[:-1] + edges[1:]) / 2, signal, own, variances)
    return _Plane(signal, chance - chance.max(axis=0), np.exp(chance) * np.diff(edges), variances)


def _variances(freedom: float, levels: Floats) -> Floats:
    """True variances of the noise over the measured one that are equally likely."""
    return np.asarray(freedom / scipy.special.chdtri(freedom, levels), dtype=np.float64)


def _log_density(power: Floats, signal: Floats, own: float, variances: Floats) -> Floats:
    """Logarithm of the density of each power under each signal, shape (signals, powers)."""
    total = np.full((signal.size, power.size), -np.inf)
    for variance in variances:
        x, size = power / variance, signal[:, np.newaxis] / variance
        alone = (own / 2 - 1) * np.log(x / 2) - x / 2 - scipy.special.gammaln(own / 2) - np.log(2 * variance)
        total = np.logaddexp(total, alone - size / 2 + _log_hyp0f1(own / 2, np.sqrt(size * x)))
    return np.asarray(total - np.log(variances.size), dtype=np.float64)


def _log_hyp0f1(b: float, z: Floats) -> Floats:
    """Logarithm of 0F1(b; z^2/4), which is a Bessel function where it would overflow."""
    found = np.log(scipy.special.hyp0f1(b, np.minimum(z, _FAR) ** 2 / 4))
    far = z > _FAR
    bessel = np.log(scipy.special.ive(b - 1, z[far])) + z[far]
    found[far] = scipy.special.gammaln(b) + (1 - b) * np.log(z[far] / 2) + bessel
    return np.asarray(found, dtype=np.float64)


def _with_probability(power: float, own: float, variance: Floats, probability: float) -> float:
    """Signal power with which so much power or less has this probability; 0 if there is none."""

    def chance(size: float) -> float:
        return float(np.mean(scipy.special.chndtr(power / variance, own, size / variance)))

    if chance(0.0) < probability:
        return 0.0
    high = 4.0 * power + 100.0
    while chance(high) > probability:
        high *= 2.0
    found = scipy.optimize.brentq(lambda size: chance(size) - probability, 0.0, high, xtol=1e-4 * (1 + power))
    return float(found)


# --------------------
# Output words that no gyro sent: single words far beyond the noise around them.
#
# Few and far is what makes an outlier. Words far out that come often belong to the gyro: with a 2 pi error and all
# samples used, each fall of the staircase leaves a pulse in its word, and their mean is part of the output


_BLOCK = 64  # words whose median is the level around a word: drift and the earth rate's sine count in it
_FAR_OUT = 8.0  # standard deviations
_STEPS = 10.0  # of a word that hardly moves, in its smallest steps
_FEW = 0.002  # of all words, or three


def outliers(words: ArrayLike) -> Bools:
    """Tell which words are outliers; nan is none."""
    values = np.asarray(words, dtype=np.float64)
    none = np.zeros(values.size, dtype=np.bool_)
    if values.size < 8:
        return none
    left = np.abs(values - _level(values))
    known = left[np.isfinite(left)]
    spread = 1.4826 * float(np.median(known)) if known.size else 0.0
    if known.size == 0 or (spread > 0 and float(known.max()) <= _FAR_OUT * spread):
        return none
    levels = np.unique(values[np.isfinite(values)])
    step = float(np.diff(levels).min()) if levels.size > 1 else 0.0
    far = left > max(_FAR_OUT * spread, _FAR_OUT / 3.3 * float(np.quantile(known, 0.9)), _STEPS * step)
    return far if 0 < far.sum() <= max(3.0, _FEW * values.size) else none


def _level(values: Floats) -> Floats:
    """Level around each word: the medians of blocks, joined by straight lines."""
    count = max(1, values.size // _BLOCK)
    edges = np.linspace(0, values.size, count + 1).round().astype(np.intp)
    width = int(np.diff(edges).min())
    blocks = np.stack([values[begin : begin + width] for begin in edges[:-1]])
    gone = np.isnan(blocks)
    medians = np.full(count, np.nan)
    whole = ~gone.any(axis=1)
    if whole.any():
        medians[whole] = np.median(blocks[whole], axis=1)
    for place in np.flatnonzero(~whole & ~gone.all(axis=1)):
        medians[place] = np.nanmedian(blocks[place])
    there = np.isfinite(medians)
    if not there.any():
        return np.zeros(values.size)
    centres = edges[:-1] + (width - 1) / 2
    return np.asarray(np.interp(np.arange(values.size), centres[there], medians[there]), dtype=np.float64)
