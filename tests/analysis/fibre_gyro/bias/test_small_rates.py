"""Threshold, resolution and dead zone against ladders whose edges are known."""

import math

import numpy as np
import pytest

from analysis.fibre_gyro import References, Responses, plan_ladder, refined, responses, small_rates

RUNGS = np.array([0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5])
BOTH = np.concatenate([RUNGS, -RUNGS])
K = 250.0


def ladder(rising: float, falling: float, u: float, rng: np.random.Generator | None = None) -> Responses:
    """Responses of a gyro that shows nothing up to an edge of each sense; `u` in deg/s."""
    seen = np.where(BOTH > 0, rising, falling) <= np.abs(BOTH)
    ratio_u = u / np.abs(BOTH)
    noise = 0.0 if rng is None else rng.normal(0, ratio_u)
    return Responses(BOTH, seen + noise, ratio_u, 0.0)


def test_the_edge_lies_between_the_rungs_that_say_so() -> None:
    found = small_rates(ladder(0.03, 0.006, 1e-6))
    # even in the logarithm: the median of 0.02..0.05 is the root of their product
    assert found.rising.value == pytest.approx(math.sqrt(0.02 * 0.05), rel=2e-3)
    assert found.rising.low_95 == pytest.approx(0.02 * 2.5**0.025, rel=2e-3)
    assert found.rising.high_95 == pytest.approx(0.02 * 2.5**0.975, rel=2e-3)
    assert 0.005 < found.falling.low_95 < found.falling.high_95 < 0.01
    # the worse sense
    assert found.threshold.value == pytest.approx(found.rising.value)
    assert 0.025 < found.width.low_95 < found.width.value < found.width.high_95 < 0.06
    assert found.threshold.undecided_dps == ()


def test_without_a_dead_zone_there_is_a_bound_and_not_zero() -> None:
    found = small_rates(ladder(0.0, 0.0, 1e-6))
    assert not found.threshold.seen
    assert math.isnan(found.threshold.value)
    assert (found.threshold.low_95, found.threshold.high_95) == (0.0, 0.001)
    assert (found.width.low_95, found.width.high_95) == (0.0, 0.002)
    # noise as large as the three smallest inputs: the bound grows
    loud = small_rates(ladder(0.0, 0.0, 0.01))
    assert loud.threshold.high_95 > 0.005
    assert loud.threshold.undecided_dps != ()


def test_a_gyro_that_shows_nothing_at_all_has_no_upper_end() -> None:
    found = small_rates(ladder(1.0, 1.0, 1e-6))
    assert math.isinf(found.threshold.high_95)
    assert found.threshold.low_95 == pytest.approx(0.5, rel=1e-2)
    assert not found.threshold.seen
    assert math.isinf(found.width.high_95)


def test_one_sense_alone_gives_no_width() -> None:
    both = ladder(0.03, 0.03, 1e-6)
    one = Responses(both.input_dps[:9], both.ratio[:9], both.ratio_u[:9], 0.0)
    found = small_rates(one)
    assert found.senses == (1,)
    assert found.rising.seen
    assert math.isinf(found.width.high_95)
    assert math.isinf(found.falling.high_95)


def test_a_backlash_has_its_threshold_at_twice_its_size_and_begins_at_its_size() -> None:
    ratio = np.maximum(1 - 0.012 / np.abs(BOTH), 0)
    found = small_rates(Responses(BOTH, ratio, np.full(BOTH.size, 1e-3), 0.0))
    assert 0.02 < found.threshold.low_95 < 2 * 0.012 < found.threshold.high_95 < 0.05
    assert 0.01 < found.rising.low_95 < 0.012 / 0.9 < found.rising.high_95 < 0.02


