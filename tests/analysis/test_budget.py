"""The uncertainty budget against hand arithmetic, derivatives of other formulas, and simulated measurements."""

import math
from dataclasses import replace

import numpy as np
import pytest
import reference
from scipy import stats

from analysis import beat_signal, combine_estimates, estimate_lock_in
from analysis.budget import (
    NOTHING_BUT_RECORDS,
    BenchKnowledge,
    Budget,
    BudgetInput,
    OperatingPoint,
    RecordShape,
    ResponseCorner,
    TableGeometry,
    expected_noise,
    expected_point,
    lock_in_budget,
    operating_point,
    stated_inputs,
)
from analysis.rotation import rate_on_axis
from benchmarks import sbc
from benchmarks.monte_carlo import simulate_measurements

K, WL = 2000.0, 0.01
SILENT = NOTHING_BUT_RECORDS


def bench(**known) -> BenchKnowledge:
    """A perfect bench with an oscilloscope, but for what is given."""
    return replace(SILENT, **{"time_base_limit_ppm": 50.0, **known})


TILT = 88.693
TABLE = TableGeometry(
    table_rate=0.08 / math.cos(math.radians(TILT)),
    table_rate_u=1e-4,
    tilt_deg=TILT,
    tilt_u_deg=0.01,
    latitude_deg=28.2,
    latitude_u_deg=0.5,
    azimuth_deg=70.0,
    azimuth_u_deg=5.0,
)


def line(budget: Budget, name: str) -> BudgetInput:
    return next(one for one in budget.inputs if one.name == name)


def point_at(over: float, *, records: int = 1, noise: float = 0.01, level: float = 0.01, **more: float) -> tuple:
    rate = more.pop("rate", over * WL)
    frequency = K * math.sqrt(rate**2 - WL**2)
    shape = RecordShape(2500, 20 / frequency / 2500, 1.0, noise, level, records)
    return shape, expected_point(shape, scale_factor=K, input_rate=rate, lock_in_rate=WL, **more)


def solved_rate(frequency: float, ratio: float, scale_factor: float) -> float:
    """WL from f and r without any closed inverse: chi = 2 atan r, WL = (f/K) tan chi."""
    return frequency / scale_factor * math.tan(2 * math.atan(ratio))


def test_sensitivities_of_a_self_referenced_record_are_the_derivatives_of_the_rate() -> None:
    point = OperatingPoint(K, 0.03, WL, ratio_u=1e-3, beat_frequency_u=1e-3)
    budget = lock_in_budget(point, bench(scale_factor_u_ppm=100.0))
    f, r = K * math.sqrt(0.03**2 - WL**2), math.tan(0.5 * math.asin(1 / 3))
    assert solved_rate(f, r, K) == pytest.approx(WL, rel=1e-12)
    step = 1e-6
    by_ratio = (solved_rate(f, r + step, K) - solved_rate(f, r - step, K)) / (2 * step)
    by_frequency = (solved_rate(f + step, r, K) - solved_rate(f - step, r, K)) / (2 * step)
    by_scale = (solved_rate(f, r, K + 0.01) - solved_rate(f, r, K - 0.01)) / 0.02
    assert line(budget, "noise").sensitivity == pytest.approx(by_ratio, rel=1e-6)
    assert line(budget, "beat_frequency").sensitivity == pytest.approx(by_frequency, rel=1e-6)
    assert line(budget, "scale_factor").sensitivity == pytest.approx(by_scale, rel=1e-6)
    assert line(budget, "scale_factor").u == pytest.approx(0.2)
    # a time base that is slow by 1 ppm shows a beat that is too fast by 1 ppm
    assert line(budget, "time_base").contribution == pytest.approx(WL * 50e-6 / math.sqrt(3))


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_sensitivities_by_the_table_are_the_derivatives_of_the_rate(sense: float) -> None:
    table = TableGeometry(**{**vars(TABLE), "table_rate": sense * TABLE.table_rate})

    def lock_in(**changed: float) -> float:
        values = {**vars(table), **changed}
        rate = rate_on_axis(
            values["table_rate"], values["tilt_deg"], values["latitude_deg"], values["azimuth_deg"]
        )
        return abs(float(rate)) * math.sin(2 * math.atan(ratio))

    rate = float(rate_on_axis(table.table_rate, TILT, 28.2, 70.0))
    ratio = math.tan(0.5 * math.asin(WL / abs(rate)))
    budget = lock_in_budget(OperatingPoint(K, rate, WL, 1e-3), bench(table=table), "rate")
    for name, field in (
        ("table_rate", "table_rate"),
        ("tilt", "tilt_deg"),
        ("latitude", "latitude_deg"),
        ("azimuth", "azimuth_deg"),
    ):
        middle, step = vars(table)[field], 1e-4
        slope = (lock_in(**{field: middle + step}) - lock_in(**{field: middle - step})) / (2 * step)
        assert line(budget, name).sensitivity == pytest.approx(slope, rel=1e-5), name
    assert line(budget, "time_base").sensitivity == 0


