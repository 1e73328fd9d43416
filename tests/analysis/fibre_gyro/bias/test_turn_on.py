"""Transients of known size, and the repeatability against chi-square."""

import math

import numpy as np
import pytest
import scipy.stats

from analysis.fibre_gyro import repeatability, turn_on_transient

TIMES = np.arange(5.0, 1800.0, 10.0)


def noisy(curve: np.ndarray, seed: int, u: float = 0.1) -> np.ndarray:
    return curve + np.random.default_rng(seed).normal(0, u, curve.size)


def test_one_exponential() -> None:
    found = turn_on_transient(TIMES, noisy(4.0 + 2 * np.exp(-TIMES / 150), 1), 0.1)
    assert found.exponentials == 1
    assert abs(found.final - 4.0) < 4 * found.final_u < 0.1
    assert abs(found.transient - 2.0) < 4 * found.transient_u < 0.6
    truth = 150 * math.log(20)
    assert found.warm_up_low_95_s < truth < found.warm_up_high_95_s < 2 * truth
    assert found.ends
    assert found.noise_u == pytest.approx(0.1, rel=0.3)


def test_two_exponentials_of_opposite_sign() -> None:
    curve = 3 * np.exp(-TIMES / 20) - 1.5 * np.exp(-TIMES / 300)
    found = turn_on_transient(TIMES, noisy(curve, 2, 0.02), 0.1)
    assert found.exponentials == 2
    # the slow one is the last beyond the bound
    assert found.warm_up_low_95_s < 300 * math.log(15) < found.warm_up_high_95_s
    assert found.transient == pytest.approx(1.5, abs=0.3)


def test_without_a_transient_the_warm_up_is_over_at_once() -> None:
    found = turn_on_transient(TIMES, noisy(np.full(TIMES.size, 7.0), 3, 0.05), 0.2)
    assert found.exponentials == 0
    assert found.warm_up_s == found.warm_up_low_95_s == 0.0
    assert found.warm_up_high_95_s < 200


def test_a_transient_that_does_not_end_within_the_record_is_said() -> None:
    found = turn_on_transient(TIMES, noisy(2 * np.exp(-TIMES / 3000), 4, 0.02), 0.1)
    assert not found.ends
    assert math.isinf(found.warm_up_high_95_s)


def test_noise_with_a_memory_widens_the_interval() -> None:
    curve, rng = 2 * np.exp(-TIMES / 150), np.random.default_rng(5)
    white = rng.normal(0, 0.1, TIMES.size + 9)
    slow = np.convolve(white, np.full(10, 1 / math.sqrt(10)), "valid")
    alone = turn_on_transient(TIMES, curve + white[: TIMES.size], 0.1)
    found = turn_on_transient(TIMES, curve + slow, 0.1)
    assert found.final_u > 1.7 * alone.final_u


@pytest.mark.slow
def test_warm_up_intervals_hold() -> None:
    held = []
    for seed in range(150):
        rng = np.random.default_rng(seed)
        size, tau = rng.uniform(0.6, 3.0), rng.uniform(60, 250)
        found = turn_on_transient(TIMES, size * np.exp(-TIMES / tau) + rng.normal(0, 0.1, TIMES.size), 0.1)
        held.append(found.warm_up_low_95_s <= tau * math.log(size / 0.1) <= found.warm_up_high_95_s)
    assert np.mean(held) > 0.86  # 0.95 less five standard deviations


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(ValueError, match="needs 12 values in time, not 5"):
        turn_on_transient(TIMES[:5], TIMES[:5], 0.1)
    with pytest.raises(ValueError, match="must be positive, not 0"):
        turn_on_transient(TIMES, TIMES, 0.0)
    with pytest.raises(ValueError, match="at least two"):
        repeatability([1.0], [0.1])


def test_repeatability_is_the_interval_of_chi_square_less_the_noise() -> None:
    values = np.array([0.3, -0.1, 0.25, 0.0, -0.35, 0.1])
    found = repeatability(values, np.full(6, 0.05))
    assert found.value == pytest.approx(np.std(values, ddof=1))
    low, high = (math.sqrt(5 * found.value**2 / scipy.stats.chi2.ppf(p, 5) - 0.05**2) for p in (0.975, 0.025))
    assert (found.low_95, found.high_95) == pytest.approx((low, high))
    # what may be of the table's azimuth makes it begin lower, and leaves its other end
    careful = repeatability(values, np.full(6, 0.05), perhaps_u=0.3)
    assert careful.low_95 == 0.0
    assert careful.high_95 == found.high_95
