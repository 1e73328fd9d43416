"""A rate that steps, and a time base that does: the same motion of the phase, another lock-in rate."""

import numpy as np
import pytest

from analysis import estimate_lock_in, flag_names
from analysis.waveform.smooth_phase import fit_smooth_phase
from benchmarks.hostile.gyro import N_SAMPLES, beat, converted, draw_gyro, levels_of, noisy, steady, step_times


def stepped(seed, place, *, rate=1.0, time_base=1.0, x=3.0, periods=20.3, noise=0.6):
    """A gyro and its codes; from `place` on rate or time base are so many times what they were."""
    rng = np.random.default_rng(seed)
    gyro = draw_gyro(
        rng, rate_over_lock_in=(x, x), periods=(periods, periods), noise=(noise, noise), amplitude=(90.0, 90.0)
    )
    late = step_times() > place
    interval = gyro.sample_interval * np.where(late, time_base, 1.0)
    signal = beat(gyro, steady(gyro) * np.where(late, rate, 1.0), interval)
    return gyro, converted(noisy(rng, gyro, levels_of(gyro, signal)))


def estimate(gyro, codes):
    return estimate_lock_in(codes, gyro.sample_interval, scale_factor=gyro.scale_factor)


@pytest.mark.parametrize(("x", "rate"), [(3.0, 1.6), pytest.param(1.6, 1.5, marks=pytest.mark.slow)])
def test_a_step_of_the_rate_costs_neither_bias_nor_u(x, rate):
    gyro, codes = stepped(60, 0.61, rate=rate, x=x, periods=30.3)
    found, at_rest = estimate(gyro, codes), estimate(*stepped(60, 0.61, x=x, periods=30.3))
    assert flag_names(int(found.flags)) == ["rate_wander"]
    assert abs(float(found.lock_in_rate) - gyro.lock_in_rate) < 4 * float(found.lock_in_rate_u)
    # the faster part knows the ratio less well
    assert float(found.lock_in_rate_u) < 1.5 * rate * float(at_rest.lock_in_rate_u)


def test_a_step_of_the_time_base_is_told_from_one_of_the_rate():
    gyro, codes = stepped(61, 0.22, time_base=1.5)
    found = estimate(gyro, codes)
    assert "parts_differ" in flag_names(int(found.flags))
    # the mean of the record is not the lock-in rate, and u knows it
    away = float(found.lock_in_rate) / gyro.lock_in_rate - 1
    assert away > 0.2
    assert float(found.lock_in_rate_low_95) < gyro.lock_in_rate < 1.5 * gyro.lock_in_rate
    assert float(found.lock_in_rate_high_95) > 1.5 * gyro.lock_in_rate


def test_where_the_record_does_not_decide_u_holds_both():
    gyro, codes = stepped(62, 0.22, time_base=1.05, x=10.0, periods=8.3, noise=2.0)
    found = estimate(gyro, codes)
    assert flag_names(int(found.flags)) == ["rate_wander"]
    assert float(found.lock_in_rate_u) > 0.5 * abs(float(found.lock_in_rate) - gyro.lock_in_rate)
    assert float(found.misfit_u) > 0.015 * float(found.ratio)


def test_a_swing_is_no_step():
    rng = np.random.default_rng(63)
    phase = 2 * np.pi * (20 * step_times()[::8] + np.sin(4 * np.pi * step_times()[::8]) / 4)
    values = 90 * np.sin(phase) + rng.normal(size=(1, N_SAMPLES))
    fit = fit_smooth_phase(values - values.mean(), np.ones_like(values))
    assert fit.moves[0] > 1e4 and fit.stepped_u[0] == 0 and not fit.stretched[0]
