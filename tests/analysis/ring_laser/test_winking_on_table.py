"""A simulated laser with slow gain, against its equations integrated step by step in time."""

import math
from dataclasses import replace

import numpy as np
import pytest
from laser_fields import integrated_fields
from scipy.integrate import solve_ivp

from analysis import fit_harmonics
from analysis.ring_laser import Detector, Gyro, Winking, beat_signal_on_table, symmetric_laser
from instrument.simulated.controllers import TableMotion

K, LOCK_IN, CORNER, XI, EPS = 2000.0, 0.01, 300.0, 0.6, 1.0
WINKING = Winking(K, LOCK_IN, gain_corner_hz=CORNER, phase_sum=EPS, cross_saturation=XI)
GYRO = Gyro(K, LOCK_IN, backscatter_phase=0.6, tilt_deg=0.0, latitude_deg=0.0, start_phase=0.3, winking=WINKING)
DETECTOR = Detector(readout_phase=0.35, amplitude=0.4, offset=0.1)


def integrated(rate: float, single_beams: float, times: np.ndarray) -> np.ndarray:
    """The semiclassical equations in their textbook form, and what the detector sees."""
    a = math.pi * K * LOCK_IN / math.cos(EPS / 2)
    g = 2 * math.pi * CORNER

    def slopes(_: float, state: np.ndarray) -> list[float]:
        i1, i2, psi = state
        q = math.sqrt(i2 / i1)
        gain1 = g * (1 - (i1 + XI * i2) / (1 + XI)) + 2 * a * q * math.cos(psi + EPS / 2)
        gain2 = g * (1 - (i2 + XI * i1) / (1 + XI)) + 2 * a / q * math.cos(psi - EPS / 2)
        turned = 2 * math.pi * K * rate - a / q * math.sin(psi - EPS / 2) - a * q * math.sin(psi + EPS / 2)
        return [i1 * gain1, i2 * gain2, turned]

    settled = 0.1
    shifted = times - times[0] + settled
    done = solve_ivp(slopes, (0, shifted[-1]), [1.0, 1.0, 0.0], t_eval=shifted, rtol=1e-10, atol=1e-12)
    i1, i2, psi = done.y
    light = (i1 + i2) / 2
    return 0.1 + 0.4 * (np.sqrt(i1 * i2) * np.sin(psi - 0.6 + 0.35) + single_beams * (light - light.mean()))


def seen(volts: np.ndarray, step: float) -> tuple[float, complex, float]:
    """Beat frequency, complex ratio of the first two harmonics, offset."""
    fit = fit_harmonics(volts, step, harmonics=6)
    first, second = fit.amplitudes[:2]
    return float(fit.frequency), complex(second * abs(first) / first**2), float(fit.offset)


@pytest.mark.slow
@pytest.mark.parametrize("rate", [0.03, -0.03, 0.2, -0.2])
@pytest.mark.parametrize("single_beams", [0.0, 1.2])
def test_the_beat_is_that_of_the_integrated_equations(rate: float, single_beams: float) -> None:
    step = 10.0 / (K * abs(rate)) / 2500 * 2
    times = np.arange(2500) * step
    detector = replace(DETECTOR, single_beams=single_beams)
    simulated = beat_signal_on_table(GYRO, detector, (TableMotion(0.0, 0.0, rate),), times)
    expected = integrated(rate, single_beams, times)
    frequency, ratio, offset = seen(simulated, step)
    expected_frequency, expected_ratio, expected_offset = seen(expected, step)
    assert frequency == pytest.approx(expected_frequency, rel=2e-7)
    assert abs(ratio - expected_ratio) < 2e-6
    assert offset == pytest.approx(expected_offset, abs=1e-4)
    # far from what the lock-in equation alone would give
    plain = beat_signal_on_table(GYRO.without_winking(), detector, (TableMotion(0.0, 0.0, rate),), times)
    assert abs(ratio - seen(plain, step)[1]) > 0.1 * abs(ratio)


def test_the_detector_sees_more_of_the_stronger_beam() -> None:
    """Beams as unequal as none are, against their fields in time."""
    of, rate, step = {"beam_imbalance": 0.4, "gain_dispersion": 0.1}, 0.2, 1e-5
    laser = symmetric_laser(
        LOCK_IN, scale_factor=K, gain_corner_hz=CORNER, phase_sum=EPS, cross_saturation=XI, **of
    )
    first, second = integrated_fields(laser, rate, 2500 * step, 2500)
    light = 0.7 * np.abs(first) ** 2 + 0.3 * np.abs(second) ** 2
    expected = (first * np.conj(second) * np.exp(0.35j - 0.6j)).imag + 1.2 * light
    gyro = replace(GYRO, winking=replace(WINKING, **of))
    turning, times = (TableMotion(0.0, 0.0, rate),), np.arange(2500) * step
    seen_ratio = seen(beat_signal_on_table(gyro, replace(DETECTOR, single_beams=1.2), turning, times), step)[1]
    assert abs(seen_ratio - seen(expected, step)[1]) < 1e-5


def test_fast_gain_is_the_lock_in_equation_behind_one_pole() -> None:
    fast = replace(GYRO, winking=replace(WINKING, gain_corner_hz=2e4))
    times = np.arange(2500) * 4e-5
    turning = (TableMotion(0.0, 0.0, 0.08),)
    frequency, ratio, _ = seen(beat_signal_on_table(fast, DETECTOR, turning, times), 4e-5)
    plain_frequency, plain, _ = seen(beat_signal_on_table(GYRO.without_winking(), DETECTOR, turning, times), 4e-5)
    assert frequency == pytest.approx(plain_frequency, rel=5e-6)
    assert ratio * (1 + 1j * frequency / 2e4) == pytest.approx(plain, abs=2e-6)


def test_behind_a_filter_the_second_harmonic_falls_once_more() -> None:
    times = np.arange(2500) * 4e-5
    turning = (TableMotion(0.0, 0.0, 0.2),)
    _, ratio, _ = seen(beat_signal_on_table(GYRO, DETECTOR, turning, times), 4e-5)
    frequency, filtered, _ = seen(
        beat_signal_on_table(GYRO, replace(DETECTOR, low_pass_hz=800.0), turning, times), 4e-5
    )
    first, second = 1 + 1j * frequency / 800, 1 + 2j * frequency / 800
    assert filtered / ratio == pytest.approx(first**2 / abs(first) / second, abs=1e-6)
