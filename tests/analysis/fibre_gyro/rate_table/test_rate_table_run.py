"""Odd and even parts, differences and the fit of all runs, against hand data, NumPy's polyfit and many trials."""

import numpy as np
import pytest
import scipy.optimize

from analysis.fibre_gyro import (
    TableRuns,
    bias_at_latitude,
    fit_axis,
    missing_senses,
    odd_even_parts,
    rate_differences,
    table_runs,
    vertical_earth_rate_dph,
)

RATES = np.array([20.0, 20.01, 20.1, 21.0])
BOTH = np.concatenate([RATES, -RATES])
K = 246.152866
EARTH = 15.041067 * np.sin(np.deg2rad(45.78))


def simulated(
    rng: np.random.Generator, *, white_dps: float = 0.0, irreproducible: float = 0.0, ends: tuple[int, ...] = (1,)
) -> TableRuns:
    """Runs of a gyro with bias 0.02 deg/h, each with its own noise and its own error of scale."""
    nominal = np.tile(BOTH, len(ends))
    end = np.repeat(ends, BOTH.size)
    scale = K * (1 + irreproducible * rng.normal(size=nominal.size))
    mean = scale * end * (nominal + EARTH / 3600) + K * 0.02 / 3600 + K * white_dps * rng.normal(size=nominal.size)
    return table_runs(nominal, mean, K * max(white_dps, 1e-9), duration_s=10800 / np.abs(nominal), end_up=end)


def test_odd_and_even_parts_by_hand() -> None:
    parts = odd_even_parts(
        table_runs([20.0, -20.0, 21.0, -21.0], [5010.0, -4990.0, 5262.0, -5240.0], [3, 4, 3, 4])
    )
    assert parts.rate_dps.tolist() == [20.0, 21.0]
    assert parts.odd.tolist() == [5000.0, 5251.0]
    assert parts.even.tolist() == [10.0, 11.0]
    assert parts.odd_u.tolist() == [2.5, 2.5]
    differences = rate_differences(parts, irreproducibility_ppm=0.0)
    assert differences.number.tolist() == [251.0]
    assert differences.noise_u[0] == pytest.approx(2.5 * np.sqrt(2))


def test_repeated_runs_are_averaged_and_the_table_rate_that_was_reached_counts() -> None:
    runs = table_runs(
        [20.0, 20.0, -20.0], [100.0, 104.0, -90.0], [1.0, 1.0, 1.0], rate_dps=[20.002, 20.004, -20.001]
    )
    parts = odd_even_parts(runs)
    assert parts.odd[0] == pytest.approx((102.0 + 90.0) / 2)
    assert parts.rate_dps[0] == pytest.approx((20.003 + 20.001) / 2)
    assert parts.odd_u[0] == pytest.approx(np.hypot(np.sqrt(0.5), 1) / 2)


def test_a_missing_sense_is_named() -> None:
    runs = table_runs([20.0, -20.0, 20.01, -21.0], np.ones(4), 1.0)
    assert missing_senses(runs) == [20.01, -21.0]
    with pytest.raises(ValueError, match=r"opposite sense of \+20\.01 deg/s, -21 deg/s"):
        odd_even_parts(runs)
    with pytest.raises(ValueError, match="both senses"):
        fit_axis(table_runs(RATES, K * RATES, 1.0))
    with pytest.raises(ValueError, match="other than zero"):
        table_runs([0.0], [1.0], 1.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("white", "irreproducible", "predicted"),
    [
        # 0.005 deg/sqrt(h) in 540 s: 359, 36, 3.6 ppm of 0.01, 0.1, 1 deg/s
        (0.005 / 60 / np.sqrt(540), 0.0, [359, 35.9, 3.59]),
        # 5 ppm from run to run: 1 %, 0.1 %, 0.01 %
        (0.0, 5e-6, [10000, 1000, 100]),
    ],
)
def test_differences_scatter_as_predicted(white: float, irreproducible: float, predicted: list[float]) -> None:
    rng = np.random.default_rng(2)
    found = []
    for _ in range(1500):
        runs = simulated(rng, white_dps=white, irreproducible=irreproducible)
        differences = rate_differences(odd_even_parts(runs), irreproducibility_ppm=1e6 * irreproducible)
        found.append(differences.number / (K * differences.delta_dps) - 1)
    scatter = 1e6 * np.std(found, axis=0)
    assert scatter == pytest.approx(predicted, rel=0.08)
    assert differences.relative_u_ppm == pytest.approx(predicted, rel=0.06)


