"""The rate table: rates take effect, azimuth is their integral."""

import itertools

import numpy as np
import pytest

from instrument.simulated import SimulatedRateTable, VirtualClock
from instrument.simulated.controllers import TableMotion


def test_azimuth_is_the_integral_of_the_rate():
    clock = VirtualClock()
    table = SimulatedRateTable(clock, acceleration=7.0, azimuth=12.0)
    source = np.random.default_rng(3)
    for _ in range(30):
        table.set_rate(float(source.uniform(-50, 50)))
        clock.sleep(float(source.uniform(0.0, 6.0)))  # often too short to get there
    times = np.linspace(0, clock.now(), 400_001)
    rates = table.rate_at(times)
    integral = np.concatenate([[0.0], np.cumsum((rates[1:] + rates[:-1]) / 2 * np.diff(times))])
    assert np.abs(table.azimuth_at(times) - 12.0 - integral).max() < 1e-3
    assert np.abs(np.diff(rates)).max() <= 7.0 * (times[1] - times[0]) * (1 + 1e-6)


def test_rate_changes_at_once_without_a_limit():
    clock = VirtualClock()
    table = SimulatedRateTable(clock)
    clock.sleep(1.0)
    table.set_rate(-3.0)
    assert table.rate() == -3.0
    clock.sleep(2.0)
    assert table.azimuth() == -6.0
    assert table.rate_at(np.array([[0.5], [1.5]])).tolist() == [[0.0], [-3.0]]


def test_past_is_not_changed_by_a_new_command():
    clock = VirtualClock()
    table = SimulatedRateTable(clock, acceleration=1.0)
    table.set_rate(10.0)
    clock.sleep(5.0)
    past = np.linspace(0, 5.0, 11)
    before = table.azimuth_at(past)
    table.set_rate(-10.0)
    assert np.array_equal(table.azimuth_at(past), before)
    assert table.azimuth() == pytest.approx(12.5)
    clock.sleep(5.0)
    assert table.rate() == pytest.approx(0.0, abs=1e-12)
    assert table.azimuth() == pytest.approx(25.0)


def test_table_remembers_its_motion():
    clock = VirtualClock()
    table = SimulatedRateTable(clock, acceleration=2.0, azimuth=30.0)
    table.set_rate(0.0)  # it rests already
    clock.sleep(1.0)
    table.set_rate(10.0)
    table.wait_until_steady()
    assert clock.now() == pytest.approx(6.0, abs=1e-6) and clock.now() > 6.0
    assert table.motion == (
        TableMotion(0.0, 30.0, 0.0),
        TableMotion(1.0, 30.0, 0.0, 2.0),
        TableMotion(6.0, 55.0, 10.0),
    )
    clock.sleep(1.0)
    table.set_rate(10.0)  # it turns so already
    table.set_rate(-10.0)
    clock.sleep(2.0)
    table.set_rate(0.0)  # before it has come to the rate that was asked for: what it will not do is forgotten
    starts = [piece.start for piece in table.motion]
    assert len(starts) == 6 and starts == sorted(starts)
    for piece, following in itertools.pairwise(table.motion):
        end = np.array([following.start])
        assert piece.rate_at(end)[0] == pytest.approx(following.rate_dps)
        assert piece.azimuth_at(end)[0] == pytest.approx(following.azimuth_deg)
    table.wait_until_steady()
    assert table.rate() == 0.0


def test_too_fast_is_refused_in_one_sentence():
    table = SimulatedRateTable(VirtualClock(), highest_rate=100.0)
    with pytest.raises(ValueError, match=r"at most 100 deg/s; 101 deg/s was asked for"):
        table.set_rate(101.0)
    with pytest.raises(ValueError, match="at most"):
        table.set_rate(float("nan"))
    with pytest.raises(ValueError, match="positive acceleration"):
        SimulatedRateTable(VirtualClock(), acceleration=0.0)
    table.close()
