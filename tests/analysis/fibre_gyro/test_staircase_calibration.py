"""Numbers of the staircase, slope and predictions, against the patent's sums, NumPy's polyfit and hand data."""

import numpy as np
import pytest

from analysis.fibre_gyro import (
    compare_scale,
    fit_slope,
    odd_even_parts,
    predicted_difference_ppm,
    predicted_self_scale,
    predicted_table_scale,
    rate_differences,
    scaled_numbers,
    steps_beyond_dac,
    superposed_numbers,
    table_runs,
)

K = 246.152866
BOTH = np.array([20.0, 20.01, 20.1, 21.0, -20.0, -20.01, -20.1, -21.0])
RATES = np.array([-20.0, -10.0, -1.0, -0.1, 0.1, 1.0, 10.0, 20.0])


def patents_slope(w: list[float], f: list[float]) -> tuple[float, float]:
    """The sums as they stand in the patent, one after the other."""
    m = len(w)
    k = (sum(a * b for a, b in zip(w, f, strict=True)) - sum(w) * sum(f) / m) / (
        sum(a * a for a in w) - sum(w) ** 2 / m
    )
    return k, sum(f) / m - k * sum(w) / m


def test_the_slope_is_the_patents_and_polyfits() -> None:
    rng = np.random.default_rng(1)
    output = K * RATES + 0.3 + rng.normal(0, 0.01, RATES.size)
    fit = fit_slope(RATES, output)
    assert (fit.slope, fit.intercept) == pytest.approx(patents_slope(RATES.tolist(), output.tolist()), rel=1e-10)
    values, covariance = np.polyfit(RATES, output, 1, cov=True)
    assert (fit.slope, fit.intercept) == pytest.approx(tuple(values), rel=1e-10)
    assert (fit.slope_u, fit.intercept_u) == pytest.approx(tuple(np.sqrt(np.diag(covariance))), rel=1e-8)


def test_the_weighted_slope_is_polyfits() -> None:
    rng = np.random.default_rng(2)
    u = rng.uniform(0.001, 0.1, RATES.size)
    output = K * RATES + 0.3 + 0.3 * rng.normal(0, u)
    fit = fit_slope(RATES, output, u)
    assert fit.chi_square < 6
    values, covariance = np.polyfit(RATES, output, 1, w=1 / u, cov="unscaled")
    assert (fit.slope, fit.intercept) == pytest.approx(tuple(values), rel=1e-9)
    assert (fit.slope_u, fit.intercept_u) == pytest.approx(tuple(np.sqrt(np.diag(covariance))), rel=1e-8)
    worse = fit_slope(RATES, K * RATES + rng.normal(0, 5 * u), u)
    assert worse.slope_u > 2 * fit.slope_u
    with pytest.raises(ValueError, match="three points"):
        fit_slope([1.0, 2.0], [1.0, 2.0])
    with pytest.raises(ValueError, match="two or more rates"):
        fit_slope([1.0, 1.0, 1.0], [1.0, 2.0, 3.0])


def test_the_standard_error_is_the_scatter_of_the_slopes() -> None:
    rng = np.random.default_rng(3)
    fits = [fit_slope(RATES, K * RATES + rng.normal(0, 0.02, RATES.size), np.full(8, 0.02)) for _ in range(2000)]
    distance = [(fit.slope - K) / fit.slope_u for fit in fits]
    assert np.std(distance) == pytest.approx(0.94, abs=0.06)


def test_numbers_are_built_from_the_differences() -> None:
    runs = table_runs(BOTH, K * BOTH + 5.0, 0.001)
    differences = rate_differences(odd_even_parts(runs), irreproducibility_ppm=0)
    plan = superposed_numbers([0.37, -20.0, 0.015, 1.11], differences)
    assert plan.multiples.tolist() == [[7, 3, 0], [0, 0, -20], [1.5, 0, 0], [1, 1, 1]]
    assert plan.number == pytest.approx(K * plan.rate_dps, rel=1e-9)
    assert scaled_numbers([2.0], K, 0.5).number.tolist() == [2 * K]
    assert scaled_numbers([-2.0], K, 0.5).number_u.tolist() == [1.0]


