"""Verdicts with guard bands: against the rules of JCGM 106, and probabilities counted another way."""

import math

import numpy as np
import pytest

from station.results.quantity import Quantity, Value
from station.results.verdict import Limit, Rule, decide, worst

K95 = 1.959963984540054


def judged(value: float, half: float, rule: Rule = "U95", **ends: float) -> tuple[str, float | None]:
    limit = Limit("lock_in_rate_dps", rule=rule, **ends)
    outcome = decide(limit, Value(value, "deg/s", value - half, value + half))
    return outcome.verdict, outcome.risk


@pytest.mark.parametrize(
    ("value", "verdict"),
    [(0.9, "PASS"), (0.95, "PASS"), (0.951, "MARGINAL"), (1.0, "MARGINAL"), (1.05, "MARGINAL"), (1.051, "FAIL")],
)
def test_a_guard_band_of_u95_on_either_side_of_a_limit(value: float, verdict: str) -> None:
    assert judged(value, 0.05, at_most=1.0)[0] == verdict
    assert judged(-value, 0.05, at_least=-1.0)[0] == verdict


def test_two_limits_leave_less_room() -> None:
    for value, verdict in ((1.0, "PASS"), (0.96, "MARGINAL"), (1.04, "MARGINAL"), (0.8, "FAIL"), (1.2, "FAIL")):
        assert judged(value, 0.08, at_least=0.9, at_most=1.1)[0] == verdict
    # an interval wider than the limits passes nowhere
    assert judged(1.0, 0.2, at_least=0.9, at_most=1.1)[0] == "MARGINAL"


def test_simple_acceptance_decides_by_the_value_and_tells_the_risk() -> None:
    rng = np.random.default_rng(7)
    for value, verdict in ((0.97, "PASS"), (1.02, "FAIL")):
        found, risk = judged(value, 0.05, "simple", at_most=1.0)
        true = value + 0.05 / K95 * rng.standard_normal(1_000_000)
        wrong = np.mean(true > 1.0) if verdict == "PASS" else np.mean(true <= 1.0)
        assert found == verdict
        # six standard deviations of the count
        assert risk == pytest.approx(wrong, abs=6 * math.sqrt(0.25 / 1e6))
    assert judged(1.0, 0.05, "simple", at_most=1.0) == ("PASS", pytest.approx(0.5))


def test_each_side_of_an_interval_has_its_own_width() -> None:
    limit = Limit("x", at_most=1.0, rule="simple")
    measured = Value(0.9, "", 0.9 - 0.01, 0.9 + 0.1 * K95)
    # half a normal distribution above the value, its standard deviation 0.1
    assert decide(limit, measured).risk == pytest.approx(0.158655, abs=1e-5)


def test_a_risk_that_is_too_high_decides_nothing() -> None:
    limit = Limit("x", at_most=1.0, rule="simple", highest_risk=0.05)
    for value, verdict in ((0.95, "PASS"), (0.99, "MARGINAL"), (1.01, "MARGINAL"), (1.05, "FAIL")):
        assert decide(limit, Value(value, "", value - 0.04, value + 0.04)).verdict == verdict


def test_without_a_value_or_the_uncertainty_that_the_rule_asks_for_the_unit_is_not_blamed() -> None:
    for rule in ("none", "U95", "simple"):
        assert decide(Limit("x", at_most=1.0, rule=rule), Value(math.nan, "")).verdict == "ERROR"
    for rule, verdict in (("none", "PASS"), ("U95", "ERROR"), ("simple", "ERROR")):
        assert decide(Limit("x", at_most=1.0, rule=rule), Value(0.5, "")).verdict == verdict  # type: ignore[arg-type]


def test_margin_and_acceptance_interval_are_told() -> None:
    tilt = Quantity("tilt", "deg")
    outcome = decide(Limit(tilt.key(), 1.0, 3.0), Value(1.5, "deg", 1.4, 1.7, quantity=tilt))
    assert outcome.margin == pytest.approx(0.5)
    assert (outcome.acceptance_low, outcome.acceptance_high) == (pytest.approx(1.1), pytest.approx(2.8))
    assert (
        outcome.sentence
        == "PASS tilt: 1.500 [1.400, 1.700] deg, at least 1 deg and at most 3 deg, margin +0.500 deg"
    )


def test_the_worst_verdict_rules() -> None:
    order = ["PASS", "MARGINAL", "FAIL", "ERROR", "ABORTED"]
    for place, verdict in enumerate(order):
        assert worst(order[: place + 1]) == verdict  # type: ignore[arg-type]
    assert worst([]) is None
