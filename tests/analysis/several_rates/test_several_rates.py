import numpy as np
import pytest
from bench_signals import WL, K, both_senses, estimates, ratios_of_slow_gain, volts
from reference import bound

from analysis import RatesFlag, combine_estimates, estimate_lock_in, fit_rate_ratios, fit_rates
from station.lock_in.messages import describe_rates

RATES = (8, 15, 30, 60)
FASTEST_BEAT = K * 60 * WL


@pytest.mark.slow
def test_a_receiver_of_minus_46_dbc_costs_less_than_half_a_percent():
    """1 % noise, 8 records of 2500 points a rate and sense; one record alone is wrong by 20 % at 30 WL."""
    rng = np.random.default_rng(1)
    values, singles = [], []
    for _ in range(10):
        made = estimates(both_senses(*RATES), 8, rng, hd2=0.005)
        fit = fit_rates(made)
        values.append(fit.lock_in_rate / WL - 1)
        singles.append(made[2].lock_in_rate / WL - 1)
        assert fit.distortion == pytest.approx(0.005, abs=5 * fit.distortion_u)
        assert fit.flags == 0
    assert np.max(np.abs(values)) < 0.005
    assert np.sqrt(np.mean(np.square(values))) < 0.0015
    assert np.abs(np.mean(singles)) > 0.19
    assert "-46" in describe_rates(fit)[1]


@pytest.mark.slow
@pytest.mark.parametrize("hd2", [0.0, 0.005])
def test_a_gain_corner_at_twice_the_highest_beat_costs_less_than_a_percent(hd2):
    rng = np.random.default_rng(2)
    made = estimates(both_senses(*RATES), 8, rng, hd2=hd2, gain_corner_hz=2 * FASTEST_BEAT)
    fit = fit_rates(made)
    assert fit.model == "all"
    assert abs(fit.lock_in_rate / WL - 1) < 0.004
    assert fit.gain_corner_hz == pytest.approx(2 * FASTEST_BEAT, rel=0.1)
    assert fit.gain_corner_low_95_hz < 2 * FASTEST_BEAT < fit.gain_corner_high_95_hz
    # Taken for a laser with fast gain, the same records disagree with the model and say so.
    blind = fit_rates(made, model="distortion")
    assert blind.flags & RatesFlag.MISFIT
    assert blind.lock_in_rate_u > 5 * fit.lock_in_rate_u


@pytest.mark.parametrize("corner", [0.05 * K * WL * 25, 0.3 * K * WL * 25, 2 * K * WL * 25])
@pytest.mark.parametrize("reference", ["rate", "beat"])
def test_slow_gain_near_lock_in_is_exact(corner, reference):
    """One pole, the limit far above lock-in, would put the corner 9 to 31 % low."""
    rates, ratios, beats = ratios_of_slow_gain(both_senses(1.5, 3, 8, 25), corner)
    fit = fit_rate_ratios(
        rates, ratios, np.eye(2) * 1e-12, beats, scale_factor=K, reference=reference, model="both"
    )
    assert fit.gain_corner_hz == pytest.approx(corner, rel=1e-6)
    assert fit.lock_in_rate == pytest.approx(WL, rel=1e-6)
    assert fit.backscatter_phase == pytest.approx(-0.4, abs=1e-6)
    assert abs(fit.distortion) < 1e-8 and fit.chi_square < 1e-3


def test_conservative_coupling_moves_the_gain_corner_by_what_the_words_say():
    """60 deg between the backscatter of the beams; the corner is known to better than what that does to it."""
    corner = 2 * K * WL * 25
    rates, ratios, beats = ratios_of_slow_gain(both_senses(3, 8, 25), corner, np.pi / 3)
    fit = fit_rate_ratios(rates, ratios, np.eye(2) * 1e-9, beats, scale_factor=K, reference="beat", model="both")
    assert fit.gain_corner_hz / corner - 1 == pytest.approx(0.02, rel=0.15)
    assert "about 2 % too high" in describe_rates(fit)[2]
    blurred = fit_rate_ratios(rates, ratios, np.eye(2) * 1e-6, beats, scale_factor=K, reference="beat")
    assert "too high" not in describe_rates(blurred)[2]
    freed = fit_rate_ratios(rates, ratios, np.eye(2) * 1e-9, beats, scale_factor=K, reference="beat")
    assert freed.gain_corner_hz == pytest.approx(corner, rel=0.002) and "too high" not in describe_rates(freed)[2]


