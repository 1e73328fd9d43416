from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import i0e

from analysis.dead_band import DeadBandFlag, falling, find_dead_band, rounded_pulse_rate, simulate_sweep

K, WL = 2000.0, 0.0512


def sweep(step=0.0025, top=0.1):
    up = np.arange(0, top + step / 2, step)
    return np.concatenate([up, up[::-1], -up[1:], -up[::-1]])


@pytest.mark.parametrize("share", [0.9, 0.99, 1.0, 1.02, 1.5, 3.0])
@pytest.mark.parametrize("walk", [1e-4, 1e-3])
def test_the_rounded_corner_is_stratonovichs_integral(share, walk):
    diffusion = (2 * np.pi * K * walk) ** 2 / 2
    a, b = (2 * np.pi * K * w / diffusion for w in (share * WL, WL))
    peak = 2 * np.arccos(min(share, 1.0))
    largest = 2 * b * np.sin(peak / 2) - a * peak

    def height(s):
        return np.exp(2 * b * np.sin(s / 2) - a * s - largest) * i0e(2 * b * np.sin(s / 2))

    ends = np.sort(
        [0, peak, *(peak + np.array([-6, -2, 2, 6]) / np.sqrt(b)), *(np.array([1, 5, 25, 100]) / a), 2 * np.pi]
    )
    ends = np.unique(np.clip(ends, 0, 2 * np.pi))
    integral = sum(quad(height, *pair, limit=200, epsabs=0)[0] for pair in pairwise(ends))
    expected = -np.expm1(-2 * np.pi * a) * np.exp(-largest) / integral * diffusion / (2 * np.pi)
    made = rounded_pulse_rate(share * WL, scale_factor=K, lock_in_rate=WL, random_walk=walk)
    assert float(made) == pytest.approx(expected, rel=1e-7, abs=1e-9)


def test_the_rounded_corner_becomes_sharp_without_noise():
    rates = WL * np.array([-3.0, 0.5, 1.1, 2.0])
    sharp = rounded_pulse_rate(rates, scale_factor=K, lock_in_rate=WL, random_walk=0.0)
    np.testing.assert_allclose(sharp, K * np.sign(rates) * np.sqrt(np.maximum(rates**2 - WL**2, 0)))
    tiny = rounded_pulse_rate(rates, scale_factor=K, lock_in_rate=WL, random_walk=1e-6)
    np.testing.assert_allclose(tiny, sharp, rtol=1e-4, atol=1e-6)
    # Without lock-in the noise averages out.
    free = rounded_pulse_rate(rates, scale_factor=K, lock_in_rate=0.0, random_walk=1e-3)
    np.testing.assert_allclose(free, K * rates)


def test_simulated_pulses_have_the_mean_of_the_closed_form():
    rates = np.repeat([0.046, 0.0495, 0.0512, 0.054, 0.07, -0.054], 40)
    bench = {"scale_factor": K, "lock_in_rate": WL, "random_walk": 3e-4}
    counts = simulate_sweep(rates, 3.0, seed=1, **bench).reshape(6, 40)
    expected = 3.0 * np.abs(rounded_pulse_rate(rates[::40], **bench))
    error = counts.std(axis=1, ddof=1) / np.sqrt(40)
    assert np.all(np.abs(counts.mean(axis=1) - expected) < 3.5 * error + 0.05)


def test_without_noise_the_edges_hold_the_truth():
    for bias in (0.0, 0.004):
        pulses = simulate_sweep(sweep(), 5.0, scale_factor=K, lock_in_rate=WL, bias_rate=bias, seed=2)
        band = find_dead_band(sweep(), pulses, 5.0, scale_factor=K, fit_corner=False)
        true = np.array([[WL + bias] * 2, [WL - bias] * 2])
        assert np.all(np.abs(band.edges - true) <= band.edge_half_widths + 1e-12)
        assert abs(band.lock_in_rate - WL) < 2.5 * band.lock_in_rate_u
        assert abs(band.bias_rate - bias) < 3.5 * band.bias_rate_u
        assert band.hysteresis == 0 and band.flags == 0


