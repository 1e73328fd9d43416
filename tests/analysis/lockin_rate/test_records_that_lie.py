"""What a residual, and the parts of a record, say against its number."""

import numpy as np
import pytest
import scipy.signal
from scipy.optimize import least_squares

from analysis import DOUBTFUL, FATAL, Flag, beat_signal, combine_estimates, estimate_lock_in
from analysis.waveform.converter import is_a_piece
from analysis.waveform.fit import passing_power, slow_curve_power
from analysis.waveform.residuals import repeating
from analysis.waveform.series import drift_by_samples
from analysis.waveform.series_fit import fit_series
from benchmarks.hostile.classes import CLASSES
from benchmarks.hostile.gyro import N_SAMPLES, beat, draw_gyro, levels_of, steady, step_times
from benchmarks.hostile.measure import answer_to, measure
from benchmarks.hostile.moving_rate import random_walk_rates

N = np.arange(2500)
X = 0.1


def records(n_records, seed, *, periods=40.3, amplitude=90.0, noise=0.5, **more):
    rng = np.random.default_rng(seed)
    k = periods / 2500 / np.sqrt(1 - X * X)
    volts = beat_signal(
        N,
        scale_factor=k,
        input_rate=1.0,
        lock_in_rate=X,
        amplitude=amplitude,
        initial_phase=rng.uniform(0, 6, n_records),
        **more,
    )
    return k, volts, rng.normal(scale=noise, size=volts.shape)


def has(estimate, flag):
    return (estimate.flags & int(flag)) != 0


@pytest.mark.slow
def test_the_uncertainty_holds_the_even_half_of_a_saturation_whose_odd_half_is_seen():
    k, volts, noise = records(40, 1)
    for drive in (0.5, 1.0):
        codes = np.rint(90 * np.tanh(drive * (volts / 90 + 0.2)) / np.tanh(drive * 1.2) + noise)
        e = estimate_lock_in(codes, 1.0, scale_factor=k)
        error = np.abs(e.lock_in_rate - X)
        assert has(e, Flag.MISFIT).all()
        # noise alone would not explain it, the misfit does; WL is nearly 2 W r
        noise_u = 2 * np.sqrt(np.trace(e.complex_ratio_covariance, axis1=-2, axis2=-1) / 2)
        assert np.median(error / noise_u) > 5
        assert np.median(error / e.lock_in_rate_u) < 2


def test_a_line_far_from_the_harmonics_costs_less_than_one_on_the_third():
    k, volts, noise = records(20, 2)
    turn = 2 * np.pi * 40.3 / 2500 * N
    far, third = (
        estimate_lock_in(np.rint(volts + noise + 0.6 * np.cos(order * turn)), 1.0, scale_factor=k)
        for order in (2.53, 3.0)
    )
    assert has(far, Flag.MISFIT).all() and has(third, Flag.MISFIT).all()
    assert np.median(third.misfit_u) > 10 * np.median(far.misfit_u)
    assert np.all(np.abs(far.lock_in_rate - X) < 5 * far.lock_in_rate_u)


def test_a_step_in_the_codes_that_no_line_shows_is_seen_by_all_harmonics_together():
    k, volts, noise = records(60, 7, noise=1.3)
    levels = volts + noise
    e = estimate_lock_in(np.rint(levels + 2 * (levels > 25)), 1.0, scale_factor=k)
    error = np.abs(e.lock_in_rate - X)
    noise_u = 2 * np.sqrt(np.trace(e.complex_ratio_covariance, axis1=-2, axis2=-1) / 2)
    assert np.median(error / noise_u) > 5
    assert np.mean(has(e, Flag.MISFIT)) > 0.9
    assert np.all(error < 3 * e.lock_in_rate_u)


def test_noise_that_rises_to_low_frequencies_does_not_repeat_with_the_beat():
    k, volts, noise = records(60, 8, periods=23.7)
    pink = scipy.signal.lfilter([1], [1, -0.9], noise, axis=-1)
    e = estimate_lock_in(volts + pink, 1.0, scale_factor=k)
    assert not has(e, Flag.MISFIT).any()
    assert np.mean(e.misfit_u > 0) < 0.05


def test_lines_beside_which_there_is_nothing_repeat_for_sure():
    power = np.zeros(1250)
    assert repeating(power, 50.0, 2500) == (0.0, False)
    power[[199, 249, 299]] = 1e-3  # the fourth to the sixth harmonic
    assert repeating(power, 50.0, 2500) == (pytest.approx(3e-3), True)


