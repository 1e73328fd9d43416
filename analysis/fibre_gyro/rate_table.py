"""Scale factor, earth rate, bias and its drift of one axis by weighted least squares over all runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from analysis.arrays import Floats, Ints
from analysis.fibre_gyro.scatter import RunScatter, find_run_scatter, signal_interval
from analysis.rotation import EARTH_RATE_DPS

_EARTH_RATE_DPH = 3600.0 * EARTH_RATE_DPS
_PPM = 1e6


@dataclass(frozen=True)
class AxisFit:
    """Scale factor of one axis."""

    scale_factor: float  # K, counts per deg/s; with its uncertainty
    scale_factor_u: float
    # what each cause contributes to the uncertainty of K, counts per deg/s: "noise" within the runs, "slow noise"
    # by the noise model, "stated" irreproducibility, "scatter" beyond all of them, "table rate"
    contributions: Mapping[str, float]
    factors: Floats  # (n,): of the mean of each run in K, deg/s
    covariance: Floats  # (n, n): of the means, by noise and scatter, counts^2
    # even part, counts: K w_v + B with the axis up, B - K w_v with the axis down; with its uncertainty
    even: float
    even_u: float
    # the same as a rate, deg/h, and its standard uncertainty: vertical earth rate and bias together
    even_dph: tuple[float, float]
    # vertical earth rate and bias each by itself, with uncertainty; nan unless both ends were up in turn
    earth_rate_dph: tuple[float, float]
    bias_dph: tuple[float, float]
    # drift of the bias that was taken out, and its uncertainty; nan where the runs are too few to show one
    drift_dph_per_h: tuple[float, float]
    drift_in_scale_factor: float  # what the drift would have added to K, counts per deg/s
    end_up: int  # which end of the axis was up in all runs, 1 or -1; 0 if both were
    residual_ppm: Floats  # (n,): of every run, ppm of its own output
    chi_square: float  # of the residuals, with the uncertainties that were the weights
    degrees_of_freedom: int
    # irreproducibility from run to run that the residuals show beyond noise, ppm; 0 where noise explains them
    scatter_ppm: float
    # whether the runs cannot show their irreproducibility and nobody states it: a bound is counted
    scatter_assumed: bool
    # deg/sqrt(h), from the uncertainties of the means: the white noise that would explain them
    angle_random_walk: float


def fit_axis(
    runs: TableRuns, *, irreproducibility_ppm: float | None = None, table_rate_u_ppm: float = 0.0
) -> AxisFit:
    """Fit scale factor, earth rate, bias and its drift of one axis to all runs."""
    # Weights are 1/u^2 with u the noise of the mean and, in quadrature, the irreproducibility of the run, stated
    # or as the residuals show it. All uncertainties count the scatter that the residuals allow (`scatter`); 1.96
    # of them are half a 95 % interval. The drift is fitted where three degrees of freedom are left with it.
    if not (np.any(runs.rate_dps > 0) and np.any(runs.rate_dps < 0)):
        raise ValueError("the scale factor needs runs in both senses")
    plain = design_of(runs)
    design = with_drift(plain, runs.at_s)
    drifts, both_ends = design.shape[1] > plain.shape[1], plain.shape[1] == 3
    stated = None if irreproducibility_ppm is None else irreproducibility_ppm / _PPM
    scatter = find_run_scatter(
        design, runs.mean, runs.mean_u, stated, slow=runs.slow, by_model=runs.slow is not None
    )
    estimator = scatter.estimator(design, by_known=stated is not None)
    values = estimator @ runs.mean
    k = float(values[0])
    residual = runs.mean - design @ values
    u = np.sqrt(np.diag(scatter.mean_covariance() if stated is None else scatter.known_covariance()))
    constants = np.eye(values.size)[1 : plain.shape[1]]
    even = constants.sum(axis=0)
    freedom = runs.mean.size - values.size

    def as_dph(combination: Floats) -> tuple[float, float]:
        """Rate in deg/h, and its uncertainty, of a combination of the constant terms: divided by K."""
        rate = float(combination @ values) / k
        slopes = (combination - rate * np.eye(values.size)[0]) / k
        return 3600.0 * rate, 3600.0 * scatter.standard_u(slopes @ estimator)

    nan = (float("nan"), float("nan"))
    earth, bias = [as_dph(one) for one in constants] if both_ends else [nan, nan]
    drift = np.eye(values.size)[-1]
    of_drift = float(scatter.estimator(plain)[0] @ design[:, -1] * values[-1]) if drifts else 0.0
    contributions = {**scatter.parts(estimator[0]), "table rate": abs(k) * table_rate_u_ppm / _PPM}
    # what the residuals show beyond the noise of the means is irreproducibility from run to run
    beyond = float(np.sum(residual**2 - runs.mean_u**2 * freedom / residual.size))
    excess = beyond / freedom if freedom >= 1 else 0.0
    return AxisFit(
        scale_factor=k,
        scale_factor_u=float(np.hypot(scatter.standard_u(estimator[0]), contributions["table rate"])),
        contributions=contributions,
        factors=estimator[0],
        covariance=scatter.mean_covariance(),
        even=float(even @ values),
        even_u=scatter.standard_u(even @ estimator),
        even_dph=as_dph(even),
        earth_rate_dph=earth,
        bias_dph=bias,
        drift_dph_per_h=as_dph(drift) if drifts else nan,
        drift_in_scale_factor=of_drift,
        end_up=0 if both_ends else int(runs.end_up[0]),
        residual_ppm=np.asarray(_PPM * residual / np.abs(runs.mean), dtype=np.float64),
        chi_square=float(np.sum((residual / u) ** 2)),
        degrees_of_freedom=freedom,
        scatter_ppm=_PPM * float(np.sqrt(max(excess, 0.0) / np.mean(runs.mean**2))),
        scatter_assumed=scatter.assumed,
        angle_random_walk=float(60 / abs(k) * np.sqrt(np.mean(runs.mean_u**2 * runs.duration_s))),
    )


def correlation_with_numbers(fit: AxisFit, factors: Floats) -> Floats:
    """Correlation of K and of numbers of small rates that come from the same runs, shape (1 + k, 1 + k)."""
    both = np.vstack([fit.factors, factors])
    covariance = both @ fit.covariance @ both.T
    size = np.sqrt(np.diag(covariance))
    return np.asarray(covariance / np.outer(size, size), dtype=np.float64)


def bias_at_latitude(fit: AxisFit, latitude_deg: float) -> tuple[float, float]:
    """Bias, deg/h, and its standard uncertainty, from the even part and the known vertical earth rate."""
    if fit.end_up == 0:
        return fit.bias_dph
    value, u = fit.even_dph
    return value - fit.end_up * vertical_earth_rate_dph(latitude_deg), u


def vertical_earth_rate_dph(latitude_deg: float) -> float:
    """Earth rate along the upward vertical, deg/h.

    Examples
    --------
    >>> round(vertical_earth_rate_dph(45.78), 3)
    10.779
    """
    return float(_EARTH_RATE_DPH * np.sin(np.deg2rad(latitude_deg)))


def horizontal_earth_rate_dps(latitude_deg: float) -> float:
    """Earth rate in the horizontal plane, towards the north, deg/s.

    Examples
    --------
    >>> round(3600 * horizontal_earth_rate_dps(60.0), 3)
    7.521
    """
    return float(EARTH_RATE_DPS * np.cos(np.deg2rad(latitude_deg)))


# --------------------
# Odd and even parts of the output over the sense of rotation, and the numbers of small rates.
#
# Runs in both senses separate the odd part K Omega from the even part K w_v + B. The differences of odd parts are
# what the patent CN104634364A makes numbers of small rates from; they are given with what they are worth


@dataclass(frozen=True)
class OddEven:
    """Odd and even parts at each rate, in rising order of the rate."""

    rate_dps: Floats  # (m,): mean size of the table's rate in both senses
    # (m,): half the difference of the senses, K Omega: free of bias and of the vertical earth rate. Counts.; with
    # its uncertainty
    odd: Floats
    odd_u: Floats
    even: Floats  # (m,): half their sum, K w_v + B. Counts.; with its uncertainty
    even_u: Floats
    duration_s: Floats  # (m,): mean window of the two senses


def odd_even_parts(runs: TableRuns, *, end_up: int = 1) -> OddEven:
    """Odd and even parts of the runs with one end of the axis up; several runs of a kind are averaged."""
    kept = runs.end_up == end_up
    if not kept.any():
        raise ValueError(f"there is no run with the {'upper' if end_up > 0 else 'lower'} end of the axis up")
    chosen = runs.chosen(kept)
    if alone := missing_senses(chosen):
        names = ", ".join(f"{rate:+g} deg/s" for rate in alone)
        raise ValueError(f"the opposite sense of {names} is missing: run it, or leave the point out")
    rows = []
    for rate in distinct_rates(np.abs(chosen.nominal_dps)):
        forward, backward = (_average(chosen, sense * rate) for sense in (1, -1))
        u = float(np.hypot(forward[2], backward[2])) / 2
        odd, even = (forward[1] - backward[1]) / 2, (forward[1] + backward[1]) / 2
        rows.append(((forward[0] - backward[0]) / 2, end_up * odd, u, even, u, (forward[3] + backward[3]) / 2))
    return OddEven(*np.array(rows, dtype=np.float64).T)


def _average(runs: TableRuns, nominal: float) -> tuple[float, float, float, float]:
    """Rate, mean, its uncertainty and the window of all runs at one signed rate, weighted by 1/u^2."""
    kept = np.abs(runs.nominal_dps - nominal) < SAME_RATE
    weights = runs.mean_u[kept] ** -2.0
    mean = float(np.average(runs.mean[kept], weights=weights))
    rate = float(np.average(runs.rate_dps[kept], weights=weights))
    return rate, mean, float(weights.sum() ** -0.5), float(runs.duration_s[kept].mean())


@dataclass(frozen=True)
class RateDifferences:
    """Output of one axis for small rates, as differences of two large ones."""

    delta_dps: Floats  # (k,)
    number: Floats  # (k,): N(delta) = D(base + delta) - D(base), counts
    noise_u: Floats  # (k,): standard uncertainty from the scatter of the runs
    # (k,): from the irreproducibility of scale factor and table rate: about s base/delta of the number
    irreproducibility_u: Floats
    # the rate that is subtracted, and the uncertainty of its odd part from noise (it is in every number)
    base_dps: float
    base_u: float
    factors: Floats | None = None  # (k, n): of the mean of each run in each number, where the runs are known

    @property
    def number_u(self) -> Floats:
        """Both kinds together."""
        return np.hypot(self.noise_u, self.irreproducibility_u)

    @property
    def relative_u_ppm(self) -> Floats:
        """Uncertainty of each number, ppm of the number."""
        return np.asarray(_PPM * self.number_u / np.abs(self.number), dtype=np.float64)


def rate_differences(
    parts: OddEven, *, irreproducibility_ppm: float | None, runs: TableRuns | None = None, end_up: int = 1
) -> RateDifferences:
    """Differences of the odd part at every higher rate from that at the lowest.

    Parameters
    ----------
    irreproducibility_ppm : float or None
        Standard deviation of scale factor and table rate from run to run, ppm, where it is known. Each odd part
        holds two runs and a difference two odd parts, so that s of a single run gives s times the root mean square
        of both rates.
    runs : TableRuns, optional
        Those that the parts were made of: the scatter that they show beyond noise and what is stated counts too,
        that of a bias which moves between the runs among it.
    end_up : {1, -1}, optional
        Of the runs that the parts were made of.

    Raises
    ------
    ValueError
        Fewer than two rates.

    Examples
    --------
    1 ppm between runs makes 20 ppm of the difference for 1 deg/s, and 2000 ppm of that for 0.01 deg/s.

    >>> rates = np.array([20.0, 20.01, 21.0])
    >>> parts = OddEven(rates, 246.0 * rates, np.full(3, 1e-9), 0 * rates, np.full(3, 1e-9), np.full(3, 540.0))
    >>> rate_differences(parts, irreproducibility_ppm=1.0).relative_u_ppm.round(1).tolist()
    [2000.5, 20.5]
    """
    if parts.rate_dps.size < 2:
        raise ValueError("a difference needs at least two rates")
    base, rates = float(parts.rate_dps[0]), parts.rate_dps[1:]
    noise = np.hypot(parts.odd_u[1:], parts.odd_u[0])
    number, factors = parts.odd[1:] - parts.odd[0], None
    if runs is None:
        slope = abs(float(parts.odd[0])) / base
        spread = (irreproducibility_ppm or 0.0) / _PPM * slope * np.sqrt((rates**2 + base**2) / 2)
    else:
        factors, spread = _differences_of(runs, end_up, noise, irreproducibility_ppm)
        number = factors @ runs.mean
    return RateDifferences(rates - base, number, noise, spread, base, float(parts.odd_u[0]), factors)


def _differences_of(
    runs: TableRuns, end_up: int, noise: Floats, stated_ppm: float | None
) -> tuple[Floats, Floats]:
    """Factors of the means in each difference freed of a drift, and what scatter adds to its noise, counts."""
    design, stated = design_of(runs), None if stated_ppm is None else stated_ppm / _PPM
    sizes = distinct_rates(np.abs(runs.nominal_dps[runs.end_up == end_up]))
    base = _odd_part_of(runs, end_up, sizes[0])
    factors, spread = [], []
    for size, noise_u in zip(sizes[1:], noise, strict=True):
        difference = _odd_part_of(runs, end_up, size) - base
        # its own deviation from the line is not counted as scatter: it need not lie on the line
        own = np.column_stack([design, difference])
        whole = with_drift(own, runs.at_s)
        scatter = find_run_scatter(
            whole, runs.mean, runs.mean_u, stated, slow=runs.slow, by_model=runs.slow is not None
        )
        if whole.shape[1] > own.shape[1]:
            difference = difference - (difference @ whole[:, -1]) * scatter.estimator(whole)[-1]
        factors.append(difference)
        spread.append(np.sqrt(max(scatter.standard_u(difference) ** 2 - noise_u**2, 0.0)))
    return np.array(factors, dtype=np.float64), np.array(spread, dtype=np.float64)


def _odd_part_of(runs: TableRuns, end_up: int, size: float) -> Floats:
    """Factor of each run's mean in the odd part at one rate, shape (n,)."""
    factors = np.zeros(runs.mean.size)
    for sense in (1, -1):
        kept = (np.abs(runs.nominal_dps - sense * size) < SAME_RATE) & (runs.end_up == end_up)
        weights = runs.mean_u[kept] ** -2.0
        factors[kept] = end_up * sense * weights / weights.sum() / 2
    return factors


