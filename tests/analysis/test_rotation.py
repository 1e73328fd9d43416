import numpy as np
import pytest

from analysis import beat_frequency, earth_rate_on_axis, estimate_lock_in, rate_on_axis, rate_varying_beat
from analysis.rotation import EARTH_RATE_DPS, tilt_from_fast_runs


def vector_rate(time, table, tilt, latitude, start):
    """Rate on the axis by turning a vector in the laboratory (north, east, up) with the table."""
    azimuth, lean = np.deg2rad(start + table * time), np.deg2rad(tilt)
    axis = np.array([np.sin(lean) * np.cos(azimuth), np.sin(lean) * np.sin(azimuth), np.cos(lean)])
    earth = EARTH_RATE_DPS * np.array([np.cos(np.deg2rad(latitude)), 0.0, np.sin(np.deg2rad(latitude))])
    return float(axis @ (earth + np.array([0.0, 0.0, table])))


def test_the_rate_on_the_axis_is_that_of_a_turned_vector():
    times = np.linspace(0, 20, 17)
    ours = rate_on_axis(-7.0, 70.0, 40.0, 33.0 - 7.0 * times)
    np.testing.assert_allclose(ours, [vector_rate(t, -7.0, 70.0, 40.0, 33.0) for t in times], rtol=1e-12)


def test_the_papers_plus_minus_13_degrees_per_hour():
    azimuth = np.linspace(0, 360, 721)
    swing = 3600 * earth_rate_on_axis(28.2, 88.693, azimuth)
    assert (swing.max() - swing.min()) / 2 == pytest.approx(13.25, abs=0.01)


def test_earth_rate_at_the_pole_and_at_the_equator():
    assert float(earth_rate_on_axis(90, 0, 0)) * 3600 == pytest.approx(15.041067)
    assert float(earth_rate_on_axis(0, 90, 0)) * 3600 == pytest.approx(15.041067)
    assert float(earth_rate_on_axis(0, 90, 90)) == pytest.approx(0, abs=1e-12)


def test_a_record_on_the_turning_table_has_the_mean_rate():
    """The beat with W(t) by exact steps; its own reference gives W, and the mean over the record says the same."""
    table, start, lock_in, scale = 8.77, -20.0, 0.02, 2000.0
    interval = 2e-3
    middle = (np.arange(2499) + 0.5) * interval
    rate = rate_on_axis(table, 88.693, 28.2, start + table * middle)
    volts = rate_varying_beat(rate, interval, scale_factor=scale / 8, lock_in_rate=lock_in)
    made = estimate_lock_in(volts, interval, scale_factor=scale / 8)
    # A frequency fit weighs the middle of the record more than its ends.
    assert float(made.input_rate) == pytest.approx(float(rate.mean()), rel=4e-4)
    # The earth's swing, ignored, would be an error of over 1 % of W.
    assert abs(float(made.input_rate) / (table * np.cos(np.deg2rad(88.693))) - 1) > 0.005


def runs(table, azimuth, *, tilt=88.693, latitude=28.2, scale=2000.0, lock_in=0.1):
    rates = np.array([vector_rate(0.0, w, tilt, latitude, a) for w, a in zip(table, azimuth, strict=True)])
    return np.asarray(beat_frequency(scale, rates, lock_in))


def test_both_senses_at_known_azimuths_give_the_tilt():
    table, azimuth = np.array([100.0, -100.0]), np.array([40.0, 250.0])
    beats = runs(table, azimuth)
    fit = tilt_from_fast_runs(
        beats, [0.5, 0.5], table, scale_factor=2000.0, latitude_deg=28.2, azimuth_deg=azimuth, lock_in_rate=0.1
    )
    assert fit.tilt_deg == pytest.approx(88.693, abs=1e-7)
    assert fit.tilt_u_deg == pytest.approx(np.rad2deg(0.5 / 2e5 / np.sqrt(2)), rel=0.01)
    assert fit.chi_square < 1e-6 and fit.degrees_of_freedom == 1
    # The senses stand at different azimuths, so the earth rate does not cancel by itself.
    assert abs(fit.earth_rate_part_deg) > 3 * fit.tilt_u_deg
    # Lock-in forgotten: half of (WL/W)^2 of the cosine.
    without = tilt_from_fast_runs(
        beats, [0.5, 0.5], table, scale_factor=2000.0, latitude_deg=28.2, azimuth_deg=azimuth
    )
    assert np.deg2rad(without.tilt_deg - fit.tilt_deg) == pytest.approx(0.5 * 0.1**2 / 2.281 / 100, rel=0.02)


