"""Which rates a campaign goes through, and how they change with what the first records say."""

import json
import math
from dataclasses import replace
from typing import Any

import pytest

from analysis.lock_in_run import PreliminaryLockIn
from analysis.rotation import EARTH_RATE_DPS
from station.errors import NoUsableSignal
from station.lock_in.rate_plan import RatePlan, changed_plan, rate_plan, records_after, records_at_each, saved_plan
from station.lock_in.settings import Settings, load_settings


def settings_of(**sections: dict[str, Any]) -> Settings:
    return load_settings(overrides=sections)


def ratios(plan: RatePlan, sense: int = 1) -> list[float]:
    return [step.over_lock_in for step in plan.steps if step.sense == sense]


def seen(rate: float, off: float = 0.1) -> PreliminaryLockIn:
    return PreliminaryLockIn(rate, rate * (1 - off), rate * (1 + off))


def changed(
    settings: Settings, plan: RatePlan, found: PreliminaryLockIn | None, tried: int, silent: int = 0
) -> Any:
    """The plan after so many steps were tried, the last of which showed no beat."""
    steps = plan.steps[:tried]
    return changed_plan(settings, plan, 0.0, seen=found, tried=steps, without_beat=steps[tried - silent : tried])


def test_the_shipped_bench_goes_through_several_rates_in_both_senses() -> None:
    settings = settings_of()
    plan = rate_plan(settings, 88.693)
    assert len(ratios(plan)) == 5
    # the slow rates, which carry the lock-in rate, in the middle
    assert ratios(plan) == sorted(ratios(plan), reverse=True) == ratios(plan, -1)[::-1]
    assert (max(ratios(plan)), min(ratios(plan))) == (30, 3)
    assert [step.rate_dps for step in plan.steps if step.over_lock_in == 3] == pytest.approx([0.03, -0.03])
    assert records_at_each(settings, plan) * len(plan.steps) == 40


@pytest.mark.parametrize(
    ("measurement", "steps", "records"),
    [
        ({"rates_over_lock_in": [8]}, [(8, 1)], 20),
        ({"rates_over_lock_in": [8], "both_senses": True}, [(8, 1), (8, -1), (8, 1)], 20),
        ({"rates_over_lock_in": [3, 8], "records": 7}, [(8, 1), (3, 1), (3, -1), (8, -1)], 7),
        ({"rates_over_lock_in": [3, 8], "both_senses": False}, [(8, 1), (3, 1), (8, 1)], 20),
        ({"rates_over_lock_in": []}, [(8, 1)], 20),
    ],
)
def test_rates_that_the_user_names(measurement: dict[str, Any], steps: list[Any], records: int) -> None:
    settings = settings_of(measurement=measurement)
    plan = rate_plan(settings, 88.693)
    assert [(step.over_lock_in, step.sense) for step in plan.steps] == steps
    assert records_at_each(settings, plan) == records


def test_two_visits_share_the_records_of_a_rate() -> None:
    settings = settings_of(measurement={"rates_over_lock_in": [3, 5, 8], "both_senses": False, "records": 7})
    plan = rate_plan(settings)
    visits = [(8, 4), (5, 4), (3, 7), (5, 7), (8, 7)]  # and how many records there are after each
    assert [(step.over_lock_in, records_after(plan, step, 7)) for step in plan.steps] == visits
    assert saved_plan(settings, json.loads(json.dumps(plan.as_json()))) == plan


def test_a_table_that_turns_already_has_one_rate() -> None:
    settings = settings_of(table={"kind": "none"})
    assert not settings.rates_are_chosen
    assert [(step.over_lock_in, step.sense) for step in rate_plan(settings).steps] == [(8, 1)]


@pytest.mark.parametrize("lock_in", [0.0005, 0.002, 0.01])
def test_the_earth_cannot_stop_or_turn_a_tilted_gyro(lock_in: float) -> None:
    settings = settings_of(gyro={"expected_lock_in_rate_dps": lock_in})
    slowest = min(abs(step.rate_dps) for step in rate_plan(settings, 88.693).steps)
    horizontal = EARTH_RATE_DPS * math.cos(math.radians(28.2)) * math.sin(math.radians(88.693))
    assert slowest - horizontal > 1.9 * lock_in
    # along the table's axis there is no horizontal part
    assert min(ratios(rate_plan(settings, 0.0))) == 3