# --------------------
# Runs of one axis on the rate table, as arrays, and what is fitted to all of them.
#
# Model of the mean output over whole turns, gyro axis along the vertical table axis (end = +1) or against it (-1):
#
#     N = end K (Omega + w_v) + B + D (t - t_0)
#
# K counts per deg/s, Omega the table's signed rate, w_v the vertical earth rate, B the bias in counts at the
# middle of the runs, D its drift


SAME_RATE = 1e-9  # deg/s: rates that were asked for and differ by less are the same
_FREEDOM_FOR_DRIFT = 3
_HOUR = 3600.0


@dataclass(frozen=True)
class TableRuns:
    """Means over whole turns of one axis, one element a run."""

    nominal_dps: Floats  # (n,): rate that was asked for, signed. Runs are paired by it.
    rate_dps: Floats  # (n,): rate that the table had, signed
    mean: Floats  # (n,): counts; the uncertainty is that of the noise within the run
    mean_u: Floats
    duration_s: Floats  # (n,)
    end_up: Ints  # (n,): +1 where the axis points up, -1 where it points down
    at_s: Floats  # (n,): middle of the window; nan where nobody knows it
    slow: Floats | None = None  # (n, n): generalised covariance of the slow noise by a noise model, counts^2

    def chosen(self, kept: ArrayLike) -> TableRuns:
        """Some of the runs; `kept` is a mask, shape (n,)."""
        of = np.asarray(kept, dtype=np.bool_)
        return replace(
            self,
            nominal_dps=self.nominal_dps[of],
            rate_dps=self.rate_dps[of],
            mean=self.mean[of],
            mean_u=self.mean_u[of],
            duration_s=self.duration_s[of],
            end_up=self.end_up[of],
            at_s=self.at_s[of],
            slow=None if self.slow is None else self.slow[np.ix_(of, of)],
        )