def test_misfit_is_no_noise_and_does_not_shift_the_value():
    """Freeing the ratio of the bias of noise by the misfit would make it too small."""
    k, volts, noise = records(1, 3)
    bent = volts + noise + 4 * np.cos(3 * 2 * np.pi * 40.3 / 2500 * N)
    e = estimate_lock_in(bent, 1.0, scale_factor=k)
    assert e.misfit_u[0] > 0.5 * e.ratio[0]
    assert float(e.ratio[0]) == pytest.approx(float(np.abs(e.complex_ratio[0])), rel=1e-3)


def test_parts_of_other_time_bases_differ_and_their_difference_enters_u():
    rng = np.random.default_rng(4)
    for _ in range(5):
        gyro = draw_gyro(rng, periods=(30, 60), rate_over_lock_in=(3, 10), noise=(0.3, 0.6))
        interval = np.full(step_times().size, gyro.sample_interval)
        interval[interval.size // 2 :] *= 1.2
        volts = levels_of(gyro, beat(gyro, steady(gyro), interval)) + rng.normal(scale=gyro.noise, size=N_SAMPLES)
        e = estimate_lock_in(volts, gyro.sample_interval, scale_factor=gyro.scale_factor)
        assert not np.isfinite(e.lock_in_rate) or int(e.flags) & int(DOUBTFUL)
        assert not abs(float(e.lock_in_rate) - gyro.lock_in_rate) > 3 * float(e.lock_in_rate_u)


@pytest.mark.slow
def test_a_beam_blocked_for_a_third_is_refused_or_flagged():
    k, volts, noise = records(8, 5)
    volts[:, 800:1600] = 0.0
    e = estimate_lock_in(np.rint(volts + noise), 1.0, scale_factor=k)
    assert np.all(has(e, FATAL | DOUBTFUL))


@pytest.mark.slow
def test_what_all_records_have_in_common_does_not_average_out():
    k, volts, noise = records(100, 6)
    codes = np.rint(90 * np.tanh(0.7 * (volts / 90 + 0.2)) / np.tanh(0.7 * 1.2) + noise)
    e = estimate_lock_in(codes, 1.0, scale_factor=k)
    mean = combine_estimates(e)
    assert int(mean.flags) & Flag.MISFIT
    assert abs(float(mean.lock_in_rate) - X) < 2 * float(mean.lock_in_rate_u)
    assert float(mean.misfit_u) == pytest.approx(float(np.median(e.misfit_u)), rel=0.2)


def test_one_record_that_did_not_fit_hardly_counts_among_good_ones():
    k, volts, noise = records(20, 7)
    noise[0] += 6 * np.cos(2 * 2 * np.pi * 41.9 / 2500 * N)
    e = estimate_lock_in(np.rint(volts + noise), 1.0, scale_factor=k)
    with_it, without = combine_estimates(e), combine_estimates(e[1:])
    assert has(e, Flag.MISFIT)[0]
    assert abs(float(with_it.lock_in_rate - without.lock_in_rate)) < 0.3 * float(without.lock_in_rate_u)


@pytest.mark.slow
def test_no_record_stops_the_others():
    """Noise of the rate so strong that a phase runs backwards; inside lock-in; steps, ramps, single values."""
    rng = np.random.default_rng(8)
    odd = [one.make(rng).volts for one in CLASSES if one.kind == "detect"]
    odd += [1e150 * rng.normal(size=2500), np.r_[np.zeros(2499), 1.0], N * 1.0, np.sign(np.sin(N / 9.0))]
    k, volts, noise = records(1, 9)
    together = estimate_lock_in(np.array([*odd, (volts + noise)[0]]), 1.0, scale_factor=k)
    assert abs(float(together.lock_in_rate[-1]) - X) < 5 * float(together.lock_in_rate_u[-1])
    refused = np.isnan(together.lock_in_rate)
    assert np.all(has(together, FATAL)[refused])


@pytest.mark.slow
@pytest.mark.parametrize("n_samples", [8, 9, 12, 19, 50, 51])
def test_few_samples_of_anything_end_in_flags_and_no_warning(n_samples):
    """As few samples as leave no line of noise, no part of a record, no other line than the lowest ones."""
    rng, n = np.random.default_rng(n_samples), np.arange(n_samples)
    odd = [rng.normal(size=n_samples) for _ in range(20)] + [50 * np.sin(w * n) for w in (0.1, 0.7, 2.9)]
    odd += [np.cumsum(rng.normal(size=n_samples)), np.zeros(n_samples), n % 3.0, np.sign(np.sin(n / 2.0))]
    gaps = np.array(odd)
    gaps[rng.random(gaps.shape) < 0.5] = np.nan
    for volts in (np.array(odd), gaps):
        e = estimate_lock_in(volts, 1.0, scale_factor=1.0, nan_policy="omit")
        assert np.all(has(e, FATAL)[np.isnan(e.lock_in_rate)])
        assert np.all(e.lock_in_rate_low_95[e.usable] <= e.lock_in_rate_high_95[e.usable])


@pytest.mark.slow
def test_hardly_an_ideal_record_is_suspected():
    ideal = [one for one in CLASSES if one.name == "nothing is wrong"]
    (outcome,) = measure(ideal, 150, [1])
    assert outcome.count("finite") == 150
    assert outcome.count("warned") <= 2
    assert outcome.covered >= 125


@pytest.mark.slow
@pytest.mark.parametrize("name", ["random-walk phase, 3 to 10 rad", "ramp into the lock-in zone", "slow slewing"])
def test_what_is_to_be_detected_is(name):
    (one,) = [one for one in CLASSES if one.name == name]
    rng = np.random.default_rng(10)
    answers = [answer_to(one.make(rng)) for _ in range(4)]
    assert not any(answer.error or (answer.wrong and not answer.warned) for answer in answers)


@pytest.mark.slow
def test_a_locked_gyro_after_a_transient_is_flagged_though_the_rest_is_a_sine():
    k, volts, noise = records(5, 8)
    volts = 60 * np.sin(2 * np.pi * 20.3 / 2500 * N) + 120 * np.exp(-N / 8) + noise
    assert np.all(has(estimate_lock_in(np.rint(volts), 1.0, scale_factor=k), FATAL | DOUBTFUL))


def vibrating(gyro, size, turns):
    swing = size * 2 * np.pi * turns / N_SAMPLES / gyro.radians
    return gyro.input_rate + swing * np.cos(2 * np.pi * turns * step_times())


@pytest.mark.slow
def test_a_vibration_is_told_from_noise_of_the_rate():
    """Both are fitted as noise of the rate; only a vibration is a line there, and may be lock-in as well."""
    rng = np.random.default_rng(11)
    gyro = draw_gyro(rng, periods=(60, 60), rate_over_lock_in=(2, 4), noise=(0.6, 0.6))
    for rates, vibrates in ((vibrating(gyro, 0.4, 75.2), True), (random_walk_rates(rng, gyro, 3.0), False)):
        e = estimate_lock_in(
            np.rint(levels_of(gyro, beat(gyro, rates)) + rng.normal(scale=gyro.noise, size=N_SAMPLES)),
            gyro.sample_interval,
            scale_factor=gyro.scale_factor,
        )
        assert bool(int(e.flags) & Flag.MISFIT) == vibrates
        assert abs(float(e.lock_in_rate) - gyro.lock_in_rate) < 5 * float(e.lock_in_rate_u)


def test_noise_of_any_colour_is_there_all_the_time_and_a_transient_is_not():
    rng = np.random.default_rng(12)
    white = rng.normal(size=(300, 2500))
    pink = np.fft.irfft(np.fft.rfft(white) / np.sqrt(np.arange(1251) + 1.0), 2500)
    slow = scipy.signal.lfilter([1], [1, -0.97], white)
    louder = white * np.where((N > 600) & (N < 900), 4.0, 1.0)
    for noise in (white, pink, slow, 3 * np.sin(0.05 * N) + white, louder):
        assert not any(passing_power(one) or slow_curve_power(one) for one in noise)
    settling = 8 * np.exp(-N / 20)
    found = np.array([passing_power(one + settling) for one in white[:50]])
    assert np.all(found > 0.5 * settling @ settling) and np.all(found < 2 * settling @ settling)
    # among slow lines no part stands alone, but a run of one sign does
    begun = np.where(N < 60, -8.0, 0.0)
    found = np.array(
        [passing_power(one + begun) for one in np.sin(np.outer(np.ones(20), 0.05 * N)) + 0.1 * white[:20]]
    )
    assert found == pytest.approx(np.full(20, begun @ begun), rel=0.2)
    dying = 3 * (np.exp(-N / 500) - np.exp(-N / 500).mean())
    found = np.array([slow_curve_power(one + dying) for one in 0.3 * white[:50]])
    assert found == pytest.approx(np.full(50, dying @ dying), rel=0.1)


def test_spikes_at_random_places_are_no_piece_and_a_broken_piece_is():
    rng = np.random.default_rng(13)
    for count in (5, 12, 40):
        scattered = np.zeros((500, 2500), dtype=bool)
        for one in scattered:
            one[rng.choice(2500, count, replace=False)] = True
        assert not any(is_a_piece(one, one) for one in scattered)
    broken = np.zeros(2500, dtype=bool)
    broken[[0, 1, 3, 4, 6, 9, 13, 14]] = True
    assert is_a_piece(broken, broken)
    short, tail = np.zeros((2, 2500), dtype=bool)
    short[50:54] = tail[50:58] = True
    assert is_a_piece(short, tail) and not is_a_piece(short, short)
    # a gyro that settles as the record begins
    settling = np.arange(2500) < 2
    assert is_a_piece(settling, settling) and not is_a_piece(settling | short, settling | short)


def test_a_second_beat_that_hardly_parts_is_seen_by_the_drift_of_the_ratio():
    rng = np.random.default_rng(31)
    gyro = draw_gyro(rng, rate_over_lock_in=(2.0, 2.0), periods=(40.3, 40.3))
    turns = 40.3 + 0.3
    volts = 90 * beat(gyro, steady(gyro)) + rng.normal(scale=0.5, size=(10, 2500))
    other = 0.006 * 90 * np.cos(2 * np.pi * turns / 2500 * N + rng.uniform(0, 7, 10)[:, np.newaxis])
    alone, both = (
        estimate_lock_in(v, gyro.sample_interval, scale_factor=gyro.scale_factor) for v in (volts, volts + other)
    )
    assert np.mean(alone.misfit_u > 0) < 0.4 and np.mean(both.misfit_u > 0) > 0.6
    assert (np.abs(both.lock_in_rate - gyro.lock_in_rate) / both.lock_in_rate_u).max() < 5


def test_the_drift_of_the_ratio_is_that_of_a_linear_fit():
    _, volts, noise = records(2, 32, periods=7.3)
    values = volts + noise - np.mean(volts + noise, axis=-1, keepdims=True)
    series = fit_series(values, None).series
    drift, covariance = drift_by_samples(values, None, series)
    time = (N - 1249.5) / 1249.5

    def model(p):
        first, ratio = p[1] + 1j * p[2], p[3] + 1j * p[4]
        turn = np.exp(1j * p[5] * (N - 1249.5))
        q = ratio + (p[7] + 1j * p[8]) * time
        return p[0] + ((1 + p[6] * time) * first * turn / (1 - q * turn)).real

    for row in range(2):
        of = [field[row] for field in (series.offset, series.first, series.ratio, series.omega)]
        start = [of[0], of[1].real, of[1].imag, of[2].real, of[2].imag, of[3], 0.0, 0.0, 0.0]
        fit = least_squares(lambda p, row=row: values[row] - model(p), start, x_scale="jac")
        spread = np.linalg.inv(fit.jac.T @ fit.jac)[7:, 7:]
        assert np.allclose(drift[row], fit.x[7:], atol=0.05 * np.sqrt(0.25 * spread[0, 0]))
        assert np.allclose(covariance[row], spread, rtol=0.02, atol=0.02 * spread[0, 0])


def test_weak_harmonics_count_together_and_noise_alone_does_not():
    k, volts, noise = records(80, 33, noise=1.5)
    carry = 2.0 * (volts + noise > 21)
    clean, wrong = (estimate_lock_in(np.rint(v + noise), 1.0, scale_factor=k) for v in (volts, volts + carry))
    assert np.mean(clean.misfit_u > 0) < 0.2
    assert np.mean(wrong.misfit_u > 0) > 0.9
    assert (np.abs(wrong.lock_in_rate - X) / wrong.lock_in_rate_u).max() < 5


@pytest.mark.parametrize("count", [1, 3])
def test_missing_samples_are_counted_in_their_record(count):
    """A record that is alone was told to have twice as many."""
    volts = np.sin(np.arange(500.0)) * np.ones((count, 1))
    volts[-1, 7:10] = np.nan
    with pytest.raises(ValueError, match=r"\(3 samples, the first is sample 7 of its record\)"):
        estimate_lock_in(volts[-1] if count == 1 else volts, 1e-4, scale_factor=2000.0)
