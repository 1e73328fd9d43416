"""Plans against simulated measurements, and against what is known without any plan."""

import math
from dataclasses import replace

import numpy as np
import pytest

from analysis.budget import NOTHING_BUT_RECORDS, BenchKnowledge, ResponseCorner, TableGeometry
from analysis.plan import (
    OscilloscopeSteps,
    PlanRequest,
    budget_elsewhere,
    plan_measurement,
    predicted_budget,
    uncertainty_curve,
)
from benchmarks.monte_carlo import simulate_measurements
from benchmarks.several_rates.planned import DISTORTION, planned, rms_error, simulated_fits


def bench(scale_factor_u_ppm: float = 0.0, **known):
    """A perfect bench with an oscilloscope, but for what is given."""
    return replace(
        NOTHING_BUT_RECORDS, scale_factor_u_ppm=scale_factor_u_ppm, **{"time_base_limit_ppm": 50.0, **known}
    )


STEPS = OscilloscopeSteps(
    time_bases=tuple(float(f"{m}e{d}") for d in range(-9, 2) for m in (1, 2.5, 5)),
    vertical_scales=(0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0),
)
REQUEST = PlanRequest(
    lock_in_rate=0.01,
    wanted_u=0.01,
    scale_factor=2000.0,
    amplitude=0.38,
    noise_rms=0.02,
    noise_levels=0.5,
    oscilloscope=STEPS,
    knowledge=bench(scale_factor_u_ppm=50.0),
)


def test_scope_settings_are_steps_that_hold_the_beat() -> None:
    rate = plan_measurement(REQUEST).rates[0]
    assert rate.seconds_per_division in STEPS.time_bases
    assert rate.volts_per_division == 0.1  # 0.38 V are 95 levels at 0.1 V/div and would be 190 at 0.05
    assert rate.beat_frequency == pytest.approx(2000 * math.sqrt(rate.input_rate**2 - 1e-4))
    assert rate.periods == pytest.approx(rate.beat_frequency * 10 * rate.seconds_per_division)
    assert rate.periods >= 15
    assert rate.samples_per_period >= 20
    faster = max(base for base in STEPS.time_bases if base < rate.seconds_per_division)
    assert rate.beat_frequency * 10 * faster < 15


def test_the_slowest_safe_rate_wins_and_20_times_needs_far_more() -> None:
    plan = plan_measurement(replace(REQUEST, wanted_u=0.004))
    assert plan.reached
    assert plan.rates[0].over_lock_in == pytest.approx(3.0)  # 1.5 times the double of what is expected
    at_20 = plan_measurement(replace(REQUEST, wanted_u=0.004, rates_over_lock_in=(20.0,)))
    # noise of the ratio is the same, its weight 1/r: (r(3)/r(20))^2 = 47 times the records, less by (1+r^2)^2
    assert 38 < at_20.records / (predicted_budget(REQUEST, 3.0, 1).relative_u / 0.004) ** 2 < 48


def test_records_are_as_many_as_needed_and_no_more() -> None:
    request = replace(REQUEST, wanted_u=0.002, rates_over_lock_in=(8.0,))
    plan = plan_measurement(request)
    assert plan.records > 20
    assert plan.budget.relative_u <= 0.002
    assert predicted_budget(request, 8.0, plan.records - 1).relative_u > 0.002
    assert plan.duration_s == pytest.approx(plan.records * plan.rates[0].shape.duration)


def test_what_cannot_be_reached_is_told_with_its_floor() -> None:
    plan = plan_measurement(replace(REQUEST, wanted_u=1e-5))
    assert not plan.reached
    # 50 ppm of K and 50 ppm / sqrt(3) of the time base
    assert plan.floor_u == pytest.approx(math.hypot(50e-6, 50e-6 / math.sqrt(3)), rel=0.01)
    assert plan.budget.relative_u < 1.2 * plan.floor_u


SINGLE = {
    "noise": {},
    "20 times": {"rates_over_lock_in": (20.0,)},
    "distortion": {"knowledge": bench(100.0, distortion_limit=10 ** (-46 / 20)), "wanted_u": 0.02},
    "few periods": {"periods_min": 4.0, "noise_rms": 0.04},
    "scatter": {"scatter": 0.03, "wanted_u": 0.012},
    "gain": {"knowledge": bench(100.0, gain=ResponseCorner(300.0)), "rates_over_lock_in": (5.0,)},
}

SLOW = ("20 times", "distortion", "scatter", "few periods", "gain")


@pytest.mark.parametrize("case", [pytest.param(c, marks=pytest.mark.slow) if c in SLOW else c for c in SINGLE])
def test_predictions_agree_with_simulation_within_10_percent(case: str) -> None:
    plan = plan_measurement(replace(REQUEST, **SINGLE[case]))
    rate, request = plan.rates[0], plan.request
    shape = rate.shape
    at = _point(request, plan)
    simulated = simulate_measurements(at, request.knowledge, shape, trials=600, rng=np.random.default_rng(3))
    assert simulated.u == pytest.approx(plan.budget.combined_u, rel=0.10)


@pytest.mark.slow
def test_prediction_by_the_table_agrees_with_simulation() -> None:
    spread = TableGeometry(1.0, 20e-6, 88.693, 0.01, 28.2, 0.01)
    plan = plan_measurement(replace(REQUEST, reference="rate", table=spread, wanted_u=0.03))
    table = spread.for_rate(plan.rates[0].input_rate)
    knowledge = replace(plan.request.knowledge, table=table)
    at = _point(plan.request, plan)
    simulated = simulate_measurements(
        at, knowledge, plan.rates[0].shape, "rate", trials=600, rng=np.random.default_rng(4)
    )
    assert plan.rates[0].over_lock_in > 6  # the earth's rotation weighs as 1/W: slow is not best here
    assert simulated.u == pytest.approx(plan.budget.combined_u, rel=0.10)


