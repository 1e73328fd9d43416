"""The detector's signal and its noise as the oscilloscope looks at them: few points tell the smooth part."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline
from scipy.signal import bilinear, lfilter

from analysis.ring_laser import (
    Detector,
    Gyro,
    NoisySignal,
    beat_phase_on_table,
    beat_signal_on_table,
    signal_above,
    signal_bounds,
    smooth_interval,
)
from instrument.simulated.controllers import TableMotion

GYRO = Gyro(2000.0, 0.01, 0.6, 88.7, 28.2, start_phase=1.0)
DETECTOR = Detector(0.35, amplitude=0.4)


@pytest.mark.parametrize(
    ("gyro", "detector", "rate"),
    [
        (GYRO, DETECTOR, 3.5),
        (GYRO, DETECTOR, 50.0),
        (GYRO, DETECTOR, -3.5),
        (GYRO, DETECTOR, 1.2),
        (replace(GYRO, ripple_dps=0.002, ripple_hz=3.0), DETECTOR, 3.5),
        (GYRO, replace(DETECTOR, second_order=0.02, third_order=0.04), 3.5),
        (GYRO, replace(DETECTOR, low_pass_hz=2e3, ac_corner_hz=1.0), 3.5),
        (GYRO, replace(DETECTOR, pump_ripple=0.02, pump_hz=100.0), 3.5),
    ],
)
def test_between_points_at_the_interval_the_signal_is_a_polynomial(gyro, detector, rate):
    motion = (TableMotion(0.0, 40.0, rate),)
    interval = smooth_interval(gyro, detector, motion, 20.0, 20.2)
    assert interval > 0
    grid = 20.0 + interval * np.arange(400)
    between = make_interp_spline(grid, beat_signal_on_table(gyro, detector, motion, grid), k=5)
    times = np.linspace(grid[10], grid[-10], 5001)
    error = between(times) - beat_signal_on_table(gyro, detector, motion, times)
    assert np.abs(error).max() < 1e-4 * detector.amplitude


def test_where_the_gyro_locks_and_unlocks_no_interval_is_known():
    passing = (TableMotion(0.0, 0.0, 50.0), TableMotion(1.0, 50.0, 50.0, -100.0), TableMotion(2.0, 50.0, -50.0))
    assert smooth_interval(GYRO, DETECTOR, passing, 0.5, 0.9) > 0
    assert smooth_interval(GYRO, DETECTOR, passing, 0.5, 1.1) == 0
    assert smooth_interval(GYRO, DETECTOR, (TableMotion(0.0, 0.0, 0.3),), 0.0, 1.0) == 0


def test_light_without_a_beat_is_followed_as_it_swings():
    dark = replace(DETECTOR, amplitude=0.0, offset=0.3, pump_ripple=0.02, pump_hz=100.0)
    assert 1 / 2000 < smooth_interval(GYRO, dark, (TableMotion(0.0, 40.0, 3.5),), 20.0, 20.2) < 1 / 500


@pytest.mark.parametrize("rate", [3.5, -50.0, 1.2])
@pytest.mark.parametrize(
    "detector",
    [
        DETECTOR,
        replace(DETECTOR, offset=0.3, second_order=0.02, third_order=0.04),
        replace(DETECTOR, offset=0.3, low_pass_hz=2e3, ac_corner_hz=1.0, pump_ripple=0.02, pump_hz=100.0),
    ],
)
def test_the_signal_does_not_leave_its_bounds(detector, rate):
    motion = (TableMotion(0.0, 40.0, 0.0), TableMotion(1.0, 40.0, rate))
    low, high = signal_bounds(GYRO, detector, motion, 2.0, 400.0)
    volts = beat_signal_on_table(GYRO, detector, motion, np.random.default_rng(1).uniform(2.0, 400.0, 20_000))
    assert low <= volts.min() and volts.max() <= high
    assert high - low < 1.6 * np.ptp(volts)


def test_bounds_are_not_known_where_the_gyro_may_lock_or_the_table_slews():
    passing = (TableMotion(0.0, 0.0, 50.0), TableMotion(1.0, 50.0, 50.0, -100.0), TableMotion(2.0, 50.0, -50.0))
    assert np.isfinite(signal_bounds(GYRO, DETECTOR, passing, 0.5, 0.9)).all()
    assert np.isinf(signal_bounds(GYRO, DETECTOR, passing, 0.5, 1.1)).all()
    assert np.isinf(signal_bounds(GYRO, DETECTOR, (TableMotion(0.0, 0.0, 0.3),), 0.0, 1.0)).all()
    low, high = signal_bounds(GYRO, DETECTOR, (TableMotion(0.0, 0.0, 0.0),), 0.0, 1.0)
    assert low == high == beat_signal_on_table(GYRO, DETECTOR, (TableMotion(0.0, 0.0, 0.0),), np.zeros(1))[0]


@pytest.mark.parametrize("ripple_hz", [0.0, 5.0, 200.0])
@pytest.mark.parametrize("spacing", [1e-7, 4e-5, 2e-3])
def test_phase_of_many_samples_is_that_of_each_alone(ripple_hz, spacing):
    gyro = replace(GYRO, ripple_dps=0.003 if ripple_hz else 0.0, ripple_hz=ripple_hz)
    motion = (TableMotion(0.0, 0.0, 0.0), TableMotion(10.0, 40.0, 3.5))
    times = 5000.0 + spacing * np.arange(2500)
    rates, phases = beat_phase_on_table(gyro, motion, times)
    some = np.arange(0, 2500, 229)
    alone = [beat_phase_on_table(gyro, motion, times[i : i + 1]) for i in some]
    # the phase of the ripple is a million turns in doubles, that of the beat five million rad
    assert rates[some] == pytest.approx([float(rate[0]) for rate, _ in alone], abs=1e-11)
    assert phases[some] == pytest.approx([float(phase[0]) for _, phase in alone], abs=2e-8)


def test_smooth_part_and_noise_make_the_signal():
    noisy = NoisySignal(np.sin, 0.1, seed=3)
    times = np.linspace(0.0, 1.0, 500)
    assert np.array_equal(noisy(times), np.sin(times) + noisy.noise(times))
    assert noisy.noise(times).std() == pytest.approx(0.1, rel=0.1)


@pytest.mark.parametrize(
    ("gyro", "detector", "rate"),
    [
        (GYRO, DETECTOR, 3.5),
        (GYRO, replace(DETECTOR, offset=1.0), -3.5),
        (GYRO, replace(DETECTOR, ac_corner_hz=1.0, low_pass_hz=2e3), 3.5),
        (replace(GYRO, ripple_dps=2e-5, ripple_hz=1.0), replace(DETECTOR, pump_ripple=5e-4, pump_hz=150.0), 3.5),
    ],
)
def test_what_an_ac_coupling_makes_of_the_beat_is_what_a_filter_makes_of_it(gyro, detector, rate):
    motion, per_second = (TableMotion(0.0, 40.0, rate),), 50e3
    times = 20.0 + np.arange(30_000) / per_second
    above = signal_above(gyro, detector, motion, 10.0, times[0], times[-1])
    whole = beat_signal_on_table(gyro, detector, motion, times)
    time_constant = 1 / (2 * np.pi * 10.0)
    filtered = lfilter(*bilinear([time_constant, 0], [time_constant, 1], per_second), whole - whole.mean())
    settled = times > 20.4
    assert np.abs(above(times) - filtered)[settled].max() < 5e-4 * detector.amplitude


@pytest.mark.parametrize(
    ("gyro", "detector", "motion"),
    [
        (GYRO, replace(DETECTOR, pump_ripple=0.02, pump_hz=150.0), (TableMotion(0.0, 40.0, 3.5),)),
        (replace(GYRO, ripple_dps=0.01, ripple_hz=3.0), DETECTOR, (TableMotion(0.0, 40.0, 3.5),)),
        (GYRO, DETECTOR, (TableMotion(0.0, 40.0, 3.5), TableMotion(20.1, 0.0, 5.0))),
        (GYRO, DETECTOR, (TableMotion(0.0, 40.0, 0.2),)),
    ],
    ids=["light swings", "rate swings", "table changes its rate", "locked"],
)
def test_what_an_ac_coupling_makes_of_other_beats_is_not_known(gyro, detector, motion):
    assert signal_above(gyro, detector, motion, 10.0, 20.0, 20.2) is None
