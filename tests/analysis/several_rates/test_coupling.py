"""Coupling without loss: what beats and rates say of it, against the integrated equations of the laser."""

import numpy as np
import pytest
from bench_signals import WL, K, both_senses, ratios_of_slow_gain, volts

from analysis import estimate_lock_in, fit_rate_ratios, fit_rates
from analysis.budget import BenchKnowledge
from analysis.several_rates import RatesFlag, fit_again
from benchmarks import sbc

NOISE = 1e-4
CORNER = 15 * K * WL
RATES = both_senses(3, 5.3, 9.5, 17, 30)


def fitted(
    phase_sum,
    *,
    rates=RATES,
    corner=CORNER,
    steady=1e-5,
    wrong=0.0,
    reference="beat",
    seed=1,
    scale_factor=K,
    **laser,
):
    """Records of a laser with its gain corner among the rates, noise on ratios and beats; rates may be wrong."""
    rng = np.random.default_rng(seed)
    rate, ratio, beat = ratios_of_slow_gain(rates, corner, np.deg2rad(phase_sum), **laser)
    ratio = ratio + NOISE * (rng.normal(size=rate.size) + 1j * rng.normal(size=rate.size))
    beat = beat * (1 + steady * rng.normal(size=rate.size))
    covariance, beat_u = np.eye(2) * NOISE**2, steady * beat
    rate = rate * (1 + wrong * rng.normal(size=rate.size))
    return fit_rate_ratios(
        rate, ratio, covariance, beat, scale_factor=scale_factor, beat_frequency_u=beat_u, reference=reference
    )


def test_beats_that_follow_the_rates_rule_coupling_out():
    """Where nothing tests it, up to (tan(30 deg) K WL/corner * 3)^2 = 1.3 % may be in the value: 60 deg."""
    steady = fitted(0.0)
    assert steady.lock_in_rate_u < 0.0012 * WL
    assert abs(steady.lock_in_rate / WL - 1) < 0.005
    # beats scattered by 1 % about their rates tell nothing
    assert fitted(0.0, steady=0.01).lock_in_rate_u > max(0.004 * WL, 15 * steady.lock_in_rate_u)


@pytest.mark.parametrize("reference", ["beat", "rate"])
@pytest.mark.parametrize("phase_sum", [20, 40, 60])
def test_coupling_that_ratios_and_beats_show_is_taken_out(phase_sum, reference):
    """By the model without it the lock-in rate is too high by 0.75 to 1.22 times the share."""
    fit = fitted(phase_sum, reference=reference)
    share = (3 * np.tan(np.deg2rad(phase_sum / 2)) * K * WL / CORNER) ** 2
    assert fit.lock_in_rate_low_95 < WL < fit.lock_in_rate_high_95
    assert abs(fit.lock_in_rate / WL - 1) < 0.1 * share + 0.0005
    assert fit.lock_in_rate_u / WL < 0.1 * share + 0.0009
    assert not fit.flags & RatesFlag.STATED_LIMITS_EXCEEDED  # that the receiver makes no third harmonic


@pytest.mark.parametrize("reference", ["beat", "rate"])
@pytest.mark.parametrize("rates", [RATES, pytest.param(RATES[RATES > 0], marks=pytest.mark.slow)])
def test_lasers_beyond_what_is_usual_are_found_too(rates, reference):
    """Up to 80 degrees, a2/a1 of 4 and cross saturation of 0.2 to 0.8: without these up to 10 u off."""
    rng, pulls = np.random.default_rng(11), []
    for seed in range(6):
        of = {"backscatter_ratio": 4 ** rng.uniform(-1, 1), "cross_saturation": rng.uniform(0.2, 0.8)}
        fit = fitted(rng.uniform(0, 80), rates=rates, reference=reference, steady=1e-4, seed=seed, **of)
        pulls.append((fit.lock_in_rate - WL) / fit.lock_in_rate_u)
        assert fit.lock_in_rate_u < 0.02 * WL
    assert np.max(np.abs(pulls)) < 3.3 and np.sqrt(np.mean(np.square(pulls))) < 1.6


@pytest.mark.parametrize("wrong", [1e-3, pytest.param(1e-4, marks=pytest.mark.slow)])
def test_rates_that_are_wrong_each_by_itself_tell_less_of_the_laser(wrong):
    """Nobody stated it. A laser that follows such rates goes far for it, or there is none."""
    rng = np.random.default_rng(3)
    fits = [fitted(rng.uniform(0, 60), wrong=wrong, seed=seed, backscatter_ratio=1.6) for seed in range(5)]
    pulls = np.array([(fit.lock_in_rate - WL) / fit.lock_in_rate_u for fit in fits])
    assert np.max(np.abs(pulls)) < 3.3 and np.sqrt(np.mean(pulls**2)) < 1.6
    assert max(fit.lock_in_rate_u for fit in fits) < 0.01 * WL


@pytest.mark.parametrize("rates", [RATES, RATES[RATES > 0]])
@pytest.mark.parametrize(
    ("ratio", "phase_sum"),
    [(1.5, 50), (2.5, 0), *(pytest.param(*of, marks=pytest.mark.slow) for of in [(1.5, 0), (2.5, 20)])],
)
def test_unequal_backscatter_pushes_the_beats_too(rates, ratio, phase_sum):
    """It does so in phase, where it makes the lock-in rate no larger: the ratios tell the two apart."""
    for reference in ("beat", "rate"):
        fit = fitted(phase_sum, rates=rates, corner=10 * K * WL, reference=reference, backscatter_ratio=ratio)
        assert abs(fit.lock_in_rate - WL) < 2.6 * fit.lock_in_rate_u < 0.06 * WL


