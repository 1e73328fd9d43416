"""A converter whose codes are uneven each by itself: counted and not doubted, while other misfits stay flagged."""

import numpy as np
import pytest
from bench_signals import WL, K, both_senses, volts

from analysis import estimate_lock_in
from analysis.several_rates import RatesFlag, fit_rate_ratios, fit_rates

MISFITS = RatesFlag.MISFIT | RatesFlag.ONE_RATE_DISAGREES
MULTIPLES = both_senses(3, 5, 9, 17, 30)


def converted(records, widths):
    """Levels of a converter of 200 levels over the amplitude of 1, of which each is too wide by so much."""
    thresholds = np.cumsum(1 + widths - np.mean(widths))
    thresholds -= thresholds[thresholds.size // 2]
    return np.digitize(100 * records, thresholds).astype(float)


def run(rng, widths, phase):
    made = []
    for multiple in MULTIPLES:
        records, interval = volts(multiple * WL, 4, rng, phase=phase, periods=20.3)
        made.append(
            estimate_lock_in(converted(records, widths), interval, scale_factor=K, input_rate=multiple * WL)
        )
    return fit_rates(made, reference="beat")


@pytest.mark.slow
def test_uneven_codes_are_counted_and_set_no_flag():
    pulls, us, told = [], [], 0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        fit = run(rng, rng.uniform(0.1, 0.3) * rng.normal(size=300), rng.uniform(0, 2 * np.pi))
        assert not fit.flags & MISFITS
        told += "uneven codes" in fit.noise_model
        pulls.append((fit.lock_in_rate - WL) / fit.lock_in_rate_u)
        us.append(fit.lock_in_rate_u / WL)
    assert np.sqrt(np.mean(np.square(pulls))) < 1.5 and np.abs(pulls).max() < 3.5
    assert np.median(us) < 3e-3 and told > 6


def test_even_codes_cost_nothing():
    fit = run(np.random.default_rng(1), np.zeros(300), 1.0)
    assert fit.lock_in_rate_u < 1.1e-3 * WL and not fit.flags & MISFITS


@pytest.mark.parametrize(("direction", "size"), [(1j, 1e-3), (1, 4e-3)])
def test_what_no_codes_do_to_a_ratio_is_still_a_misfit(direction, size):
    rng = np.random.default_rng(7)
    rates = WL * MULTIPLES
    beats = K * np.sqrt(rates**2 - WL**2)
    ratio = WL / (np.abs(rates) + beats / K)
    own = np.where(rates > 0, -ratio * np.exp(0.9j), ratio * np.exp(-0.9j))
    u = 1.4e-4
    shaken = own + u * (rng.normal(size=rates.size) + 1j * rng.normal(size=rates.size))
    shaken += size * direction * rng.choice([-1, 1], rates.size)
    fit = fit_rate_ratios(
        rates, shaken, u**2 * np.eye(2), beats, scale_factor=K, reference="beat",
        third_harmonic=u * rng.normal(size=rates.size), third_harmonic_u=u,
    )  # fmt: skip
    assert fit.flags & MISFITS
