"""A quantity of a gyro over temperature, and over its change in time: model chosen by the data, with intervals.

    q = c_0 + c_1 (T - T_0) + ... + c_p (T - T_0)^p + d dT/dt + noise

Noise: that of each value, and a slow one beside it of unknown size, found by its likelihood. It may scatter from
value to value, over a fiftieth of the run (segments), with all times alike (1/f, the bias instability of fibre
gyros), or walk over the whole run: so neighbours that lie off together count once, and what is too slow to show is
known from what is not. A walk has no mean of its own: the constant is that of the run. Order p and the term dT/dt
are chosen by the corrected Akaike criterion

    AICc = -2 ln L + 2 k + 2 k (k + 1)/(n - k - 1)            k parameters, two of the noise among them

and the uncertainty counts that another model may be the right one (Burnham and Anderson), or another noise: with
the weight w of each model, exp(-AICc/2) of all, and the probability p of each noise under it, the coefficients are

    sum_m sum_h w_m p_mh Normal(b_mh, C_mh)

and u is such that 1.96 u on both sides of the chosen model hold 95 % of that. (Its standard deviation would be
ruled by what is unlikely and far off.)

Inside, Legendre polynomials over the measured range stand for the powers. Beyond that range nothing is given.

A thermometer that is late, or a gyro that warms up after it, bends the curve one way on the way up and the other
on the way down, which no polynomial does: the models are tried with the temperature of a little later and earlier.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.polynomial import Legendre, Polynomial
from numpy.typing import ArrayLike
from scipy.special import ndtr

from analysis.arrays import NORMAL_95, Floats, Ints

_SIZES = 18
SLOW_NOISES = ("from value to value", "from segment to segment", "as 1/f", "as a walk")  # kinds of slow noise
_SHARES = (0.15, 0.15, 0.5, 0.2)  # of them before the data: 1/f is what fibre gyros are known for
_SEGMENT, _SLOWEST = 0.02, 2.0  # of the time of the run
_FLICKER_TERMS = 10
_SEPARATE = 0.1  # part of the change of dT/dt that no polynomial in T explains: less cannot be told from one
_NEGLIGIBLE = 1e-7  # probability
_LAGS = np.array([1, 2, 4, 8, 16]) / 320.0  # of the time of the run, by which a thermometer may be late or early
_NOTHING_BEYOND = 2.0  # weight of no slow noise, in that of one up to the noise of a value


@dataclass(frozen=True)
class Candidate:
    """One model: polynomial order, whether dT/dt is in it, AICc above the least, and its weight."""

    order: int
    with_rate: bool
    aicc: float
    weight: float


@dataclass(frozen=True)
class Mixture:
    """What the coefficients may be: normal distributions, each with its probability."""

    weight: Floats  # (m,)
    mean: Floats  # (m, p)
    covariance: Floats  # (m, p, p)

    def standard_u(self, combinations: Floats, about: Floats) -> Floats:
        """Standard uncertainty of combinations of coefficients: 1.96 of it on both sides hold 95 %."""
        # Shapes: combinations (n, p), about (p,).
        off = (self.mean - about) @ combinations.T
        sigma = np.sqrt(np.einsum("ni,mij,nj->mn", combinations, self.covariance, combinations, optimize=True))
        sigma = np.maximum(sigma, 1e-300)
        low, high = np.zeros(off.shape[1]), np.max(np.abs(off) + 8 * sigma, axis=0)
        for _ in range(50):
            middle = (low + high) / 2
            inside = self.weight @ (ndtr((middle - off) / sigma) - ndtr((-middle - off) / sigma))
            low, high = np.where(inside < 0.95, middle, low), np.where(inside < 0.95, high, middle)
        return np.asarray((low + high) / 2 / NORMAL_95, dtype=np.float64)


@dataclass(frozen=True)
class OverTemperature:
    """Fitted model."""

    order: int
    with_rate: bool  # whether dT/dt is in it
    rate_known: bool  # whether the data can tell dT/dt from a polynomial in T
    reference: float  # T_0, deg C
    # (order + 1,): c_0, c_1, ...; unit of the values per kelvin to the power; with its uncertainty
    coefficients: Floats
    coefficients_u: Floats
    # d, unit of the values per unit of dT/dt; 0 where it was not chosen, with what may be hidden; with its
    # uncertainty
    rate_coefficient: float
    rate_coefficient_u: float
    lowest: float  # measured range, deg C
    highest: float
    candidates: tuple[Candidate, ...]  # all that were tried, the chosen one first
    residual: Floats  # (n,)
    noise_u: float  # mean noise of a value, and standard deviation of the slow noise (mean over what is likely)
    slow: float
    slow_kind: str  # the likeliest of `SLOW_NOISES`
    # by how much the thermometer is late where the values say so best, s, and by how much AICc is lower there
    lag_s: float
    lag_gain: float
    legendre: Floats
    likely: Mixture

    def at(self, temperature: ArrayLike) -> tuple[Floats, Floats]:
        """Value without dT/dt, and its standard uncertainty; nan outside the measured temperatures.

        Parameters
        ----------
        temperature : array_like, shape (n,)
            deg C.
        """
        wanted = np.atleast_1d(np.asarray(temperature, dtype=np.float64))
        inside = (wanted >= self.lowest) & (wanted <= self.highest)
        basis = self._basis(wanted)
        value, u = basis @ self.legendre, self.likely.standard_u(basis, self.legendre)
        return np.where(inside, value, np.nan), np.where(inside, u, np.nan)

    def span(self) -> tuple[float, float]:
        """Largest less smallest value over the measured temperatures, and the standard uncertainty."""
        everywhere = np.linspace(self.lowest, self.highest, 201)
        basis = self._basis(everywhere)
        value = basis @ self.legendre
        apart = basis[int(np.argmax(value))] - basis[int(np.argmin(value))]
        return float(np.ptp(value)), float(self.likely.standard_u(apart[np.newaxis], self.legendre)[0])

    def _basis(self, temperature: Floats) -> Floats:
        """Legendre polynomials there, and 0 for dT/dt, shape (n, p)."""
        polynomials = _legendre(temperature, self.lowest, self.highest, self.legendre.size - 2)
        return np.column_stack([polynomials, np.zeros(temperature.size)])


def fit_over_temperature(
    values: ArrayLike,
    values_u: ArrayLike,
    at_s: ArrayLike,
    temperature: ArrayLike,
    temperature_rate: ArrayLike | None = None,
    *,
    reference: float,
    highest_order: int = 4,
) -> OverTemperature:
    """Fit all models and choose one.

    Parameters
    ----------
    values, values_u : (n,)
        And the noise of each as a standard uncertainty.
    at_s : (n,)
        Times, s.
    temperature : (n,)
        deg C.
    temperature_rate : (n,), optional
        Without it dT/dt is in no model.
    reference : float
        T_0, deg C.
    highest_order : int, optional
        Of the polynomial; fewer where there are fewer values or temperatures.

    Raises
    ------
    ValueError
        Fewer than four values, or the temperature does not change.

    Examples
    --------
    >>> t = np.linspace(-20, 60, 60)
    >>> noise = np.random.default_rng(1).normal(0, 0.01, 60)
    >>> fit = fit_over_temperature(3 + 0.02 * t + noise, np.full(60, 0.01), np.arange(60.0), t, reference=0.0)
    >>> fit.order, bool(abs(fit.coefficients[1] - 0.02) < 4 * fit.coefficients_u[1] < 1e-3)
    (1, True)
    """
    value, u, at, warm = (np.asarray(v, dtype=np.float64) for v in (values, values_u, at_s, temperature))
    if value.size < 4 or not np.ptp(warm) > 0:
        raise ValueError(
            f"a model over the temperature needs four values at different temperatures, not {value.size} within "
            f"{np.ptp(warm) if warm.size else 0.0:.3g} K"
        )
    lowest, highest = float(warm.min()), float(warm.max())
    most = int(min(highest_order, np.unique(warm.round(1)).size - 1, value.size - 3))
    powers = _legendre(warm, lowest, highest, most)
    rate = np.zeros(value.size) if temperature_rate is None else np.asarray(temperature_rate, dtype=np.float64)
    scale = float(np.abs(rate).max())
    left = rate - powers @ np.linalg.lstsq(powers, rate, rcond=None)[0]  # what polynomials in T leave of it
    known = scale > 0 and bool(np.linalg.norm(left) > _SEPARATE * np.linalg.norm(rate))
    design = np.column_stack([powers, rate / (scale or 1.0)])
    trials = [
        (order, with_rate) for order in range(most + 1) for with_rate in ((False, True) if known else (False,))
    ]
    trials = [one for one in trials if value.size - sum(one) - 1 - 3 > 0] or [(0, False)]
    lags = float(np.ptp(at)) * np.concatenate([[0.0], _LAGS, -_LAGS])
    designs, by_time = [design], np.argsort(at)
    for lag in lags[1:]:
        later, its_rate = (np.interp(at + lag, at[by_time], one[by_time]) for one in (warm, rate / (scale or 1.0)))
        designs.append(np.column_stack([_legendre(later, lowest, highest, most), its_rate]))
    width = most + 2
    noise = _noise_hypotheses(value, u, at, np.hstack(designs), width)
    of_lags = [
        min(
            _fit([width * place + column for column in _columns(one, most)], noise, value.size).aicc
            for one in trials
        )
        for place in range(lags.size)
    ]
    fits = [_fit(_columns(one, most), noise, value.size) for one in trials]
    least = min(one.aicc for one in fits)
    weight = np.exp(-(np.array([one.aicc for one in fits]) - least) / 2)
    weight /= weight.sum()
    best = int(np.argmax(weight))
    chosen = fits[best]
    likely = _mixture(fits, weight, width)
    coefficients = chosen.coefficients[:width]
    latest = int(np.argmin(of_lags))
    order, with_rate = trials[best]
    # from coefficients of the Legendre polynomials to those of the powers of T - T_0
    to_powers = np.zeros((most + 1, most + 1))
    shifted = Polynomial([reference, 1.0])
    for degree in range(most + 1):
        power = Legendre.basis(degree, domain=[lowest, highest]).convert(kind=Polynomial)(shifted)
        to_powers[: degree + 1, degree] = power.coef[: degree + 1]
    powers = np.column_stack([to_powers, np.zeros(most + 1)])
    powers_u = likely.standard_u(powers, coefficients)
    ranked = sorted(range(len(trials)), key=lambda one: -float(weight[one]))
    rate_u = _rate_u(likely, coefficients, with_rate=with_rate) / scale if known else float("nan")
    return OverTemperature(
        order=order,
        with_rate=with_rate,
        rate_known=known,
        reference=reference,
        coefficients=(powers @ coefficients)[: order + 1],
        coefficients_u=powers_u[: order + 1],
        rate_coefficient=float(coefficients[-1]) / (scale or 1.0) if known else float("nan"),
        rate_coefficient_u=rate_u,
        lowest=lowest,
        highest=highest,
        candidates=tuple(Candidate(*trials[k], fits[k].aicc - least, float(weight[k])) for k in ranked),
        residual=np.asarray(value - design @ coefficients, dtype=np.float64),
        noise_u=float(np.sqrt(np.mean(u**2))),
        slow=float(chosen.likely @ noise.size),
        slow_kind=SLOW_NOISES[int(np.argmax(np.bincount(noise.kind, chosen.likely * noise.size)))],
        lag_s=float(lags[latest]),
        lag_gain=float(of_lags[0] - of_lags[latest]),
        legendre=coefficients,
        likely=likely,
    )


def _rate_u(likely: Mixture, chosen: Floats, *, with_rate: bool) -> float:
    """Standard uncertainty of the coefficient of dT/dt."""
    u = float(likely.standard_u(np.eye(chosen.size)[-1:], chosen)[0])
    if with_rate:
        return u
    # most models hold it to be nothing at all: 95 % of them would leave what may be hidden out
    hidden = likely.weight @ (likely.mean[:, -1] ** 2 + likely.covariance[:, -1, -1])
    return max(u, float(np.sqrt(hidden)))


def _columns(trial: tuple[int, bool], most: int) -> list[int]:
    order, with_rate = trial
    return [*range(order + 1), *([most + 1] if with_rate else [])]


def _legendre(temperature: Floats, lowest: float, highest: float, order: int) -> Floats:
    place = (2 * temperature - lowest - highest) / (highest - lowest)
    return np.asarray(np.polynomial.legendre.legvander(place, order), dtype=np.float64)


@dataclass(frozen=True)
class _Noise:
    """Hypotheses of the noise, (h, ...)."""

    size: Floats  # (h,): Of the slow noise; `kind` a place in `SLOW_NOISES`
    kind: Ints
    log_determinant: Floats  # (h,): Of the covariance V; of the hypothesis
    log_prior: Floats
    products: Floats  # (h, p + 1, p + 1): X^T V^-1 X, X the columns of the design and, last, the values


def _noise_hypotheses(value: Floats, u: Floats, at: Floats, design: Floats, width: int) -> _Noise:
    design, every = design[:, :width], design
    left = value - design @ np.linalg.lstsq(design, value, rcond=None)[0]
    quiet = float(np.sqrt(np.mean(u**2)))
    spread = float(np.sqrt(left @ left / max(value.size - design.shape[1], 1)))
    size = np.concatenate([[0.0], np.geomspace(0.05 * quiet, 10 * quiet + 20 * spread, _SIZES)])
    share = np.gradient(size) / (size + quiet / 3)
    share[0] = _NOTHING_BEYOND * float(share[size < quiet].sum())
    apart, span = np.abs(np.subtract.outer(at, at)), float(np.ptp(at)) or 1.0
    shortest = span / max(at.size - 1, 1)
    # equal parts for each decade of time make 1/f
    parts = [np.exp(-apart / theta) for theta in np.geomspace(shortest, _SLOWEST * span, _FLICKER_TERMS)]
    segments = np.exp(-apart / (_SEGMENT * span))
    walk = np.minimum.outer(at - at.min(), at - at.min())
    walk -= walk.mean(axis=0)
    walk -= walk.mean(axis=1)[:, np.newaxis]
    walk /= np.trace(walk) / at.size or 1.0
    shapes = [np.eye(at.size), segments, np.asarray(np.mean(parts, axis=0)), walk]
    rows = [(0.0, 0, float(share[0]))]
    rows += [
        (float(one), kind, float(weight) * _SHARES[kind])
        for one, weight in zip(size[1:], share[1:], strict=True)
        for kind in range(len(shapes))
    ]
    both = np.column_stack([every, value])
    products, determinants = [], []
    for one, kind, _ in rows:
        factor = np.linalg.cholesky(np.diag(u**2) + one**2 * shapes[kind])
        white = scipy.linalg.solve_triangular(factor, both, lower=True, check_finite=False)
        products.append(white.T @ white)
        determinants.append(2 * float(np.log(np.diag(factor)).sum()))
    sizes, kinds, weights = zip(*rows, strict=True)
    return _Noise(np.array(sizes), np.array(kinds), np.array(determinants), np.log(weights), np.array(products))


@dataclass(frozen=True)
class _Fit:
    """Mean coefficients of all columns (0 where not in it), AICc, and hypotheses of one model."""

    coefficients: Floats
    aicc: float
    likely: Floats  # (h,): Probability of each hypothesis of the noise
    columns: list[int]
    found: Floats  # (h, k): Under each of them
    covariances: Floats


def _fit(columns: list[int], noise: _Noise, n: int) -> _Fit:
    """Fit a model under every hypothesis of the noise, and weigh these with their restricted likelihood."""
    normal = noise.products[:, columns][:, :, columns]
    moment = noise.products[:, columns, -1]
    covariances = np.asarray(np.linalg.inv(normal), dtype=np.float64)
    found = np.asarray(np.einsum("hij,hj->hi", covariances, moment), dtype=np.float64)
    left = noise.products[:, -1, -1] - np.einsum("hi,hi->h", found, moment)
    likelihood = -0.5 * (noise.log_determinant + left)
    likely = likelihood - 0.5 * np.linalg.slogdet(normal)[1] + noise.log_prior
    likely = np.exp(likely - likely.max())
    likely /= likely.sum()
    wide = np.zeros(noise.products.shape[1] - 1)
    wide[columns] = likely @ found
    parameters = len(columns) + 2
    aicc = -2 * float(likelihood.max()) + 2 * parameters
    aicc += 2 * parameters * (parameters + 1) / max(n - parameters - 1, 1)
    return _Fit(wide, aicc, np.asarray(likely, dtype=np.float64), columns, found, covariances)


def _mixture(fits: Sequence[_Fit], weight: Floats, count: int) -> Mixture:
    """All models under all hypotheses of the noise, each with its probability."""
    weights, means, covariances = [], [], []
    for share, one in zip(weight, fits, strict=True):
        heard = share * one.likely > _NEGLIGIBLE
        mean = np.zeros((int(heard.sum()), count))
        mean[:, one.columns] = one.found[heard]
        covariance = np.zeros((mean.shape[0], count, count))
        covariance[np.ix_(range(mean.shape[0]), one.columns, one.columns)] = one.covariances[heard]
        weights.append(share * one.likely[heard])
        means.append(mean)
        covariances.append(covariance)
    shares = np.concatenate(weights)
    return Mixture(shares / shares.sum(), np.concatenate(means), np.concatenate(covariances))


def temperature_course(
    times: ArrayLike, temperature: ArrayLike, at_s: ArrayLike, *, window_s: float
) -> tuple[Floats, Floats, Floats]:
    """Temperature at some times, its change, and the noise of that; by lines through a window about each."""
    when, warm, wanted = (np.asarray(v, dtype=np.float64) for v in (times, temperature, at_s))
    there = np.isfinite(warm)
    when, warm = when[there], warm[there]
    if when.size < 3:
        raise ValueError(f"the log gives {when.size} temperatures")
    half = min(window_s, float(np.ptp(when))) / 2
    middle = np.clip(wanted, when[0] + half, when[-1] - half)
    found, rate, rate_u = np.empty(wanted.size), np.empty(wanted.size), np.empty(wanted.size)
    first = np.searchsorted(when, middle - half - 1e-9)
    last = np.searchsorted(when, middle + half + 1e-9)
    for place, (begin, end) in enumerate(zip(first, last, strict=True)):
        if end - begin < 3:
            begin, end = max(min(begin, when.size - 3), 0), max(begin + 3, end)
        t, w = when[begin:end] - middle[place], warm[begin:end]
        centred = t - t.mean()
        square = float(centred @ centred)
        slope = float(centred @ w) / square if square else 0.0
        left = w - w.mean() - slope * centred
        found[place] = w.mean() + slope * (wanted[place] - middle[place] - t.mean())
        rate[place] = 60 * slope
        rate_u[place] = 60 * float(np.sqrt(left @ left / max(left.size - 2, 1) / square)) if square else np.inf
    return found, rate, rate_u
