"""Figures of merit against hand data and against a plain polyfit."""

import numpy as np
import pytest

from analysis.fibre_gyro import repeatability, residual_pattern, scale_figures, temperature_coefficient_ppm

RATES = np.array([-100, -50, -20, -10, -5, -2, -0.5, -0.1, 0.1, 0.5, 2, 5, 10, 20, 50, 100.0])


def test_nonlinearity_by_hand() -> None:
    """Rates -1, 0, 1 with outputs -10, 3, 10: slope 10, intercept 1, deviations 1, -2, 1 of full scale 10."""
    figures = scale_figures([-1.0, 0.0, 1.0], [-10.0, 3.0, 10.0])
    assert (figures.fit.slope, figures.fit.intercept) == (10.0, 1.0)
    assert figures.deviation_of_full_scale_ppm == pytest.approx([1e5, -2e5, 1e5])
    assert figures.nonlinearity_ppm == pytest.approx(2e5)
    assert figures.deviation_of_point_ppm[[0, 2]] == pytest.approx([1e5, -1e5])
    assert np.isnan(figures.deviation_of_point_ppm[1])
    assert figures.nonlinearity_of_point_ppm == pytest.approx(1e5)
    assert np.isnan(figures.nonlinearity_u_ppm)


def test_asymmetry_by_hand() -> None:
    """K(+) = 1002 from 1002, 2004; K(-) = 1000: asymmetry 2/1001, with the errors of two points each."""
    figures = scale_figures([-2.0, -1.0, 1.0, 2.0], [-2000.0, -1000.0, 1002.0, 2004.0], [0.3, 0.4, 0.3, 0.4])
    assert figures.scale_factor_positive == pytest.approx(1002)
    assert figures.scale_factor_negative == pytest.approx(1000)
    assert figures.asymmetry_ppm == pytest.approx(1e6 * 2 / 1001)
    assert figures.asymmetry_u_ppm == pytest.approx(1e6 * 0.5 * np.sqrt(2) / 1001)
    assert np.isnan(scale_figures([1.0, 2.0, 3.0], [1.0, 2.0, 3.0]).asymmetry_ppm)


def test_figures_are_those_of_polyfit() -> None:
    rng = np.random.default_rng(1)
    output = 246.0 * RATES + 2e-5 * RATES**3 + 0.004 * np.abs(RATES) + rng.normal(0, 0.01, RATES.size)
    figures = scale_figures(RATES, output)
    line = np.polyval(np.polyfit(RATES, output, 1), RATES)
    assert figures.nonlinearity_ppm == pytest.approx(1e6 * np.abs(line - output).max() / np.abs(output).max())
    up, down = (np.polyfit(RATES[s * RATES > 0], output[s * RATES > 0], 1)[0] for s in (1, -1))
    assert figures.asymmetry_ppm == pytest.approx(1e6 * abs(up - down) / ((up + down) / 2))


def test_repeatability_and_temperature_coefficient_by_hand() -> None:
    # 99, 100, 101: standard deviation 1, mean 100
    assert repeatability([99.0, 100.0, 101.0], [0.0, 0.0, 0.0]).value == pytest.approx(1.0)
    with pytest.raises(ValueError, match="two switchings"):
        repeatability([1.0], [0.0])
    # 40 ppm in 20 K and 90 ppm in 30 K
    k, t = [100.004, 100.0, 99.991], [-5.0, 15.0, 45.0]
    assert temperature_coefficient_ppm(k, t, reference=(100.0, 15.0)) == pytest.approx(3.0)
    with pytest.raises(ValueError, match="second temperature"):
        temperature_coefficient_ppm([1.0], [15.0], reference=(1.0, 15.0))


def pattern_of(shape: np.ndarray, seed: int = 1) -> tuple[str, ...]:
    output = 246.0 * RATES + 0.3 + shape + np.random.default_rng(seed).normal(0, 0.01, RATES.size)
    return residual_pattern(RATES, output, np.full(RATES.size, 0.01)).names


def test_patterns_are_told_apart() -> None:
    assert pattern_of(1e-6 * RATES**3) == ("odd",)
    assert pattern_of(1e-4 * RATES**3) == ("odd",)
    assert pattern_of(0.003 * np.abs(RATES)) == ("even",)
    assert pattern_of(np.where(np.abs(RATES) < 0.3, -246.0 * RATES, 0.0)) == ("near zero",)
    assert set(pattern_of(1e-6 * RATES**3 + 0.003 * np.abs(RATES))) == {"odd", "even"}
    assert sum(bool(pattern_of(0 * RATES, seed)) for seed in range(200)) <= 3


def test_the_size_of_a_dead_zone_is_that_of_the_point() -> None:
    output = np.where(np.abs(RATES) < 0.3, 0.0, 246.0 * RATES)
    pattern = residual_pattern(RATES, output, np.full(RATES.size, 0.01))
    assert pattern.near_zero_ppm == pytest.approx(1e6)
    assert pattern.odd_ppm == pytest.approx(0, abs=1e-3)


def test_points_in_one_sense_give_no_odd_or_even_part() -> None:
    rates = np.array([0.1, 1.0, 10.0, 50.0, 100.0])
    pattern = residual_pattern(rates, 10 * rates, np.full(5, 0.01))
    assert np.isnan(pattern.odd_ppm)
    assert np.isnan(pattern.odd_p)
    assert pattern.names == ()


def test_the_u_of_an_asymmetry_is_that_of_the_noise_and_no_curve_widens_it() -> None:
    """Runs with a cubic curve 30 times the noise: the same in both senses, so it is none of the asymmetry."""
    rng = np.random.default_rng(7)
    off = []
    for _ in range(300):
        asymmetry, cubic = rng.uniform(-3e-6, 3e-6), rng.uniform(-5e-9, 5e-9)
        u = rng.uniform(0.02, 0.08, RATES.size)
        outputs = 246.0 * (1 + asymmetry * np.sign(RATES) / 2) * RATES + 246 * cubic * RATES**3 + rng.normal(0, u)
        figures = scale_figures(RATES, outputs, u)
        signed = 1e6 * (figures.scale_factor_positive - figures.scale_factor_negative) / 246
        off.append((signed - 1e6 * asymmetry) / figures.asymmetry_u_ppm)
    assert 0.9 < np.sqrt(np.mean(np.square(off))) < 1.1
