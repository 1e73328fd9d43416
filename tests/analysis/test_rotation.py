import numpy as np
import pytest

from analysis import earth_rate_on_axis


def test_the_papers_plus_minus_13_degrees_per_hour():
    azimuth = np.linspace(0, 360, 721)
    swing = 3600 * earth_rate_on_axis(28.2, 88.693, azimuth)
    assert (swing.max() - swing.min()) / 2 == pytest.approx(13.25, abs=0.01)


def test_earth_rate_at_the_pole_and_at_the_equator():
    assert float(earth_rate_on_axis(90, 0, 0)) * 3600 == pytest.approx(15.041067)
    assert float(earth_rate_on_axis(0, 90, 0)) * 3600 == pytest.approx(15.041067)
    assert float(earth_rate_on_axis(0, 90, 90)) == pytest.approx(0, abs=1e-12)
