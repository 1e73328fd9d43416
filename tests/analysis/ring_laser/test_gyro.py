"""The beat on a turning table, against the lock-in equation integrated step by step."""

import math

import numpy as np
import pytest

from analysis.lockin_equation import rate_varying_beat
from analysis.ring_laser import Detector, Gyro, NoisySignal, axis_rate_on_table, beat_signal_on_table
from instrument.simulated.controllers import TableMotion

GYRO = Gyro(
    scale_factor=2000.0,
    lock_in_rate=0.01,
    backscatter_phase=0.6,
    tilt_deg=88.693,
    latitude_deg=28.2,
    start_phase=0.3,
)
DETECTOR = Detector(readout_phase=0.35)
SLOW = 0.08 / math.cos(math.radians(88.693))


def start_phase_of_equation(gyro: Gyro, rate: float) -> float:
    """phi(0) of the lock-in equation that belongs to psi(0), by the angles of the exact solution."""
    if abs(rate) <= gyro.lock_in_rate:
        return math.asin(rate / gyro.lock_in_rate) - gyro.backscatter_phase
    x = gyro.lock_in_rate / abs(rate)
    r = math.tan(math.asin(x) / 2)
    u = np.exp(1j * math.copysign(gyro.start_phase, rate))
    z = 1j * (r - u) / (1 - r * u)
    return float(np.angle(z if rate > 0 else np.conj(z))) - gyro.backscatter_phase


@pytest.mark.parametrize(("table_rate", "tolerance"), [(SLOW, 1e-6), (-SLOW, 1e-6), (0.0, 1e-9), (0.05, 1e-5)])
def test_beat_follows_the_lock_in_equation_while_the_earth_turns_under_it(
    table_rate: float, tolerance: float
) -> None:
    step = 4e-5
    motion = (TableMotion(0.0, 10.0, table_rate),)
    times = np.arange(5001) * step
    rates = axis_rate_on_table(GYRO, motion, times[:-1] + step / 2)
    expected = rate_varying_beat(
        rates,
        step,
        scale_factor=2000.0,
        lock_in_rate=0.01,
        initial_phase=start_phase_of_equation(GYRO, float(axis_rate_on_table(GYRO, motion, times[:1])[0])),
        backscatter_phase=0.6,
        readout_phase=0.35,
    )
    assert np.abs(beat_signal_on_table(GYRO, DETECTOR, motion, times) - expected).max() < tolerance


def test_rate_on_the_axis_swings_by_the_papers_13_deg_per_hour() -> None:
    quarter_turns = np.arange(5) * 90.0 / SLOW
    rates = axis_rate_on_table(GYRO, (TableMotion(0.0, 0.0, SLOW),), quarter_turns)
    assert (rates[0] - rates[2]) / 2 * 3600 == pytest.approx(13.25, abs=0.005)
    assert rates[4] == pytest.approx(rates[0])
    assert rates[1] == pytest.approx(0.08 + 15.041067 / 3600 * math.sin(math.radians(28.2)) * SLOW_COSINE)


SLOW_COSINE = math.cos(math.radians(88.693))


def test_the_phase_after_a_day_is_the_one_of_a_sum_over_whole_turns() -> None:
    turn = 360.0 / SLOW
    motion = (TableMotion(0.0, 0.0, SLOW),)
    azimuth = np.linspace(0, 360, 20001)
    rates = GYRO.axis_rate(np.full(azimuth.size, SLOW), azimuth)
    cycles = np.trapezoid(2000 * np.sqrt(rates**2 - 0.01**2), azimuth) / SLOW
    turns = 800  # 23 hours
    times = turns * turn + np.arange(50) * 1e-4
    shifted = Gyro(**{**vars(GYRO), "start_phase": GYRO.start_phase + 2 * math.pi * ((turns * cycles) % 1.0)})
    late = beat_signal_on_table(GYRO, DETECTOR, motion, times)
    early = beat_signal_on_table(shifted, DETECTOR, motion, times - turns * turn)
    assert np.abs(late - early).max() < 2e-4


def test_the_beat_has_no_jump_where_the_table_changes_its_rate() -> None:
    slew = 0.035
    acceleration = (SLOW - 50.0) / slew
    motion = (
        TableMotion(0.0, 0.0, 50.0),
        TableMotion(1.0, 50.0, 50.0, acceleration),
        TableMotion(1.0 + slew, 50.0 + slew * (50 + SLOW) / 2, SLOW),
    )
    for edge in (1.0, 1.0 + slew):
        times = edge + np.array([-1e-9, 0.0, 1e-9])
        volts = beat_signal_on_table(GYRO, DETECTOR, motion, times)
        assert np.ptp(volts) < 1e-4


def test_a_locked_gyro_gives_a_constant() -> None:
    times = np.linspace(0.0, 1.0, 100)
    volts = beat_signal_on_table(GYRO, DETECTOR, (TableMotion(0.0, 0.0, 0.0),), times)
    rate = float(axis_rate_on_table(GYRO, (TableMotion(0.0, 0.0, 0.0),), times[:1])[0])
    assert 0.003 < rate < 0.004
    assert np.ptp(volts) == 0.0
    assert volts[0] == pytest.approx(math.sin(math.asin(rate / 0.01) - 0.6 + 0.35))


def test_a_gyro_without_lock_in_gives_a_pure_sine() -> None:
    free = Gyro(**{**vars(GYRO), "lock_in_rate": 0.0, "latitude_deg": 90.0, "tilt_deg": 90.0 - 1e-9})
    times = np.arange(1000) * 1e-4
    volts = beat_signal_on_table(free, DETECTOR, (TableMotion(0.0, 0.0, 0.0),), times)
    assert np.ptp(volts) < 1e-6
    assert free.harmonic_ratio(np.array([0.0, 0.1])).tolist() == [0.0, 0.0]


def test_detector_noise_is_the_same_for_the_same_samples_and_seed() -> None:
    def silent(times: np.ndarray) -> np.ndarray:
        return np.zeros_like(times)

    times = 5.0 + np.arange(20000) * 1e-4
    noisy = NoisySignal(silent, 0.01, 3, 0)
    assert np.array_equal(noisy(times), noisy(times))
    assert not np.array_equal(noisy(times), NoisySignal(silent, 0.01, 4, 0)(times))
    assert not np.array_equal(noisy(times), noisy(times + 1e-4))
    assert np.array_equal(noisy(times + 2e-9), noisy(times + 1e-8))
    assert not np.array_equal(noisy(times), NoisySignal(silent, 0.01, 3, 1)(times))
    assert noisy(times).std() == pytest.approx(0.01, rel=0.03)
    assert noisy(np.empty(0)).size == 0