# `benchmarks.several_rates.planned` has more rates and trials
@pytest.mark.slow
@pytest.mark.parametrize(
    ("over", "both"),
    [((3.0,), True), ((3.0, 30.0), False), pytest.param((8.0, 15.0, 30.0), False, marks=pytest.mark.slow)],
)
def test_prediction_for_several_rates_agrees_with_their_fit(over: tuple[float, ...], both: bool) -> None:
    plan = planned(over, both)
    assert next(line for line in plan.budget.inputs if line.name == "distortion").contribution == 0
    fits = simulated_fits(plan, DISTORTION, 60, np.random.default_rng(7))
    # 60 trials know it to 9 %; the distortion that was put in, 80 times what noise alone would do, is gone
    assert rms_error(fits) == pytest.approx(plan.budget.relative_u, rel=0.4)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("over", "both"),
    [
        ((8.0,), True),
        pytest.param((3.0, 30.0), False, marks=pytest.mark.slow),
        pytest.param((3.0, 9.5, 30.0), True, marks=pytest.mark.slow),
    ],
)
def test_of_a_bench_that_nobody_stated_a_plan_promises_what_its_fit_says(
    over: tuple[float, ...], both: bool
) -> None:
    """At one rate in both senses the gain corner is open, however little noise there is."""
    knowledge = replace(bench(time_base_limit_ppm=0.0), distortion_limit=math.nan, third_order_limit=math.nan)
    knowledge = replace(knowledge, bandwidth=ResponseCorner(30e3), gain=ResponseCorner())
    plan = plan_measurement(replace(planned(over, both).request, phase=math.nan, knowledge=knowledge))
    phases, rng = 2 * np.pi * np.arange(6) / 6, np.random.default_rng(8)
    fits = [fit for phase in phases for fit in simulated_fits(plan, DISTORTION, 2, rng, phase)]
    said = math.sqrt(np.mean([fit.lock_in_rate_u**2 for fit in fits]))
    assert plan.budget.combined_u == pytest.approx(said, rel=0.35)


@pytest.mark.slow
def test_two_rates_in_one_sense_promise_no_more_than_two_solutions_allow() -> None:
    """3 and 30 times lock-in: several times worse than the same rates in both senses, and no records cure it."""
    unknown = replace(planned((3.0, 30.0), False).request, phase=math.nan, knowledge=BenchKnowledge())
    one, both = (plan_measurement(replace(unknown, both_senses=senses, wanted_u=0.02)) for senses in (False, True))
    assert one.floor_u > 2 * both.floor_u
    more = replace(one.request, wanted_u=one.floor_u / 2)
    assert not plan_measurement(more).reached
    assert one.budget.inputs[0].name == "separation" and not one.budget.inputs[0].stated


def test_one_rate_in_one_sense_cannot_separate() -> None:
    from analysis.plan import expected_joint_u

    shape = plan_measurement(REQUEST).rates[0].shape
    with pytest.raises(ValueError, match="both senses"):
        expected_joint_u([shape, shape], [0.03, 0.03], 0.01, 2000.0)


def test_another_lock_in_rate_than_expected() -> None:
    plan = plan_measurement(REQUEST)
    half = budget_elsewhere(plan, 0.005)
    again = plan_measurement(replace(REQUEST, lock_in_rate=0.005, rates_over_lock_in=(6.0,)))
    one = predicted_budget(again.request, 6.0, plan.records)
    assert half.relative_u == pytest.approx(one.relative_u, rel=1e-9)
    with pytest.raises(ValueError):
        budget_elsewhere(plan, 0.04)


def test_curve_goes_through_the_plan_and_rises_with_the_rate() -> None:
    request = replace(REQUEST, knowledge=bench(50.0, distortion_limit=0.003))
    plan = plan_measurement(request)
    curve = uncertainty_curve(request, plan.records)
    at_plan = np.interp(plan.rates[0].over_lock_in, curve.over_lock_in, curve.total)
    assert at_plan == pytest.approx(plan.budget.relative_u, rel=0.01)
    # noise alone is least at W = 1.155 WL (r^2 = 1/3), see the derivative of (1 + r^2)/(r sqrt(1 - r^2))
    assert curve.over_lock_in[curve.noise.argmin()] == pytest.approx(2 / math.sqrt(3), rel=0.03)
    assert np.all(np.diff(curve.distortion) > 0)
    parts = np.sqrt(curve.noise**2 + curve.distortion**2 + curve.reference**2 + curve.channel**2)
    np.testing.assert_allclose(curve.total, parts, rtol=1e-9)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"wanted_u": 0.0}, "wanted_u"),
        ({"lock_in_rate": -1.0}, "lock_in_rate"),
        ({"rates_over_lock_in": (0.9,)}, "1.05"),
        ({"lock_in_factor": 0.5}, "factor"),
        ({"reference": "rate"}, "table rate and tilt"),
    ],
)
def test_impossible_requests_are_refused(change: dict, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        replace(REQUEST, **change)


def test_signal_too_large_for_the_screen() -> None:
    with pytest.raises(ValueError, match="probe"):
        plan_measurement(replace(REQUEST, amplitude=40.0))


def _point(request: PlanRequest, plan):
    from analysis.budget import expected_point

    rate = plan.rates[0]
    return expected_point(
        rate.shape,
        scale_factor=request.scale_factor,
        input_rate=rate.input_rate,
        lock_in_rate=request.lock_in_rate,
        scatter=request.scatter * request.lock_in_rate,
        phase=request.phase,
    )
