import numpy as np
import pytest
from reference import integrated_beat

from analysis import fit_harmonics
from analysis.frequency_method import FrequencyFlag, fit_frequencies
from analysis.ring_laser import steady_beat, symmetric_laser
from station.lock_in.messages import describe_frequencies

K, WL = 2000.0, 0.05


def beats(rates, *, lock_in=WL, bias=0.0, scale=K):
    return scale * np.sqrt((rates - bias) ** 2 - lock_in**2)


def both(*multiples):
    return WL * np.array([*multiples, *(-m for m in multiples)])


@pytest.mark.slow
def test_integrated_beats_give_lock_in_bias_and_scale_factor():
    rates, bias = both(1.3, 2, 4, 9), 0.004
    f = []
    for rate in rates:
        guess = beats(rate, bias=bias)
        times = np.arange(4000) * 60 / guess / 4000
        volts = integrated_beat(times, K, rate - bias, WL, phi0=0.4)
        f.append(float(fit_harmonics(volts, times[1], harmonics=12).frequency))
    fit = fit_frequencies(rates, f, 1e-3)
    assert fit.lock_in_rate == pytest.approx(WL, rel=1e-5)
    assert fit.bias_rate == pytest.approx(bias, rel=1e-5)
    assert fit.scale_factor == pytest.approx(K, rel=1e-7)
    assert fit.degrees_of_freedom == 5


@pytest.mark.parametrize(("x", "share"), [(0.02, 4e-6), (0.05, 25e-6), (0.1, 100e-6), (0.5, 0.003)])
def test_one_percent_of_lock_in_needs_the_known_accuracy(x, share):
    """One rate, K known: dWL/WL = (1/x^2 - 1) df/f; these shares of f are worth about 1 % of WL."""
    rate = np.array([WL / x])
    fit = fit_frequencies(rate, beats(rate), share * beats(rate), scale_factor=K, bias=False)
    assert fit.lock_in_rate_u / fit.lock_in_rate == pytest.approx((1 / x**2 - 1) * share, rel=1e-3)
    assert fit.lock_in_rate_u / fit.lock_in_rate == pytest.approx(0.01, rel=0.12)
    # An error of K is worth as much as one of f: both enter f/K.
    by_scale = fit_frequencies(rate, beats(rate), 1e-6, scale_factor=K, scale_factor_u=share * K, bias=False)
    assert by_scale.lock_in_rate_u == pytest.approx(fit.lock_in_rate_u, rel=1e-2)
    # And one of the rate for 1/x^2.
    by_rate = fit_frequencies(rate, beats(rate), 0.0, input_rate_u=share * rate, scale_factor=K, bias=False)
    assert by_rate.lock_in_rate_u == pytest.approx(fit.lock_in_rate_u / (1 - x**2), rel=1e-2)


@pytest.mark.parametrize(
    ("known", "bias"), [({}, True), ({"scale_factor": K, "scale_factor_u": 0.02}, True), ({}, False)]
)
def test_the_covariance_is_that_of_the_scatter(known, bias):
    rng = np.random.default_rng(1)
    rates = both(1.5, 3, 8)
    values, us = [], []
    for _ in range(400):
        given = dict(known)
        if known:
            given["scale_factor"] = K + rng.normal(scale=known["scale_factor_u"])
        f = beats(rates) + rng.normal(scale=0.02, size=rates.size)
        fit = fit_frequencies(rates, f, 0.02, bias=bias, **given)
        values.append((fit.lock_in_square, fit.bias_rate, fit.scale_factor))
        us.append((fit.lock_in_square_u, fit.bias_rate_u, fit.scale_factor_u))
    kept = [0, 1, 2] if bias else [0, 2]
    np.testing.assert_allclose(np.std(values, axis=0)[kept], np.mean(us, axis=0)[kept], rtol=0.12)
    correlation = np.corrcoef(np.array(values)[:, [0, 2]].T)[0, 1]
    assert correlation == pytest.approx(fit.covariance[0, 2] / us[-1][0] / us[-1][2], abs=0.1)


