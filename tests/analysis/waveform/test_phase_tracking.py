import numpy as np
import pytest

from analysis import estimate_lock_in, flag_names, rate_varying_beat

N, PERIODS, X = 2500, 60.3, 0.1
TIME = np.arange(N) / N


def wandering_record(rng, shape, rms, noise=0.5, x=X):
    """Codes of a gyro whose beat phase departs from a straight line by `rms` rad; K for an interval of 1 s."""
    k = PERIODS / N / np.sqrt(1 - x * x)
    wander = shape(rng)
    wander = wander - np.polyval(np.polyfit(TIME, wander, 1), TIME)
    wander *= rms / wander.std()
    frequency = np.gradient(2 * np.pi * PERIODS * TIME + wander)[:-1] / (2 * np.pi)
    volts = rate_varying_beat(
        np.hypot(frequency / k, x),
        1.0,
        scale_factor=k,
        lock_in_rate=x,
        amplitude=90,
        initial_phase=rng.uniform(0, 6),
        backscatter_phase=1.0,
    )
    return k, np.rint(volts + rng.normal(scale=noise, size=N))


def ripple(rng):
    return np.sin(2 * np.pi * (rng.uniform(1, 3) * TIME + rng.uniform()))


def ramp(_rng):
    return (TIME - 0.5) ** 2


@pytest.mark.parametrize("shape", [ripple, ramp])
@pytest.mark.parametrize("rms", [0.1, 0.5, 1.5, 3.0])
def test_a_wandering_phase_costs_neither_bias_nor_honesty(shape, rms):
    rng = np.random.default_rng(40)
    z, flags, u = [], set(), []
    for _ in range(12):
        k, codes = wandering_record(rng, shape, rms)
        e = estimate_lock_in(codes, 1.0, scale_factor=k)
        z.append((float(e.lock_in_rate) - X) / float(e.lock_in_rate_u))
        u.append(float(e.lock_in_rate_u) / X)
        flags |= set(flag_names(int(e.flags)))
    assert "rate_wander" in flags
    # Chi-square with 12 degrees of freedom: 99.9 % lie below 32.9.
    assert np.sum(np.square(z)) < 32.9
    # Without wander this record gives u = 0.36 %.
    assert np.mean(u) < 0.0042


@pytest.mark.parametrize("x", [0.8, 0.93])
@pytest.mark.parametrize("rms", [0.3, 1.5])
def test_next_to_lock_in_where_every_harmonic_has_its_sidebands(x, rms):
    rng = np.random.default_rng(44)
    z = []
    for _ in range(8):
        k, codes = wandering_record(rng, ripple, rms, x=x)
        e = estimate_lock_in(codes, 1.0, scale_factor=k)
        assert "rate_wander" in flag_names(int(e.flags))
        assert e.usable
        z.append((float(e.lock_in_rate) - x) / float(e.lock_in_rate_u))
    # Chi-square with 8 degrees of freedom: 99.9 % lie below 26.1.
    assert np.sum(np.square(z)) < 26.1


def test_the_deficit_without_tracking_is_what_theory_says_and_tracking_removes_it():
    """At constant frequency a phase wander of s rad loses 1 - exp(-1.5 s^2) of the ratio: 5.8 % at 0.2 rad."""
    from analysis.harmonics import fit_harmonics

    rng = np.random.default_rng(41)
    lost, left = [], []
    for _ in range(10):
        k, codes = wandering_record(rng, ripple, 0.2, noise=0.3)
        fit = fit_harmonics(codes, 1.0, harmonics=4)
        lost.append(float(np.abs(fit.amplitudes[1] / fit.amplitudes[0])) / 0.0501256 - 1)
        left.append(float(estimate_lock_in(codes, 1.0, scale_factor=k).ratio) / 0.0501256 - 1)
    assert np.mean(lost) == pytest.approx(-0.058, abs=0.02)
    assert abs(np.mean(left)) < 0.002


def test_a_steady_rate_is_not_called_wandering():
    rng = np.random.default_rng(42)
    for _ in range(10):
        k, codes = wandering_record(rng, ripple, 1e-4)
        assert flag_names(int(estimate_lock_in(codes, 1.0, scale_factor=k).flags)) == []
