import numpy as np
import pytest
from reference import integrated_beat

from analysis import (
    Flag,
    QuadratureFlag,
    beat_signal,
    combine_estimates,
    estimate_quadratures,
    fit_harmonics,
    fit_rates,
)

WL = 0.05


def channels(
    multiple,
    n_records=1,
    *,
    rng=None,
    noise=0.0,
    gain=1.0,
    skew=0.0,
    squares=(0.01, 0.01),
    cube=0.0,
    n_samples=2500,
    periods=50.3,
):
    """Sine and cosine of a gyro at a multiple of its lock-in rate; interval, scale factor and rate."""
    rng = np.random.default_rng(0) if rng is None else rng
    rate, interval = multiple * WL, 1e-5
    scale = periods / (n_samples * interval) / np.sqrt(rate**2 - WL**2)
    bench = {
        "scale_factor": scale,
        "input_rate": rate,
        "lock_in_rate": WL,
        "initial_phase": rng.uniform(0, 6.28, n_records),
        "backscatter_phase": 0.7,
    }
    times = np.arange(n_samples) * interval
    pair = [gain * beat_signal(times, readout_phase=-skew, **bench)]
    pair.append(beat_signal(times, readout_phase=np.pi / 2, **bench))
    pair = [v + s * v**2 + cube * v**3 for v, s in zip(pair, squares, strict=True)]
    pair = [v + rng.normal(scale=noise, size=v.shape) if noise else v for v in pair]
    return pair[0], pair[1], interval, scale, rate


def estimated(*args, given=True, **more):
    sine, cosine, interval, scale, rate = channels(*args, **more)
    return estimate_quadratures(sine, cosine, interval, scale_factor=scale, input_rate=rate if given else None)


def by_image(sine, cosine, interval):
    """rho of c_2 - c_-2 (c_1/|c_1|)^4 with Heydemann's correction from c_-1, as in the books; growing phase."""
    lines = fit_harmonics(np.stack([cosine, sine]), interval, harmonics=6)
    turned = lines.amplitudes * np.exp(
        2j * np.pi * (lines.frequency[0] - lines.frequency)[:, None] * np.arange(1, 7) * interval * sine.size / 2
    )
    plus, minus = (turned[0] + 1j * turned[1]) / 2, (np.conj(turned[0]) + 1j * np.conj(turned[1])) / 2
    share = minus[0] / np.conj(plus[0])
    plus, minus = plus - share * np.conj(minus), minus - share * np.conj(plus)
    second = plus[1] - minus[1] * (plus[0] / abs(plus[0])) ** 4
    return second * abs(plus[0]) / plus[0] ** 2


@pytest.mark.slow
@pytest.mark.parametrize("multiple", [3, 8, 20, 50, 100, -3, -20, -100])
def test_distortion_of_minus_46_dbc_is_gone_in_perfect_quadrature(multiple):
    made = estimated(multiple)
    assert abs(made.estimate.lock_in_rate[0] / WL - 1) < 1.0e-4
    assert abs(made.sine.lock_in_rate[0] / WL - 1) > 0.003 * abs(multiple)
    assert made.sense[0] == np.sign(multiple)
    np.testing.assert_allclose(made.distortion[0], 0.005, rtol=5e-3)
    assert made.estimate.backscatter_phase[0] == pytest.approx(0.7, abs=1e-3)
    assert made.estimate.input_rate[0] == multiple * WL
    assert made.flags[0] == 0


def test_for_equal_channels_it_is_the_subtraction_of_the_image():
    sine, cosine, interval, scale, rate = channels(30, n_samples=20000, periods=400)
    made = estimate_quadratures(sine, cosine, interval, scale_factor=scale, input_rate=rate)
    image = by_image(sine[0], cosine[0], interval)
    # Both have the true size; the image method's rho is that of Z, which reads the phase like the cosine.
    assert abs(image) == pytest.approx(abs(made.estimate.complex_ratio[0]), rel=3e-4)
    assert abs(made.estimate.lock_in_rate[0] / WL - 1) < 1.5e-4


@pytest.mark.slow
@pytest.mark.parametrize("multiple", [20, -20, 100])
def test_unequal_channels_cost_nothing_either(multiple):
    """3 % gain, 0.05 rad, different distortion: subtraction of the image leaves 1 %, this 0.01 %."""
    bench = {"gain": 1.03, "skew": 0.05, "squares": (0.01, 0.006)}
    made = estimated(multiple, **bench)
    assert abs(made.estimate.lock_in_rate[0] / WL - 1) < 1e-4
    assert made.gain_ratio[0] == pytest.approx(1.03, rel=2e-3)
    assert made.phase_error[0] == pytest.approx(0.05, abs=1e-5)  # in either sense
    np.testing.assert_allclose(made.distortion[0], [0.00515, 0.003], rtol=3e-3)
    if multiple > 0:
        sine, cosine, interval, _, _ = channels(multiple, **bench)
        left = abs(by_image(sine[0], cosine[0], interval)) * 2 * multiple - 1
        assert 0.004 < abs(left) < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("multiple", [1.2, 3, 20])
