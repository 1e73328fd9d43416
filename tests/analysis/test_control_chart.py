"""Control chart: limits by hand, rules against a slow reading of the handbook, and how often chance signals."""

import numpy as np
import pytest

from analysis.control_chart import control_chart, trend

# moving ranges 1 1 2 1 1 2 2 0: mean 1.25
VALUES = [10.0, 11.0, 10.0, 12.0, 11.0, 10.0, 12.0, 10.0, 10.0]


def test_limits_by_hand() -> None:
    chart = control_chart(VALUES)
    assert chart.centre == pytest.approx(96 / 9)
    assert chart.sigma == pytest.approx(1.25 / 1.128, rel=1e-3)
    assert chart.range_limit == pytest.approx(3.267 * 1.25)
    assert np.isnan(chart.moving_range[0])
    assert chart.moving_range[1:].tolist() == [1, 1, 2, 1, 1, 2, 2, 0]
    assert chart.signals == ()
    assert chart.last_is_in_control


def test_later_values_do_not_move_the_limits() -> None:
    before = control_chart(VALUES, baseline=9)
    after = control_chart([*VALUES, 30.0, 31.0], baseline=9)
    assert (after.centre, after.sigma) == (before.centre, before.sigma)
    assert {one.place for one in after.signals if one.rule == 1} == {9, 10}
    assert {one.place for one in after.signals if one.rule == 5} == {9}
    assert not after.last_is_in_control


@pytest.mark.parametrize("values", [VALUES[:7], [5.0] * 20, []])
def test_without_scatter_or_with_few_values_there_are_no_limits(values: list[float]) -> None:
    chart = control_chart(values)
    assert not chart.has_limits
    assert chart.signals == ()


@pytest.mark.parametrize(("values", "baseline"), [([1.0, np.nan], 25), ([[1.0]], 25), (VALUES, 3)])
def test_what_is_no_chart_is_refused(values: object, baseline: int) -> None:
    with pytest.raises(ValueError, match=r"control chart|baseline"):
        control_chart(values, baseline=baseline)


def slow_rules(z: list[float]) -> set[tuple[int, int]]:
    """The handbook, read aloud: at each value, look back."""
    found = set()
    for place, value in enumerate(z):
        if abs(value) > 3:
            found.add((place, 1))
        for rule, count, of, sigmas in ((2, 2, 3, 2), (3, 4, 5, 1), (4, 8, 8, 0)):
            if place + 1 < of:
                continue
            last = z[place + 1 - of : place + 1]
            high, low = sum(one > sigmas for one in last), sum(one < -sigmas for one in last)
            if (high >= count and value > sigmas) or (low >= count and value < -sigmas):
                found.add((place, rule))
    return found


def test_rules_as_the_handbook_reads() -> None:
    values = np.random.default_rng(3).standard_t(3, size=4000)
    chart = control_chart(values, baseline=1000)
    z = ((values - chart.centre) / chart.sigma).tolist()
    wanted = slow_rules(z)
    assert {rule for _, rule in wanted} == {1, 2, 3, 4}
    assert {(one.place, one.rule) for one in chart.signals if one.rule < 5} == wanted


def test_chance_alone_signals_seldom_and_a_shift_soon() -> None:
    """Rules 1 to 4 together: one false alarm in 92 values (Champ, Woodall 1987); 2 sigma within 8."""
    values = np.random.default_rng(7).normal(size=60_000)
    chart = control_chart(values, baseline=60_000)
    alarms = len({one.place for one in chart.signals if one.rule < 5}) / values.size
    assert 0.008 < alarms < 0.03
    shifted = control_chart([*values[:500], *(values[500:600] + 2)], baseline=500)
    assert min(one.place for one in shifted.signals if one.place >= 500 and one.rule < 5) < 508


@pytest.mark.parametrize("scatter", [0.0, 3.0])
def test_the_interval_of_a_trend_holds(scatter: float) -> None:
    """Three things of other levels, tested at random times; with and without scatter beyond the uncertainties."""
    rng, inside = np.random.default_rng(4), 0
    for _ in range(300):
        of = np.repeat([0, 1, 2], [6, 3, 1])
        days, u = rng.uniform(0, 30, of.size), rng.uniform(0.3, 3, of.size)
        values = (
            100.0 * of + 0.2 * days + u * rng.standard_normal(of.size) + scatter * rng.standard_normal(of.size)
        )
        found = trend(days, values, u, of)
        assert found is not None
        assert found.low_95 < found.per_day < found.high_95
        inside += found.low_95 < 0.2 < found.high_95
    assert 0.92 * 300 < inside < 0.99 * 300


def test_too_few_values_or_one_time_give_no_trend() -> None:
    assert trend([0.0, 1.0, 2.0], [1.0, 2.0, 3.0], [1.0] * 3, ["a"] * 3) is None
    assert trend([0.0] * 6, np.arange(6), [1.0] * 6, ["a"] * 6) is None
    assert trend(np.arange(6), np.arange(6), [1.0] * 6, list("abcdef")) is None
    found = trend(np.arange(6), 2 * np.arange(6), [np.nan] * 6, ["a"] * 6)
    assert found is not None
    assert found.per_day == pytest.approx(2)