def test_the_steps_give_the_uncertainty():
    """Any bias and any threshold: the error is uniform in the gap of each sense, up and down share theirs."""
    rng = np.random.default_rng(3)
    errors, us = [], []
    for _ in range(300):
        lock_in, bias = rng.uniform(0.045, 0.06), rng.uniform(-0.005, 0.005)
        pulses = simulate_sweep(sweep(), 20.0, scale_factor=K, lock_in_rate=lock_in, bias_rate=bias)
        band = find_dead_band(sweep(), pulses, 20.0, scale_factor=K, fit_corner=False)
        errors.append(band.lock_in_rate - lock_in)
        us.append(band.lock_in_rate_u)
    assert np.std(errors) == pytest.approx(0.0025 / np.sqrt(12) / np.sqrt(2), rel=0.12)
    assert np.mean(us) == pytest.approx(np.std(errors), rel=0.12)


def test_hysteresis_is_found_and_paid_for():
    pulses = simulate_sweep(sweep(), 5.0, scale_factor=K, lock_in_rate=WL, capture_rate=0.8 * WL, seed=4)
    band = find_dead_band(sweep(), pulses, 5.0, scale_factor=K, fit_corner=False)
    assert band.flags == DeadBandFlag.HYSTERESIS
    assert band.hysteresis == pytest.approx(0.2 * WL, abs=0.0025)
    assert band.lock_in_rate == pytest.approx(0.9 * WL, abs=0.002)
    assert band.lock_in_rate_u > band.hysteresis / 2 / np.sqrt(3) > 0.0023


@pytest.mark.slow
def test_noise_moves_the_edges_and_the_corner_shows_it():
    corners, us, walks = [], [], []
    for seed in range(6):
        pulses = simulate_sweep(
            sweep(), 2.0, scale_factor=K, lock_in_rate=WL, random_walk=3e-4, bias_rate=0.003, seed=seed
        )
        band = find_dead_band(sweep(), pulses, 2.0, scale_factor=K)
        # A few slips are enough to end the silence: the edges are 10 % low.
        assert band.lock_in_rate < 0.94 * WL
        assert band.flags & DeadBandFlag.ROUNDED
        assert abs(band.lock_in_rate - WL) < 2 * band.lock_in_rate_u
        corners.append(band.corner_rate - WL)
        us.append(band.corner_rate_u)
        walks.append(band.random_walk)
    assert np.sqrt(np.mean(np.square(corners))) < 2 * np.mean(us) < 5e-3 * WL
    assert np.mean(walks) == pytest.approx(3e-4, rel=0.05)


def test_a_criterion_of_more_pulses_ends_the_band_later():
    pulses = simulate_sweep(sweep(), 2.0, scale_factor=K, lock_in_rate=WL, random_walk=3e-4, seed=5)
    bands = [
        find_dead_band(sweep(), pulses, 2.0, scale_factor=K, least_pulses=n, fit_corner=False).lock_in_rate
        for n in (1, 30)
    ]
    assert bands[0] < bands[1]


def test_one_sense_keeps_the_bias_and_says_so():
    up = np.arange(0, 0.1, 0.002)
    pulses = simulate_sweep(up, 5.0, scale_factor=K, lock_in_rate=WL, bias_rate=0.004)
    band = find_dead_band(up, pulses, 5.0, scale_factor=K, fit_corner=False)
    assert band.flags & DeadBandFlag.ONE_SENSE
    assert band.lock_in_rate == pytest.approx(WL + 0.004, abs=0.0011)
    assert np.isnan(band.bias_rate) and np.isnan(band.hysteresis)


@pytest.mark.slow
def test_branches_without_an_edge_are_named():
    low = np.array([0.01, 0.02, 0.03, 0.06, 0.07, -0.01, -0.02, -0.03])
    pulses = np.where(np.abs(low) > WL, 100, 0)
    assert find_dead_band(low, pulses, 1.0, scale_factor=K).flags & DeadBandFlag.NO_PULSES
    odd = np.where(low == 0.07, 0, pulses)
    assert find_dead_band(low, odd, 1.0, scale_factor=K).flags & DeadBandFlag.PULSES_INSIDE
    with pytest.raises(ValueError, match="no edge of the dead band"):
        find_dead_band(low, 0 * pulses, 1.0, scale_factor=K)
    with pytest.raises(ValueError, match="no edge of the dead band"):
        find_dead_band(low, 0 * pulses + 5, 1.0, scale_factor=K)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"pulses": [1, 2]}, "lists of one length"),
        ({"pulses": [1, -2, 3]}, "not negative"),
        ({"input_rates": [0.1, np.nan, 0.2]}, "finite"),
        ({"dwell": 0.0}, "must be positive"),
        ({"least_pulses": 0}, "must be positive"),
    ],
)
def test_bad_sweeps_are_named(change, message):
    good = {"input_rates": [0.01, 0.1, 0.2], "pulses": [0, 2, 3], "dwell": 1.0, "scale_factor": K}
    with pytest.raises(ValueError, match=message):
        find_dead_band(**{**good, **change})
    with pytest.raises(ValueError, match="dwell and scale_factor"):
        simulate_sweep([0.1], 0.0, scale_factor=K, lock_in_rate=WL)


