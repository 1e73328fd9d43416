"""The mean of many stretches of a beat against the mean of each of them."""

from dataclasses import replace

import numpy as np
import pytest

from analysis.ring_laser import Detector, Gyro, Winking, beat_signal_on_table, mean_beat_on_table, signal_above
from instrument.simulated.controllers import TableMotion

GYRO = Gyro(2000.0, 0.01, 0.6, 88.7, 28.2, start_phase=1.0, ripple_dps=2e-5, ripple_hz=1.0)
WINKING = replace(GYRO, winking=Winking(2000.0, 0.01, gain_corner_hz=3000.0, phase_sum=0.0, cross_saturation=0.5))
DETECTOR = Detector(0.35, amplitude=0.4, offset=0.1, second_order=0.006, pump_ripple=5e-4, pump_hz=150.0)


@pytest.mark.parametrize("corner_hz", [0.0, 10.0])
@pytest.mark.parametrize(("gyro", "rate"), [(GYRO, 3.5), (GYRO, -3.5), (WINKING, 3.5)])
@pytest.mark.parametrize("span", [0.01, 0.5])
def test_the_mean_of_many_stretches_is_that_of_each(gyro, rate, span, corner_hz):
    motion, times = (TableMotion(0.0, 40.0, rate),), np.linspace(0.0, span, 500)
    starts = 50.0 + np.cumsum(np.random.default_rng(3).uniform(span, span + 0.006, 40))
    mean = mean_beat_on_table(gyro, DETECTOR, motion, starts, times, corner_hz=corner_hz, settling_s=0.1)
    each = signal_above(gyro, DETECTOR, motion, corner_hz, 49.0, starts[-1] + span) if corner_hz else None
    if each is None:
        each = lambda when: beat_signal_on_table(gyro, DETECTOR, motion, when)  # noqa: E731
    expected = np.mean([each(start + times) for start in starts], axis=0)
    assert np.abs(mean - expected).max() < 1e-3 * DETECTOR.amplitude


@pytest.mark.parametrize(
    ("detector", "motion"),
    [
        (replace(DETECTOR, pump_ripple=0.02), (TableMotion(0.0, 40.0, 3.5),)),
        (DETECTOR, (TableMotion(0.0, 40.0, 3.5), TableMotion(50.1, 0.0, 5.0))),
        (DETECTOR, (TableMotion(0.0, 40.0, 0.2),)),
    ],
    ids=["light swings", "table changes its rate", "locked"],
)
def test_the_mean_of_other_stretches_is_not_known(detector, motion):
    starts = 50.0 + 0.02 * np.arange(20)
    assert mean_beat_on_table(GYRO, detector, motion, starts, np.linspace(0.0, 0.01, 100)) is None
