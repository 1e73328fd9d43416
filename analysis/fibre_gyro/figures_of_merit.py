"""Figures of merit of a scale factor, in the style of GJB 2426A and of IEEE Std 952.

"Style", since the formulas are those in common use under these names; no claim of conformity is made. K is
output over input, counts per deg/s; the S of the IEEE texts is its inverse, input over output.
"""

from dataclasses import dataclass

import numpy as np
import scipy.special
from numpy.typing import ArrayLike

from analysis.arrays import Bools, Floats
from analysis.fibre_gyro.injection import SlopeFit, fit_slope

_PPM = 1e6
_SIGNIFICANT = 1e-3


@dataclass(frozen=True)
class ScaleFigures:
    """Line through one run over the range, and how far the points lie from it."""

    fit: SlopeFit  # over all rates
    # K of the fits to the positive and to the negative rates alone, each with its own intercept; nan with fewer
    # than two rates in that sense
    scale_factor_positive: float
    scale_factor_negative: float
    deviation_of_full_scale_ppm: Floats  # (n,): (fitted - measured) over the largest output of all points
    # (n,): (measured - fitted) over the point's own fitted output without the intercept; nan at rate zero
    deviation_of_point_ppm: Floats
    nonlinearity_ppm: float  # largest deviation, of full scale
    nonlinearity_of_point_ppm: float  # largest deviation, of the point
    # standard uncertainty of the deviation that is the largest, of full scale; nan if none was given
    nonlinearity_u_ppm: float
    asymmetry_ppm: float
    asymmetry_u_ppm: float
    slope_noise_u: float  # of K over all rates by the outputs' own uncertainties; nan if none were given


def scale_figures(rates_dps: ArrayLike, outputs: ArrayLike, outputs_u: ArrayLike | None = None) -> ScaleFigures:
    """Nonlinearity and asymmetry of one run.

    GJB style, with F_j the net output (mean less the mean of the static outputs before and after):

        K, F_0 by least squares;  fitted  F^_j = K w_j + F_0
        deviation     alpha_j = (F^_j - F_j)/|F_max|
        nonlinearity  K_n = max |alpha_j|
        asymmetry     K_a = |K(+) - K(-)| / K,   K = [K(+) + K(-)]/2

    IEEE style: the same line; the scale-factor (linearity) error is its deviation as ppm of full scale and as ppm
    of the output: both are given and named.

    Parameters
    ----------
    rates_dps, outputs : array_like, shape (n,)
        deg/s and counts.
    outputs_u : array_like, shape (n,), optional
        Standard uncertainties. They do not weight the fits, whose sums have equal weights in either style; they
        say how well the largest deviation is known.

    Raises
    ------
    ValueError
        Fewer than three points.

    Examples
    --------
    Slope 100 one way and 101 the other: the asymmetry is 1/100.5.

    >>> figures = scale_figures([-2.0, -1.0, 1.0, 2.0], [-200.0, -100.0, 101.0, 202.0])
    >>> round(figures.asymmetry_ppm), figures.scale_factor_positive, figures.scale_factor_negative
    (9950, 101.0, 100.0)
    """
    rate, output = (np.asarray(v, dtype=np.float64) for v in (rates_dps, outputs))
    u = None if outputs_u is None else np.broadcast_to(np.asarray(outputs_u, dtype=np.float64), rate.shape)
    fit = fit_slope(rate, output)
    full_scale = float(np.abs(output).max())
    deviation = -_PPM * fit.residual / full_scale
    of_point = np.full(rate.size, np.nan)
    np.divide(_PPM * fit.residual, fit.slope * rate, out=of_point, where=rate != 0)
    worst = int(np.argmax(np.abs(deviation)))
    positive, positive_u = _slope_of(rate, output, u, rate > 0)
    negative, negative_u = _slope_of(rate, output, u, rate < 0)
    mean = (positive + negative) / 2
    return ScaleFigures(
        fit=fit,
        scale_factor_positive=positive,
        scale_factor_negative=negative,
        deviation_of_full_scale_ppm=np.asarray(deviation, dtype=np.float64),
        deviation_of_point_ppm=of_point,
        nonlinearity_ppm=float(np.abs(deviation[worst])),
        nonlinearity_of_point_ppm=float(np.nanmax(np.abs(of_point))),
        nonlinearity_u_ppm=float("nan") if u is None else _PPM * float(u[worst]) / full_scale,
        asymmetry_ppm=_PPM * abs(positive - negative) / abs(mean),
        asymmetry_u_ppm=_PPM * float(np.hypot(positive_u, negative_u)) / abs(mean),
        slope_noise_u=float("nan") if u is None else _slope_of(rate, output, u, np.isfinite(rate))[1],
    )