@pytest.mark.slow
@pytest.mark.parametrize("slowest", [3.0, 8.0])
@pytest.mark.parametrize("corner_over_fastest", [0.5, 2.0])
def test_the_interval_holds_what_conservative_coupling_of_60_deg_does(slowest, corner_over_fastest):
    rates = both_senses(slowest, 3 * slowest, 7.5 * slowest)
    corner = corner_over_fastest * K * WL * 7.5 * slowest
    for sign in (1, -1):
        seen = ratios_of_slow_gain(rates, corner, sign * np.pi / 3)
        fit = fit_rate_ratios(seen[0], seen[1], np.eye(2) * 1e-9, seen[2], scale_factor=K, reference="beat")
        assert fit.lock_in_rate_low_95 < WL < fit.lock_in_rate_high_95


@pytest.mark.parametrize("sense", [1, -1])
def test_the_gain_corner_has_the_same_sign_in_either_sense(sense):
    """Noise-free records in one sense, from the integrated intensity equations."""
    rng = np.random.default_rng(3)
    made = estimates(sense * np.array(RATES), 1, rng, noise=1e-6, gain_corner_hz=0.5 * FASTEST_BEAT)
    fit = fit_rates(made, model="both")
    assert fit.lock_in_rate == pytest.approx(WL, rel=2e-3)
    assert fit.gain_corner_hz == pytest.approx(0.5 * FASTEST_BEAT, rel=1e-2)
    assert fit.backscatter_phase == pytest.approx(0.7, abs=5e-3)  # x^2 is left


@pytest.mark.slow
@pytest.mark.parametrize(
    ("multiples", "periods", "n_seeds"),
    [
        pytest.param(both_senses(*RATES), 100.3, 80, marks=pytest.mark.slow),
        pytest.param(both_senses(3, 5), 60.3, 80, marks=pytest.mark.slow),
        (both_senses(3, 5), 60.3, 40),
    ],
)
def test_without_distortion_the_error_stands_at_the_bound(multiples, periods, n_seeds):
    rng = np.random.default_rng(4)
    made = estimates(multiples, n_seeds, rng, periods=periods)
    information = 0.0
    for multiple in multiples:
        rate = abs(multiple) * WL
        frequency = K * np.sqrt(rate**2 - WL**2)
        times = np.arange(2500) * periods / frequency / 2500
        truth = {
            "f_over_k": frequency / K,
            "wl": WL,
            "k": K,
            "theta": 1.0,
            "delta": 0.7,
            "amplitude": 1,
            "offset": 0,
        }
        information += bound(times, truth, 0.01) ** -2
    fits = [fit_rates([e[k] for e in made]) for k in range(n_seeds)]
    errors = np.array([f.lock_in_rate - WL for f in fits])
    # 80 seeds know their rms to 8 %. In both senses distortion and gain corner cost next to nothing, third
    # order and bandwidth something: the more, the closer the rates.
    known = [fit_rates([e[k] for e in made], model="both").lock_in_rate - WL for k in range(n_seeds)]
    assert np.sqrt(np.mean(np.square(known))) * np.sqrt(information) < 1.15
    assert np.sqrt(np.mean(errors**2)) * np.sqrt(information) < (2.5 if len(multiples) > 4 else 3.5)
    covered = [f.lock_in_rate_low_95 <= WL <= f.lock_in_rate_high_95 for f in fits]
    assert 0.90 <= np.mean(covered) <= 0.99
    assert np.std(errors / [f.lock_in_rate_u for f in fits]) == pytest.approx(1, abs=0.15)
    # The truth stands in the middle of every prior, where less of it is left than of a value by chance: 1 of the
    # chi-square of 18, 0.6 of that of 6.
    assert np.mean([f.chi_square / f.degrees_of_freedom for f in fits]) == pytest.approx(0.92, abs=0.15)


@pytest.mark.slow
def test_one_sense_pays_what_linear_algebra_says():
    """The unknowns by plain least squares with r = WL/2W, which is exact enough at 8 WL."""
    rng = np.random.default_rng(5)
    made = estimates(np.array(RATES), 50, rng, hd2=0.005)
    fits = [fit_rates([e[k] for e in made], model="both") for k in range(50)]
    rates = np.array(RATES) * WL
    own, rotor = -0.5 / rates, np.exp(0.7j)
    columns = np.stack(
        [own, 1j * own, np.ones(4), -2j * np.pi * K * rates * WL * own * rotor * 1e-6], axis=-1
    )  # Re z, Im z, D, gain time in microseconds
    noise = np.sqrt([np.diagonal(e.complex_ratio_covariance, axis1=-2, axis2=-1).mean() for e in made])
    design = np.concatenate([columns.real / noise[:, None], columns.imag / noise[:, None]])
    covariance = np.linalg.inv(design.T @ design)[:2, :2]
    along = np.array([rotor.real, rotor.imag])
    expected = np.sqrt(along @ covariance @ along)
    errors = np.array([f.lock_in_rate for f in fits]) - WL
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(expected, rel=0.2)
    assert np.mean([f.lock_in_rate_u for f in fits]) == pytest.approx(expected, rel=0.05)
    assert all(f.flags & RatesFlag.ONE_SENSE for f in fits)