def table_runs(
    nominal_dps: ArrayLike,
    mean: ArrayLike,
    mean_u: ArrayLike,
    *,
    rate_dps: ArrayLike | None = None,
    duration_s: ArrayLike = np.nan,
    end_up: ArrayLike = 1,
    at_s: ArrayLike = np.nan,
    slow: Floats | None = None,
) -> TableRuns:
    """Put the means of one axis together; the fields are those of :class:`TableRuns`."""
    nominal = np.atleast_1d(np.asarray(nominal_dps, dtype=np.float64))
    given = (nominal if rate_dps is None else rate_dps, mean, mean_u, duration_s, at_s)
    rate, means, u, duration, at = (np.broadcast_to(np.asarray(v, dtype=np.float64), nominal.shape) for v in given)
    ends = np.broadcast_to(np.asarray(end_up, dtype=np.int64), nominal.shape)
    if not np.all(np.abs(nominal) > 0):
        raise ValueError("a rate-table run needs rates other than zero")
    if not np.all(u > 0):
        raise ValueError("every mean needs a positive standard uncertainty: it is the weight of the run")
    return TableRuns(nominal, rate, means, u, duration, ends, at, slow)


def missing_senses(runs: TableRuns) -> list[float]:
    """Signed rates that lack their opposite, in the order of the runs.

    Examples
    --------
    >>> missing_senses(table_runs([20.0, -20.0, 21.0], [1.0, 1.0, 1.0], 1.0))
    [21.0]
    """
    alone = []
    for rate, end in zip(runs.nominal_dps, runs.end_up, strict=True):
        opposite = (np.abs(runs.nominal_dps + rate) < SAME_RATE) & (runs.end_up == end)
        if not opposite.any():
            alone.append(float(rate))
    return alone


