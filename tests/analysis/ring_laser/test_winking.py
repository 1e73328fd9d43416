import time
from dataclasses import replace

import numpy as np
import pytest
from bench_signals import seen
from laser_fields import integrated_fields

from analysis import fit_harmonics, harmonic_ratio
from analysis.ring_laser import TwoModeLaser, steady_beat, symmetric_laser

K = 2000.0


@pytest.mark.parametrize(
    ("rate", "phase_sum", "unequal", "dispersion"),
    [(0.2, 0.0, 0, 0), (0.2, 1.1, 0, 0), (-0.2, 1.1, -0.3, 0.2), (0.1, 2.1, 0, 0), (0.2, 0.7, 0.2, -0.3)],
)
def test_the_steady_beat_is_that_of_the_fields_in_time(rate, phase_sum, unequal, dispersion):
    laser = TwoModeLaser(K, (200.0, 350.0), phase_sum, 2 * np.pi * 150, 0.6, unequal, dispersion)
    beat = steady_beat(laser, rate)
    duration, n = 12.3 / beat.frequency, 3000
    first, second = integrated_fields(laser, rate, duration, n)
    field = first * np.conj(second)
    middle = beat.beat.size // 2
    fit = fit_harmonics(np.stack([field.imag, np.abs(first) ** 2]), duration / n, harmonics=8)
    assert fit.frequency[0] == pytest.approx(beat.frequency, rel=1e-7)
    made = seen(beat, np.arange(n) * duration / n)
    ours = fit_harmonics(made, duration / n, harmonics=8)
    np.testing.assert_allclose(np.abs(ours.amplitudes), np.abs(fit.amplitudes[0]), atol=1e-6)
    ratio, expected = (c[1] * abs(c[0]) / c[0] ** 2 for c in (ours.amplitudes, fit.amplitudes[0]))
    assert ratio == pytest.approx(expected, abs=1e-6)
    wink = 2 * np.abs(beat.beams[:, middle + 1])
    assert fit.amplitudes[1, 0].__abs__() == pytest.approx(wink[0], rel=1e-5)


@pytest.mark.parametrize(
    ("slowness", "factor"),
    [(0.01, 1.0000), (0.03, 0.9996), (0.1, 0.9950), (0.3, 0.9579), (1, 0.7073), (3, 0.3164), (10, 0.0996)],
)
def test_a_slow_gain_weakens_the_second_harmonic(slowness, factor):
    """Factors found by another integration of the same equations; the phase lag is atan(w/g)."""
    rate, lock_in = 1.0, 0.05
    frequency = K * np.sqrt(rate**2 - lock_in**2)
    laser = symmetric_laser(lock_in, scale_factor=K, gain_corner_hz=frequency / slowness)
    beat = steady_beat(laser, rate)
    middle = beat.beat.size // 2
    first, second = beat.beat[middle + 1 : middle + 3]
    rho = second * abs(first) / first**2
    assert abs(rho) / harmonic_ratio(0.05) == pytest.approx(factor, abs=5e-4)
    # With fast gain the line of exp(i psi) has the phase i (r - u)/(1 - r u): +90 degrees.
    assert np.angle(rho) - np.pi / 2 == pytest.approx(-np.arctan(slowness), abs=1e-3)


def test_dispersion_of_a_fast_gain_is_a_part_of_the_coupling():
    """It adds i h times the other combination of both backscatters, which alone would not lock."""
    lock_in, rate = 0.05, 0.2
    laser = symmetric_laser(
        lock_in, scale_factor=K, gain_corner_hz=1e6, phase_sum=2.0, backscatter_ratio=1.5, gain_dispersion=0.3
    )
    plain = replace(laser, gain_dispersion=0.0)
    assert abs(plain.lock_in_rate / lock_in - 1) > 0.3
    beat = steady_beat(laser, rate)
    middle = beat.beat.size // 2
    assert beat.frequency == pytest.approx(K * np.sqrt(rate**2 - lock_in**2), rel=2e-5)
    ratio = abs(beat.beat[middle + 2] / beat.beat[middle + 1])
    assert ratio == pytest.approx(np.tan(np.arcsin(lock_in / rate) / 2), rel=1e-3)


