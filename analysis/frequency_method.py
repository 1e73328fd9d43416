"""Lock-in rate from beat frequency against rate: f^2 = K^2 [(W - W0)^2 - WL^2], the route without harmonics.

The equation is a parabola in W, f^2 = a W^2 + b W + c, so the fit is linear; W0 is the bias rate of the gyro
(earth rate included). A given scale factor is one more observation, a = K^2.

What it sees is not quite the lock-in rate. Backscatter that moves energy between the beams (dissipative) pulls the
frequency down; the part that only shifts their phases (conservative) pushes it up once the beat is faster than the
gain can follow the difference of the beams. WL^2 of this method is the difference of the two and may be negative.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntFlag

import numpy as np
import scipy.special
from numpy.typing import ArrayLike

from analysis.arrays import NORMAL_95, Bools, Floats, NoFit

ROUNDS = 20
UNLIKELY = 0.001
_AT_ONCE = 1 << 14


class FrequencyFlag(IntFlag):
    """Bits of `FrequencyFit.flags`; the lower-case name is the one used in JSON."""

    NEGATIVE_SQUARE = 1
    """WL^2 came out below zero."""
    NOT_SIGNIFICANT = 2
    """WL^2 does not stand out of its uncertainty."""
    MISFIT = 4
    """The frequencies scatter more than their uncertainties say; those of the result are enlarged."""
    NOT_TESTED = 8
    """As many unknowns as observations."""
    LOCKED_RECORDS = 16
    """Records without a beat agree with the lock-in rate found, and bound it from below."""
    NO_BEAT_ABOVE_LOCK_IN = 32
    """Records without a beat at a rate where there should be one."""
    RECORDS_LEFT_OUT = 64
    """Records with a frequency or rate that is not a number."""


@dataclass(frozen=True)
class FrequencyFit:
    """Fit of f^2 = K^2 [(W - W0)^2 - WL^2].

    lock_in_rate, lock_in_rate_u : deg/s; nan where WL^2 is not positive. The uncertainty is that of WL^2 over 2 WL
    lock_in_rate_low_95, lock_in_rate_high_95 : deg/s, from the ends of the interval of WL^2: 0 where the lower end
        is negative, nan where even the upper one is
    lock_in_square, lock_in_square_u : WL^2 in (deg/s)^2, of either sign
    scale_factor, scale_factor_u, bias_rate, bias_rate_u : pulses per degree; deg/s
    covariance : (3, 3) of WL^2, W0 and K
    chi_square, degrees_of_freedom, p_value : a given scale factor counts as an observation
    residual : (n,) Hz, f less the fitted one; nan where not used
    used, locked : (n,)
    flags : bits of `FrequencyFlag`
    scale_factor_given : whether the scale factor was one of the observations
    """

    lock_in_rate: float
    lock_in_rate_u: float
    lock_in_rate_low_95: float
    lock_in_rate_high_95: float
    lock_in_square: float
    lock_in_square_u: float
    scale_factor: float
    scale_factor_u: float
    bias_rate: float
    bias_rate_u: float
    covariance: Floats
    chi_square: float
    degrees_of_freedom: int
    p_value: float
    residual: Floats
    used: Bools
    locked: Bools
    flags: int
    scale_factor_given: bool


def fit_frequencies(
    input_rate: ArrayLike,
    beat_frequency: ArrayLike,
    beat_frequency_u: ArrayLike,
    *,
    input_rate_u: ArrayLike = 0.0,
    scale_factor: float | None = None,
    scale_factor_u: float = 0.0,
    bias: bool = True,
) -> FrequencyFit:
    """Lock-in rate, bias rate and scale factor from beat frequencies at several rates.

    Parameters
    ----------
    input_rate, input_rate_u : (n,)
        deg/s, signed; the uncertainty of each rate is independent of the others.
    beat_frequency, beat_frequency_u : (n,)
        Hz; 0 where there was no beat.
    scale_factor, scale_factor_u : float, optional
        K in pulses per degree, if known. Without it K is fitted too.
    bias : bool
        Whether W0 is fitted; otherwise it is zero.

    Raises
    ------
    NoFit
        Too few different rates for the unknowns, or frequencies that do not rise with the rate.
    ValueError
        Uncertainties that are not positive, shapes that do not fit.

    Examples
    --------
    >>> rates = np.array([0.1, 0.2, 0.4, -0.1, -0.2, -0.4])
    >>> fit = fit_frequencies(rates, 2000 * np.sqrt(rates**2 - 0.05**2), 0.01)
    >>> round(fit.lock_in_rate, 6), round(fit.scale_factor, 3)
    (0.05, 2000.0)
    """
    rate, f, fu, rate_u = _checked(input_rate, beat_frequency, beat_frequency_u, input_rate_u)
    if scale_factor is not None and not (np.isfinite(scale_factor) and scale_factor > 0 and scale_factor_u >= 0):
        raise ValueError("scale_factor must be positive (pulses per degree), its uncertainty not negative")
    finite = np.isfinite(rate) & np.isfinite(f) & np.isfinite(fu) & np.isfinite(rate_u)
    used, locked = finite & (f > 0), finite & (f == 0)
    if not np.any(rate, where=used):
        raise NoFit("no beat frequency at a rate other than zero: nothing can be fitted")
    seen = _Seen(rate, f, fu, rate_u, used)
    point, covariance, chi_square = _parabola(seen, scale_factor, scale_factor_u, bias)
    degrees = int(used.sum()) + (scale_factor is not None) - point.size
    p_value, widen, quantile = _test(chi_square, degrees)
    values, covariance = _physical(point, covariance * widen, bias)
    square, square_u = float(values[0]), float(np.sqrt(covariance[0, 0]))
    half, seen_locked = quantile * square_u, np.abs(rate[locked] - values[1])
    high = float(np.sqrt(square + half)) if square + half > 0 else float("nan")
    # rates seen locked bound it from below, as far as they lie inside
    low = max(float(np.sqrt(max(square - half, 0.0))), *seen_locked[seen_locked <= high], 0.0)
    flags = _flags(rate, used, locked, values, square_u, high, p_value, degrees)
    root, us = float(np.sqrt(square)) if square > 0 else float("nan"), np.sqrt(np.diagonal(covariance))
    return FrequencyFit(
        lock_in_rate=root,
        lock_in_rate_u=square_u / (2 * root),
        lock_in_rate_low_95=low,
        lock_in_rate_high_95=high,
        lock_in_square=square,
        lock_in_square_u=square_u,
        scale_factor=float(values[2]),
        scale_factor_u=float(us[2]),
        bias_rate=float(values[1]),
        bias_rate_u=float(us[1]),
        covariance=covariance,
        chi_square=chi_square,
        degrees_of_freedom=degrees,
        p_value=p_value,
        residual=seen.residual(values),
        used=used,
        locked=locked,
        flags=flags,
        scale_factor_given=scale_factor is not None,
    )


def _checked(
    input_rate: ArrayLike, beat_frequency: ArrayLike, beat_frequency_u: ArrayLike, input_rate_u: ArrayLike
) -> tuple[Floats, Floats, Floats, Floats]:
    rate = np.atleast_1d(np.asarray(input_rate, dtype=np.float64))
    if rate.ndim != 1:
        raise ValueError("input_rate must be a list of rates (deg/s)")
    columns = [rate]
    for name, values in (
        ("beat_frequency", beat_frequency),
        ("beat_frequency_u", beat_frequency_u),
        ("input_rate_u", input_rate_u),
    ):
        array = np.asarray(values, dtype=np.float64)
        if array.ndim > 1 or array.size not in (1, rate.size):
            raise ValueError(f"{name} must hold {rate.size} values, one for every rate, not {array.size}")
        columns.append(np.broadcast_to(array, rate.shape))
    _, f, fu, rate_u = columns
    if np.any(f < 0) or np.any(fu < 0) or np.any(rate_u < 0):
        raise ValueError("frequencies and uncertainties must not be negative")
    if np.any((f > 0) & (fu == 0) & (rate_u == 0)):
        raise ValueError("every frequency needs an uncertainty, of its own (Hz) or of its rate (deg/s)")
    return rate, f, fu, rate_u


def _test(chi_square: float, degrees: int) -> tuple[float, float, float]:
    """Probability of chi-square, factor for the variances where chance does not explain it, 95 % quantile."""
    if degrees <= 0:
        return float("nan"), 1.0, NORMAL_95
    p_value = float(scipy.special.chdtrc(degrees, chi_square))
    if p_value < UNLIKELY:
        return p_value, chi_square / degrees, float(scipy.special.stdtrit(degrees, 0.975))
    return p_value, 1.0, NORMAL_95


@dataclass(frozen=True)
class _Seen:
    """Frequencies, Hz, at rates, deg/s, with their uncertainties; which of them count. All of shape (n,)."""

    rate: Floats
    f: Floats
    fu: Floats
    rate_u: Floats
    used: Bools

    def blocks(self) -> Iterator[tuple[slice, tuple[Floats, ...]]]:
        """Those that count, some at a time: what is worked out of a million at once would take much memory."""
        for first in range(0, self.used.size, _AT_ONCE):
            some = slice(first, first + _AT_ONCE)
            yield some, tuple(each[some][self.used[some]] for each in (self.rate, self.f, self.fu, self.rate_u))

    def residual(self, values: Floats) -> Floats:
        """Hz, f less the one by WL^2, W0 and K; nan where not used."""
        left = np.full(self.used.shape, np.nan)
        for some, (rate, f, _, _) in self.blocks():
            expected = values[2] * np.sqrt(np.maximum((rate - values[1]) ** 2 - values[0], 0.0))
            left[some][self.used[some]] = f - expected
        return left


def _parabola(
    seen: _Seen, scale_factor: float | None, scale_factor_u: float, bias: bool
) -> tuple[Floats, Floats, float]:
    """a, (b,) c of f^2 = a W^2 + b W + c, their covariance, and chi-square."""
    unknowns = 3 if bias else 2
    fastest = np.max(np.abs(seen.rate), where=seen.used, initial=0.0)
    slope = 2 * (scale_factor or float(np.max(seen.f, where=seen.used, initial=0.0) / fastest)) ** 2, 0.0
    known = np.zeros((0, unknowns + 1))
    if scale_factor is not None:
        # An exact K is one known far better than any frequency can show.
        u = max(2 * scale_factor * scale_factor_u, 1e-12 * scale_factor**2)
        known = np.concatenate([np.eye(1, unknowns), [[scale_factor**2]]], axis=1) / u
    for _ in range(ROUNDS):
        triangle = _triangle(seen, slope, known, bias)
        white, aim = triangle[:-1, :-1], triangle[:-1, -1]
        size = np.linalg.norm(white, axis=0)
        few = int(seen.used.sum()) + len(known) < unknowns
        if few or np.any(size == 0) or np.linalg.cond(white / size) > 1e8:
            raise NoFit(
                "these rates do not determine the unknowns: without a bias rate two different |W| are needed, "
                "with it also both senses or a third rate; a known scale factor saves one"
            )
        inverse = np.linalg.pinv(white / size) / size[:, np.newaxis]
        point = inverse @ aim
        before, slope = slope, (2 * float(point[0]), float(point[1]) if bias else 0.0)
        if not np.any(seen.rate_u) or all(
            np.allclose(slope[0] * rate + slope[1], before[0] * rate + before[1], rtol=1e-12, atol=0)
            for _, (rate, *_) in seen.blocks()
        ):
            break
    return point, inverse @ inverse.T, float(triangle[-1, -1] ** 2)


def _triangle(seen: _Seen, slope: tuple[float, float], known: Floats, bias: bool) -> Floats:
    """The triangle that stands for the equations of all frequencies, by QR; its last column is the right side."""
    triangle = np.concatenate([known, np.zeros((3 + bias - len(known), 3 + bias))])
    for _, (rate, f, fu, rate_u) in seen.blocks():
        us = np.hypot(2 * f * fu, (slope[0] * rate + slope[1]) * rate_u)
        columns = [rate**2, rate, np.ones_like(rate)] if bias else [rate**2, np.ones_like(rate)]
        equations = np.stack([*columns, f**2], axis=-1) / us[:, np.newaxis]
        triangle = np.asarray(np.linalg.qr(np.concatenate([triangle, equations]), mode="r"))
    return triangle


def _physical(point: Floats, covariance: Floats, bias: bool) -> tuple[Floats, Floats]:
    """WL^2, W0 and K, and their covariance, from a, (b,) c."""
    a, c = point[0], point[-1]
    if a <= 0:
        raise NoFit("the frequencies do not rise with the rate: no gyro beat")
    b = point[1] if bias else 0.0
    center, root = -b / (2 * a), np.sqrt(a)
    by_a = [-(b**2) / (2 * a**3) + c / a**2, b / (2 * a**2), 1 / (2 * root)]
    by_b = [b / (2 * a**2), -1 / (2 * a), 0.0]
    by_c = [-1 / a, 0.0, 0.0]
    jacobian = np.array([by_a, by_b, by_c] if bias else [by_a, by_c]).T
    return np.array([center**2 - c / a, center, root]), jacobian @ covariance @ jacobian.T


def _flags(
    rate: Floats,
    used: Bools,
    locked: Bools,
    values: Floats,
    square_u: float,
    high: float,
    p_value: float,
    degrees: int,
) -> int:
    above = np.abs(rate[locked] - values[1]) > (0.0 if np.isnan(high) else high)
    conditions = {
        FrequencyFlag.NEGATIVE_SQUARE: values[0] <= 0,
        FrequencyFlag.NOT_SIGNIFICANT: values[0] < 3.3 * square_u,
        FrequencyFlag.MISFIT: p_value < UNLIKELY,
        FrequencyFlag.NOT_TESTED: degrees <= 0,
        FrequencyFlag.LOCKED_RECORDS: bool(np.any(~above)),
        FrequencyFlag.NO_BEAT_ABOVE_LOCK_IN: bool(np.any(above)),
        FrequencyFlag.RECORDS_LEFT_OUT: not bool(np.all(used | locked)),
    }
    return int(sum(bit for bit, raised in conditions.items() if raised))