def test_white_noise_of_four_runs_is_in_a_difference() -> None:
    # each odd part averages two runs of length T, the difference holds two odd parts: (N/60)/sqrt(T)
    runs = simulated(np.random.default_rng(0), white_dps=0.005 / 60 / np.sqrt(540))
    differences = rate_differences(odd_even_parts(runs), irreproducibility_ppm=0)
    assert differences.noise_u / K == pytest.approx(np.full(3, 3.59e-6), rel=2e-3)


def test_the_fit_is_that_of_scipy() -> None:
    rng = np.random.default_rng(8)
    runs = table_runs(BOTH, K * BOTH + 0.7 + rng.normal(0, 0.01, 8), rng.uniform(0.005, 0.02, 8))
    fit = fit_axis(runs, irreproducibility_ppm=0.0)
    values, covariance = scipy.optimize.curve_fit(
        lambda w, k, b: k * w + b, BOTH, runs.mean, sigma=runs.mean_u, absolute_sigma=True
    )
    assert fit.scale_factor == pytest.approx(values[0], rel=1e-9)
    assert fit.even == pytest.approx(values[1], rel=1e-6)
    # wider by what scatter the residuals allow, at most by as much as Student's t of six degrees of freedom
    for u, own in ((fit.scale_factor_u, covariance[0, 0]), (fit.even_u, covariance[1, 1])):
        assert np.sqrt(own) < u < 1.25 * np.sqrt(own * max(1.0, fit.chi_square / 6))
    assert fit.degrees_of_freedom == 6


@pytest.mark.slow
def test_scale_factor_and_even_part_lie_where_their_uncertainties_say() -> None:
    rng = np.random.default_rng(3)
    white = 0.005 / 60 / np.sqrt(540)
    fits = [fit_axis(simulated(rng, white_dps=white)) for _ in range(400)]
    distance = np.array([(fit.scale_factor - K) / fit.scale_factor_u for fit in fits])
    assert np.sqrt(np.mean(distance**2)) == pytest.approx(0.87, abs=0.1)  # wide by the scatter that may be there
    even = np.array([(fit.even_dph[0] - EARTH - 0.02) / fit.even_dph[1] for fit in fits])
    assert np.sqrt(np.mean(even**2)) == pytest.approx(0.87, abs=0.1)
    # all four rates together beat 20 deg/s alone (0.13 ppm) by nearly two
    assert 1e6 * fits[0].scale_factor_u / K == pytest.approx(0.063, rel=0.5)
    assert fits[0].angle_random_walk == pytest.approx(0.005, rel=0.02)
    assert np.isnan(fits[0].earth_rate_dph[0])
    assert bias_at_latitude(fits[0], 45.78)[0] == pytest.approx(0.02, abs=5 * fits[0].even_dph[1])


def test_both_ends_up_separate_earth_rate_and_bias() -> None:
    fit = fit_axis(simulated(np.random.default_rng(1), white_dps=1e-7, ends=(1, -1)))
    assert fit.end_up == 0
    assert fit.earth_rate_dph[0] == pytest.approx(EARTH, abs=5 * fit.earth_rate_dph[1])
    assert fit.bias_dph[0] == pytest.approx(0.02, abs=5 * fit.bias_dph[1])
    assert fit.even_dph[0] == pytest.approx(EARTH + 0.02, abs=5 * fit.even_dph[1])
    assert 0 < fit.bias_dph[1] < 0.001
    down = fit_axis(simulated(np.random.default_rng(1), white_dps=1e-7, ends=(-1,)))
    assert down.scale_factor == pytest.approx(K, rel=1e-6)
    assert down.even_dph[0] == pytest.approx(0.02 - EARTH, abs=1e-3)
    assert bias_at_latitude(down, 45.78)[0] == pytest.approx(0.02, abs=1e-3)
    assert odd_even_parts(simulated(np.random.default_rng(1), ends=(-1,)), end_up=-1).odd[0] == pytest.approx(
        20 * K
    )


def test_irreproducibility_beyond_the_noise_is_found() -> None:
    rng = np.random.default_rng(6)
    scatter = [fit_axis(simulated(rng, white_dps=1e-7, irreproducible=20e-6)).scatter_ppm for _ in range(200)]
    assert np.sqrt(np.mean(np.square(scatter))) == pytest.approx(20, rel=0.1)
    quiet = fit_axis(simulated(rng, white_dps=1e-6))
    assert quiet.scatter_ppm < 0.1


def test_the_earths_vertical_rate() -> None:
    assert vertical_earth_rate_dph(45.78) == pytest.approx(10.779, abs=1e-3)
    assert vertical_earth_rate_dph(-90) == pytest.approx(-15.041067)
