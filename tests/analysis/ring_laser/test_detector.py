"""Detector and bench of the simulated gyro, against filters and integrals worked out step by step."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from analysis.lockin_equation import rate_varying_beat
from analysis.ring_laser import Detector, Gyro, axis_rate_on_table, beat_phase_on_table, beat_signal_on_table
from instrument.simulated.controllers import TableMotion

# the axis is that of the table, and there is no earth rate on the equator: the table's rate is the gyro's
GYRO = Gyro(
    scale_factor=2000.0, lock_in_rate=0.01, backscatter_phase=0.6, tilt_deg=0.0, latitude_deg=0.0, start_phase=0.3
)
TURNING = (TableMotion(0.0, 10.0, 0.08),)


def one_pole(volts: np.ndarray, corner_hz: float, step: float) -> np.ndarray:
    """The trapezoidal rule on y' = 2 pi corner (x - y)."""
    x = math.pi * corner_hz * step
    start = volts[: len(volts) // 4].mean()
    filtered = lfilter([x / (1 + x)] * 2, [1, (x - 1) / (1 + x)], volts - start)
    return filtered + start


@pytest.mark.parametrize("rate", [0.08, -0.08, 0.015])
@pytest.mark.parametrize("kind", ["low pass", "AC coupling"])
def test_filters_do_what_a_filter_does_to_the_samples(rate: float, kind: str) -> None:
    step, corner = 1e-6, 300.0 if kind == "low pass" else 60.0
    motion = (TableMotion(0.0, 10.0, rate),)
    plain = Detector(readout_phase=0.35, amplitude=0.4, offset=0.1, second_order=0.02)
    # enough of the past for the filter to have forgotten its start
    times = np.arange(160_000) * step
    before = beat_signal_on_table(GYRO, plain, motion, times)
    slow = one_pole(before, corner, step)
    expected = slow if kind == "low pass" else before - slow
    filtered = replace(plain, **{"low_pass_hz" if kind == "low pass" else "ac_corner_hz": corner})
    seen = beat_signal_on_table(GYRO, filtered, motion, times)
    assert np.abs(seen - before).max() > 0.05
    assert np.abs(seen - expected)[120_000:].max() < 2e-5


def test_a_filter_that_lets_everything_through_changes_nothing() -> None:
    plain = Detector(readout_phase=0.35, amplitude=0.4, offset=0.1, second_order=0.02, third_order=0.01)
    times = np.arange(2500) * 4e-5
    wide = beat_signal_on_table(GYRO, replace(plain, low_pass_hz=1e12), TURNING, times)
    assert np.abs(wide - beat_signal_on_table(GYRO, plain, TURNING, times)).max() < 2e-8


def test_a_locked_gyro_behind_a_filter_is_a_constant() -> None:
    resting = (TableMotion(0.0, 0.0, 0.005),)
    times = np.linspace(0, 1, 50)
    coupled = Detector(readout_phase=0.35, offset=0.1, ac_corner_hz=10.0)
    assert np.ptp(beat_signal_on_table(GYRO, coupled, resting, times)) == 0.0
    assert beat_signal_on_table(GYRO, coupled, resting, times)[0] == 0.0
    slow = replace(coupled, ac_corner_hz=0.0, low_pass_hz=10.0)
    assert beat_signal_on_table(GYRO, slow, resting, times)[0] == pytest.approx(
        0.1 + math.sin(math.asin(0.5) - 0.6 + 0.35)
    )


@pytest.mark.parametrize(("order", "dbc"), [(2, -46.0), (3, -60.0)])
def test_distortion_has_its_level_below_a_pure_beat(order: int, dbc: float) -> None:
    free = replace(GYRO, lock_in_rate=0.0)
    level = 10 ** (dbc / 20)
    detector = Detector(
        0.0, amplitude=0.4, **({"second_order": 2 * level} if order == 2 else {"third_order": 4 * level})
    )
    # 16 periods of 160 Hz, whole
    volts = beat_signal_on_table(free, detector, TURNING, np.arange(2560) / 25600)
    lines = np.abs(np.fft.rfft(volts)) / 1280
    assert 20 * math.log10(lines[16 * order] / lines[16]) == pytest.approx(dbc, abs=0.03)


def test_a_swinging_rate_swings_the_beat_as_the_lock_in_equation_says() -> None:
    step = 2e-5
    gyro = replace(GYRO, ripple_dps=0.008, ripple_hz=1.3)
    times = np.arange(50_001) * step
    rates = axis_rate_on_table(gyro, TURNING, times[:-1] + step / 2)
    assert rates.max() == pytest.approx(0.088, abs=1e-6)
    assert rates.min() == pytest.approx(0.072, abs=1e-6)
    _, phases = beat_phase_on_table(gyro, TURNING, times)
    by_trapezoid = 2 * math.pi * 2000 * np.cumsum(np.sqrt(rates**2 - 0.01**2)) * step
    assert np.abs(phases[1:] - phases[0] - by_trapezoid).max() < 1e-5
    ratio = math.tan(math.asin(0.01 / 0.08) / 2)
    start = 1j * (ratio - np.exp(0.3j)) / (1 - ratio * np.exp(0.3j))
    expected = rate_varying_beat(
        rates,
        step,
        scale_factor=2000.0,
        lock_in_rate=0.01,
        initial_phase=float(np.angle(start)) - 0.6,
        backscatter_phase=0.6,
        readout_phase=0.35,
    )
    # r follows the rate with a lag of about ripple / beat frequency: this much is left
    assert np.abs(beat_signal_on_table(gyro, Detector(0.35), TURNING, times) - expected).max() < 2e-3


def test_a_drifting_scale_factor_moves_the_beat_and_nothing_else() -> None:
    gyro = replace(GYRO, scale_factor_drift_ppm_per_hour=500.0, tilt_deg=60.0, latitude_deg=40.0)
    steady = replace(gyro, scale_factor_drift_ppm_per_hour=0.0)
    times = np.linspace(0.0, 7200.0, 200_001)
    rates, phases = beat_phase_on_table(gyro, TURNING, times)
    cycles = 2000 * np.sqrt(rates**2 - 0.01**2) * (1 + 500e-6 * times / 3600)
    by_trapezoid = 2 * math.pi * np.concatenate([[0], np.cumsum((cycles[1:] + cycles[:-1]) / 2 * np.diff(times))])
    assert np.abs(phases - phases[0] - by_trapezoid).max() < 1e-3
    assert phases[-1] - beat_phase_on_table(steady, TURNING, times)[1][-1] > 1000


def test_the_pump_makes_sidebands_of_half_its_share() -> None:
    free = replace(GYRO, lock_in_rate=0.0)
    swinging = Detector(0.0, amplitude=0.4, pump_ripple=0.1, pump_hz=30.0)
    volts = beat_signal_on_table(free, swinging, TURNING, np.arange(25600) / 25600)
    lines = np.abs(np.fft.rfft(volts)) / 12800
    assert lines[[130, 160, 190]] == pytest.approx([0.02, 0.4, 0.02], abs=1e-6)