def test_the_tilts_uncertainty_is_that_of_the_scatter():
    rng = np.random.default_rng(1)
    table, tilts, us = np.array([60.0, -60.0, 80.0]), [], []
    for _ in range(300):
        azimuth = rng.uniform(0, 360, 3)
        beats = runs(table, azimuth) + rng.normal(scale=2.0, size=3)
        fit = tilt_from_fast_runs(
            beats, [2.0] * 3, table, scale_factor=2000.0, latitude_deg=28.2, lock_in_rate=0.1
        )
        tilts.append(fit.tilt_deg)
        us.append(fit.tilt_u_deg)
    # Without azimuths the horizontal earth rate is part of the uncertainty: 7.36 Hz at a random phase.
    assert np.std(tilts) == pytest.approx(np.mean(us), rel=0.12)
    assert np.mean(tilts) == pytest.approx(88.693, abs=4 * np.mean(us) / np.sqrt(300))
    known = tilt_from_fast_runs(
        beats, [2.0] * 3, table, scale_factor=2000.0, latitude_deg=28.2, azimuth_deg=azimuth, lock_in_rate=0.1
    )
    assert known.tilt_u_deg < 0.5 * us[-1]


def test_scale_factor_and_table_enter_by_the_cotangent():
    table, azimuth = np.array([100.0, -100.0]), np.zeros(2)
    for tilt in (88.693, 60.0):
        beats = runs(table, azimuth, tilt=tilt, lock_in=0.0)
        fit = tilt_from_fast_runs(
            beats,
            [1e-6, 1e-6],
            table,
            scale_factor=2000.0,
            latitude_deg=28.2,
            azimuth_deg=azimuth,
            scale_factor_u=0.6,
            table_rate_u=4e-4,
        )
        assert np.deg2rad(fit.tilt_u_deg) == pytest.approx(5e-4 / np.tan(np.deg2rad(tilt)), rel=1e-2)


def test_azimuths_known_roughly_do_not_average_out_at_one_rate():
    """Eight records at one rate, all 20 deg past the azimuth given: the error is that of one, and so is u."""
    table, given = np.full(8, 100.0), np.full(8, 70.0)
    beats = runs(table, given + 20.0)
    fit = tilt_from_fast_runs(
        beats,
        [1e-3] * 8,
        table,
        scale_factor=2000.0,
        latitude_deg=28.2,
        azimuth_deg=given,
        azimuth_u_deg=20.0,
        lock_in_rate=0.1,
    )
    horizontal = 15.041067 / 3600 * np.cos(np.deg2rad(28.2))
    assert np.deg2rad(fit.tilt_u_deg) * 100 == pytest.approx(
        horizontal * np.sin(np.deg2rad(70)) * np.deg2rad(20), rel=1e-3
    )
    assert 0.9 < abs(fit.tilt_deg - 88.693) / fit.tilt_u_deg < 1.1


def test_an_upright_axis_has_a_finite_uncertainty():
    beats = runs([50.0, -50.0], [0.0, 0.0], tilt=0.0, lock_in=0.0)
    fit = tilt_from_fast_runs(
        beats, [1.0, 1.0], [50.0, -50.0], scale_factor=2000.0, latitude_deg=28.2, azimuth_deg=[0, 0]
    )
    assert fit.tilt_deg < 0.05
    assert 0.05 < fit.tilt_u_deg < 1.0


def test_impossible_fast_runs_are_refused():
    with pytest.raises(ValueError, match="check the scale factor"):
        tilt_from_fast_runs([250_000.0], [1.0], [100.0], scale_factor=2000.0, latitude_deg=28.2)
    with pytest.raises(ValueError, match="not zero"):
        tilt_from_fast_runs([250.0], [1.0], [0.0], scale_factor=2000.0, latitude_deg=28.2)
    with pytest.raises(ValueError, match="every fast run"):
        tilt_from_fast_runs([250.0, 1.0], [1.0], [1.0], scale_factor=2000.0, latitude_deg=28.2)
