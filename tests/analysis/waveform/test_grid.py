"""The estimator on random gyros of the whole working range, against the Cramér-Rao bound and an integrator.

Limits are those of chance: three standard deviations, or the same probability shared among cells.
"""

from itertools import pairwise

import numpy as np
import pytest
from reference import bound, integrated_beat, random_records, slow_fit
from scipy.stats import chi2, norm

from analysis import estimate_lock_in

CHANCE = 2 * norm.sf(3)
X_EDGES = (1.02, 1.5, 5, 20, 100)
PERIOD_EDGES = (2.5, 10, 60, 590)


@pytest.fixture(scope="module")
def grid():
    """Codes, truths, noises, errors of lock-in rate in units of the bound, and what divides records into cells."""
    rng = np.random.default_rng(40)
    times, codes, truths, noises = random_records(
        rng, 1500, x_range=(1.02, 100), noise_range=(0.3, 4), periods_range=(2.5, 590)
    )
    estimates = estimate_lock_in(codes, 1.0, scale_factor=1.0)
    k = np.array([truth["k"] for truth in truths])
    wl = np.array([truth["wl"] for truth in truths])
    f_over_k = np.array([truth["f_over_k"] for truth in truths])
    u = np.array([bound(times, truth, noise) for truth, noise in zip(truths, noises, strict=True)])
    ratio = np.tan(np.arctan(wl / f_over_k) / 2)
    # r = tan(atan(WL K/f)/2); f is known so well beside r that its part in u does not matter here.
    ratio_u = u / f_over_k * (1 - ratio**2) ** 2 / (2 * (1 + ratio**2))
    return {
        "times": times,
        "codes": codes,
        "truths": truths,
        "noises": noises,
        "estimates": estimates,
        "frequency": k * f_over_k,
        "amplitude": np.array([truth["amplitude"] for truth in truths]),
        "ratio": ratio,
        "error": (estimates.lock_in_rate / k - wl) / u,
        "significant": ratio > 5 * ratio_u,
        "x": np.hypot(f_over_k, wl) / wl,
        "periods": 2500 * k * f_over_k,
    }


def largest_rms(n, chance=CHANCE):
    """The rms of n unit Gaussians that is exceeded with this probability."""
    return np.sqrt(chi2.isf(chance, n) / n)


def test_pooled_error_is_that_of_the_bound(grid):
    error = grid["error"][grid["significant"]]
    assert error.size > 1200
    rms = np.sqrt(np.mean(error**2))
    assert rms < largest_rms(error.size)
    assert rms > np.sqrt(chi2.ppf(CHANCE, error.size) / error.size)  # better than the bound: the bound is wrong


@pytest.mark.slow
def test_pooled_bias_is_within_chance(grid):
    error = grid["error"][grid["significant"]]
    assert abs(error.mean()) < 3 / np.sqrt(error.size)


def test_no_cell_stands_out(grid):
    cells = []
    for x_from, x_to in pairwise(X_EDGES):
        for p_from, p_to in pairwise(PERIOD_EDGES):
            chosen = grid["significant"] & (x_from <= grid["x"]) & (grid["x"] < x_to)
            chosen &= (p_from <= grid["periods"]) & (grid["periods"] < p_to)
            cells.append(((x_from, p_from), grid["error"][chosen]))
    assert min(error.size for _, error in cells) >= 25
    for name, error in cells:
        assert np.sqrt(np.mean(error**2)) < largest_rms(error.size, CHANCE / len(cells)), name
        assert abs(error.mean()) < norm.isf(CHANCE / len(cells) / 2) / np.sqrt(error.size), name


def test_no_frequency_is_a_wrong_line(grid):
    """Six standard deviations of a series of harmonics k A_k; twice as many where under ten periods correlate."""
    r = grid["ratio"]
    strength = grid["amplitude"] * np.sqrt((1 + r**2) / (1 - r**2))
    u = np.sqrt(24) * grid["noises"] / (2 * np.pi * strength * 2500**1.5)
    limit = np.where(grid["periods"] < 10, 12, 6) * u
    wrong = ~(np.abs(grid["estimates"].beat_frequency - grid["frequency"]) < limit)
    assert not wrong.any(), np.flatnonzero(wrong)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("periods", "x"), [((2.5, 2.8), (1.02, 1.06)), ((2.5, 5.0), (1.02, 1.1)), ((400, 590), (1.02, 1.1))]
)
def test_the_start_is_found_in_the_hard_corners_next_to_lock_in(periods, x):
    """Lines not yet apart; harmonics folded almost onto each other, at 4.5, 5 and 6 samples a period."""
    rng = np.random.default_rng(42)
    _, codes, truths, _ = random_records(rng, 1000, x_range=x, noise_range=(0.3, 4), periods_range=periods)
    found = estimate_lock_in(codes, 1.0, scale_factor=1.0)
    assert found.usable.all()
    true = np.array([truth["k"] * truth["f_over_k"] for truth in truths]) * 2500
    assert np.abs(found.periods - true).max() < 0.2


def test_every_record_gives_a_rate(grid):
    assert grid["estimates"].usable.all()
    assert np.isfinite(grid["estimates"].lock_in_rate_u).all()


@pytest.mark.slow
def test_the_value_is_that_of_a_general_optimiser_all_over_the_grid(grid):
    """The same likelihood minimised by `least_squares` on the samples; rounding is noise above half a level."""
    chosen = np.flatnonzero(grid["significant"] & (grid["noises"] > 0.6))[:60]
    for number in chosen:
        truth = grid["truths"][number]
        one = grid["estimates"][int(number)]
        size = np.abs(one.complex_ratio)
        raw = float(one.beat_frequency) / truth["k"] * 2 * size / (1 - size**2)
        slow = slow_fit(grid["times"], grid["codes"][number], truth)
        u = bound(grid["times"], truth, grid["noises"][number])
        assert raw == pytest.approx(slow, abs=0.02 * u), truth


@pytest.mark.slow
def test_from_the_differential_equation_to_the_rate():
    """Nothing but the equation of motion, integrated; codes; the estimate: no closed form on the way."""
    rng = np.random.default_rng(41)
    times = np.arange(2500) * 1e-4
    z = []
    for x in (0.05, 0.1, 0.5, 0.9, 0.97):
        for sense in (1, -1):
            wl = 0.05
            beat = integrated_beat(
                times,
                2000,
                sense * wl / x,
                wl,
                amplitude=90,
                phi0=rng.uniform(0, 6.28),
                beta=rng.uniform(0, 6.28),
                delta=rng.uniform(0, 6.28),
            )
            codes = np.rint(beat + rng.normal(scale=1.0, size=2500))
            for rate in (None, sense * wl / x):
                e = estimate_lock_in(codes, 1e-4, scale_factor=2000, input_rate=rate)
                z.append((float(e.lock_in_rate) - wl) / float(e.lock_in_rate_u))
    own, given = np.array(z[0::2]), np.array(z[1::2])
    for values in (own, given):
        assert np.sum(values**2) < chi2.isf(CHANCE, values.size)
