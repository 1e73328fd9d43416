"""Derived constants of a coil, by hand arithmetic."""

import math

import pytest

from analysis.fibre_gyro import FibreCoil, LoopDesign

COIL = FibreCoil(length_m=1000.0, diameter_m=0.10, wavelength_m=1.55e-6, group_index=1.468)


def test_constants_of_a_navigation_grade_coil() -> None:
    # 1468 m/c; 2 pi 100 m^2/(1.55e-6 m c); 2^16 times the latter/360; its inverse in deg/h
    assert COIL.transit_time == pytest.approx(4.8967209e-6, rel=1e-7)
    assert COIL.sagnac_factor == pytest.approx(1.352158, rel=1e-6)
    assert COIL.nominal_scale(16) == pytest.approx(246.152866, rel=1e-9)
    assert 3600 / COIL.nominal_scale(16) == pytest.approx(14.625, abs=5e-4)
    assert math.radians(20.0) * COIL.sagnac_factor == pytest.approx(0.472, abs=5e-4)
    assert COIL.nominal_scale(16) / 2**16 / COIL.transit_time == pytest.approx(767, abs=0.5)  # falls/s per deg/s
    assert COIL.proper_frequency == pytest.approx(102.109e3, rel=1e-5)


def test_scale_follows_length_diameter_and_wavelength_but_not_the_index() -> None:
    twice = FibreCoil(2000.0, 0.1, 1.55e-6, 1.468)
    assert twice.nominal_scale(16) == pytest.approx(2 * COIL.nominal_scale(16))
    assert FibreCoil(1000.0, 0.1, 0.775e-6, 1.468).nominal_scale(16) == pytest.approx(2 * COIL.nominal_scale(16))
    assert FibreCoil(1000.0, 0.1, 1.55e-6, 1.5).nominal_scale(16) == COIL.nominal_scale(16)
    assert COIL.scaled(1.5).nominal_scale(16) == pytest.approx(1.5 * COIL.nominal_scale(16))
    assert COIL.scaled(1.5).transit_time == COIL.transit_time


def test_noise_of_a_detector_sample_gives_the_angle_random_walk_back() -> None:
    """0.005 deg/sqrt(h) is 8.33e-5 deg/sqrt(s); a pair of samples of noise s errs by s/(sqrt(2) A) rad."""
    design = LoopDesign(angle_random_walk_deg_per_sqrt_h=0.005, adc_bits=14)
    pair_rad = design.detector_noise(COIL) / (math.sqrt(2) * 8192)
    rate_dps = math.degrees(pair_rad / 1.352158)
    assert rate_dps * math.sqrt(2 * 4.8967209e-6) == pytest.approx(0.005 / 60, rel=1e-5)


@pytest.mark.parametrize("name", ["length_m", "diameter_m", "wavelength_m", "group_index"])
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_coil_that_cannot_be_is_refused_by_name(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        FibreCoil(**{name: value})
