from dataclasses import fields, replace

import numpy as np
import pytest
from reference import adler_beat, bound, random_records

from analysis import Flag, estimate_lock_in
from analysis.lockin_rate import Beat, fewest_levels


def _no_beat(n_records):
    return Beat(**{field.name: np.zeros(n_records) for field in fields(Beat)})


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.1, 0.2])
def test_quiet_records_are_better_than_with_white_rounding(noise):
    """The rounding error stands on the harmonics; taken out, the error is honest and below the white bound."""
    rng = np.random.default_rng(50)
    times, records, truths, _ = random_records(
        rng, 150, x_range=(1.5, 30), noise_range=(noise, noise), periods_range=(4, 400)
    )
    z, against_white = [], []
    for codes, truth in zip(records, truths, strict=True):
        # The levels of a file or a scope: any spacing, any offset.
        e = estimate_lock_in(codes * 0.004 - 1.3, 1.0, scale_factor=truth["k"])
        error = float(e.lock_in_rate) - truth["wl"]
        z.append(error / float(e.lock_in_rate_u))
        against_white.append(error / bound(times, truth, np.hypot(noise, 1 / np.sqrt(12))))
    assert np.sqrt(np.mean(np.square(z))) < 1.17
    assert np.sqrt(np.mean(np.square(against_white))) < (0.92 if noise == 0.1 else 1.0)


def test_the_mean_rounding_error_is_that_of_a_simulation():
    """Against ten thousand noisy roundings of one waveform."""
    from analysis.waveform.converter import mean_rounding

    truth = {"f_over_k": 1.0, "wl": 0.3, "k": 0.01, "theta": 0.2, "delta": 1.0, "amplitude": 6.0, "offset": 0.3}
    wave = adler_beat(np.arange(200.0), **truth)
    rng = np.random.default_rng(51)
    for noise in (0.1, 0.25):
        codes = np.rint(wave + rng.normal(scale=noise, size=(10_000, 200)))
        seen = (codes - wave).mean(axis=0)
        rms = np.array([np.hypot(noise, 1 / np.sqrt(12))])
        ours = mean_rounding(wave[np.newaxis], codes[:1], np.ones(1), rms)[0]
        assert np.abs(ours - seen).max() < 0.025
        assert np.abs(seen).max() > 0.05


@pytest.mark.parametrize("scale", [1.0, 0.0032])
def test_a_beat_of_few_levels_says_so(scale):
    """A swing inside lock-in looks like a small beat; a beat that fills the converter does not."""
    rng, n = np.random.default_rng(52), np.arange(2500)
    heights = np.array([6.0, 30.0, 45.0, 90.0])
    noise = rng.normal(scale=[[0.3], [2.0], [3.0], [3.0]], size=(4, n.size))
    codes = np.rint(heights[:, np.newaxis] * np.sin(2 * np.pi * n / 61.3) + noise)
    flags = estimate_lock_in(scale * codes, 1.0, scale_factor=1.0).flags
    assert [bool(one & Flag.FEW_LEVELS) for one in flags] == [True, True, False, False]
    # codes as the scope sends them, and values of no converter
    assert np.array_equal(estimate_lock_in(codes.astype(np.int8), 1.0, scale_factor=1.0).flags, flags)
    assert not int(estimate_lock_in(codes[0] + noise[0], 1.0, scale_factor=1.0).flags) & Flag.FEW_LEVELS


def test_a_swing_inside_lock_in_of_a_quarter_of_the_screen_says_so():
    """Its phase is arc sine of W/WL, its second harmonic in phase with the fundamental; that of a beat is not."""
    rng, n = np.random.default_rng(53), np.arange(2500)
    swing = np.arcsin(0.3 * np.sin(2 * np.pi * n / 61.3))
    seen = 90 * np.cos(swing + np.array([[0.9], [-0.6]]))
    turning = {"f_over_k": 1.0, "wl": 0.05, "k": 1 / 61.3, "theta": 0.2, "amplitude": 30.0, "offset": 0.0}
    beats = np.stack([adler_beat(n + 0.0, delta=delta, **turning) for delta in (1.0, 2.0, -1.2)])
    codes = np.rint(np.concatenate([seen, beats]) + rng.normal(scale=0.4, size=(5, n.size)))
    e = estimate_lock_in(codes, 1.0, scale_factor=1.0)
    assert np.all(e.amplitude / (90 * 0.3) < 1.2)
    assert [bool(one & Flag.FEW_LEVELS) for one in e.flags] == [True, True, False, False, False]


def test_a_beat_whose_third_harmonic_shows_is_no_swing_whatever_the_phase_of_its_second():
    rng, n = np.random.default_rng(56), np.arange(2500)
    turning = {"f_over_k": 1.0, "k": 1 / 61.3, "theta": 0.2, "amplitude": 30.0, "offset": 0.0}
    beats = np.stack([adler_beat(n + 0.0, wl=wl, delta=d, **turning) for wl in (0.3, 0.02) for d in (0.0, np.pi)])
    e = estimate_lock_in(np.rint(beats + rng.normal(scale=0.4, size=beats.shape)), 1.0, scale_factor=1.0)
    assert np.abs(e.complex_ratio.imag / e.complex_ratio.real).max() < 0.1
    # far above lock-in it is too weak to be seen
    assert [bool(one & Flag.FEW_LEVELS) for one in e.flags] == [False, False, True, True]


def test_where_the_third_harmonic_is_amiss_a_larger_or_a_quicker_swing_has_few_levels_too():
    rho = np.array([0.03, 0.03, 0.03 * np.exp(0.6j), 0.03 * np.exp(0.6j), 0.03j])
    third = np.array([0.0, 0.004, 0.0, 0.004, 0.004])
    ones = np.ones(5)
    beat = replace(_no_beat(5), rho=rho, rho_covariance=1e-6 * np.eye(2) * ones[:, np.newaxis, np.newaxis])
    assert np.array_equal(fewest_levels(beat, third, 1e-3 * ones), [40.0, 64.0, 16.0, 64.0, 16.0])


def test_a_third_harmonic_too_weak_for_a_line_anywhere_is_a_misfit():
    """It has one place: 20 times the mean power there is no chance, among all lines it may be."""
    n, rng = np.arange(2500), np.random.default_rng(54)
    phase = 2 * np.pi * 40.0 * n / n.size
    noise = rng.normal(size=n.size)
    for order in range(1, 4):
        turn = np.exp(-1j * order * phase)
        noise -= 2 * np.real(np.mean(noise * turn) * np.conj(turn))
    third = np.sqrt(18.0 * 2 * np.mean(noise**2) * 2 / n.size)
    records = 60 * np.cos(phase) + noise + np.array([[third], [third / 2]]) * np.cos(3 * phase)
    flags = estimate_lock_in(records, 1.0, scale_factor=1.0).flags
    assert [bool(one & Flag.MISFIT) for one in flags] == [True, False]
