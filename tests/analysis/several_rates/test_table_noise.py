"""Rates that are wrong, each in its own way, with the rate as reference: the beats show it, and u counts it."""

import numpy as np
import pytest
from bench_signals import WL, K, both_senses

from analysis import RatesFlag, fit_rate_ratios

NOISE = 1e-4


def fitted(multiples, rng, *, table=0.0, noise=NOISE, records=1, **options):
    """Ratios of an ideal gyro at rates that the table missed by a share of each, the same for all its records."""
    given = np.repeat(WL * np.array(multiples), records)
    missed = np.repeat(table * rng.standard_normal(len(multiples)), records)
    size = np.abs(given * (1 + missed))
    r = np.tan(np.arcsin(WL / size) / 2)
    z = np.exp(1j * rng.uniform(0, 2 * np.pi))
    ratio = np.where(given > 0, -r * z, r * np.conj(z))
    ratio = ratio + noise * (rng.standard_normal(r.size) + 1j * rng.standard_normal(r.size))
    return fit_rate_ratios(
        given, ratio, np.eye(2) * noise**2, K * np.sqrt(size**2 - WL**2), scale_factor=K, **options
    )


@pytest.mark.slow
def test_table_noise_that_the_beats_show_is_counted():
    """Without it 0.1 % of each rate is wrong by many standard uncertainties, and nothing says so."""
    fits = [fitted(both_senses(1.2, 2, 4), np.random.default_rng(n), table=1e-3) for n in range(10)]
    assert 0.5 < np.sqrt(np.mean([((f.lock_in_rate - WL) / f.lock_in_rate_u) ** 2 for f in fits])) < 1.5
    assert sum(f.lock_in_rate_low_95 <= WL <= f.lock_in_rate_high_95 for f in fits) >= 9
    assert not any(f.flags & RatesFlag.MISFIT for f in fits)


def test_a_table_that_does_not_matter_changes_nothing():
    """0.002 % of each rate is far below what the ratios leave open: a scale factor is not table noise either."""
    rng = np.random.default_rng(1)
    exact = fitted(both_senses(3, 5, 9), np.random.default_rng(1), noise=1e-3)
    ripple = fitted(both_senses(3, 5, 9), rng, noise=1e-3, table=2e-5)
    assert ripple.lock_in_rate_u == pytest.approx(exact.lock_in_rate_u, rel=0.01)


def test_a_stated_uncertainty_of_the_rates_counts_in_full_near_lock_in():
    """One to one, at 1.2 WL as at 8 WL, where r falls nearly twice as fast as the rate rises."""
    for multiple in (1.2, 8):
        rates_u = 0.01 * multiple * WL
        fit = fitted([multiple], np.random.default_rng(2), noise=1e-6, input_rate_u=rates_u, model="lock-in")
        assert fit.lock_in_rate_u == pytest.approx(0.01 * WL, rel=0.05)


@pytest.mark.slow
def test_rates_within_what_was_stated_of_them_are_neither_left_out_nor_flagged():
    multiples = both_senses(3, 5, 9, 17, 30)
    stated = 5e-3 * np.abs(WL * np.array(multiples))
    doubt, silent = RatesFlag.RECORDS_LEFT_OUT | RatesFlag.RATE_AND_BEAT_DISAGREE, 0
    for n in range(3):
        silent |= fitted(multiples, np.random.default_rng(n), table=3e-3, noise=1e-3).flags
        told = fitted(multiples, np.random.default_rng(n), table=3e-3, noise=1e-3, input_rate_u=stated)
        assert not told.flags & doubt and told.used.all()
    assert silent & doubt == doubt
