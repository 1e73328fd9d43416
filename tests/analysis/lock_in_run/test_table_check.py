"""The check by the rate table: it can fail, it fails only where it should, and it says what it cannot see."""

from dataclasses import replace

import numpy as np
import pytest
from array_bench import KNOWN, LATITUDE, TILT, WL, Gyro, K, records, table_rate_for, together

from analysis import Flag
from analysis.budget import NOTHING_BUT_RECORDS as PERFECT, BenchKnowledge
from analysis.lock_in_run import Method, RunArrays, evaluate

ONE = [0.08] * 8
SEVERAL = [rate * sense for rate in (0.03, 0.08, 0.2) for sense in (1, -1) for _ in range(4)]


def run(seed, slow=SEVERAL, table_u=0.0, moves=0.0, bias=0.0, **more):
    """A run whose azimuths are known; each setting of the table is wrong by chance.

    table_u is relative; moves, deg/s, is what the rate has moved by while the records of a setting were taken; and
    bias, deg/s, is that of the gyro.
    """
    rng = np.random.default_rng(seed)
    gyro = Gyro(rng, **more)
    first = rng.uniform(0, 360)
    arc = 15.0 if slow is ONE else 90.0
    azimuths = first + np.linspace(0, arc, len(slow))
    turning = records(gyro, [table_rate_for(rate) for rate in slow], azimuths=azimuths, turned=1.0)
    away = np.concatenate([first - 100 + np.linspace(0, 8, 4), first - 150 - np.linspace(0, 8, 4)])
    fast = records(gyro, [2.0] * 4 + [-2.0] * 4, azimuths=away, turned=1.0, periods=60.3)
    shown = [_shown(one, rng, table_u, moves, bias) for one in (together(turning), fast)]
    return RunArrays(*shown)


def _shown(arrays, rng, table_u, moves, bias):
    """The rates that the table shows: those that the axis has, but for an error of each setting."""
    settings, place = np.unique(arrays.table_rate, return_inverse=True)
    shown = settings * (1 + table_u * rng.normal(size=settings.size))
    along = np.cos(np.radians(TILT))
    return replace(arrays, table_rate=(shown - (moves * rng.normal(size=settings.size) + bias) / along)[place])


def wrong_by(error, **more):
    return replace(KNOWN, scale_factor=K * (1 + error), **more)


@pytest.mark.parametrize(
    "slow", [pytest.param(ONE, id="one rate"), pytest.param(SEVERAL, marks=pytest.mark.slow, id="several rates")]
)
def test_a_run_without_fault_lies_within_its_uncertainties(slow):
    beat, scale = [], []
    for seed in range(5):
        error = np.random.default_rng(900 + seed).normal(scale=50e-6)
        found = evaluate(run(seed, slow, table_u=20e-6), wrong_by(error), Method(K * (1 + error)))
        check = found.table_check
        beat.append((check.beat_over_table - 1) / check.beat_over_table_u)
        (way,) = check.scale_factors
        scale.append((way.scale_factor - K) / way.scale_factor_u)
        assert not check.mismatch and not check.scale_factor_mismatch
        assert not int(found.combined.flags) & int(Flag.TABLE_MISMATCH | Flag.SCALE_FACTOR_MISMATCH)
    # chi-square of 5 values leaves this range less than once in a thousand times
    for deviations in (beat, scale):
        assert 0.18 < np.sqrt(np.mean(np.square(deviations))) < 2.25


@pytest.mark.slow
def test_a_rate_that_moves_from_setting_to_setting_makes_no_scale_factor_wrong():
    """As a ripple in step with the records does. Without it the earth rate tells K to 0.1 %."""
    scale, beat = [], []
    for seed in range(5):
        check = evaluate(run(40 + seed, table_u=20e-6, moves=2e-4), KNOWN, Method(K)).table_check
        scale += [(way.scale_factor - K) / way.scale_factor_u for way in check.scale_factors]
        beat.append((check.beat_over_table - 1) / check.beat_over_table_u)
        assert not check.mismatch and not check.scale_factor_mismatch
    assert len(scale) > 4
    # found from four degrees of freedom, so that larger values occur than in a normal distribution
    for deviations in (beat, scale):
        assert 0.2 < np.sqrt(np.mean(np.square(deviations))) < 2.0


@pytest.mark.slow
@pytest.mark.parametrize("sense", [1, -1])
def test_a_small_bias_of_the_gyro_makes_no_scale_factor_wrong(sense):
    check = evaluate(run(60, table_u=20e-6, bias=sense * 0.025 / 3600), KNOWN, Method(K)).table_check
    (way,) = check.scale_factors
    assert abs(way.scale_factor - K) < 3 * way.scale_factor_u < 0.03 * K
    assert not check.mismatch and not check.scale_factor_mismatch


@pytest.mark.slow
def test_a_wrong_scale_factor_is_absorbed_by_the_tilt_and_seen_by_the_earth_rate():
    right, wrong = (evaluate(run(3), known, Method(known.scale_factor)) for known in (KNOWN, wrong_by(0.02)))
    assert float(wrong.combined.lock_in_rate) / float(right.combined.lock_in_rate) == pytest.approx(1 / 1.02, 1e-3)
    cosines = [np.cos(np.radians(found.tilt.tilt_deg)) for found in (right, wrong)]
    assert cosines[1] / cosines[0] == pytest.approx(1 / 1.02, rel=1e-3)
    assert not wrong.table_check.mismatch
    (way,) = wrong.table_check.scale_factors
    assert way.by == "earth rate"
    assert abs(way.scale_factor - K) < 4 * way.scale_factor_u < 0.005 * K
    assert way.p_value < 1e-6
    assert int(wrong.combined.flags) & Flag.SCALE_FACTOR_MISMATCH
    assert not int(right.combined.flags) & Flag.SCALE_FACTOR_MISMATCH


