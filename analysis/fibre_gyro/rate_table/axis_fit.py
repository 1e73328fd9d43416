"""Scale factor, earth rate, bias and its drift of one axis by weighted least squares over all runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from analysis.arrays import Floats
from analysis.fibre_gyro.rate_table.scatter import find_run_scatter
from analysis.fibre_gyro.rate_table.table_runs import TableRuns, design_of, with_drift
from analysis.rotation import EARTH_RATE_DPS

_EARTH_RATE_DPH = 3600.0 * EARTH_RATE_DPS
_PPM = 1e6


@dataclass(frozen=True)
class AxisFit:
    """Scale factor of one axis.

    Attributes
    ----------
    scale_factor, scale_factor_u : float
        K, counts per deg/s.
    contributions : mapping of str to float
        What each cause contributes to the uncertainty of K, counts per deg/s: "noise" within the runs, "slow
        noise" by the noise model, "stated" irreproducibility, "scatter" beyond all of them, "table rate".
    factors : ndarray, shape (n,)
        Of the mean of each run in K, deg/s.
    covariance : ndarray, shape (n, n)
        Of the means, by noise and scatter, counts^2.
    even, even_u : float
        Even part, counts: K w_v + B with the axis up, B - K w_v with the axis down.
    even_dph : tuple of float
        The same as a rate, deg/h, and its standard uncertainty: vertical earth rate and bias together.
    earth_rate_dph, bias_dph : tuple of float
        Vertical earth rate and bias each by itself, with uncertainty; nan unless both ends were up in turn.
    drift_dph_per_h : tuple of float
        Drift of the bias that was taken out, and its uncertainty; nan where the runs are too few to show one.
    drift_in_scale_factor : float
        What the drift would have added to K, counts per deg/s.
    end_up : int
        Which end of the axis was up in all runs, 1 or -1; 0 if both were.
    residual_ppm : ndarray, shape (n,)
        Of every run, ppm of its own output.
    chi_square : float
        Of the residuals, with the uncertainties that were the weights.
    scatter_ppm : float
        Irreproducibility from run to run that the residuals show beyond noise, ppm; 0 where noise explains them.
    scatter_assumed : bool
        Whether the runs cannot show their irreproducibility and nobody states it: a bound is counted.
    angle_random_walk : float
        deg/sqrt(h), from the uncertainties of the means: the white noise that would explain them.
    """

    scale_factor: float
    scale_factor_u: float
    contributions: Mapping[str, float]
    factors: Floats
    covariance: Floats
    even: float
    even_u: float
    even_dph: tuple[float, float]
    earth_rate_dph: tuple[float, float]
    bias_dph: tuple[float, float]
    drift_dph_per_h: tuple[float, float]
    drift_in_scale_factor: float
    end_up: int
    residual_ppm: Floats
    chi_square: float
    degrees_of_freedom: int
    scatter_ppm: float
    scatter_assumed: bool
    angle_random_walk: float


def fit_axis(
    runs: TableRuns, *, irreproducibility_ppm: float | None = None, table_rate_u_ppm: float = 0.0
) -> AxisFit:
    """Fit scale factor, earth rate, bias and its drift of one axis to all runs.

    Weights are 1/u^2 with u the noise of the mean and, in quadrature, the irreproducibility of the run, stated or
    as the residuals show it. All uncertainties count the scatter that the residuals allow (`scatter`); 1.96 of
    them are half a 95 % interval. The drift is fitted where three degrees of freedom are left with it.

    Parameters
    ----------
    irreproducibility_ppm : float or None, optional
        Known standard deviation of scale factor and table rate from run to run, ppm.
    table_rate_u_ppm : float, optional
        Standard uncertainty of the table's rate that is common to all runs, ppm.

    Raises
    ------
    ValueError
        All runs are in one sense.
    """
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
        scatter_ppm=_excess_scatter(runs, residual, freedom),
        scatter_assumed=scatter.assumed,
        angle_random_walk=_angle_random_walk(runs, k),
    )


def correlation_with_numbers(fit: AxisFit, factors: Floats) -> Floats:
    """Correlation of K and of numbers of small rates that come from the same runs, shape (1 + k, 1 + k).

    Parameters
    ----------
    factors : ndarray, shape (k, n)
        Of :class:`RateDifferences`.
    """
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


def _excess_scatter(runs: TableRuns, residual: Floats, freedom: int) -> float:
    """Run-to-run irreproducibility, ppm, that the residuals show beyond the noise of the means."""
    if freedom < 1:
        return 0.0
    excess = float(np.sum(residual**2 - runs.mean_u**2 * freedom / residual.size)) / freedom
    return _PPM * float(np.sqrt(max(excess, 0.0) / np.mean(runs.mean**2)))


def _angle_random_walk(runs: TableRuns, scale_factor: float) -> float:
    each = 60.0 * runs.mean_u / abs(scale_factor) * np.sqrt(runs.duration_s)
    return float(np.sqrt(np.mean(each**2)))


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
