"""Odd and even parts of the output over the sense of rotation, and the numbers of small rates.

Runs in both senses separate the odd part K Omega from the even part K w_v + B. The differences of odd parts are
what the patent CN104634364A makes numbers of small rates from; they are given with what they are worth.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.arrays import Floats
from analysis.fibre_gyro.rate_table.scatter import find_run_scatter
from analysis.fibre_gyro.rate_table.table_runs import (
    SAME_RATE,
    TableRuns,
    design_of,
    distinct_rates,
    missing_senses,
    with_drift,
)

_PPM = 1e6


@dataclass(frozen=True)
class OddEven:
    """Odd and even parts at each rate, in rising order of the rate.

    Attributes
    ----------
    rate_dps : ndarray, shape (m,)
        Mean size of the table's rate in both senses.
    odd, odd_u : ndarray, shape (m,)
        Half the difference of the senses, K Omega: free of bias and of the vertical earth rate. Counts.
    even, even_u : ndarray, shape (m,)
        Half their sum, K w_v + B. Counts.
    duration_s : ndarray, shape (m,)
        Mean window of the two senses.
    """

    rate_dps: Floats
    odd: Floats
    odd_u: Floats
    even: Floats
    even_u: Floats
    duration_s: Floats


def odd_even_parts(runs: TableRuns, *, end_up: int = 1) -> OddEven:
    """Odd and even parts of the runs with one end of the axis up; several runs of a kind are averaged.

    Parameters
    ----------
    end_up : {1, -1}, optional

    Raises
    ------
    ValueError
        A rate was run in one sense only; the text names it.
    """
    chosen = _of_end(runs, end_up)
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


def _of_end(runs: TableRuns, end_up: int) -> TableRuns:
    kept = runs.end_up == end_up
    if not kept.any():
        raise ValueError(f"there is no run with the {'upper' if end_up > 0 else 'lower'} end of the axis up")
    return runs.chosen(kept)


def _average(runs: TableRuns, nominal: float) -> tuple[float, float, float, float]:
    """Rate, mean, its uncertainty and the window of all runs at one signed rate, weighted by 1/u^2."""
    kept = np.abs(runs.nominal_dps - nominal) < SAME_RATE
    weights = runs.mean_u[kept] ** -2.0
    mean = float(np.average(runs.mean[kept], weights=weights))
    rate = float(np.average(runs.rate_dps[kept], weights=weights))
    return rate, mean, float(weights.sum() ** -0.5), float(runs.duration_s[kept].mean())


@dataclass(frozen=True)
class RateDifferences:
    """Output of one axis for small rates, as differences of two large ones.

    Attributes
    ----------
    delta_dps : ndarray, shape (k,)
    number : ndarray, shape (k,)
        N(delta) = D(base + delta) - D(base), counts.
    noise_u : ndarray, shape (k,)
        Standard uncertainty from the scatter of the runs.
    irreproducibility_u : ndarray, shape (k,)
        From the irreproducibility of scale factor and table rate: about s base/delta of the number.
    base_dps, base_u : float
        The rate that is subtracted, and the uncertainty of its odd part from noise (it is in every number).
    factors : ndarray, shape (k, n), or None
        Of the mean of each run in each number, where the runs are known.
    """

    delta_dps: Floats
    number: Floats
    noise_u: Floats
    irreproducibility_u: Floats
    base_dps: float
    base_u: float
    factors: Floats | None = None

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