def test_table_and_earth_do_not_enter_a_self_referenced_rate() -> None:
    point = OperatingPoint(K, 0.08, WL, 1e-4)
    budget = lock_in_budget(point, bench(scale_factor_u_ppm=10, table=TABLE))
    for name in ("table_rate", "tilt", "latitude", "azimuth", "earth_rate"):
        assert line(budget, name).contribution == 0
        assert line(budget, name).u > 0
    bare = lock_in_budget(point, bench(scale_factor_u_ppm=10))
    assert budget.combined_u == pytest.approx(bare.combined_u, rel=1e-12)


def test_unknown_azimuth_of_the_papers_bench_is_its_13_degrees_an_hour() -> None:
    table = TableGeometry(**{**vars(TABLE), "azimuth_deg": math.nan})
    budget = lock_in_budget(OperatingPoint(K, 0.2, WL, 1e-4), bench(table=table), "rate")
    azimuth = line(budget, "azimuth")
    assert azimuth.u * math.sqrt(2) * 3600 == pytest.approx(13.25, abs=0.01)
    # 13.25 deg/h of 0.2 deg/s is 1.84 %
    assert azimuth.contribution * math.sqrt(2) / WL == pytest.approx(0.0184, abs=0.0001)


def test_distortion_has_the_known_largest_size() -> None:
    # -46 dBc at 20 times lock-in: 2 X HD2 = 20 % at worst
    limit = 10 ** (-46 / 20)
    for phase, worst in ((0.0, 0.2), (math.pi, 0.2), (math.pi / 3, 0.1)):
        point = OperatingPoint(K, 20 * WL, WL, 1e-4, phase=phase)
        found = line(lock_in_budget(point, bench(distortion_limit=limit)), "distortion")
        assert found.contribution * math.sqrt(3) / WL == pytest.approx(worst, abs=0.003)
    apart = lock_in_budget(point, bench(distortion_limit=limit, separated=frozenset({"distortion"})))
    assert line(apart, "distortion").contribution == 0


@pytest.mark.parametrize("phase", [math.pi / 2, 1.4, 0.3, 2.5])
def test_distortion_that_turns_the_ratio_counts_as_well(phase: float) -> None:
    # what was seen is rho, and d may be anything within its limit: r is |rho - d|, by drawing
    limit, point = 0.01, OperatingPoint(K, 20 * WL, WL, 1e-5, phase=phase)
    d = np.random.default_rng(4).uniform(-limit, limit, 200_000)
    true = np.abs(-point.ratio * np.exp(-1j * phase) - d)
    spread = math.sqrt(np.mean((true - point.ratio) ** 2))
    by_ratio = line(lock_in_budget(point, SILENT), "noise").sensitivity * (1 - point.ratio**2)
    found = line(lock_in_budget(point, bench(distortion_limit=limit)), "distortion")
    assert found.contribution == pytest.approx(spread * by_ratio, rel=0.01)


def test_corners_have_the_known_effect() -> None:
    # one pole at 10 f takes 1.45 % of the ratio, AC coupling at f/5 adds 1.5 %, w = 0.1 g_c takes 0.5 %
    point = OperatingPoint(K, 20 * WL, WL, 1e-4)
    f = point.beat_frequency
    for name, lost in (
        ({"bandwidth": ResponseCorner(10 * f)}, 0.0145),
        ({"high_pass": ResponseCorner(f / 5)}, -0.0148),
        ({"gain": ResponseCorner(10 * f)}, 0.00496),
    ):
        budget = lock_in_budget(point, bench(**name))
        found = line(budget, {"gain": "gain_corner"}.get(next(iter(name)), next(iter(name))))
        assert found.value == pytest.approx(lost, rel=0.02)
        assert found.u == pytest.approx(abs(lost) / math.sqrt(3), rel=0.02)
    with pytest.raises(ValueError, match="lets no beat through"):
        lock_in_budget(point, bench(bandwidth=ResponseCorner(0.0)))