@pytest.mark.slow
def test_four_beats_of_stated_uncertainty_rule_out_most_of_it():
    """Two rates in both senses leave one degree of freedom; that alone would make u three times the error."""
    fits = [fitted(0.0, rates=both_senses(3, 9.5), seed=seed) for seed in range(8)]
    u = np.array([fit.lock_in_rate_u for fit in fits]) / WL
    error = np.array([fit.lock_in_rate for fit in fits]) / WL - 1
    assert np.median(u) < 0.0005 and u.max() < 0.0012  # the larger ones count two valleys
    assert 0.5 < np.sqrt(np.mean((error / u) ** 2)) < 1.4


def test_where_no_laser_can_be_found_the_answer_is_doubtful():
    """Coupling too strong for a gain so slow: searches fail, and no warning of theirs reaches anybody."""
    fit = fitted(40, rates=both_senses(1.2, 2, 4), corner=5 * K * WL, backscatter_ratio=1.5)
    assert not fit.lasers and fit.flags & RatesFlag.MISFIT
    assert fit.lock_in_rate_u > 0.24 * WL  # 0.235 without what other backscatter may do
    assert fit.lock_in_rate_low_95 < WL < fit.lock_in_rate_high_95


@pytest.mark.parametrize(
    ("plan", "seed"), [("two rates in one sense", 100034), ("default run", 100004), ("channel unstated", 100060)]
)
def test_lasers_that_once_were_missed_or_doubted(plan, seed):
    """One minimum of equation (1) hid another, no single rate disagrees, and drifts are those of the laser."""
    found = sbc.outcome(sbc.PLANS[plan], 1.0, None, seed)
    assert abs(found.pull) < 2.6 and found.covered and not found.doubtful


def test_the_valley_of_the_other_stronger_beam_is_found():
    """The stronger beam may be the one or the other; parts begun along slopes stayed in one: 6.6 u off."""
    found = sbc.outcome(sbc.PLANS["one sense"], 1.0, None, 100182)
    assert abs(found.pull) < 2.6 and not found.doubtful


def test_rates_that_come_from_the_beats_test_nothing():
    """The record's own rate follows the beat, whatever pushes it."""
    rng, made = np.random.default_rng(5), []
    for multiple in RATES:
        records, interval = volts(multiple * WL, 2, rng, gain_corner_hz=CORNER)
        made.append(estimate_lock_in(records, interval, scale_factor=K))
    given = np.repeat(RATES * WL, 2)
    own = np.sign(given) * np.concatenate([one.input_rate for one in made])
    known, circular = (fit_rates(made, input_rate=rate, reference="beat") for rate in (given, own))
    assert abs(circular.lock_in_rate - known.lock_in_rate) < 1.2 * circular.lock_in_rate_u
    assert known.lock_in_rate_u < 0.0001 * WL < 0.0018 * WL < circular.lock_in_rate_u


def test_a_fit_repeated_is_the_same_with_rates_as_uncertain_as_they_were():
    rates, ratios, beats = ratios_of_slow_gain(RATES, CORNER, np.deg2rad(40.0))
    u = 1e-3 * np.abs(rates)
    fit = fit_rate_ratios(
        rates, ratios, np.eye(2) * NOISE**2, beats, scale_factor=K, input_rate_u=u, reference="beat"
    )
    again = fit_again(fit, factor=np.ones_like, receiver=BenchKnowledge(third_order_limit=0.0))
    assert fit.lasers and again.lock_in_rate_u == pytest.approx(fit.lock_in_rate_u, rel=1e-6)
    assert abs(again.lock_in_rate - fit.lock_in_rate) < 1e-3 * fit.lock_in_rate_u


def test_a_wrong_scale_factor_is_no_coupling():
    """All beats depart alike from their rates: that is said, and 60 deg between the beams count, not 120."""
    right, wrong = (fitted(0.0, rates=(5, 9, 17), reference="rate", scale_factor=k) for k in (K, 1.02 * K))
    assert wrong.flags & RatesFlag.RATE_AND_BEAT_DISAGREE and not right.flags & RatesFlag.RATE_AND_BEAT_DISAGREE
    assert wrong.lock_in_rate_u == pytest.approx(right.lock_in_rate_u, rel=0.1)


def test_slow_gain_is_no_wrong_scale_factor():
    """The second harmonic of the fast records is half gone, and yet their beats are those of their rates."""
    for reference in ("rate", "beat"):
        fit = fitted(0.0, rates=both_senses(1.2, 2, 4), corner=2.3 * K * WL, reference=reference)
        assert fit.lock_in_rate_low_95 < WL < fit.lock_in_rate_high_95
        assert not fit.flags & (RatesFlag.RATE_AND_BEAT_DISAGREE | RatesFlag.RECORDS_LEFT_OUT)


@pytest.mark.slow
def test_strong_coupling_near_the_threshold_is_found_or_counts():
    """Equation (1) does not hold there: by ratios the answers with the two references are far apart."""
    near = {"rates": both_senses(1.2, 2, 4), "corner": 20 * K * WL}
    by_beat, by_rate = (fitted(108, reference=reference, **near) for reference in ("beat", "rate"))
    of_ratios = [next(one.lock_in_rate for one in fit.models if one.model == "all") for fit in (by_beat, by_rate)]
    assert abs(of_ratios[0] - of_ratios[1]) > 0.01 * WL
    for fit in (by_beat, by_rate):
        assert fit.lasers or fit.flags & (RatesFlag.RATE_AND_BEAT_DISAGREE | RatesFlag.MISFIT)
        assert abs(fit.lock_in_rate - WL) < 2.5 * fit.lock_in_rate_u