def distinct_rates(rates: Floats) -> list[float]:
    """Rates that differ, in rising order."""
    found: list[float] = []
    for rate in np.sort(rates):
        if not found or rate - found[-1] > SAME_RATE:
            found.append(float(rate))
    return found


def design_of(runs: TableRuns) -> Floats:
    """Columns of scale factor and constants, (n, p): one constant, or with both ends up earth rate and bias."""
    columns = [runs.end_up * runs.rate_dps, runs.end_up, np.ones_like(runs.rate_dps)]
    both_ends = bool(np.any(runs.end_up > 0) and np.any(runs.end_up < 0))
    return np.column_stack(columns if both_ends else [columns[0], columns[2]])


def with_drift(design: Floats, at_s: Floats) -> Floats:
    """The design with a column for a drift of the bias, counts per hour, where the runs can bear one more."""
    known = bool(np.all(np.isfinite(at_s))) and float(np.ptp(at_s)) > 0
    if not known or at_s.size - design.shape[1] - 1 < _FREEDOM_FOR_DRIFT:
        return design
    return np.column_stack([design, (at_s - at_s.mean()) / _HOUR])


# --------------------
# Scale-factor error over a ladder of rates: polynomial, asymmetry, and nonlinearity freed of noise.
#
# With w the rate along the axis, w_F the largest, x = w/w_F:
#
#     N = K w [ 1 + (s/2) sign(w) + c_1 x + c_2 x^2 + c_4 x^4 ] + constants
#
# s is the asymmetry K(+)/K(-) - 1; even powers bend the line alike in both senses, s and odd powers do not. A term
# stands in the polynomial where it is more than three of its uncertainties. The nonlinearity is that of the curve
# with all terms that the ladder can bear, at the rates of the runs, against its own straight line. What noise and
# scatter from run to run add to its mean square is known and taken off; the interval begins at 0 where they may
# make all of it.


