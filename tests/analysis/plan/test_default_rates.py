"""The rates of a measurement that nobody planned."""

import pytest

from analysis.plan import default_rates


def test_rates_are_safe_whatever_the_lock_in_rate_is_within_its_factor() -> None:
    rates = default_rates(0.01, 2000.0)
    assert rates == tuple(sorted(rates)) and len(rates) == 5
    assert min(rates) * 0.01 >= 1.5 * 0.02  # a lock-in rate of twice the expected one
    assert max(rates) / min(rates) == pytest.approx(10)


@pytest.mark.parametrize("limit", [{"fastest_rate": 0.12}, {"fastest_beat_hz": 240.0}])
def test_table_and_receiver_end_the_rates(limit: dict) -> None:
    rates = default_rates(0.01, 2000.0, **limit)
    assert min(rates) == 3.0
    assert max(rates) == 12.0
    assert len(rates) == 5


def test_rates_lie_a_quarter_apart_at_least() -> None:
    assert default_rates(0.01, 2000.0, fastest_rate=0.06) == (3.0, 3.8, 4.8, 6.0)
    assert default_rates(0.01, 2000.0, fastest_rate=0.035) == (3.0, 3.5)


def test_a_bench_that_reaches_one_safe_rate_only() -> None:
    assert default_rates(0.01, 2000.0, fastest_rate=0.03) == (3.0,)
    with pytest.raises(ValueError, match="no rate is safe"):
        default_rates(0.01, 2000.0, fastest_rate=0.02)


@pytest.mark.parametrize("bad", [(0.0, 2000.0), (0.01, -1.0), (float("nan"), 2000.0)])
def test_impossible_values_are_refused(bad: tuple[float, float]) -> None:
    with pytest.raises(ValueError, match="positive"):
        default_rates(*bad)