@pytest.mark.parametrize("over", [3.0, pytest.param(8.0, marks=pytest.mark.slow)])
def test_a_thermal_tail_has_the_effect_of_a_record_that_went_through_one(over: float) -> None:
    """Its late share is put on the spectrum of a record of whole periods; the budget never saw a sample."""
    shape, point = point_at(over, noise=0.0, level=0.0)
    times = shape.sample_interval * np.arange(2500)
    volts = beat_signal(times, scale_factor=K, input_rate=over * WL, lock_in_rate=WL, amplitude=1.0)
    hz = np.fft.rfftfreq(2500, shape.sample_interval)
    moved = []
    for after in np.geomspace(3e-4, 3e-3, 9):
        late = np.fft.irfft(np.fft.rfft(volts) * (1 + 0.01 / (1 + 2j * np.pi * hz * after)), 2500)
        found = estimate_lock_in(late + 1e-6 * np.sin(7e4 * times**2), shape.sample_interval, scale_factor=K)
        moved.append(abs(float(found.lock_in_rate) - WL))
    said = line(lock_in_budget(point, bench(tail_limit=0.01)), "tail")
    assert math.sqrt(3) * said.contribution == pytest.approx(max(moved), rel=0.15)
    assert not [one for one in lock_in_budget(point, bench()).inputs if one.name == "tail"]


@pytest.mark.parametrize("way", [1, -1])
def test_a_tail_counts_if_it_moves_the_result_in_one_direction_alone(way: int) -> None:
    seen = np.array([100.0])
    (said,) = stated_inputs(
        bench(tail_limit=0.01), 1.0, lambda factor: max(way * (float(np.abs(factor(seen)[0])) - 1), 0.0)
    )
    assert 1e-4 < said.contribution < 0.01


@pytest.mark.slow
def test_a_stated_thermal_tail_covers_what_it_does_to_a_run() -> None:
    silent, stated = (
        sbc.outcome(sbc.PLANS["default run"], 0.1, sbc.FAULTS[name], 555)
        for name in ("thermal tail of 0.2 to 1 %", "the same, 1 % stated")
    )
    assert abs(silent.pull) > 1.5 and abs(stated.pull) < 1.0 and stated.covered
    assert 1.5 < stated.relative_u / silent.relative_u < 5.0


def test_what_nobody_stated_counts_with_its_bound() -> None:
    point = OperatingPoint(K, 0.08, WL, 1e-4, phase=0.0)
    budget = lock_in_budget(point, BenchKnowledge())
    assert {one.name for one in budget.not_stated} == {
        *("scale_factor", "distortion", "third_order", "bandwidth", "high_pass", "gain_corner")
    }
    assert all(one.note.startswith("not stated: bound of") for one in budget.not_stated)
    # by hand: 2 X HD2 is 16 % for -40 dBc, a pole at 5 f 5.3 %, a gain at 3 f 5.1 %, -40 dBc, 1 % of K
    for name, size in (
        ("distortion", 0.16),
        ("bandwidth", 0.0528),
        ("gain_corner", 0.0513),
        ("third_order", 0.01),
        ("scale_factor", 0.01),
    ):
        assert line(budget, name).contribution * math.sqrt(3) / WL == pytest.approx(size, rel=0.04), name
    stated = {
        "bandwidth": ResponseCorner(math.inf),
        "gain": ResponseCorner(math.inf),
        "high_pass": ResponseCorner(0.0),
    }
    known = BenchKnowledge(100.0, distortion_limit=0.001, third_order_limit=0.001, **stated)
    assert lock_in_budget(point, known).not_stated == ()


def test_a_rate_of_which_nobody_said_how_it_was_found() -> None:
    budget = lock_in_budget(OperatingPoint(K, -0.08, WL, 1e-4), SILENT, "rate")
    # the earth turns by 15 deg/h, 5 % of 0.08 deg/s
    given = line(budget, "input_rate")
    assert given.contribution / WL == pytest.approx(15.041 / 3600 / math.sqrt(2) / 0.08, rel=0.01)
    assert not given.stated


def test_below_lock_in_there_is_no_operating_point() -> None:
    with pytest.raises(ValueError, match="there is no beat"):
        OperatingPoint(K, 0.01, WL, 1e-4)