def test_a_pair_of_senses_is_the_mean_of_hand_arithmetic():
    rng = np.random.default_rng(6)
    forward, backward = estimates([30, -30], 1, rng, hd2=0.005)
    plus, minus = complex(forward.complex_ratio[0]), complex(backward.complex_ratio[0])
    by_hand = -(plus - np.conj(minus)) / 2
    fit = fit_rates([forward, backward], model="distortion")
    size = abs(by_hand)
    assert fit.lock_in_rate == pytest.approx(30 * WL * 2 * size / (1 + size**2), rel=2e-3)
    assert fit.backscatter_phase == pytest.approx(np.angle(by_hand), abs=0.01)
    assert fit.distortion == pytest.approx(((plus + np.conj(minus)) / 2).real, rel=0.01)
    assert fit.degrees_of_freedom == 1
    # The records alone miss by 20 %, to either side.
    assert forward.lock_in_rate[0] / WL < 0.83 and backward.lock_in_rate[0] / WL > 1.2


def test_near_the_threshold_the_exact_ratio_is_used():
    rng = np.random.default_rng(7)
    made = estimates(both_senses(1.3, 2, 4), 2, rng, noise=1e-3, hd2=0.005)
    for reference in ("rate", "beat"):
        fit = fit_rates(made, reference=reference)
        assert abs(fit.lock_in_rate - WL) < 4 * fit.lock_in_rate_u < 2e-4 * WL
        assert fit.distortion == pytest.approx(0.005, rel=0.02)


def test_with_the_beat_as_reference_a_wrong_rate_does_not_matter():
    rng = np.random.default_rng(8)
    made = []
    for multiple in both_senses(4, 8, 16):
        records, interval = volts(multiple * WL, 4, rng)
        made.append(estimate_lock_in(records, interval, scale_factor=K, input_rate=1.02 * multiple * WL))
    by_rate, by_beat = fit_rates(made), fit_rates(made, reference="beat")
    assert by_rate.flags & RatesFlag.RATE_AND_BEAT_DISAGREE
    assert by_rate.lock_in_rate / WL == pytest.approx(1.02, abs=4 * by_rate.lock_in_rate_u / WL)
    assert abs(by_beat.lock_in_rate - WL) < 4 * by_beat.lock_in_rate_u
    np.testing.assert_allclose(by_rate.rate_mismatch, 1 / 1.02 - 1, atol=1e-3)
    # Given too low instead, the beat is faster than such a rate could make it: the scale factor may be that.
    low = fit_rates(made, input_rate=np.repeat(0.95 * both_senses(4, 8, 16) * WL, 4), reference="beat")
    assert abs(low.lock_in_rate - by_beat.lock_in_rate) < 1e-9
    by_low = fit_rates(made, input_rate=np.repeat(0.95 * both_senses(4, 8, 16) * WL, 4))
    assert by_low.flags & RatesFlag.RATE_AND_BEAT_DISAGREE
    assert by_low.lock_in_rate / WL == pytest.approx(0.95, abs=4 * by_low.lock_in_rate_u / WL)
    assert by_low.scale_factor == pytest.approx(K / 0.95, abs=5 * by_low.scale_factor_u + 1e-4 * K)
    assert f"{by_low.scale_factor:.6g}"[:3] in describe_rates(by_low)[-2]