def test_conservative_coupling_pushes_the_frequency_up():
    """eps = 120 deg, w = g, xi = 0.6: +5.7e-4 where the lock-in equation says -3.1e-4."""
    lock_in = 0.025
    laser = symmetric_laser(
        lock_in, scale_factor=K, gain_corner_hz=K, phase_sum=np.deg2rad(120), cross_saturation=0.6
    )
    assert np.sqrt(1 - lock_in**2) - 1 == pytest.approx(-3.1e-4, abs=0.05e-4)
    assert steady_beat(laser, 1.0).frequency / K - 1 == pytest.approx(5.7e-4, abs=0.05e-4)


def test_the_laser_locks_where_it_says():
    laser = TwoModeLaser(K, (300.0, 200.0), 0.8, 2 * np.pi * 5e4, 0.5)
    assert abs(laser.coupling) == pytest.approx(2 * np.pi * K * laser.lock_in_rate)
    # Strong gain: the threshold is that of the lock-in equation.
    assert steady_beat(laser, 1.01 * laser.lock_in_rate).frequency < 0.2 * K * laser.lock_in_rate
    with pytest.raises(ValueError, match="locked"):
        steady_beat(laser, 0.97 * laser.lock_in_rate)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"gain_rate": 0.0}, "positive"),
        ({"cross_saturation": 1.0}, "cross_saturation"),
        ({"backscatter": (1.0, np.nan)}, "finite"),
        ({"backscatter": (-1.0, 1.0)}, "negative"),
    ],
)
def test_an_impossible_laser_is_refused(change, message):
    good = {
        "scale_factor": K,
        "backscatter": (1.0, 1.0),
        "phase_sum": 0.0,
        "gain_rate": 1e4,
        "cross_saturation": 0.5,
    }
    with pytest.raises(ValueError, match=message):
        TwoModeLaser(**{**good, **change})


@pytest.mark.parametrize("corner", [1e5, 3e5, 1e7])
def test_a_gain_far_faster_than_the_beat_is_quick(corner):
    """A stiff equation: an integrator in time takes many seconds, or never ends."""
    begun = time.perf_counter()
    beat = steady_beat(symmetric_laser(0.01, scale_factor=K, gain_corner_hz=corner, phase_sum=1.0), 0.0806225775)
    assert time.perf_counter() - begun < 2
    middle = beat.beat.size // 2
    first, second = beat.beat[middle + 1 : middle + 3]
    expected = 1j * harmonic_ratio(0.01 / 0.0806225775) / (1 + 1j * beat.frequency / corner)
    assert second * abs(first) / first**2 == pytest.approx(expected, rel=1e-5)
    assert beat.frequency == pytest.approx(160, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(("multiple", "turns"), [(2.0, False), (2.5, True)])
def test_conservative_coupling_locks_beyond_the_lock_in_rate_of_fast_gain(multiple, turns):
    """eps = 143 deg and a difference of the beams that relaxes slowly, against the fields in time."""
    laser = symmetric_laser(0.01, scale_factor=K, gain_corner_hz=1e3, phase_sum=2.5, cross_saturation=0.8)
    first, second = integrated_fields(laser, 0.01 * multiple, 0.4, 4000)
    phase = np.unwrap(np.angle(first * np.conj(second)))
    if turns:
        beat = steady_beat(laser, 0.01 * multiple).frequency
        assert (phase[-1] - phase[0]) / (2 * np.pi) == pytest.approx(0.4 * beat, abs=0.1)
    else:
        assert abs(phase[-1] - phase[0]) < 1
        with pytest.raises(ValueError, match="locked"):
            steady_beat(laser, 0.01 * multiple)


def test_the_light_of_single_beams_adds_little():
    """Contrast 0.8, w/g = 0.1, eps = 86 deg, x = 0.05: the ratio changes by 0.13 % at most."""
    laser = symmetric_laser(
        0.05, scale_factor=K, gain_corner_hz=10 * K, phase_sum=np.deg2rad(86), cross_saturation=0.5
    )
    beat = steady_beat(laser, 1.0)
    times = np.arange(4000) / (K * 50)
    changes = []
    for readout in np.linspace(0, 2 * np.pi, 12, endpoint=False):
        pure, mixed = (
            fit_harmonics(seen(beat, times, readout_phase=readout, contrast=c), times[1], harmonics=4)
            for c in (np.inf, 0.8)
        )
        ratios = [abs(f.amplitudes[1] / f.amplitudes[0]) for f in (pure, mixed)]
        changes.append(ratios[1] / ratios[0] - 1)
    assert np.max(np.abs(changes)) == pytest.approx(1.3e-3, rel=0.3)
