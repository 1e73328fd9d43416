"""A run at one rate, from arrays to one result."""

from dataclasses import replace

import numpy as np
import pytest
from array_bench import (
    EARTH_DPS,
    KNOWN,
    LATITUDE,
    PHASE,
    TILT,
    WL,
    Gyro,
    K,
    axis_rate,
    no_records,
    records,
    table_rate_for,
    together,
    whole_run,
)

from analysis import Flag, estimate_lock_in
from analysis.arrays import NoTilt
from analysis.budget import BenchKnowledge, ResponseCorner
from analysis.lock_in_run import Method, RunArrays, Tilt, evaluate, find_tilt, rows_of_batches
from analysis.lock_in_run.records import estimate_records, only_beats
from analysis.lock_in_run.table import axis_rates

PLAIN = Method(K)


@pytest.fixture
def gyro():
    return Gyro(np.random.default_rng(1))


def test_records_alone_give_the_mean_by_hand(gyro):
    slow = records(gyro, [table_rate_for(0.08)] * 6)
    found = evaluate(RunArrays(together(slow), no_records()), None, PLAIN)
    alone = [estimate_lock_in(b.volts[0, 0], b.sample_interval, scale_factor=K) for b in slow.batches]
    values = np.array([float(one.lock_in_rate) for one in alone])
    assert found.each.lock_in_rate == pytest.approx(values, rel=1e-9)
    assert float(found.combined.lock_in_rate) == pytest.approx(values.mean(), rel=1e-3)
    assert abs(float(found.combined.lock_in_rate) - WL) < 4 * float(found.combined.lock_in_rate_u)
    assert float(found.combined.backscatter_phase) == pytest.approx(PHASE, abs=0.05)
    assert (found.tilt, found.table_check, found.several, found.quadratures) == (None, None, None, None)
    # nothing is known of the bench: the budget counts what everything may be, and covers all the more
    assert {"scale_factor", "distortion", "bandwidth", "gain_corner"} < {
        one.name for one in found.budget.not_stated
    }
    assert found.lock_in_rate_u > 50 * found.noise_u
    assert found.interval_95[0] < WL < found.interval_95[1]


def test_the_whole_run_gives_the_truth_by_beat_and_by_table(gyro):
    run = whole_run(gyro, [0.08] * 8)
    found = evaluate(run, KNOWN, PLAIN)
    assert abs(found.tilt.tilt_deg - TILT) < 4 * found.tilt.tilt_u_deg < 0.03
    best = int(np.argmin(found.each.lock_in_rate_u / found.each.lock_in_rate))
    assert found.tilt == find_tilt(run.fast, KNOWN, float(found.each.lock_in_rate[best]))
    check = found.table_check
    assert check.input_rate == pytest.approx(0.08, rel=1e-4)
    assert check.beat_over_table == pytest.approx(1.0, abs=1e-4)
    assert abs(check.lock_in_rate - WL) < 4 * check.lock_in_rate_u
    # an azimuth that nobody knows leaves the horizontal earth rate open
    horizontal = EARTH_DPS * np.cos(np.radians(LATITUDE)) * np.sin(np.radians(TILT)) / np.sqrt(2)
    assert check.lock_in_rate_u > 0.99 * WL * horizontal / 0.08
    assert found.several is None


def test_a_wrong_scale_factor_shows_between_beat_and_table(gyro):
    run = whole_run(gyro, [0.08] * 4)
    right, wrong = (evaluate(run, KNOWN, Method(k)) for k in (K, 1.01 * K))
    assert wrong.table_check.beat_over_table == pytest.approx(right.table_check.beat_over_table / 1.01, rel=1e-6)
    assert float(wrong.combined.lock_in_rate) == pytest.approx(float(right.combined.lock_in_rate) / 1.01, rel=1e-6)
    assert wrong.table_check.lock_in_rate == pytest.approx(right.table_check.lock_in_rate, rel=1e-6)
    # the tilt is found with the scale factor of the bench, whatever the method tries
    assert wrong.tilt.tilt_deg == pytest.approx(right.tilt.tilt_deg, rel=1e-6)


def test_rates_on_the_axis_are_those_of_vectors(gyro):
    azimuths = np.array([0.0, 37.0, 90.0, 200.0, 341.0])
    slow = records(gyro, [0.17] * 5, azimuths=azimuths + 25.0, turned=20.0)
    axis = axis_rates(slow, Tilt(TILT, 0.001), replace(KNOWN, north_azimuth_deg=25.0))
    assert axis.rates == pytest.approx([axis_rate(0.17, azimuth) for azimuth in azimuths], rel=1e-12)
    by_tilt = np.tan(np.radians(TILT)) * np.radians(0.001)
    assert axis.common_u == pytest.approx(np.full(5, by_tilt))
    for azimuth, u in zip(azimuths, axis.azimuth_u, strict=True):
        spread = [axis_rate(0.17, azimuth + step) for step in np.linspace(-10, 10, 2001)]
        # exact but for the curvature, which is all there is at north
        assert u == pytest.approx(np.std(spread), rel=0.02, abs=0.05 * EARTH_DPS * np.radians(20) ** 2)