def test_locked_records_bound_the_lock_in_rate_from_below():
    rng = np.random.default_rng(9)
    made = estimates([4, -4], 1, rng, noise=0.03)
    times = np.arange(2500) * 1e-4
    quiet = 0.3 + rng.normal(scale=0.03, size=(2, times.size))
    rates = np.array([0.0498, 0.02])
    locked = estimate_lock_in(quiet, 1e-4, scale_factor=K, input_rate=rates)
    assert not locked.usable.any()
    free, held = fit_rates(made), fit_rates([*made, locked])
    assert held.at_least == 0.0498 and list(held.locked) == [False, False, True, True]
    assert free.lock_in_rate_low_95 < held.lock_in_rate_low_95 == 0.0498
    assert held.lock_in_rate >= 0.0498
    assert held.flags & RatesFlag.LOCKED_RECORDS and not held.flags & RatesFlag.RECORDS_LEFT_OUT
    # No beat far above the threshold is no lock-in.
    fault = estimate_lock_in(quiet[:1], 1e-4, scale_factor=K, input_rate=0.5)
    odd = fit_rates([*made, fault])
    assert odd.flags & RatesFlag.NO_BEAT_ABOVE_LOCK_IN and odd.at_least == 0
    assert odd.lock_in_rate == pytest.approx(free.lock_in_rate, rel=1e-12)
    assert any("cable" in s for s in describe_rates(odd))


def test_a_rate_below_lock_in_that_shows_a_beat_is_flagged():
    """The table says 0.9 WL where the axis had 1.1 WL: by the rates the fit complains, by the beat it is right."""
    rng = np.random.default_rng(10)
    records, interval = volts(1.1 * WL, 1, rng, noise=1e-3)
    odd = estimate_lock_in(records, interval, scale_factor=K, input_rate=0.9 * WL)
    made = estimates(both_senses(4, 8), 8, rng, noise=1e-3)
    by_rate = fit_rates([*made, odd])
    assert by_rate.flags & RatesFlag.RATE_BELOW_LOCK_IN or by_rate.flags & RatesFlag.RATE_AND_BEAT_DISAGREE
    assert by_rate.flags & RatesFlag.MISFIT
    assert by_rate.flags & RatesFlag.ONE_RATE_DISAGREES
    by_beat = fit_rates([*made, odd], reference="beat")
    assert abs(by_beat.lock_in_rate - WL) < 4 * by_beat.lock_in_rate_u < 0.01 * WL


def test_leaving_out_the_bad_rate_names_it():
    rng = np.random.default_rng(11)
    made = estimates(both_senses(3, 5, 12), 4, rng, noise=3e-3)
    bad, interval = volts(5 * WL, 4, rng, noise=3e-3)
    made[1] = estimate_lock_in(bad, interval, scale_factor=K, input_rate=5.3 * WL)
    bad, interval = volts(-5 * WL, 4, rng, noise=3e-3)
    made[4] = estimate_lock_in(bad, interval, scale_factor=K, input_rate=-5.3 * WL)
    fit = fit_rates(made)
    assert fit.flags & RatesFlag.ONE_RATE_DISAGREES
    assert np.argmax(np.abs(fit.left_out.deviation)) == 1
    assert fit.left_out.lock_in_rate[1] == pytest.approx(WL, rel=5e-3)
    assert any("0.265" in s for s in describe_rates(fit))


@pytest.mark.slow
def test_without_a_bad_rate_the_left_out_deviations_are_of_unit_size():
    rng = np.random.default_rng(12)
    made = estimates(both_senses(3, 6, 12), 40, rng)
    deviations = np.array([fit_rates([e[k] for e in made]).left_out.deviation for k in range(40)])
    np.testing.assert_allclose(deviations.std(axis=0), 1, atol=0.25)


def test_means_of_records_do_as_well_as_the_records():
    rng = np.random.default_rng(13)
    made = estimates(both_senses(*RATES), 6, rng, hd2=0.005)
    of_means, of_all = fit_rates([combine_estimates(e) for e in made]), fit_rates(made)
    assert of_means.lock_in_rate == pytest.approx(of_all.lock_in_rate, abs=0.5 * of_all.lock_in_rate_u)
    assert of_means.distortion == pytest.approx(of_all.distortion, abs=0.5 * of_all.distortion_u)
    assert of_means.lock_in_rate_u == pytest.approx(of_all.lock_in_rate_u, rel=0.1)


def test_distortion_grows_with_the_amplitude_of_each_record():
    rng = np.random.default_rng(14)
    made = []
    for multiple, size in zip((10, 30, -10, -30), (0.5, 1.5, 0.5, 1.5), strict=True):
        records, interval = volts(multiple * WL, 1, rng, noise=0)
        records = size * records
        records = records + 0.01 * records**2 + rng.normal(scale=1e-4, size=records.shape)
        made.append(estimate_lock_in(records, interval, scale_factor=K, input_rate=multiple * WL))
    fit = fit_rates(made)
    assert fit.lock_in_rate == pytest.approx(WL, rel=2e-4)
    # The square law 0.01 x^2 at the mean amplitude, 1.
    assert fit.distortion == pytest.approx(0.005, rel=5e-3)
    assert fit.p_value > 1e-3


