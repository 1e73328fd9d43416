import numpy as np
import pytest

from analysis import earth_rate_on_axis, rate_on_axis, tilt_from_fast_run


def test_the_papers_plus_minus_13_degrees_per_hour():
    azimuth = np.linspace(0, 360, 721)
    swing = 3600 * earth_rate_on_axis(28.2, 88.693, azimuth)
    assert (swing.max() - swing.min()) / 2 == pytest.approx(13.25, abs=0.01)


def test_earth_rate_at_the_pole_and_at_the_equator():
    assert float(earth_rate_on_axis(90, 0, 0)) * 3600 == pytest.approx(15.041067)
    assert float(earth_rate_on_axis(0, 90, 0)) * 3600 == pytest.approx(15.041067)
    assert float(earth_rate_on_axis(0, 90, 90)) == pytest.approx(0, abs=1e-12)


def test_the_tilt_comes_back_from_runs_in_both_senses():
    """Hand-made beats of a gyro with K = 2000: the earth adds to one run and subtracts from the other."""
    table = np.array([100.0, -100.0])
    beats = 2000 * np.abs(rate_on_axis(table, 88.693, 28.2, 40.0))
    tilt, tilt_u = tilt_from_fast_run(beats, [0.5, 0.5], table, 2000)
    assert tilt == pytest.approx(88.693, abs=1e-6)
    # 0.5 Hz of 200 kHz, two runs, over sin(tilt).
    assert tilt_u == pytest.approx(np.rad2deg(0.5 / 2e5 / np.sqrt(2)), rel=1e-2)


def test_a_beat_faster_than_the_table_is_refused():
    with pytest.raises(ValueError, match="scale factor"):
        tilt_from_fast_run([250_000.0], [1.0], [100.0], 2000)