def test_what_table_and_channel_do_not_reach_is_left_out() -> None:
    slow_table = settings_of(table={"highest_rate_dps": 10.0})
    assert max(abs(step.rate_dps) for step in rate_plan(slow_table, 88.693).steps) <= 10 * 0.0228
    slow_channel = settings_of(budget={"bandwidth_hz": 1000.0})
    assert max(ratios(rate_plan(slow_channel, 0.0))) * 0.01 * 2000 <= 205
    # but no channel is so slow that there is no second rate
    slower = settings_of(budget={"bandwidth_hz": 100.0})
    assert len(ratios(rate_plan(slower, 0.0))) >= 2
    with pytest.raises(NoUsableSignal, match="no rate is safe"):
        rate_plan(settings_of(table={"highest_rate_dps": 1.0}), 88.693)


def test_a_plan_is_a_fact_of_the_run() -> None:
    settings = settings_of()
    plan = replace(rate_plan(settings, 88.693), planned_for_dps=0.02, changes=2)
    assert saved_plan(settings, json.loads(json.dumps(plan.as_json()))) == plan


@pytest.mark.parametrize("found", [0.0075, 0.01, 0.0135])
def test_a_lock_in_rate_that_is_about_as_expected_changes_nothing(found: float) -> None:
    settings = settings_of()
    assert changed(settings, rate_plan(settings), seen(found), tried=1) is None


@pytest.mark.parametrize("found", [0.0005, 0.003, 0.03, 0.2])
def test_a_lock_in_rate_that_is_surely_another_gives_other_rates(found: float) -> None:
    settings = settings_of(budget={"bandwidth_hz": 0.0})
    plan = rate_plan(settings)
    new = changed(settings, plan, seen(found), tried=1)
    assert new.planned_for_dps == found
    assert new.steps[0] == plan.steps[0]  # what is there stays
    sizes = [abs(step.rate_dps) / found for step in new.steps if step.sense == -1]
    assert min(sizes) == pytest.approx(3, rel=0.21)
    assert max(sizes) == pytest.approx(30, rel=0.21)
    # told only if it is sure
    assert changed(settings, plan, PreliminaryLockIn(found, 0.0, 1.0), tried=1) is None


def test_rates_that_were_gone_to_are_not_gone_to_again() -> None:
    settings = settings_of()
    plan = rate_plan(settings)
    new = changed(settings, plan, seen(0.02), tried=3)
    assert new.steps[:3] == plan.steps[:3]
    for size in ratios(new)[3:]:
        assert all(abs(size - other) > 0.15 * other for other in ratios(plan)[:3])
    # the same rates in the other sense
    assert set(ratios(new, -1)) <= set(ratios(new))


def test_a_gyro_that_is_locked_at_the_fastest_rate_is_turned_faster() -> None:
    settings = settings_of()
    plan = rate_plan(settings)
    new = changed(settings, plan, None, tried=1, silent=1)
    assert min(ratios(new)[1:]) == pytest.approx(90, rel=0.01)
    assert changed(settings, plan, None, tried=0) is None


def test_rates_below_one_that_is_locked_are_left_out() -> None:
    settings = settings_of()
    plan = rate_plan(settings)
    new = changed(settings, plan, seen(0.03), tried=4, silent=1)  # locked at 5.3, so above that
    assert min(step.over_lock_in for step in new.steps if step not in plan.steps[:4]) > 5.3 * 1.1


def test_there_is_an_end_to_it() -> None:
    settings = settings_of()
    plan = replace(rate_plan(settings), changes=4)
    assert changed(settings, plan, seen(0.2), tried=1) is None
    # a table that goes no further
    short = settings_of(table={"highest_rate_dps": 0.4})
    assert changed(short, rate_plan(short), seen(1.0), tried=1) is None