@pytest.mark.parametrize(
    ("white", "irreproducible"), [pytest.param(1e-3, 0.0, marks=pytest.mark.slow), (1e-9, 10e-6)]
)
def test_numbers_scatter_as_their_uncertainty_says(white: float, irreproducible: float) -> None:
    """The base rate is in every difference: 1.11 deg/s holds it three times over."""
    rng = np.random.default_rng(7)
    found = []
    for _ in range(1500):
        scale = K * (1 + irreproducible * rng.normal(size=8))
        runs = table_runs(BOTH, scale * BOTH + white * rng.normal(size=8), white)
        differences = rate_differences(odd_even_parts(runs), irreproducibility_ppm=1e6 * irreproducible)
        plan = superposed_numbers([1.11, 0.3, 20.0], differences)
        found.append(plan.number)
    assert np.std(found, axis=0) == pytest.approx(plan.number_u, rel=0.08)


def test_steps_beyond_the_converter_are_found() -> None:
    # 16 bits: half the range is a phase of pi, 133.1 deg/s for a coil of 1000 m and 0.1 m
    assert steps_beyond_dac(K * np.array([133.0, 133.2, -133.2]), 16).tolist() == [False, True, True]


def test_an_offset_of_the_steps_is_the_intercept() -> None:
    """It does not move the slope."""
    fit = fit_slope(RATES, K * RATES + 0.5, np.full(8, 0.01))
    assert fit.intercept == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("eps", "gated", "table_ppm"),
    [
        # prototype figures: slope of the table against eps, in ppm of K0
        (1e-4, True, -99.99), (1e-3, True, -999.00), (5e-3, True, -4975.1), (1e-2, True, -9900.99),
        (-5e-3, True, 5025.1), (1e-2, False, -6.6), (5e-3, False, -0.8), (-5e-3, False, 0.8),
    ],
)  # fmt: skip
def test_predicted_scale_of_the_table(eps: float, gated: bool, table_ppm: float) -> None:
    table = predicted_table_scale(0.0, eps, gated=gated)
    assert 1e6 * (table - 1) == pytest.approx(table_ppm, abs=0.06)
    self_scale = predicted_self_scale("shared", eps, gated=gated)
    # with numbers by design the shared path is off by eps where resets are gated out, to first order not else
    assert predicted_difference_ppm(1.0, self_scale, table) == pytest.approx(
        1e6 * eps if gated else -table_ppm, rel=0.05
    )
    # with numbers made by this very table run it agrees, whatever eps is
    assert predicted_difference_ppm(table, self_scale, table) == pytest.approx(0, abs=1e-9)


def test_predictions_of_the_second_electrode_and_of_the_optics() -> None:
    table = predicted_table_scale(0.0, 0.003, gated=True)
    second = predicted_self_scale("separate", 0.003, gated=True)
    assert predicted_difference_ppm(1.0, second, table) == pytest.approx(0, abs=1e-9)
    drifted = predicted_self_scale("separate", 0.003, 1e-4, gated=True)
    assert predicted_difference_ppm(1.0, drifted, table) == pytest.approx(100)
    warmer = predicted_table_scale(100e-6, gated=True)
    assert predicted_difference_ppm(1.0, 1.0, warmer) == pytest.approx(-99.99, abs=0.01)


def test_comparison_with_the_table() -> None:
    u = np.full(8, 0.001)
    found = fit_slope(RATES, K * (1 + 5e-6) * RATES, u)
    excess = fit_slope(RATES, K * 5e-6 * RATES, u)
    compared = compare_scale(found, excess, (K * (1 + 2e-6), K * 4e-6), numbers_u=K * 3e-6)
    assert compared.difference_ppm == pytest.approx(3.0, abs=1e-3)
    assert compared.against_numbers_ppm == pytest.approx(5.0, abs=1e-3)
    assert compared.against_numbers_u_ppm == pytest.approx(1e6 * found.slope_u / K, rel=1e-4)
    expected = np.hypot(5.0, compared.against_numbers_u_ppm)
    assert compared.difference_u_ppm == pytest.approx(expected, rel=1e-4)