def blind(arrays):
    nothing = np.full(len(arrays), np.nan)
    return replace(arrays, azimuth_start=nothing, azimuth_end=nothing)


@pytest.mark.slow
def test_without_an_angle_of_its_own_nothing_tests_the_scale_factor():
    taken = run(4)
    found = evaluate(RunArrays(blind(taken.slow), blind(taken.fast)), wrong_by(0.02), Method(1.02 * K))
    assert found.table_check.scale_factors == ()
    assert not found.table_check.mismatch


@pytest.mark.slow
@pytest.mark.parametrize(("error", "seen"), [(0.0, False), (0.02, True)])
def test_a_known_tilt_tests_the_scale_factor(error, seen):
    known = wrong_by(error, known_tilt_deg=TILT + 0.005, known_tilt_u_deg=0.01)
    found = evaluate(run(5), known, Method(known.scale_factor))
    way = found.table_check.scale_factors[0]
    assert way.by == "known tilt"
    # K = A / cos(tilt): by hand, and with its uncertainty
    by_hand = K * np.cos(np.radians(TILT)) / np.cos(np.radians(TILT + 0.005))
    assert way.scale_factor == pytest.approx(by_hand, rel=2e-4)
    by_hand = np.tan(np.radians(TILT)) * np.radians(0.01)
    assert 0.95 * by_hand < way.scale_factor_u / K < (1.5 if seen else 1.05) * by_hand  # a wrong K scatters, too
    assert found.table_check.scale_factor_mismatch is seen


@pytest.mark.slow
def test_an_unstated_scale_factor_is_not_called_wrong_within_its_bound():
    known = replace(wrong_by(0.004), bench=BenchKnowledge())
    found = evaluate(run(6), known, Method(known.scale_factor))
    (way,) = found.table_check.scale_factors
    assert abs(way.scale_factor - K) < 4 * way.scale_factor_u
    assert not found.table_check.scale_factor_mismatch
    # and the tilt that was found with it knows no better
    by_scale = 0.01 / np.sqrt(3) / np.tan(np.radians(TILT))
    assert np.radians(found.tilt.tilt_u_deg) == pytest.approx(by_scale, rel=0.02)


@pytest.mark.slow
def test_a_slow_channel_is_no_error_of_several_rates():
    found = evaluate(run(7, SEVERAL, pole_hz=850.0), KNOWN, Method(K))
    assert abs(float(found.combined.lock_in_rate) - WL) < 2 * float(found.combined.lock_in_rate_u) < 0.005 * WL
    assert not found.table_check.scale_factor_mismatch


def test_a_slow_channel_is_seen():
    found = evaluate(run(7, ONE, pole_hz=850.0), KNOWN, Method(K))
    check, off = found.table_check, float(found.combined.lock_in_rate) / WL - 1
    assert off < -0.01
    assert check.p_value < 1e-3
    assert check.beat_over_table < 1
    # an error e of WL shows as e (WL/W)^2 in the rate
    assert check.beat_over_table - 1 == pytest.approx(off / 8**2, rel=0.3)
    assert check.least_error_seen < abs(off)
    assert int(found.combined.flags) & Flag.TABLE_MISMATCH
    assert not int(found.combined.flags) & Flag.SCALE_FACTOR_MISMATCH
    # the frequencies know nothing of the channel
    assert abs(check.by_frequencies - WL) < 4 * check.by_frequencies_u < 0.05 * WL


@pytest.mark.parametrize(("stated", "unexplained"), [(KNOWN.bench, False), (PERFECT, True)])
def test_a_difference_is_a_failure_only_beyond_all_that_the_budget_counts(stated, unexplained):
    """The slow channel of above: with nothing stated of it, its bound explains the difference."""
    found = evaluate(run(7, ONE, pole_hz=850.0), replace(KNOWN, bench=stated), Method(K))
    check = found.table_check
    assert check.mismatch
    assert check.unexplained is unexplained
    off = abs(float(found.combined.lock_in_rate) / WL - 1)
    assert (1.96 * found.lock_in_rate_u > off * WL) is not unexplained


def test_an_unknown_azimuth_leaves_the_check_open_by_the_earth_rate():
    taken = run(8, ONE)
    check = evaluate(RunArrays(blind(taken.slow), blind(taken.fast)), KNOWN, Method(K)).table_check
    horizontal = 15.041067 / 3600 * np.cos(np.radians(LATITUDE)) * np.sin(np.radians(TILT)) / np.sqrt(2)
    assert check.beat_over_table_u == pytest.approx(horizontal / 0.08, rel=0.1)
    assert not check.mismatch
    assert check.least_error_seen > 1


@pytest.mark.slow
def test_some_records_at_a_time_are_all_of_them(monkeypatch):
    """A million go through the check in blocks."""
    whole = evaluate(run(3, table_u=20e-6), KNOWN, Method(K)).table_check
    monkeypatch.setattr("analysis.lock_in_run.table._CURVES_AT_ONCE", 5)
    parts = evaluate(run(3, table_u=20e-6), KNOWN, Method(K)).table_check
    for name in ("beat_over_table", "beat_over_table_u", "by_frequencies", "by_frequencies_u", "p_value"):
        assert getattr(parts, name) == pytest.approx(getattr(whole, name), rel=1e-7)
    assert parts.scale_factors[0].scale_factor == pytest.approx(whole.scale_factors[0].scale_factor, rel=1e-9)