def test_an_unknown_azimuth_leaves_the_swing_of_the_earth_rate_open(gyro):
    slow = records(gyro, [0.17])
    axis = axis_rates(slow, Tilt(TILT, 0.0), KNOWN)
    turn = [axis_rate(0.17, azimuth) for azimuth in np.arange(0.0, 360.0)]
    assert axis.rates[0] == pytest.approx(np.mean(turn))
    assert axis.common_u[0] == pytest.approx(np.std(turn) / np.mean(turn))
    assert axis.azimuth_u[0] == 0


def test_the_tilt_with_and_without_azimuths(gyro):
    azimuths = np.array([10.0, 130.0, 250.0, 10.0, 130.0, 250.0])
    fast = records(gyro, [0.9] * 3 + [-0.9] * 3, azimuths=azimuths, turned=1.0, periods=60.3)
    oriented = find_tilt(fast, KNOWN, WL)
    assert abs(oriented.tilt_deg - TILT) < 4 * oriented.tilt_u_deg
    nan = np.full(6, np.nan)
    blind = find_tilt(replace(fast, azimuth_start=nan, azimuth_end=nan), KNOWN, WL)
    assert blind.tilt_u_deg > 5 * oriented.tilt_u_deg
    by_itself = find_tilt(fast, KNOWN)
    assert abs(by_itself.tilt_deg - TILT) < 4 * by_itself.tilt_u_deg


@pytest.mark.slow
def test_the_tilt_of_a_fast_run_whose_second_harmonic_is_lost_in_the_noise(monkeypatch):
    """As behind a detector that is far too slow for the fast run; an axis along the table's shows it most."""
    monkeypatch.setattr("array_bench.TILT", 4.0)
    for seed in range(8):
        weak = Gyro(np.random.default_rng(seed), noise=1.7)
        tilt = find_tilt(records(weak, [2.0] * 4 + [-2.0] * 4, periods=25.8), KNOWN)
        assert abs(tilt.tilt_deg - 4.0) < 2 * tilt.tilt_u_deg < 12


def test_a_beat_faster_than_the_table_is_no_tilt(gyro):
    run = whole_run(gyro, [0.08] * 2)
    with pytest.raises(NoTilt, match="at most 1 is possible"):
        evaluate(run, replace(KNOWN, scale_factor=0.4 * K), PLAIN)


@pytest.mark.parametrize("missing", ["one sense", "a rate of the table"])
def test_half_a_fast_run_tells_nothing(gyro, missing):
    run = whole_run(gyro, [0.08] * 3)
    if missing == "one sense":
        run = replace(run, fast=records(gyro, [20.0] * 3, periods=60.3))
    else:
        rates = run.slow.table_rate.copy()
        rates[1] = np.nan
        run = replace(run, slow=replace(run.slow, table_rate=rates))
    found = evaluate(run, KNOWN, PLAIN)
    assert found.tilt is None and found.table_check is None
    assert found.budget is not None
    if missing == "one sense":
        assert evaluate(run, replace(KNOWN, both_senses=False), PLAIN).tilt is not None


def sensitivity(budget, name):
    (line,) = [line for line in budget.inputs if line.name == name]
    return line


@pytest.mark.slow
def test_sensitivities_of_the_budget_are_those_of_the_whole_evaluation():
    stated = BenchKnowledge(scale_factor_u_ppm=100.0, time_base_limit_ppm=50.0, distortion_limit=0.001)
    known = replace(KNOWN, bench=stated, table_rate_u_ppm=20.0, latitude_u_deg=0.01)

    def evaluated(k=K, stretch=1.0):
        bench = Gyro(np.random.default_rng(3), noise=1e-4, stretch=stretch)
        return evaluate(whole_run(bench, [0.08] * 4), known, Method(k))

    found, step = evaluated(), 1e-4
    value = float(found.combined.lock_in_rate)
    by_scale = (float(evaluated(k=K * (1 + step)).combined.lock_in_rate) - value) / (K * step)
    assert sensitivity(found.budget, "scale_factor").sensitivity == pytest.approx(by_scale, rel=0.01)
    assert sensitivity(found.budget, "scale_factor").u == pytest.approx(0.2)
    by_time = (float(evaluated(stretch=1 + step).combined.lock_in_rate) - value) / (step * 1e6)
    assert abs(sensitivity(found.budget, "time_base").sensitivity) == pytest.approx(abs(by_time), rel=0.01)
    assert sensitivity(found.budget, "tilt").contribution == 0
    common = {line.name for line in found.budget.inputs if line.common}
    assert common == {
        *("scale_factor", "time_base", "table_rate", "tilt", "latitude", "earth_rate", "azimuth"),
        *("distortion", "third_order"),
    }


