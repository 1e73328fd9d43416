"""From a result to verdicts: which interval a number has, and what a result that does not stand decides."""

import math
from typing import Any

import pytest

from station.results.quantity import Quantity, QuantityGroup, Value
from station.results.result import Result
from station.results.verdict import Limit, judged, values_of

DOCUMENT: dict[str, Any] = {
    "lock_in_rate_dps": 0.01,
    "lock_in_rate_low_95_dps": 0.0098,
    "lock_in_rate_high_95_dps": 0.0103,
    "noise_rms_v": 0.004,
    "tilt_deg": 88.7,
    "tilt_u_deg": 0.01,
    "axes": [
        {"axis": "X", "scatter_ppm": 3.0, "nominal_ppm": 10.0, "nominal_spread": 1.5},
        {
            "axis": "Z",
            "scatter_ppm": 5.0,
            "scale_factor_counts_per_dps": 1e6,
            "scale_factor_u_counts_per_dps": 2.0,
        },
    ],
    "table_check": None,
}


RATE, NOISE = Quantity("lock_in_rate", "dps", limit=True), Quantity("noise_rms", "v", limit=True)
TILT, NOMINAL = Quantity("tilt", "deg", limit=True), Quantity("nominal", "ppm", limit=True, u_at="nominal_spread")
SCATTER, SCALE = Quantity("scatter", "ppm", limit=True), Quantity("scale_factor", "counts_per_dps")


def result(*quantities: Quantity, of_axes: tuple[Quantity, ...] = (), **more: Any) -> Result:
    groups = (QuantityGroup(quantities), QuantityGroup(of_axes, "axes", "axis"))
    return Result("x", "1", DOCUMENT, quantities=groups, **more)


def test_the_interval_of_a_number_stands_beside_it_or_is_twice_its_uncertainty() -> None:
    found = result(RATE, TILT, NOISE, of_axes=(NOMINAL, SCATTER))
    (rate,) = values_of(found, DOCUMENT, "lock_in_rate_dps")
    assert rate == Value(0.01, "deg/s", 0.0098, 0.0103)
    (tilt,) = values_of(found, DOCUMENT, "tilt_deg")
    assert (tilt.low_95, tilt.high_95) == (pytest.approx(88.68), pytest.approx(88.72))
    assert not values_of(found, DOCUMENT, "noise_rms_v")[0].uncertain
    assert values_of(found, DOCUMENT, "nominal_ppm")[0] == Value(10.0, "ppm", 7.0, 13.0, "X")
    assert [one.of for one in values_of(found, DOCUMENT, "scatter_ppm")] == ["X", "Z"]


def test_any_number_of_the_json_by_its_place() -> None:
    (scale,) = values_of(result(of_axes=(SCALE,)), DOCUMENT, "result.axes.1.scale_factor_counts_per_dps")
    assert (scale.value, scale.low_95, scale.high_95) == (1e6, 1e6 - 4, 1e6 + 4)
    assert values_of(result(), DOCUMENT, "result.table_check.beat_over_table") == []
    (missing,) = values_of(result(), DOCUMENT, "result.axes.0.nothing_hz")
    assert math.isnan(missing.value)


LIMITS = (
    Limit("lock_in_rate_dps", at_most=0.02),
    Limit("lock_in_rate_dps", at_most=0.005),
    Limit("noise_rms_v", at_most=0.01, rule="none"),
    Limit("tilt_deg", at_most=89.0),
)


@pytest.mark.parametrize(
    ("more", "doubtful", "verdicts"),
    [
        ({}, "marginal", ["PASS", "FAIL", "PASS", "ERROR"]),
        ({"doubts": ("nobody knows the bandwidth",)}, "marginal", ["MARGINAL", "FAIL", "PASS", "ERROR"]),
        ({"doubts": ("nobody knows the bandwidth",)}, "as_it_is", ["PASS", "FAIL", "PASS", "ERROR"]),
        ({"failures": ("beat and table differ",)}, "as_it_is", ["ERROR", "ERROR", "ERROR", "ERROR"]),
    ],
)
def test_a_result_that_does_not_stand_decides_nothing(more: Any, doubtful: str, verdicts: list[str]) -> None:
    found = judged(result(RATE, NOISE, **more), DOCUMENT, LIMITS, doubtful=doubtful)
    assert [one.verdict for one in found] == verdicts
    for one in found[:2]:
        assert one.sentence.startswith(one.verdict)
        assert all(reason in one.sentence for reason in more.get("failures", ()))