def _slope_of(rate: Floats, output: Floats, u: Floats | None, kept: Bools) -> tuple[float, float]:
    """Slope of some of the points, and its u by theirs; by their scatter where they have none."""
    nan = float("nan")
    if np.unique(rate[kept]).size < 2:
        return nan, nan
    apart = rate[kept] - rate[kept].mean()
    slope = float(apart @ output[kept] / (apart @ apart))
    if u is not None:
        # a curve of the points is no noise: it is the same in both senses, or it is the asymmetry itself
        return slope, float(np.sqrt(apart**2 @ u[kept] ** 2) / (apart @ apart))
    return slope, nan if int(kept.sum()) == 2 else fit_slope(rate[kept], output[kept]).slope_u


def temperature_coefficient_ppm(
    scale_factors: ArrayLike, temperatures: ArrayLike, *, reference: tuple[float, float]
) -> float:
    """Temperature coefficient of the scale factor, ppm per kelvin (or per deg C, the same).

    GJB style: K_t = max_i |K_i - K_m| / ( |K_m| |T_i - T_m| ), with K_m at the reference temperature T_m.

    Parameters
    ----------
    scale_factors, temperatures : array_like, shape (n,)
        Points at the reference temperature itself are passed over.
    reference : tuple of float
        K_m and T_m.

    Raises
    ------
    ValueError
        No temperature differs from the reference.

    Examples
    --------
    >>> round(temperature_coefficient_ppm([99.98, 100.03], [-5.0, 35.0], reference=(100.0, 15.0)), 6)
    15.0
    """
    k, t = (np.asarray(v, dtype=np.float64) for v in (scale_factors, temperatures))
    apart = np.abs(t - reference[1])
    if not np.any(apart > 0):
        raise ValueError("a temperature coefficient needs a second temperature")
    each = np.abs(k - reference[0])[apart > 0] / (abs(reference[0]) * apart[apart > 0])
    return _PPM * float(each.max())


@dataclass(frozen=True)
class ResidualPattern:
    """Which shape the deviations from the line have; each part with the probability that noise alone makes it."""

    # root mean square of the odd and of the even part of the residuals at paired rates away from zero, ppm of full
    # scale. Odd: cubic, from resets or converter. Even: asymmetry.
    odd_ppm: float
    even_ppm: float
    # largest deviation of the points near zero from a smooth curve through the others, ppm of the point itself:
    # dead zone, lock-in
    near_zero_ppm: float
    odd_p: float  # nan where there are too few points to tell
    even_p: float
    # what is significant (p below 0.001), of "odd", "even", "near zero". "scatter" where the outputs lie off by
    # more than their noise, but neither a curve explains it nor one of the two parts stands out.
    names: tuple[str, ...]


