"""A quantity over the temperature against polynomials by NumPy, and against series made by formula."""

import math

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import norm

from analysis.fibre_gyro import fit_over_temperature, temperature_course
from analysis.fibre_gyro.temperature import Mixture


def up_and_down(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, s, temperature and its change, K/min, of a ramp from -20 to 60 deg C and back."""
    at = np.linspace(0, 9600, count)
    return at, np.where(at < 4800, -20 + at / 60, 60 - (at - 4800) / 60), np.where(at < 4800, 1.0, -1.0)


def test_white_noise_gives_the_polynomial_of_least_squares() -> None:
    at, warm, rate = up_and_down(120)
    rng = np.random.default_rng(1)
    value = 1.0 + 0.02 * (warm - 20) - 3e-4 * (warm - 20) ** 2 + rng.normal(0, 0.02, at.size)
    found = fit_over_temperature(value, np.full(at.size, 0.02), at, warm, rate, reference=20.0, highest_order=3)
    expected, covariance = np.polyfit(warm - 20, value, found.order, cov="unscaled")
    assert found.order in (2, 3)
    assert not found.with_rate
    assert found.coefficients == pytest.approx(expected[::-1], rel=0.02, abs=2e-4)
    least = 0.02 * np.sqrt(np.diag(covariance))[::-1]
    assert np.all(found.coefficients_u > 0.95 * least)  # other models and slow noise only add to it
    assert np.all(np.abs(found.coefficients[:3] - [1.0, 0.02, -3e-4]) < 5 * found.coefficients_u[:3])
    assert sum(one.weight for one in found.candidates) == pytest.approx(1.0)
    assert found.candidates[0].aicc == 0.0


def test_the_change_in_time_is_told_from_the_temperature() -> None:
    at, warm, rate = up_and_down(100)
    value = 0.3 * rate + 0.01 * warm + np.random.default_rng(2).normal(0, 0.05, at.size)
    found = fit_over_temperature(value, np.full(at.size, 0.05), at, warm, rate, reference=0.0)
    assert (found.order, found.with_rate, found.rate_known) == (1, True, True)
    assert abs(found.rate_coefficient - 0.3) < 5 * found.rate_coefficient_u < 0.06


def test_a_ramp_of_one_direction_cannot_tell_them() -> None:
    at, warm, rate = (one[:50] for one in up_and_down(100))
    value = 0.3 * rate + 0.01 * warm + np.random.default_rng(3).normal(0, 0.05, at.size)
    found = fit_over_temperature(value, np.full(at.size, 0.05), at, warm, rate, reference=0.0)
    assert not found.rate_known
    assert math.isnan(found.rate_coefficient)
    assert found.coefficients[0] == pytest.approx(0.3, abs=0.1)  # it is in the constant


def test_slow_noise_counts_in_the_uncertainty() -> None:
    at, warm, rate = up_and_down(120)
    rng = np.random.default_rng(4)
    decay = math.exp(-(at[1] - at[0]) / 1500)
    slow = np.empty(at.size)
    slow[0] = rng.normal(0, 0.1)
    for k in range(1, at.size):
        slow[k] = decay * slow[k - 1] + rng.normal(0, 0.1 * math.sqrt(1 - decay**2))
    value = 2.0 + 0.01 * warm + slow + rng.normal(0, 0.02, at.size)
    found = fit_over_temperature(value, np.full(at.size, 0.02), at, warm, rate, reference=20.0, highest_order=3)
    as_white = 0.1 / math.sqrt(at.size)
    assert found.coefficients_u[0] > 3 * as_white
    middle, u = found.at(20.0)
    assert abs(middle[0] - 2.2) < 5 * u[0]
    assert 0.06 < found.slow < 0.25  # what is slower than the run is in it
    assert found.slow_kind in ("from segment to segment", "as 1/f", "as a walk")


def test_what_is_unlikely_and_far_off_does_not_rule_the_interval() -> None:
    at, warm, rate = up_and_down(120)
    ratios = []
    for seed in range(8):
        value = 1.0 + 0.02 * warm + np.random.default_rng(seed).normal(0, 0.1, at.size)
        found = fit_over_temperature(value, np.full(at.size, 0.1), at, warm, rate, reference=20.0)
        ratios.append(found.coefficients_u[0] / (0.1 / math.sqrt(at.size)))
    assert 1.0 < np.median(ratios) < 1.8  # 1.5 of it are those of a parabola, which is likely enough


def test_u_is_the_half_width_of_95_per_cent_of_a_mixture() -> None:
    alone = Mixture(np.ones(1), np.array([[1.0, 2.0]]), np.array([np.diag([0.04, 0.09])]))
    both = alone.standard_u(np.array([[1.0, 0.0], [3.0, 4.0]]), np.array([1.0, 2.0]))
    assert both == pytest.approx([0.2, math.hypot(0.6, 1.2)], rel=1e-6)
    weight, mean, sigma = np.array([0.9, 0.07, 0.03]), np.array([0.0, 1.5, -2.0]), np.array([1.0, 2.0, 40.0])
    mixed = Mixture(weight, mean[:, np.newaxis], (sigma**2)[:, np.newaxis, np.newaxis])
    expected = brentq(lambda h: weight @ (norm.cdf(h, mean, sigma) - norm.cdf(-h, mean, sigma)) - 0.95, 0, 100)
    assert mixed.standard_u(np.eye(1), np.zeros(1))[0] * norm.ppf(0.975) == pytest.approx(expected, rel=1e-6)


@pytest.mark.slow
def test_intervals_hold_whatever_the_data_choose() -> None:
    at, warm, rate = up_and_down(40)
    held = []
    for seed in range(120):
        rng = np.random.default_rng(seed)
        c = rng.normal(0, [1.0, 0.02, 3e-4])
        value = c[0] + c[1] * warm + c[2] * warm**2 + rng.normal(0, 0.1, at.size)
        found = fit_over_temperature(value, np.full(at.size, 0.1), at, warm, rate, reference=0.0, highest_order=3)
        middle, u = found.at([-15.0, 20.0, 55.0])
        truth = np.polyval(c[::-1], [-15.0, 20.0, 55.0])
        held.append(np.abs(middle - truth) < 1.96 * u)
    assert np.all(np.mean(held, axis=0) > 0.85)  # 0.95 less five standard deviations


def test_nothing_is_given_outside_the_measured_temperatures() -> None:
    at, warm, rate = up_and_down(40)
    found = fit_over_temperature(0.1 * warm, np.full(at.size, 0.01), at, warm, rate, reference=20.0)
    value, u = found.at([-25.0, -20.0, 0.0, warm.max(), 60.5])
    assert np.isnan(value).tolist() == [True, False, False, False, True]
    assert np.isnan(u).tolist() == [True, False, False, False, True]
    assert value[2] == pytest.approx(0.0, abs=0.02)


def test_too_little_is_refused() -> None:
    with pytest.raises(ValueError, match=r"needs four values at different temperatures, not 3 within 2 K"):
        fit_over_temperature([1.0, 2, 3], [0.1] * 3, [0.0, 1, 2], [20.0, 21, 22], reference=20.0)
    with pytest.raises(ValueError, match=r"not 5 within 0 K"):
        fit_over_temperature([1.0] * 5, [0.1] * 5, np.arange(5.0), [20.0] * 5, reference=20.0)


def test_course_of_a_rounded_and_noisy_thermometer() -> None:
    times = np.arange(0.0, 600.0, 0.5)
    rng = np.random.default_rng(5)
    thermometer = np.round(20 + times / 60 + rng.normal(0, 0.03, times.size), 1)
    thermometer[::7] = np.nan
    warm, rate, rate_u = temperature_course(times, thermometer, [0.0, 300.0, 599.0], window_s=120.0)
    assert warm == pytest.approx([20.0, 25.0, 20 + 599 / 60], abs=0.05)
    assert np.all(np.abs(rate - 1.0) < 5 * rate_u)
    # by hand: 0.042 K of noise and rounding, 206 values over 120 s
    by_hand = 60 * math.hypot(0.03, 0.1 / math.sqrt(12)) * math.sqrt(12 / 206) / 120
    assert rate_u == pytest.approx(by_hand, rel=0.2)
    with pytest.raises(ValueError, match="gives 2 temperatures"):
        temperature_course([0.0, 1, 2], [20.0, math.nan, 21], [1.0], window_s=10.0)