def test_intervals_hold_over_edges_and_noise() -> None:
    rng = np.random.default_rng(3)
    held = []
    for _ in range(150):
        rising, falling = np.exp(rng.uniform(np.log(0.0012), np.log(0.4), 2))
        found = small_rates(ladder(rising, falling, 5e-4, rng))
        held.append(
            [
                found.threshold.low_95 <= max(rising, falling) <= found.threshold.high_95,
                found.width.low_95 <= rising + falling <= found.width.high_95,
            ]
        )
    assert np.all(np.mean(held, axis=0) > 0.86)  # 0.95 less five standard deviations


def test_responses_are_net_of_what_drifts_between_the_references() -> None:
    rng = np.random.default_rng(1)
    at, where = np.arange(1.0, 40.0), np.arange(0.0, 41.0, 5.0)
    at = at[at % 5 != 0]
    inputs = np.resize([0.01, -0.01, 0.02, -0.02], at.size)
    drift = 3.0 + 0.2 * at
    references = References(where, 3.0 + 0.2 * where + rng.normal(0, 1e-3, where.size), np.full(where.size, 1e-3))
    found = responses(inputs, at, K * inputs + drift, np.full(at.size, 1e-3), references, K)
    assert np.abs(found.ratio - 1).max() < 5 * found.ratio_u.max()
    assert found.ratio_u.max() < 1e-3
    # a reference input that is not zero: what the gyro shows of the input itself
    off = responses(
        inputs, at, K * (inputs - 0.003) + drift, np.full(at.size, 1e-3), references, K, reference_dps=0.003
    )
    assert np.abs(off.ratio - 1).max() < 5 * found.ratio_u.max()


def test_a_walk_of_the_output_between_the_references_counts() -> None:
    rng = np.random.default_rng(2)
    where = np.arange(0.0, 400.0, 2.0)
    walk = np.cumsum(rng.normal(0, 0.5, where.size))
    references = References(where, walk, np.full(where.size, 1e-3))
    found = responses([0.01], [101.0], [2.5 + walk[50]], [1e-3], references, K)
    assert found.wander == pytest.approx(0.5, rel=0.25)
    # in the middle between two points of a walk: half a step
    assert found.ratio_u[0] * 0.01 * K == pytest.approx(0.25, rel=0.3)


def test_what_cannot_be_is_refused() -> None:
    references = References(np.array([0.0]), np.array([0.0]), np.array([0.1]))
    with pytest.raises(ValueError, match="an input of zero is a reference"):
        responses([0.0], [1.0], [0.0], [0.1], references, K)
    nothing = References(np.empty(0), np.empty(0), np.empty(0))
    with pytest.raises(ValueError, match="there is no static output"):
        responses([0.1], [1.0], [0.0], [0.1], nothing, K)
    with pytest.raises(ValueError, match="no output at a small rate"):
        small_rates(Responses(np.empty(0), np.empty(0), np.empty(0), 0.0))


def test_a_plan_records_each_rate_as_long_as_its_noise_asks_for() -> None:
    found = plan_ladder(0.001, 0.5, 0.06, ratio_u=0.1, seconds=(5.0, 600.0))
    assert found.rate_dps.tolist() == RUNGS.tolist()
    # by hand: 0.06/60 = 1e-3 deg/s in a second; 0.001 to 10 % is 1e-4, twice the noise of 100 s
    assert found.seconds[0] == pytest.approx(200.0)
    assert found.seconds[1] == pytest.approx(50.0)
    assert found.seconds[-1] == 5.0
    loud = plan_ladder(0.001, 0.5, 6.0, ratio_u=0.1, seconds=(5.0, 600.0))
    assert [rate for rate, _ in loud.too_noisy] == [0.001, 0.002, 0.005, 0.01]
    assert loud.rate_dps[0] == 0.02


def test_further_inputs_lie_about_the_edge_of_each_sense() -> None:
    found = refined(ladder(0.03, 0.0, 1e-6), 2)
    assert found == pytest.approx([0.02 * 2.5 ** (1 / 3), 0.02 * 2.5 ** (2 / 3)], rel=1e-5)
    assert refined(ladder(0.0, 0.0, 1e-6), 2) == []