def test_the_uncertainty_is_that_of_the_scatter(multiple):
    rng = np.random.default_rng(2)
    made = estimated(multiple, 400, rng=rng, noise=0.01, gain=1.03, skew=0.05, squares=(0.01, 0.006), periods=27.3)
    e = made.estimate
    errors = (e.lock_in_rate - WL) / e.lock_in_rate_u
    assert errors.std() == pytest.approx(1, abs=0.12)
    assert abs(errors.mean()) < (0.5 if multiple < 2 else 0.15)
    assert np.mean((e.lock_in_rate_low_95 <= WL) & (e.lock_in_rate_high_95 >= WL)) == pytest.approx(
        0.95, abs=0.035
    )
    scatter = (made.distortion - made.distortion.mean(axis=0)) / made.distortion_u
    np.testing.assert_allclose(scatter.std(axis=0), 1, atol=0.12)
    assert np.std(made.phase_error) == pytest.approx(made.phase_error_u.mean(), rel=0.15)
    assert np.std(made.gain_ratio) == pytest.approx(made.gain_ratio_u.mean(), rel=0.15)
    # Freedom from distortion costs little against one channel alone, and false alarms are rare.
    assert e.lock_in_rate_u.mean() < 1.1 * made.sine.lock_in_rate_u.mean()
    assert np.mean(made.flags != 0) < 0.02


@pytest.mark.slow
def test_a_beat_by_an_integrator_comes_back_too():
    times = np.arange(2500) * 1e-5
    bench = {"k": 20000.0, "w": -0.15, "wl": WL, "phi0": 1.0, "beta": 0.3}
    sine = integrated_beat(times, **bench)
    cosine = integrated_beat(times, delta=np.pi / 2, **bench)
    made = estimate_quadratures(sine + 0.02 * sine**2, cosine, 1e-5, scale_factor=20000.0, input_rate=-0.15)
    assert float(made.estimate.lock_in_rate) == pytest.approx(WL, rel=3e-4)
    assert int(made.sense) == -1
    assert made.distortion[0] == pytest.approx(0.01, rel=0.01)
    assert abs(made.distortion[1]) < 1e-4


def test_without_a_rate_the_sense_comes_from_the_channels():
    for multiple in (5, -5):
        made = estimated(multiple, given=False)
        assert made.estimate.input_rate[0] == pytest.approx(multiple * WL, rel=1e-4)
        assert made.estimate.backscatter_phase[0] == pytest.approx(0.7, abs=1e-3)


def test_corrected_records_of_both_senses_and_several_rates_fit_together():
    rng = np.random.default_rng(2)
    made = [estimated(m, 4, rng=rng, noise=0.01).estimate for m in (5, 12, -5, -12)]
    for e in made:
        assert abs(float(combine_estimates(e).lock_in_rate) - WL) < 4 * float(combine_estimates(e).lock_in_rate_u)
    rates = np.concatenate([e.input_rate for e in made])
    np.testing.assert_array_equal(np.unique(rates), [-12 * WL, -5 * WL, 5 * WL, 12 * WL])
    # Different scale factors here, since every rate was given the same number of periods.
    with pytest.raises(ValueError, match="different scale factors"):
        fit_rates(made)


def test_exchanged_channels_and_third_order_distortion_are_seen():
    sine, cosine, interval, scale, rate = channels(8)
    turned = estimate_quadratures(cosine, sine, interval, scale_factor=scale, input_rate=rate)
    assert turned.sense[0] == -1
    assert turned.flags[0] == QuadratureFlag.SENSE_DISAGREES
    cubic = estimated(8, cube=0.02, squares=(0.0, 0.0))
    assert cubic.flags[0] & QuadratureFlag.IMAGE_LEFT
    # x^3 leaves a third harmonic of 0.02/4 in each channel, and that is what the image shows.
    assert cubic.images[0, 2] == pytest.approx(0.005, rel=0.05)


def test_two_copies_of_one_channel_are_no_quadratures():
    sine, _, interval, scale, rate = channels(8, rng=np.random.default_rng(3), noise=0.01)
    made = estimate_quadratures(sine, sine, interval, scale_factor=scale, input_rate=rate)
    assert made.flags[0] & QuadratureFlag.NOT_IN_QUADRATURE
    assert made.sense[0] == 0
    assert not made.estimate.lock_in_rate_u[0] < 100 * made.sine.lock_in_rate_u[0]


