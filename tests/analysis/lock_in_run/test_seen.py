"""What records at one rate say of the lock-in rate before the others are there."""

from dataclasses import replace

import numpy as np
import pytest
from array_bench import WL, Gyro, K, records, table_rate_for

from analysis.lock_in_run import PreliminaryLockIn, preliminary_lock_in


def found_at(over_lock_in: float, **receiver: float) -> PreliminaryLockIn | None:
    gyro = Gyro(np.random.default_rng(1), **receiver)
    return preliminary_lock_in(records(gyro, [table_rate_for(over_lock_in * WL)] * 3), K)


@pytest.mark.parametrize("over_lock_in", [3.0, 8.0, 30.0])
@pytest.mark.parametrize("square", [-0.01, 0.0, 0.01])
def test_the_truth_lies_between_whatever_the_receiver_distorts(over_lock_in: float, square: float) -> None:
    found = found_at(over_lock_in, square=square)
    assert found is not None
    assert found.least < WL < found.most
    if square == 0:
        assert found.lock_in_rate == pytest.approx(WL, rel=0.1)


def test_a_slow_rate_tells_more_than_a_fast_one() -> None:
    spreads = [found.spread for over in (3.0, 8.0, 30.0) if (found := found_at(over)) is not None]
    assert spreads == sorted(spreads)
    assert spreads[0] < 1.2
    assert len(spreads) == 3


def test_of_a_fast_beat_the_gain_may_have_taken_most() -> None:
    slow = records(Gyro(np.random.default_rng(1)), [table_rate_for(8 * WL)] * 3)
    # the same records a hundred times as fast, of a gyro with a hundred times the pulses
    hurried = [replace(batch, sample_interval=batch.sample_interval / 100) for batch in slow.batches]
    fast = preliminary_lock_in(replace(slow, batches=hurried), 100 * K)
    there = preliminary_lock_in(slow, K)
    assert fast is not None
    assert there is not None
    assert fast.lock_in_rate == pytest.approx(there.lock_in_rate, rel=1e-6)
    assert fast.most > 3 * there.most
    assert fast.least == pytest.approx(there.least, rel=1e-6)


def test_noise_alone_shows_nothing() -> None:
    assert found_at(8.0, noise=100.0) is None
