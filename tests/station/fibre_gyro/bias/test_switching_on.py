"""Bias repeatability, transient and warm-up in `gyrolock fog figures`, against the simulation's truth."""

import math

import pytest

from station.report.show import render_report

FEW = {"runs": 4, "rates_dps": [10.0, 50.0, 100.0], "temperatures_c": [], "turn_on_s": 900.0, "static_s": 120.0}


def test_repeatability_and_warm_up_of_the_bias(taken) -> None:
    simulation = {"seed": 8, "angle_random_walk": 0.002, "switch_on_bias_dph": 0.2, "output_rate_hz": 2.0}
    evaluated, run = taken("figures", figures=FEW, simulation=simulation, limits={"warm_up_s": 100.0})
    found = evaluated.document()
    assert found["bias_repeatability_low_95_dph"] < 0.2 < found["bias_repeatability_high_95_dph"]
    assert found["bias_repeatability_low_95_dph"] < found["bias_repeatability_dph"]
    # 1 deg/h that dies away with 100 s is within 0.1 deg/h after 100 ln 10
    assert found["warm_up_low_95_s"] < 100 * math.log(10) < found["warm_up_high_95_s"] < 400
    assert found["turn_on_transient_dph"] == pytest.approx(1.0, abs=0.2)
    for one in found["runs"]:
        assert one["turn_on"]["exponentials"] == 1
        assert abs(one["turn_on"]["transient_dph"] - 1) < 5 * one["turn_on"]["transient_u_dph"]
    assert [one.passed for one in evaluated.tested] == [False]
    assert sum("since_on_s" in segment.conditions for segment in run.records) == 4
    page = render_report(evaluated)
    assert "Bias from one switching on to the next" in page


def test_a_record_that_is_too_short_says_so(taken) -> None:
    short = {**FEW, "runs": 2, "turn_on_s": 60.0, "warm_up_bound_dph": 0.01}
    simulation = {"angle_random_walk": 0.0005, "output_rate_hz": 4.0, "warm_up_time_s": 200.0}
    evaluated, _ = taken("figures", figures=short, simulation=simulation)
    assert evaluated.document()["warm_up_high_95_s"] is None
    assert any("too short to show that the bias stays within" in one for one in evaluated.result.to_watch)


def test_without_a_record_of_switching_on_there_is_no_warm_up(taken) -> None:
    evaluated, _ = taken(
        "figures", figures={**FEW, "runs": 2, "turn_on_s": 0.0}, simulation={"output_rate_hz": 4.0}
    )
    found = evaluated.document()
    assert found["warm_up_s"] is None
    assert found["runs"][0]["turn_on"] is None
    assert found["bias_repeatability_dph"] is not None