_SIGNIFICANT = 3.0
_RANGE = 2.0  # largest rate of a ladder over its smallest
_DRAWS = 4000
LADDER_TERMS = ("asymmetry", "quadratic", "linear", "quartic")  # of the scale factor: s, c_2, c_1, c_4


@dataclass(frozen=True)
class Linearity:
    """What a ladder of rates says of the scale factor; ppm of the scale factor or of full scale."""

    chosen: tuple[str, ...]  # terms of the polynomial that the data ask for
    # of each term that the ladder can bear: of one that was chosen in the polynomial, of another beside it. ppm of
    # the scale factor at the largest rate.; with its uncertainty
    value: dict[str, float]
    value_u: dict[str, float]
    # nonlinearity freed of noise: root mean square of the deviations from the line, ppm of the largest output
    rms_ppm: float
    rms_low_95_ppm: float
    rms_high_95_ppm: float
    # the largest deviation of the polynomial, and between which values that of the true curve is
    largest_ppm: float
    largest_low_95_ppm: float
    largest_high_95_ppm: float
    rate_dps: Floats  # (m,): signed rates along the axis
    # (m,): scale-factor error of the polynomial at each rate, against its line; 0 where no term was chosen
    error_ppm: Floats
    error_u_ppm: Floats


def scale_linearity(runs: TableRuns, *, irreproducibility_ppm: float | None = None) -> Linearity | None:
    """Fit the scale-factor error over the rates of all runs; ``None`` where they are no ladder."""
    # A ladder has three rates or more, the largest at least twice the smallest, and runs in both senses.
    sizes = distinct_rates(np.abs(runs.nominal_dps))
    if len(sizes) < 3 or sizes[-1] < _RANGE * sizes[0] or np.unique(np.sign(runs.rate_dps)).size < 2:
        return None
    stated = None if irreproducibility_ppm is None else irreproducibility_ppm / _PPM
    rate = runs.end_up * runs.rate_dps
    full = float(np.abs(rate).max())
    terms = LADDER_TERMS[: 2 if len(sizes) < 5 else 4]
    columns = _columns(rate, full)
    plain = design_of(runs)

    def values_of(names: tuple[str, ...]) -> tuple[dict[str, tuple[float, float]], Floats, RunScatter]:
        design = with_drift(np.column_stack([plain, *(columns[name] for name in names)]), runs.at_s)
        scatter = find_run_scatter(
            design, runs.mean, runs.mean_u, stated, slow=runs.slow, by_model=runs.slow is not None
        )
        estimator = scatter.estimator(design)
        k = float(estimator[0] @ runs.mean)
        rows = estimator[plain.shape[1] : plain.shape[1] + len(names)] / k
        found = {
            name: (_PPM * float(row @ runs.mean), _PPM * scatter.standard_u(row))
            for name, row in zip(names, rows, strict=True)
        }
        return found, rows, scatter

    chosen: tuple[str, ...] = ()
    while True:
        tried = {name: values_of((*chosen, name))[0][name] for name in terms if name not in chosen}
        best = max(tried, key=lambda name: abs(tried[name][0]) / tried[name][1], default="")
        if not best or abs(tried[best][0]) <= _SIGNIFICANT * tried[best][1]:
            break
        chosen = (*chosen, best)
    of_chosen, rows, scatter = values_of(chosen) if chosen else ({}, np.empty((0, rate.size)), None)
    known = {**tried, **of_chosen}
    at = np.array(sorted({sense * size for size in sizes for sense in (-1.0, 1.0)}))
    # deviation of the curve of each term from its own line with a constant, over the largest output
    line = np.column_stack([at, np.ones_like(at)])
    projector = np.eye(at.size) - line @ np.linalg.pinv(line)
    shape = {name: projector @ column / full for name, column in _columns(at, full).items()}
    curve = np.column_stack([shape[name] for name in chosen]) @ rows if chosen else np.zeros((at.size, rate.size))
    error = _PPM * full * curve / at[:, np.newaxis]
    error_u = np.array([scatter.standard_u(row) for row in error]) if scatter is not None else np.zeros(at.size)
    # deviations of the curve with all terms at each rate, ppm of full scale, and their covariance
    _, of_terms, scatter_of_terms = values_of(terms)
    factors = _PPM * np.column_stack([shape[name] for name in terms]) @ of_terms
    power, spread = factors @ runs.mean, factors @ scatter_of_terms.mean_covariance() @ factors.T
    largest = _PPM * float(np.abs(curve @ runs.mean).max())
    # the largest power, and by how much noise changes it in 95 % of all cases
    values, vectors = np.linalg.eigh(spread)
    draws = np.random.default_rng(0).normal(size=(_DRAWS, values.size)) * np.sqrt(np.maximum(values, 0.0))
    seen = float(np.abs(power).max())
    wide = float(np.quantile(np.abs(draws @ vectors.T).max(axis=1), 0.95))
    rms, low, high = _rms_of(power, spread, max(runs.mean.size - plain.shape[1] - len(terms), 1))
    return Linearity(
        chosen=tuple(name for name in terms if name in chosen),
        value={name: known[name][0] for name in terms},
        value_u={name: known[name][1] for name in terms},
        rms_ppm=rms,
        rms_low_95_ppm=low,
        rms_high_95_ppm=high,
        largest_ppm=largest,
        largest_low_95_ppm=max(seen - wide, 0.0),
        largest_high_95_ppm=seen + wide,
        rate_dps=at,
        error_ppm=np.asarray(error @ runs.mean),
        error_u_ppm=error_u,
    )


