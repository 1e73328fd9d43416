"""The gyro's clock against the computer's: right within its uncertainty, whatever holds frames back."""

import numpy as np
import pytest

from benchmarks.fibre_gyro.host_clock import clock_of
from instrument.fibre_gyro.recording import Arrivals


@pytest.mark.parametrize("rate", [10.0, 100.0, 1000.0])
@pytest.mark.parametrize("latency", [0.0, 0.016])
def test_the_difference_lies_within_its_uncertainty(rate, latency):
    rng = np.random.default_rng(int(rate + 1000 * latency))
    pulls = []
    for seconds, off_ppm in ((4, 0), (12, 21_000), (40, -28_000), (40, 500)):
        for stalls in (0.0, 0.01):
            clock = clock_of(rng, rate=rate, seconds=seconds, off_ppm=off_ppm, latency=latency, stalls=stalls)
            pulls.append((clock.difference_ppm - off_ppm) / clock.u_ppm)
    assert np.abs(pulls).max() < 4  # its uncertainty is a bound more than a standard deviation


@pytest.mark.parametrize("off_ppm", [-130.0, 120.0])
def test_frames_in_step_with_an_adapter_hide_what_they_drift(off_ppm):
    # 125 frames/s are two in each of its 16 ms: 7 ms of drift in a minute move none of them to the next
    clock = clock_of(np.random.default_rng(3), rate=125.0, seconds=60, off_ppm=off_ppm, latency=0.016)
    assert abs(clock.difference_ppm) < 20  # nothing of it is seen
    assert clock.u_ppm == pytest.approx(1e6 * 0.008 / 60 / 3**0.5, rel=0.15)
    # 110 frames/s come at 44 places of the period, 0.4 ms from each other
    told = clock_of(np.random.default_rng(3), rate=110.0, seconds=60, off_ppm=off_ppm, latency=0.016)
    assert abs(told.difference_ppm - off_ppm) < 2 * told.u_ppm < 120


def test_a_minute_tells_fifty_ppm_and_two_per_cent_are_used():
    rng = np.random.default_rng(1)
    right = clock_of(rng, rate=100.0, seconds=60, off_ppm=0)
    assert right.u_ppm < 60 and not right.used
    off = clock_of(rng, rate=100.0, seconds=60, off_ppm=-20_000)
    assert off.used and off.interval_s == pytest.approx(0.01 / 0.98, rel=1e-4)
    assert str(off).startswith(("-199", "-200")) and "u " in str(off)
    # a difference that changes no result leaves the gyro its own rate
    assert not clock_of(rng, rate=100.0, seconds=60, off_ppm=150).used


def test_a_stall_at_the_end_moves_nothing():
    clock = clock_of(np.random.default_rng(2), rate=200.0, seconds=30, off_ppm=0, stall_at_end=True)
    assert abs(clock.difference_ppm) < 60  # a straight fit would be off by hundreds


def test_what_is_too_little_says_nothing():
    arrivals = Arrivals()
    assert arrivals.clock(0.01) is None
    for index in range(10):
        arrivals.add(index, 0.01 * index)
    assert arrivals.clock(0.01) is None
    stuck = Arrivals()
    for index in range(40):
        stuck.add(5, 0.01 * index)
    assert stuck.clock(0.01) is None