def test_a_lock_in_rate_of_zero_has_an_uncertainty_of_what_may_look_like_it() -> None:
    budget = lock_in_budget(OperatingPoint(K, 0.08, 0.0, 1e-4), BenchKnowledge())
    assert line(budget, "distortion").contribution == pytest.approx(2 * 0.08 * 0.01 / math.sqrt(3), rel=0.01)
    low, high = budget.interval_95
    assert low == 0
    assert 1.5 * budget.combined_u < high < 3 * budget.combined_u


def test_the_interval_goes_over_from_a_limit_to_two_sides() -> None:
    def interval(value: float) -> tuple[float, float]:
        return Budget(value, "beat", (BudgetInput("a", "a", "1", 0.0, 1.0, "normal", 1.0),)).interval_95

    assert interval(20.0) == pytest.approx((20 - 1.96, 20 + 1.96), abs=0.01)
    assert interval(0.3)[0] == 0
    assert interval(3.0)[0] > 0.5
    # it covers: a size with noise in both of its parts, freed of its bias as an estimate is
    rng = np.random.default_rng(8)
    for true in (0.0, 1.0, 2.5, 5.0):
        parts = rng.normal([true, 0.0], 1.0, (1500, 2))
        values = np.sqrt(np.maximum(np.sum(parts**2, axis=1) - 1, 0.0))
        inside = np.mean([low <= true <= high for low, high in map(interval, values)])
        assert inside > 0.93, true


def test_combination_and_coverage_follow_the_gum() -> None:
    # JCGM 100, H.1 has three such lines in nanometres; here the sum is done by hand
    lines = [
        BudgetInput("a", "a", "1", 0.0, 0.03, "normal", 1.0, 5),
        BudgetInput("b", "b", "1", 0.0, 0.04, "normal", -1.0, 8),
        BudgetInput("c", "c", "1", 0.0, 0.12, "rectangular", 1.0),
    ]
    budget = Budget(1.0, "beat", tuple(lines))
    assert [one.name for one in budget.inputs] == ["c", "b", "a"]
    assert budget.combined_u == pytest.approx(0.13)
    freedom = 0.13**4 / (0.03**4 / 5 + 0.04**4 / 8)
    assert budget.effective_degrees_of_freedom == pytest.approx(freedom)
    assert budget.coverage_factor == pytest.approx(stats.t.ppf(0.975, math.floor(freedom)))
    few = Budget(1.0, "beat", tuple(lines[:1]))
    assert few.coverage_factor == pytest.approx(2.571, abs=1e-3)
    assert sum(budget.share(one) for one in budget.inputs) == pytest.approx(1.0)
    with pytest.raises(ValueError, match="finite"):
        BudgetInput("a", "a", "1", 0.0, math.nan, "normal", 1.0)


@pytest.mark.parametrize("over", [1.1, 2.0, 20.0])
@pytest.mark.parametrize("periods", [3, 8.3, 40])
def test_expected_noise_is_the_numerical_bound(over: float, periods: float) -> None:
    n, f_over_k = 2500, 0.1
    lock_in = f_over_k / math.sqrt(over**2 - 1)
    times = np.arange(n, dtype=float)
    bounds = [
        reference.bound(
            times,
            {
                "f_over_k": f_over_k,
                "wl": lock_in,
                "k": periods / n / f_over_k,
                "theta": 0.4 + phase,
                "delta": 1.1 * phase,
                "amplitude": 1.0,
                "offset": 0.0,
            },
            0.01,
        )
        for phase in np.arange(8) * np.pi / 8
    ]
    shape = RecordShape(n, 1.0, 1.0, 0.01)
    point = expected_point(
        shape, scale_factor=periods / n / f_over_k, input_rate=over * lock_in, lock_in_rate=lock_in
    )
    predicted = lock_in_budget(point, SILENT).combined_u
    assert predicted == pytest.approx(float(np.sqrt(np.mean(np.square(bounds)))), rel=0.02)