def test_a_given_rate_counts_with_what_it_may_be_wrong_by(gyro):
    found = evaluate(whole_run(gyro, [0.08] * 2), KNOWN, Method(K, input_rate=0.08))
    assert found.budget.reference == "rate"
    given = sensitivity(found.budget, "input_rate")
    assert given.contribution == pytest.approx(WL * EARTH_DPS / np.sqrt(2) / 0.08, rel=0.02)
    assert sensitivity(found.budget, "scale_factor").contribution == 0


def test_a_formula_of_the_paper_counts_with_its_own_error(gyro):
    run = whole_run(gyro, [0.03] * 2)
    exact, paper = (evaluate(run, KNOWN, Method(K, relation=relation)) for relation in ("exact", "paper-13"))
    error = paper.lock_in_rate - exact.lock_in_rate
    assert error / WL < -0.02
    assert sensitivity(paper.budget, "relation").contribution == pytest.approx(abs(error) / np.sqrt(3), rel=1e-6)
    assert "relation" not in {one.name for one in exact.budget.inputs}


def test_a_correction_with_a_corner_that_is_hardly_known_is_a_limit(gyro):
    bench = BenchKnowledge(bandwidth=ResponseCorner(1000.0, 900.0, corrected=True))
    found = evaluate(whole_run(gyro, [0.08] * 2), replace(KNOWN, bench=bench), PLAIN)
    line = sensitivity(found.budget, "bandwidth")
    assert "hardly known" in line.note
    by_hand = np.sqrt((1 + 0.16**2) / (1 + 0.32**2)) * np.sqrt(1 / (1 + 0.16**2)) * np.sqrt(1 + 0.16**2)
    assert line.value == pytest.approx(1 / by_hand - 1, rel=0.03)


def test_records_without_a_beat_have_neither_result_nor_budget(gyro):
    run = whole_run(gyro, [0.08] * 2)
    silent = [replace(batch, volts=0 * batch.volts) for batch in run.slow.batches]
    found = evaluate(replace(run, slow=replace(run.slow, batches=silent)), KNOWN, PLAIN)
    assert not found.usable
    assert int(found.combined.flags) & Flag.CONSTANT
    assert found.budget is None and np.isnan(found.lock_in_rate_u)
    assert found.tilt is not None


def test_a_mistake_in_the_call_is_no_missing_budget(gyro):
    with pytest.raises(ValueError, match="scale_factor"):
        evaluate(whole_run(gyro, [0.08] * 2), replace(KNOWN, bench=BenchKnowledge(scale_factor_u_ppm=-5.0)), PLAIN)


def test_clipped_samples_are_told_and_not_guessed(gyro):
    slow = together(records(gyro, [table_rate_for(0.08)] * 2))
    (batch,) = slow.batches
    mask = np.abs(batch.volts) > 0.9
    cut = replace(batch, volts=np.clip(batch.volts, -0.9, 0.9), clipped=mask)
    found = evaluate(RunArrays(replace(slow, batches=[cut]), no_records()), None, PLAIN)
    assert np.all(found.each.flags & int(Flag.CLIPPED))
    assert abs(float(found.combined.lock_in_rate) - WL) < 5 * float(found.combined.lock_in_rate_u)


@pytest.mark.parametrize("channels", [1, 2])
def test_samples_known_to_be_clipped_are_left_out(gyro, channels):
    slow = together(records(gyro, [table_rate_for(0.08)] * 2))
    (batch,) = slow.batches
    volts, mask = np.repeat(batch.volts, channels, axis=0), np.repeat(batch.clipped, channels, axis=0)
    mask[0, 0, 40:43] = True
    marked = replace(slow, batches=[replace(batch, volts=volts, clipped=mask)], n_channels=channels)
    found = evaluate(RunArrays(marked, no_records()), None, PLAIN)
    marked_row = int(batch.rows[0])
    assert [bool(flags & Flag.CLIPPED) for flags in found.each.flags] == [marked_row == row for row in (0, 1)]


def test_few_periods_that_do_not_fit_either_are_no_beat(gyro):
    each = estimate_records(together(records(gyro, [table_rate_for(0.08)] * 3)), PLAIN)
    few, misfit = int(Flag.FEW_PERIODS), int(Flag.MISFIT)
    withheld = only_beats(replace(each, flags=np.array([few, misfit, few | misfit])))
    assert np.isfinite(withheld.lock_in_rate).tolist() == [True, True, False]
    assert withheld.usable.tolist() == [True, True, False]


def test_batches_hold_one_shape_and_a_thousand_records():
    interval = np.where(np.arange(2500) % 5 == 0, 2e-5, 1e-5)
    batches = rows_of_batches(interval, np.full(2500, 2500))
    assert [rows.size for rows in batches] == [500, 1000, 1000]
    assert sorted(np.concatenate(batches)) == list(range(2500))
    assert all(np.unique(interval[rows]).size == 1 for rows in batches)