def _columns(rate: Floats, full: float) -> dict[str, Floats]:
    """Columns of the output per unit of each term times K."""
    part = rate / full
    return {
        "asymmetry": np.abs(rate) / 2,
        "linear": rate * part,
        "quadratic": rate * part**2,
        "quartic": rate * part**4,
    }


def _rms_of(deviation: Floats, covariance: Floats, freedom: int) -> tuple[float, float, float]:
    """Root mean square freed of noise, and its 95 % interval, by the moments of its noise."""
    noise, square = float(np.trace(covariance)), float(np.sum(covariance**2))
    power = float(deviation @ deviation)
    scale, own = square / noise, noise**2 / square
    sizes = [max(power - noise, 0.0), *(scale * end for end in signal_interval(power / scale, own, freedom))]
    rms, low, high = (float(np.sqrt(size / deviation.size)) for size in sizes)
    return rms, low, high


# --------------------
# Where input axes point: by the earth rate's sine of one axis, or by three axes that are recorded at once.
#
# One axis along the table's: an input axis tilted by psi sees the horizontal earth rate as a sine of amplitude
# K w_h sin(psi) with the period of a turn. Its phase says nothing where nobody knows the azimuth at the begin of
# each window, so its power is taken, freed of that of the noise.
#
# Three axes at once, each brought to the table's axis in turn: with body axis b along the vertical the output of
# gyro i over whole turns is
#
#     N_i = S_ib end (Omega + w_v) + B_i
#
# The columns of S are measured one after the other; row i over its length is the direction of input axis i in the
# axes of the body, as the fixture brings them to the table's axis. What the fixture is out of square is in it.


