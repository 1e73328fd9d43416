"""Scale-factor error over a ladder of rates: polynomial, asymmetry, and nonlinearity freed of noise.

With w the rate along the axis, w_F the largest, x = w/w_F:

    N = K w [ 1 + (s/2) sign(w) + c_1 x + c_2 x^2 + c_4 x^4 ] + constants

s is the asymmetry K(+)/K(-) - 1; even powers bend the line alike in both senses, s and odd powers do not.
A term stands in the polynomial where it is more than three of its uncertainties. The nonlinearity is that of the
curve with all terms that the ladder can bear, at the rates of the runs, against its own straight line. What noise
and scatter from run to run add to its mean square is known and taken off; the interval begins at 0 where they may
make all of it.
"""

from dataclasses import dataclass

import numpy as np

from analysis.arrays import Floats
from analysis.fibre_gyro.rate_table import TableRuns, design_of, distinct_rates, with_drift
from analysis.fibre_gyro.scatter import RunScatter, find_run_scatter, signal_interval

_PPM = 1e6
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

    def scatter_with(names: tuple[str, ...]) -> tuple[Floats, RunScatter]:
        design = with_drift(np.column_stack([plain, *(columns[name] for name in names)]), runs.at_s)
        return design, find_run_scatter(
            design, runs.mean, runs.mean_u, stated, slow=runs.slow, by_model=runs.slow is not None
        )

    def values_of(names: tuple[str, ...]) -> tuple[dict[str, tuple[float, float]], Floats, RunScatter]:
        design, scatter = scatter_with(names)
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
    shape = _shape(at, full)
    curve = np.column_stack([shape[name] for name in chosen]) @ rows if chosen else np.zeros((at.size, rate.size))
    error = _PPM * full * curve / at[:, np.newaxis]
    error_u = np.array([scatter.standard_u(row) for row in error]) if scatter is not None else np.zeros(at.size)
    # deviations of the curve with all terms at each rate, ppm of full scale, and their covariance
    _, of_terms, scatter_of_terms = values_of(terms)
    factors = _PPM * np.column_stack([shape[name] for name in terms]) @ of_terms
    power, spread = factors @ runs.mean, factors @ scatter_of_terms.mean_covariance() @ factors.T
    largest = _PPM * float(np.abs(curve @ runs.mean).max())
    seen, wide = _largest_of(power, spread)
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


def _shape(rate: Floats, full: float) -> dict[str, Floats]:
    """Deviation of the curve of each term from its own line with a constant, over the largest output."""
    line = np.column_stack([rate, np.ones_like(rate)])
    projector = np.eye(rate.size) - line @ np.linalg.pinv(line)
    return {name: projector @ column / full for name, column in _columns(rate, full).items()}


def _rms_of(deviation: Floats, covariance: Floats, freedom: int) -> tuple[float, float, float]:
    """Root mean square freed of noise, and its 95 % interval, by the moments of its noise."""
    noise, square = float(np.trace(covariance)), float(np.sum(covariance**2))
    power = float(deviation @ deviation)
    scale, own = square / noise, noise**2 / square
    sizes = [max(power - noise, 0.0), *(scale * end for end in signal_interval(power / scale, own, freedom))]
    rms, low, high = (float(np.sqrt(size / deviation.size)) for size in sizes)
    return rms, low, high


def _largest_of(deviation: Floats, covariance: Floats) -> tuple[float, float]:
    """Largest deviation, and by how much noise changes it in 95 % of all cases."""
    values, vectors = np.linalg.eigh(covariance)
    draws = np.random.default_rng(0).normal(size=(_DRAWS, values.size)) * np.sqrt(np.maximum(values, 0.0))
    largest = np.abs(draws @ vectors.T).max(axis=1)
    return float(np.abs(deviation).max()), float(np.quantile(largest, 0.95))