def test_rates_too_close_together_say_so():
    rng = np.random.default_rng(15)
    fit = fit_rates(estimates([8, 8.2], 4, rng, hd2=0.005))
    assert fit.flags & RatesFlag.RATES_TOO_CLOSE
    assert fit.cost > 10
    assert any("too close" in s for s in describe_rates(fit))
    assert abs(fit.lock_in_rate - WL) < 4 * fit.lock_in_rate_u
    # In both senses the same rates do well.
    assert not fit_rates(estimates(both_senses(8, 8.2), 4, rng)).flags & RatesFlag.RATES_TOO_CLOSE


def test_one_rate_in_one_sense_is_refused():
    rng = np.random.default_rng(16)
    made = estimates([8], 5, rng)
    with pytest.raises(ValueError, match="other sense of rotation"):
        fit_rates(made)
    with pytest.raises(ValueError, match="'both'"):
        fit_rates(made, model="both")
    plain = fit_rates(made, model="lock-in")
    assert plain.lock_in_rate == pytest.approx(float(combine_estimates(made[0]).lock_in_rate), rel=1e-3)
    assert any("taken to be zero" in s for s in describe_rates(plain))


def test_records_that_cannot_be_used_are_counted():
    rng = np.random.default_rng(17)
    made = estimates(both_senses(5, 10), 2, rng)
    whole = fit_rates(made)
    rho = np.concatenate([e.complex_ratio for e in made])
    covariance = np.concatenate([e.complex_ratio_covariance for e in made])
    rate, beat = (np.concatenate([getattr(e, name) for e in made]) for name in ("input_rate", "beat_frequency"))
    rho[3] = np.nan
    fit = fit_rate_ratios(rate, rho, covariance, beat, scale_factor=K)
    assert fit.flags & RatesFlag.RECORDS_LEFT_OUT and fit.used.sum() == 7
    assert any("1 of 8 records" in s for s in describe_rates(fit))
    assert fit.lock_in_rate == pytest.approx(whole.lock_in_rate, abs=2 * whole.lock_in_rate_u)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"input_rate": [np.nan, -1.0]}, "finite and not zero"),
        ({"input_rate": [0.0, -1.0]}, "finite and not zero"),
        ({"beat_frequency": [1.0, 2.0, 3.0]}, "must hold 2 values"),
        ({"covariance": np.eye(3)}, r"shape \(2, 2, 2\)"),
        ({"scale_factor": 0.0}, "scale_factor"),
        ({"reference": "table"}, "neither"),
        ({"model": "everything"}, "none of"),
        ({"input_rate_u": -1.0}, "input_rate_u"),
        ({"ratio": [np.nan, np.nan]}, "no record with a usable beat"),
    ],
)
def test_bad_input_is_named(change, message):
    good = {
        "input_rate": [1.0, -1.0],
        "ratio": [-0.05, 0.05],
        "covariance": np.eye(2) * 1e-8,
        "beat_frequency": [1990.0, 1990.0],
        "scale_factor": 2000.0,
    }
    fit = fit_rate_ratios(**good)  # the mean over gain corners that nobody stated
    assert abs(fit.lock_in_rate - 0.1) < fit.lock_in_rate_u < 0.005
    with pytest.raises(ValueError, match=message):
        fit_rate_ratios(**{**good, **change})


def test_estimates_without_a_sense_are_refused():
    records, interval = volts(0.4, 2, np.random.default_rng(18))
    blind = estimate_lock_in(records, interval, scale_factor=K)
    with pytest.raises(ValueError, match="sense of rotation must be known"):
        fit_rates(blind)
    with pytest.raises(ValueError, match="no record"):
        fit_rates([])
    assert fit_rates(
        blind, input_rate=[0.4, 0.4], model="lock-in", reference="beat"
    ).lock_in_rate == pytest.approx(WL, rel=0.05)


def test_a_rate_uncertainty_is_part_of_the_answer():
    """Rates known to 2 %, independently: the lock-in rate of a quiet pair is known to 2 %/sqrt 2."""
    rng = np.random.default_rng(19)
    made = estimates([8, -8], 1, rng, noise=1e-5)
    fit = fit_rates(made, input_rate_u=0.02 * 8 * WL, model="lock-in")
    assert fit.lock_in_rate_u / fit.lock_in_rate == pytest.approx(0.02 / np.sqrt(2), rel=0.05)