_RIGHT_ANGLE_MRAD = 500.0 * np.pi


@dataclass(frozen=True)
class InputAxisTilt:
    """Angle between input axis and table axis."""

    # 0 where the sine does not stand out of its noise; the interval says up to where it may be hidden there
    tilt_mrad: float
    low_95_mrad: float
    high_95_mrad: float


def input_axis_tilt(
    sines: ArrayLike, sines_u: ArrayLike, horizontal_counts: float, *, freedom: float = 1e6
) -> InputAxisTilt:
    """Angle between input axis and table axis from the once-per-turn sines of several windows."""
    amplitude, u = np.abs(np.asarray(sines)), np.asarray(sines_u, dtype=np.float64)
    if not horizontal_counts > 0:
        raise ValueError("the horizontal earth rate is zero at the pole: a tilt of the input axis does not show")
    known = np.isfinite(u) & (u > 0)
    if not known.any():
        raise ValueError("no window has whole turns enough")
    power = float(np.sum((amplitude[known] / u[known]) ** 2))
    # of the power for an amplitude of one count
    each = float(np.sum(u[known] ** -2.0))
    own = 2 * int(known.sum())
    squares = [max(power - own, 0.0), *signal_interval(power, own, freedom)]
    sizes = np.sqrt(np.array(squares) / each) / horizontal_counts
    tilts = [1e3 * float(np.arcsin(size)) if size < 1 else _RIGHT_ANGLE_MRAD for size in sizes]
    return InputAxisTilt(*tilts)