@pytest.mark.slow
def test_far_above_lock_in_the_interval_begins_at_zero_and_covers():
    rng = np.random.default_rng(2)
    rates = both(20, 40, 80)
    covered, negative = 0, 0
    for _ in range(1500):
        fit = fit_frequencies(rates, beats(rates) + rng.normal(scale=5.0, size=6), 5.0)
        high = 0.0 if np.isnan(fit.lock_in_rate_high_95) else fit.lock_in_rate_high_95
        covered += fit.lock_in_rate_low_95 <= WL <= high
        if fit.flags & FrequencyFlag.NEGATIVE_SQUARE:
            negative += 1
            assert np.isnan(fit.lock_in_rate) and fit.lock_in_rate_low_95 == 0
            assert fit.flags & FrequencyFlag.NOT_SIGNIFICANT
    assert covered / 1500 == pytest.approx(0.95, abs=0.017)  # three binomial standard deviations
    assert negative > 300


def test_conservative_coupling_gives_an_imaginary_rate_and_says_so():
    """The same laser whose harmonics show WL; eps = 120 deg, beats about the gain corner."""
    laser = symmetric_laser(WL, scale_factor=K, gain_corner_hz=500.0, phase_sum=np.deg2rad(120))
    rates = both(4, 6, 10)
    f = [steady_beat(laser, rate).frequency for rate in rates]
    fit = fit_frequencies(rates, f, 0.005, scale_factor=K)
    assert fit.lock_in_square < -1 * WL**2
    assert fit.flags & FrequencyFlag.NEGATIVE_SQUARE
    assert np.isnan(fit.lock_in_rate_high_95) and np.isnan(fit.lock_in_rate)
    assert "pushed up" in describe_frequencies(fit)[0]
    # With dissipative coupling alone the same gain does no harm.
    plain = symmetric_laser(WL, scale_factor=K, gain_corner_hz=500.0)
    f = [steady_beat(plain, rate).frequency for rate in rates]
    fit = fit_frequencies(rates, f, 0.005, scale_factor=K)
    assert fit.lock_in_rate == pytest.approx(WL, rel=2e-3)
    assert "conservative" in describe_frequencies(fit)[-1]


def test_records_without_a_beat_bound_the_rate():
    rates = np.append(both(2, 4), [0.0495, 0.3])
    f = np.append(beats(both(2, 4)), [0.0, 0.0])
    fit = fit_frequencies(rates, f, 1.0)
    assert list(fit.locked) == [False] * 4 + [True] * 2
    assert fit.lock_in_rate_low_95 == pytest.approx(0.0495, abs=1e-9)
    assert fit.flags & FrequencyFlag.LOCKED_RECORDS and fit.flags & FrequencyFlag.NO_BEAT_ABOVE_LOCK_IN
    assert np.isnan(fit.residual[4:]).all()


def test_scatter_beyond_the_uncertainties_enlarges_them():
    rng = np.random.default_rng(4)
    rates = both(1.5, 2, 3, 5, 8)
    f = beats(rates) + rng.normal(scale=1.0, size=rates.size)
    honest, bold = fit_frequencies(rates, f, 1.0), fit_frequencies(rates, f, 0.01)
    assert bold.flags & FrequencyFlag.MISFIT and not honest.flags & FrequencyFlag.MISFIT
    assert bold.lock_in_square_u == pytest.approx(honest.lock_in_square_u, rel=0.6)
    assert abs(bold.lock_in_rate - WL) < 5 * bold.lock_in_rate_u


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([0.1, 0.2], [1.0, 2.0], 0.1), "do not determine"),
        (([0.1, 0.1, 0.1, 0.1], [1.0] * 4, 0.1), "do not determine"),
        (([0.1, 0.2, 0.3], [1.0, 2.0], 0.1), "must hold 3 values"),
        (([0.1, 0.2, 0.3], [1.0, 2.0, 3.0], 0.0), "needs an uncertainty"),
        (([0.1, 0.2, 0.3], [1.0, -2.0, 3.0], 0.1), "must not be negative"),
        (([0.1, 0.2, 0.4], [100.0, 300.0, 400.0], 0.1), "do not rise"),
        (([0.1, 0.2], [0.0, 0.0], 0.1), "no beat frequency"),
        (([0.1, 0.2], [np.nan, np.nan], 0.1), "no beat frequency"),
    ],
)
def test_bad_input_is_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        fit_frequencies(*arguments)


def test_a_nan_is_counted_not_fitted():
    rates, f = both(2, 4, 6), beats(both(2, 4, 6))
    f[1] = np.nan
    fit = fit_frequencies(rates, f, 0.1)
    assert fit.flags & FrequencyFlag.RECORDS_LEFT_OUT
    assert fit.lock_in_rate == pytest.approx(WL, rel=1e-6)