def residual_pattern(
    rates_dps: ArrayLike, outputs: ArrayLike, outputs_u: ArrayLike, *, near_zero: float = 0.01
) -> ResidualPattern:
    """Find out whether the deviations are odd in the rate, even, or stand near zero."""
    # Away from zero the outputs at +w and -w give an odd part [F(w) - F(-w)]/2, which a straight line through zero
    # is fitted to, and an even part [F(w) + F(-w)]/2, which a constant is fitted to. What is left of each is
    # tested with chi-square, one degree of freedom less than there are pairs. Outputs whose bias or rate changes
    # between them lie off by more than their noise too, in both parts alike: a part is a pattern only if a smooth
    # curve (w^3, |w|) is significant against what it leaves, or if the part exceeds the other one. The points near
    # zero are compared with a curve 1, w, |w|, w^3 through the others: an asymmetry does not look like a dead
    # zone.
    rate, output, u = (np.asarray(v, dtype=np.float64) for v in (rates_dps, outputs, outputs_u))
    away = np.abs(rate) > near_zero * np.abs(rate).max()
    if int(away.sum()) < 3:
        raise ValueError("a pattern of the deviations needs at least three points away from zero")
    slope = fit_slope(rate[away], output[away], u[away]).slope
    full_scale = float(np.abs(output).max())
    size, odd, even, part_u = _odd_and_even_left(rate[away], output[away], u[away])
    odd_p, even_p = (_chance(part / part_u, part.size - 1) for part in (odd, even))
    regular = {
        "odd": _stands_out(size, size**3, odd, even, part_u),
        "even": _stands_out(np.ones_like(size), size, even, odd, part_u),
        "near zero": True,
    }
    near = ~away & (rate != 0)
    scaled = rate / np.abs(rate).max()
    columns = [np.ones_like(rate), scaled, np.abs(scaled), scaled**3]
    enough = int(away.sum()) >= 6 and bool(np.any(rate[away] > 0) and np.any(rate[away] < 0))
    design = np.column_stack(columns if enough else columns[:2])
    inverse = np.linalg.pinv(design[away] / u[away, np.newaxis])
    curve = design @ (inverse @ (output[away] / u[away]))
    curve_variance = np.sum((design[near] @ inverse) ** 2, axis=1)
    left, left_u = output[near] - curve[near], np.sqrt(u[near] ** 2 + curve_variance)
    near_p = _chance(left / left_u, left.size)
    near_ppm = _PPM * float(np.abs(left / (slope * rate[near])).max()) if left.size else float("nan")
    found = [name for name, p in (("odd", odd_p), ("even", even_p), ("near zero", near_p)) if p < _SIGNIFICANT]
    names = [name for name in found if regular[name]]
    if any(not regular[name] for name in found) and not {"odd", "even"} & set(names):
        names.append("scatter")
    return ResidualPattern(
        _root_mean_square(odd) / full_scale * _PPM,
        _root_mean_square(even) / full_scale * _PPM,
        near_ppm,
        odd_p,
        even_p,
        tuple(names),
    )


def _stands_out(first: Floats, curve: Floats, part: Floats, other: Floats, part_u: Floats) -> bool:
    """Whether a smooth curve explains a part better than scatter would, or it exceeds the other part."""
    freedom = part.size - 2
    if freedom < 1:
        return True
    design = np.column_stack([first, curve / np.abs(curve).max()]) / part_u[:, np.newaxis]
    inverse = np.linalg.pinv(design)
    value = inverse @ (part / part_u)
    left = part / part_u - design @ value
    variance = max(float(left @ left) / freedom, 1.0)
    t = abs(float(value[1])) / np.sqrt(variance * float(inverse[1] @ inverse[1]))
    ratio = float(np.sum((part / part_u) ** 2)) / max(float(np.sum((other / part_u) ** 2)), part.size - 1.0)
    smooth = 2 * float(scipy.special.stdtr(freedom, -t)) < _SIGNIFICANT
    return smooth or float(scipy.special.fdtrc(part.size - 1, part.size - 1, ratio)) < _SIGNIFICANT


def _odd_and_even_left(rate: Floats, output: Floats, u: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Rates, and what a line through zero leaves of the odd parts, a constant of the even parts; uncertainty."""
    rows = []
    for size in np.unique(np.abs(rate).round(9)):
        forward, backward = (np.abs(rate - sense * size) < 1e-8 for sense in (1, -1))
        if forward.any() and backward.any():
            up, down = output[forward].mean(), output[backward].mean()
            part_u = np.hypot(*(np.sqrt(np.sum(u[k] ** 2)) / k.sum() for k in (forward, backward))) / 2
            rows.append((size, (up - down) / 2, (up + down) / 2, part_u))
    if not rows:
        return np.empty(0), np.empty(0), np.empty(0), np.empty(0)
    size, odd, even, part_u = np.array(rows, dtype=np.float64).T
    weight = part_u**-2.0
    odd = odd - size * float(np.sum(weight * size * odd) / np.sum(weight * size**2))
    return size, odd, even - float(np.average(even, weights=weight)), part_u


def _chance(normalised: Floats, freedom: int) -> float:
    return float(scipy.special.chdtrc(freedom, float(np.sum(normalised**2)))) if freedom >= 1 else float("nan")


def _root_mean_square(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")