def test_operating_point_takes_noise_and_scatter_from_records() -> None:
    rng = np.random.default_rng(5)
    shape, point = point_at(6.0, noise=0.01, level=0.01)
    frequency = point.beat_frequency
    times = np.arange(2500) * shape.sample_interval
    scatter = 0.02
    volts = []
    for wl in WL * (1 + scatter * rng.standard_normal(40)):
        f_over_k = math.sqrt(0.06**2 - wl**2)
        clean = reference.adler_beat(times, f_over_k, wl, K, rng.uniform(0, 3), 0.7, 1.0, 0.0)
        volts.append(0.01 * np.rint((clean + 0.01 * rng.standard_normal(2500)) / 0.01))
    each = estimate_lock_in(np.array(volts), shape.sample_interval, scale_factor=K)
    combined = combine_estimates(each)
    found = operating_point(each, combined, samples=2500, level_spacing=0.01)
    assert found.beat_frequency == pytest.approx(frequency, rel=1e-3)
    assert found.rounding_share == pytest.approx(1 / 13, rel=0.05)  # s^2/12 beside s^2
    assert found.ratio_u == pytest.approx(point.ratio_u / math.sqrt(40), rel=0.05)
    budget = lock_in_budget(found, SILENT)
    assert line(budget, "scatter").contribution == pytest.approx(scatter * WL / math.sqrt(40), rel=0.35)
    assert line(budget, "scatter").degrees_of_freedom == 39
    assert budget.combined_u == pytest.approx(float(combined.lock_in_rate_u), rel=0.02)


CHAINS = {
    "noise and rounding": (8.0, {}, {"level": 0.02}),
    "near the threshold": (1.3, {}, {}),
    "scale factor": (3.0, {"scale_factor_u_ppm": 3000.0}, {}),
    "distortion, phase known": (5.0, {"distortion_limit": 0.003}, {"phase": 0.6}),
    "distortion, phase unknown": (2.0, {"distortion_limit": 0.005}, {}),
    "low pass corrected": (4.0, {"bandwidth": ResponseCorner(300.0, 20.0, corrected=True)}, {}),
    "low pass not corrected": (4.0, {"bandwidth": ResponseCorner(400.0)}, {"noise": 0.002}),
    "gain corrected": (4.0, {"gain": ResponseCorner(200.0, 15.0, corrected=True)}, {}),
    "gain not corrected": (4.0, {"gain": ResponseCorner(500.0)}, {"noise": 0.002}),
    "response measured": (4.0, {"response_u": 0.01}, {"noise": 0.002}),
}


@pytest.mark.slow
@pytest.mark.parametrize("chain", CHAINS)
def test_budget_agrees_with_the_whole_chain_within_5_percent(chain: str) -> None:
    over, known, how = CHAINS[chain]
    shape, point = point_at(over, **how)
    knowledge = bench(**known)
    budget = lock_in_budget(point, knowledge)
    simulated = simulate_measurements(point, knowledge, shape, trials=2500, rng=np.random.default_rng(11))
    assert simulated.failed == 0
    assert simulated.u == pytest.approx(budget.combined_u, rel=0.05)
    assert abs(simulated.mean - WL) < 0.2 * budget.combined_u


@pytest.mark.slow
@pytest.mark.parametrize("azimuth", [math.nan, 70.0])
def test_budget_by_the_table_agrees_with_the_whole_chain(azimuth: float) -> None:
    table = TableGeometry(**{**vars(TABLE), "azimuth_deg": azimuth})
    rate = float(rate_on_axis(table.table_rate, TILT, 28.2, 90.0 if math.isnan(azimuth) else azimuth))
    shape, point = point_at(0, rate=rate)
    knowledge = bench(table=table)
    budget = lock_in_budget(point, knowledge, "rate")
    simulated = simulate_measurements(point, knowledge, shape, "rate", trials=3000, rng=np.random.default_rng(12))
    assert simulated.u == pytest.approx(budget.combined_u, rel=0.05)


@pytest.mark.slow
def test_budget_of_several_records_with_scatter_agrees_with_the_whole_chain() -> None:
    shape, point = point_at(4.0, records=4, scatter=0.01 * WL)
    knowledge = bench(scale_factor_u_ppm=2000.0)
    budget = lock_in_budget(point, knowledge)
    simulated = simulate_measurements(point, knowledge, shape, trials=1500, rng=np.random.default_rng(13))
    assert simulated.u == pytest.approx(budget.combined_u, rel=0.05)


def test_expected_noise_falls_with_the_root_of_the_records() -> None:
    one, many = (expected_noise(RecordShape(2500, 1e-4, 1.0, 0.01, 0.0, n), [0.1, 0.5]) for n in (1, 9))
    np.testing.assert_allclose(one.ratio_u / many.ratio_u, 3.0)
    np.testing.assert_allclose(
        one.across_u / one.ratio_u, np.sqrt(1 + np.square([0.1, 0.5])) / (1 - np.square([0.1, 0.5]))
    )