@dataclass(frozen=True)
class ThreeAxes:
    """Scale factors and directions of gyros that were recorded at once."""

    gyros: tuple[str, ...]  # gyros, and body axes that were brought to the table's axis
    turned: tuple[str, ...]
    matrix: Floats  # (gyros, turned): S, counts per deg/s; with its uncertainty
    matrix_u: Floats
    bias: Floats  # (gyros,): counts; with its uncertainty
    bias_u: Floats
    # (gyros,): length of each row: along the input axis. nan unless all three axes were turned.; with its
    # uncertainty
    scale_factor: Floats
    scale_factor_u: Floats
    # (gyros, turned): direction of each input axis towards the other body axes: S_ib over S_ii; 0 towards its own.
    # nan for a gyro whose own axis was not turned.
    misalignment_mrad: Floats
    misalignment_u_mrad: Floats


def fit_three_axes(
    gyros: Sequence[str],
    turned: Sequence[str],
    rate_dps: ArrayLike,
    means: ArrayLike,
    means_u: ArrayLike,
    *,
    end_up: ArrayLike = 1,
    at_s: ArrayLike = np.nan,
    vertical_earth_rate_dps: float = 0.0,
    irreproducibility_ppm: float | None = None,
    table_rate_u_ppm: float = 0.0,
    slow: Sequence[Floats | None] = (),
) -> ThreeAxes:
    """Fit the matrix of scale factors and misalignments to all runs."""
    rates = np.asarray(rate_dps, dtype=np.float64)
    ends = np.broadcast_to(np.asarray(end_up, dtype=np.float64), rates.shape)
    mean, u = np.asarray(means, dtype=np.float64), np.asarray(means_u, dtype=np.float64)
    axes = tuple(dict.fromkeys(turned))
    about = np.array([[name == axis for axis in axes] for name in turned], dtype=np.float64)
    for axis, chosen in zip(axes, about.T, strict=True):
        if np.unique(np.sign((ends * rates)[chosen > 0])).size < 2:
            raise ValueError(f"axis {axis} was turned in one sense only")
    along = ends * (rates + vertical_earth_rate_dps)
    when = np.broadcast_to(np.asarray(at_s, dtype=np.float64), rates.shape)
    design = with_drift(np.column_stack([about * along[:, np.newaxis], np.ones(rates.size)]), when)
    stated = None if irreproducibility_ppm is None else 1e-6 * irreproducibility_ppm
    count = len(axes)
    matrix, matrix_u = np.empty((len(gyros), count)), np.empty((len(gyros), count))
    bias, bias_u, scale_u = np.empty(len(gyros)), np.empty(len(gyros)), np.empty(len(gyros))
    angle, angle_u = np.zeros((len(gyros), count)), np.zeros((len(gyros), count))
    for place, gyro in enumerate(gyros):
        known = slow[place] if slow else None
        scatter = find_run_scatter(
            design, mean[:, place], u[:, place], stated, slow=known, by_model=known is not None
        )
        estimator = scatter.estimator(design)
        values = estimator @ mean[:, place]
        spread = [scatter.standard_u(row) for row in estimator]
        common = 1e-6 * table_rate_u_ppm * np.abs(values[:count])
        size = float(np.linalg.norm(values[:count]))
        matrix[place], bias[place] = values[:count], values[count]
        matrix_u[place], bias_u[place] = np.hypot(spread[:count], common), spread[count]
        along_axis = scatter.standard_u(values[:count] @ estimator[:count] / size)
        scale_u[place] = np.hypot(along_axis, 1e-6 * table_rate_u_ppm * size)
        own = axes.index(gyro) if gyro in axes else None
        for other in range(count):
            if own is None:
                angle[place, other] = angle_u[place, other] = np.nan
            elif other != own:
                ratio = values[other] / values[own]
                angle[place, other] = 1e3 * ratio
                combined = (estimator[other] - ratio * estimator[own]) / values[own]
                angle_u[place, other] = 1e3 * scatter.standard_u(combined)
    whole = count == 3
    return ThreeAxes(
        tuple(gyros), axes, matrix, matrix_u, bias, bias_u,
        np.linalg.norm(matrix, axis=1) if whole else np.full(len(gyros), np.nan),
        scale_u if whole else np.full(len(gyros), np.nan),
        angle, angle_u,
    )  # fmt: skip