def test_which_steps_fall():
    assert falling(np.array([0.0, 0.1, 0.2, 0.1, -0.1, -0.3, -0.2])).tolist() == [
        False,
        False,
        False,
        True,
        False,
        False,
        True,
    ]


def station_sweep(steps=16, top=2 * WL):
    rates = top / steps * (np.arange(-steps, steps + 1) + 0.25)
    return np.concatenate([rates, rates[-2::-1]])


@pytest.mark.slow
@pytest.mark.parametrize(("order", "hysteresis"), [("through zero", 0.1), ("by senses", 0.0)])
def test_a_drift_of_the_bias_is_found_and_taken_out(order, hysteresis):
    """The middle of the sweep counts; without the drift the corner is wrong by many of its uncertainties."""
    rates = station_sweep() if order == "through zero" else sweep(step=2 * WL / 16, top=2 * WL)
    drift = 0.15 * WL
    deviations = []
    for seed in range(8):
        rng = np.random.default_rng(50 + seed)
        lock_in, bias = rng.uniform(0.9, 1.1) * WL, rng.uniform(-0.1, 0.1) * WL
        moving = bias + drift * np.linspace(-0.5, 0.5, rates.size)
        capture = lock_in * (1 - hysteresis)
        pulses = simulate_sweep(
            rates, 5.0, scale_factor=K, lock_in_rate=lock_in, bias_rate=moving, capture_rate=capture, seed=seed
        )
        band = find_dead_band(rates, pulses, 5.0, scale_factor=K)
        true = (lock_in + capture) / 2
        deviations.append(
            [
                (band.drift - drift) / band.drift_u,
                (band.corner_rate - true) / band.corner_rate_u,
                (band.lock_in_rate - true) / band.lock_in_rate_u,
                (band.bias_rate - bias) / band.bias_rate_u,
            ]
        )
        assert band.flags & DeadBandFlag.DRIFT
        assert band.drift_u < 0.02 * drift
        assert band.corner_rate_u < 2e-3 * WL
    rms = np.sqrt(np.mean(np.square(deviations), axis=0))
    # chi-square of 8 values leaves this range less than once in a million times; edges' errors are bounded
    assert np.all(rms < 2.25)
    assert np.all(rms[:2] > 0.1)


@pytest.mark.slow
def test_slips_scatter_the_edges_and_the_bias_pays_for_it():
    rates, us, errors = station_sweep(steps=30), [], []
    quiet = find_dead_band(
        rates, simulate_sweep(rates, 2.0, scale_factor=K, lock_in_rate=WL, seed=1), 2.0, scale_factor=K
    )
    for seed in range(8):
        bias = np.random.default_rng(seed).uniform(-0.1, 0.1) * WL
        pulses = simulate_sweep(
            rates, 2.0, scale_factor=K, lock_in_rate=WL, random_walk=6e-4, bias_rate=bias, seed=seed
        )
        band = find_dead_band(rates, pulses, 2.0, scale_factor=K)
        us.append(band.bias_rate_u)
        errors.append((band.bias_rate - bias) / band.bias_rate_u)
    assert np.mean(us) > 1.1 * quiet.bias_rate_u
    assert np.sqrt(np.mean(np.square(errors))) < 1.95


def test_a_corner_that_is_none_is_not_used():
    """With a scale factor a hundred times too small the beats are no beats of this gyro."""
    pulses = simulate_sweep(sweep(), 5.0, scale_factor=K, lock_in_rate=WL)
    band = find_dead_band(sweep(), pulses, 5.0, scale_factor=K / 100)
    assert np.isnan(band.corner_rate) and np.isnan(band.drift)
    assert abs(band.lock_in_rate - WL) < 2.5 * band.lock_in_rate_u < 0.003