def test_poor_quadrature_is_corrected_at_a_price():
    made = estimated(10, 200, rng=np.random.default_rng(4), noise=0.01, skew=0.9)
    assert np.all(made.flags & QuadratureFlag.POOR_QUADRATURE)
    e = made.estimate
    assert np.std((e.lock_in_rate - WL) / e.lock_in_rate_u) == pytest.approx(1, abs=0.15)
    # Both parts of rho together against one channel, for an angle whose sine is 0.62: 1/sin^2 of its variance.
    traces = [np.trace(x.complex_ratio_covariance, axis1=-2, axis2=-1).mean() for x in (e, made.sine)]
    assert traces[0] / traces[1] == pytest.approx(1 / 0.62**2, rel=0.1)


def test_different_beats_and_missing_beats_are_flagged():
    sine, cosine, interval, scale, rate = channels(8)
    other = channels(8, periods=53.1)[1]
    apart = estimate_quadratures(sine, other, interval, scale_factor=scale, input_rate=rate)
    assert apart.flags[0] & QuadratureFlag.FREQUENCIES_DIFFER
    dead = np.zeros_like(cosine)
    made = estimate_quadratures(
        np.concatenate([sine, sine]), np.concatenate([cosine, dead]), interval, scale_factor=scale
    )
    assert list(made.estimate.usable) == [True, False]
    assert made.estimate.flags[1] & Flag.CONSTANT
    assert np.isnan(made.estimate.lock_in_rate[1]) and np.isfinite(made.estimate.lock_in_rate[0])
    assert made.sense[1] == 0


def test_shapes_are_kept_and_checked():
    sine, cosine, interval, scale, _ = channels(8, 4)
    made = estimate_quadratures(sine.reshape(2, 2, -1), cosine.reshape(2, 2, -1), interval, scale_factor=scale)
    assert made.estimate.lock_in_rate.shape == made.sense.shape == (2, 2)
    assert made.distortion.shape == (2, 2, 2) and made.images.shape == (2, 2, 3)
    with pytest.raises(ValueError, match="same shape"):
        estimate_quadratures(sine, cosine[:, :-1], interval, scale_factor=scale)


def test_a_clipped_channel_is_left_out_sample_by_sample():
    sine, cosine, interval, scale, rate = channels(5, squares=(0.0, 0.0))
    held = np.clip(sine, -0.9, 0.9)
    made = estimate_quadratures(held, cosine, interval, scale_factor=scale, input_rate=rate)
    assert made.estimate.flags[0] & Flag.CLIPPED
    assert made.estimate.lock_in_rate[0] == pytest.approx(WL, rel=0.05)


@pytest.mark.parametrize("over", [1.2, 1.3, 2.0, 5.0, 30.0])
def test_unequal_channels_are_found_free_of_their_distortion(over):
    """Gain 3 %, phase 0.05 rad, and distortion of -46 dBc with another sign in each channel, at any phase."""
    scale, lock_in, gain, phase_error, second = 2000.0, 0.01, 1.03, 0.05, 0.005
    rng = np.random.default_rng(int(10 * over))
    rate = over * lock_in
    interval = 18.7 / (scale * np.sqrt(rate**2 - lock_in**2)) / 2500
    records, times = 60, np.arange(2500) * interval
    channels = np.empty((2, records, times.size))
    for row in range(records):
        sense, readout = rng.choice([-1, 1]), rng.uniform(0, 2 * np.pi)
        beat = {
            "scale_factor": scale,
            "input_rate": sense * rate,
            "lock_in_rate": lock_in,
            "initial_phase": rng.uniform(0, 2 * np.pi),
            "backscatter_phase": rng.uniform(0, 2 * np.pi),
        }
        sine = beat_signal(times, readout_phase=readout, **beat)
        cosine = beat_signal(times, readout_phase=readout + np.pi / 2 - phase_error, **beat)
        channels[:, row] = gain * (sine + 2 * second * sine**2), cosine - 2 * second * cosine**2
    channels += rng.normal(scale=0.005, size=channels.shape)
    found = estimate_quadratures(*channels, interval, scale_factor=scale)
    for value, u, true in (
        (found.gain_ratio, found.gain_ratio_u, gain),
        (np.abs(found.phase_error), found.phase_error_u, phase_error),
        (found.estimate.lock_in_rate, found.estimate.lock_in_rate_u, lock_in),
        (found.distortion[:, 0], found.distortion_u[:, 0], second),
        (found.distortion[:, 1], found.distortion_u[:, 1], -second),
    ):
        pull = np.sqrt(np.mean(((value - true) / u) ** 2))
        # chi-square of 60 values leaves 0.6 to 1.48 less than once in a million times
        assert 0.55 < pull < 1.6
    assert np.all(found.gain_ratio_u < 5e-4)
