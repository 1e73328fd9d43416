"""The noise model against words that are made here, and the Allan variances of the textbooks."""

import numpy as np
import pytest

from analysis.fibre_gyro import allan_curve, allan_variance, fit_noise
from analysis.fibre_gyro.allan import with_words_put_in

INTERVAL = 0.1
N, K, Q = 1e-4, 2e-5, 3e-5


def words(seed: int, count: int, *, walk: float = N, wander: float = 0.0, rounding: float = 0.0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    level = np.cumsum(rng.normal(0, wander * np.sqrt(INTERVAL), count))
    angle = rng.normal(0, rounding, count + 1)
    return rng.normal(0, walk / np.sqrt(INTERVAL), count) + level + np.diff(angle) / INTERVAL


@pytest.mark.slow
def test_terms_are_found_where_they_are_and_nowhere_else():
    fit = fit_noise(words(11, 20_000), INTERVAL)
    assert fit.chosen == ("angle_random_walk",)
    assert fit.coefficients["angle_random_walk"] == pytest.approx(
        N, abs=6 * fit.coefficients_u["angle_random_walk"]
    )
    # sqrt(1/2n) of white noise alone
    assert fit.coefficients_u["angle_random_walk"] / N == pytest.approx(1 / np.sqrt(40_000), rel=0.15)
    assert all(fit.low_95[name] == 0 for name in ("quantization", "rate_random_walk", "bias_instability"))
    whole = fit_noise(words(2, 20_000, wander=K, rounding=Q), INTERVAL)
    truth = {"quantization": Q, "angle_random_walk": N, "rate_random_walk": K}
    assert set(whole.chosen) == set(truth)
    for name, value in truth.items():
        assert whole.coefficients[name] == pytest.approx(value, abs=6 * whole.coefficients_u[name])
        assert whole.coefficients_u[name] < 0.2 * value


def test_bias_instability_is_that_of_the_flat_part():
    rng = np.random.default_rng(5)
    frequency = np.fft.rfftfreq(1 << 16)
    shape = np.zeros(frequency.size)
    shape[1:] = (2 * np.pi * frequency[1:]) ** -0.5  # two-sided spectrum B^2/(2 pi f) with B = 1
    flicker = np.fft.irfft(np.fft.rfft(rng.normal(size=1 << 16)) * shape)[:30_000]
    fit = fit_noise(1e-3 * flicker + words(6, 30_000, walk=3e-4), INTERVAL)
    assert "bias_instability" in fit.chosen
    assert fit.coefficients["bias_instability"] == pytest.approx(1e-3, rel=0.15)


def test_slow_noise_that_may_be_another_kind_counts_so():
    fit = fit_noise(words(29, 4096, wander=1.2e-5), INTERVAL)
    # seven minutes: a walk is more likely, and bias instability alone would do as well
    assert fit.chosen == ("angle_random_walk", "rate_random_walk")
    assert fit.low_95["rate_random_walk"] == 0 < 1.2e-5 < fit.high_95["rate_random_walk"] < 3e-5
    assert 3.92 * fit.coefficients_u["rate_random_walk"] == pytest.approx(
        fit.high_95["rate_random_walk"], rel=1e-3
    )
    assert 1e-5 < fit.high_95["bias_instability"] < 1e-4


def test_a_walk_that_hides_behind_flicker_is_within_its_bound():
    """The data can do without the walk: its bound counts how much a larger one would have scattered."""
    rng, walk = np.random.default_rng([6, 2]), 8e-6
    frequency = np.fft.rfftfreq(1 << 16)
    shape = np.append(0.0, (2 * np.pi * frequency[1:]) ** -0.5)
    flicker = np.fft.irfft(np.fft.rfft(rng.normal(size=1 << 16)) * shape)[:20_000]
    fit = fit_noise(1e-4 * flicker + words(6, 20_000, wander=walk), INTERVAL)
    assert "rate_random_walk" not in fit.chosen
    assert walk < fit.high_95["rate_random_walk"] < 3 * walk


def test_gaps_and_outliers_leave_the_noise_as_it_is():
    values = words(3, 20_000)
    values[4000] += 1.0
    values[9000:9400] = np.nan
    values[12_345] = np.nan
    fit = fit_noise(values, INTERVAL)
    assert (fit.missing, fit.outliers) == (401, 1)
    assert fit.coefficients["angle_random_walk"] == pytest.approx(
        N, abs=6 * fit.coefficients_u["angle_random_walk"]
    )
    with pytest.raises(ValueError, match="at least 512"):
        fit_noise(values[:100], INTERVAL)
    with pytest.raises(ValueError, match="does not move"):
        fit_noise(np.zeros(2000), INTERVAL)


@pytest.mark.slow
def test_lost_words_leave_the_fast_noise_as_it_is():
    """Lines over the gaps make it twice as large: they tear apart what quantization keeps together."""
    values = words(20, 6000, rounding=4 * Q)
    values[np.flatnonzero(np.random.default_rng(3).random(6000) < 0.05)[1:-1]] = np.nan
    fit = fit_noise(values, INTERVAL)
    assert fit.coefficients["angle_random_walk"] == pytest.approx(
        N, abs=4 * fit.coefficients_u["angle_random_walk"]
    )
    assert fit.coefficients_u["angle_random_walk"] < 0.1 * N
    assert fit.low_95["quantization"] * 0.97 <= 4 * Q <= fit.high_95["quantization"] * 1.03


def test_words_put_in_have_the_noise_of_the_others():
    """Increments of quantized angles: put in by the model they stay small; on lines their sums wander."""
    values = words(31, 20_000, rounding=10 * Q)
    gone = np.arange(50, 19_950, 40)
    squares = {"quantization": (10 * Q) ** 2, "angle_random_walk": N**2}
    filled = with_words_put_in(np.where(np.isin(np.arange(20_000), gone), np.nan, values), squares, INTERVAL)
    assert np.array_equal(np.delete(filled, gone), np.delete(values, gone))
    assert 0 < np.std(filled[gone] - values[gone]) < 0.5 * np.std(values)
    assert np.std(filled[gone]) == pytest.approx(np.std(values), rel=0.2)


@pytest.mark.slow
def test_ramp_and_temperature_are_no_noise():
    count = 20_000
    at = np.arange(count) * INTERVAL
    ramp = fit_noise(words(7, count) + 5e-8 * at, INTERVAL)
    assert ramp.chosen == ("angle_random_walk", "rate_ramp")
    assert ramp.coefficients["rate_ramp"] == pytest.approx(5e-8, abs=6 * ramp.coefficients_u["rate_ramp"])
    heat = 20 + 5 * np.sin(at / 300)
    warm = fit_noise(words(8, count) + 1e-4 * heat, INTERVAL, temperature=heat)
    assert warm.temperature_slope == pytest.approx(1e-4, abs=6 * warm.temperature_slope_u)
    assert warm.temperature_slope_u < 1e-5
    assert warm.chosen == ("angle_random_walk",)


def test_the_curve_and_the_variances_of_the_terms_agree():
    curve = allan_curve(words(4, 50_000, wander=K, rounding=Q), INTERVAL)
    terms = {"quantization": Q, "angle_random_walk": N, "rate_random_walk": K}
    model = np.sqrt(allan_variance(terms, curve.tau_s))
    short = curve.tau_s < 100
    values = words(4, 50_000, wander=K, rounding=Q)
    values[1000] += 1e3
    values[20_000:20_040], values[5::50] = np.nan, np.nan
    gappy = allan_curve(values, INTERVAL, terms)
    assert np.all(np.abs(gappy.deviation / curve.deviation - 1)[short] < 0.02)
    assert np.all(np.abs(curve.deviation - model)[short] < 6 * curve.deviation_u[short] + 0.02 * model[short])
