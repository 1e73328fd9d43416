"""Which solution of several rates is taken: all minima are found and shown, statements are tested."""

import numpy as np
import pytest
import scipy.optimize
from bench_signals import WL, K, both_senses, estimates, ratios_of_slow_gain

from analysis import RatesFlag, fit_rate_ratios, fit_rates
from analysis.budget import BenchKnowledge
from analysis.several_rates.ratio_model import RatioData, beyond_first_order, predicted, third_harmonic_share
from benchmarks.several_rates.__main__ import LOCK_IN, NOISE, drawn, times

PHASES = np.arange(36) * np.pi / 18


@pytest.mark.slow
@pytest.mark.parametrize("reference", ["rate", "beat"])
def test_rates_close_above_the_threshold_are_found_at_every_phase(reference):
    """1.2, 2 and 4 times lock-in without noise: many starts lie above the slowest rate."""
    rng = np.random.default_rng(0)
    for phase in PHASES[::4]:
        fit = drawn((1.2, 2, 4), 1, phase, 0.0, rng, reference=reference, distortion=0.005)
        assert fit.lock_in_rate == pytest.approx(LOCK_IN, rel=1e-3)


@pytest.mark.slow
def test_two_rates_in_one_sense_show_both_solutions():
    """3 and 30 times lock-in without noise: four values and three unknowns that are free have two solutions."""
    rng = np.random.default_rng(0)
    several = 0
    for phase in PHASES[::4]:
        fit = drawn((3, 30), 1, phase, 0.0, rng, distortion=0.005)
        found = [fit.lock_in_rate, *(one.lock_in_rate for one in fit.alternatives)]
        assert fit.lock_in_rate_low_95 <= LOCK_IN <= fit.lock_in_rate_high_95
        assert bool(fit.flags & RatesFlag.SEVERAL_SOLUTIONS) == bool(fit.alternatives)
        # those that are shown differ by more than each of them is uncertain by itself
        assert len({round(value / LOCK_IN, 3) for value in found}) == len(found)
        several += len(found) > 1
    assert several >= 2


@pytest.mark.slow
def test_a_bent_valley_is_sounded_to_its_ends():
    """3 and 30 times lock-in: at these phases the valley goes on far beyond what its curvature says."""
    for number, phase in enumerate((2.91, 3.36, 5.22, 6.04)):
        rng = np.random.default_rng(number)
        fits = [drawn((3, 30), 8, phase, NOISE, rng) for _ in range(4)]
        assert max(abs(fit.lock_in_rate - LOCK_IN) / fit.lock_in_rate_u for fit in fits) < 4
        assert sum(fit.lock_in_rate_low_95 <= LOCK_IN <= fit.lock_in_rate_high_95 for fit in fits) >= 3


@pytest.mark.parametrize("seed", [2, 3, 5])
def test_a_bench_far_along_the_valley_is_inside(seed):
    """3 and 30 times lock-in, all contaminants within their bounds, far from where the minimum puts them."""
    contaminants = {"distortion": 0.00277, "third_order": 0.00191, "gain_time": 1.04e-4, "lag_square": 9.72e-9}
    fit = drawn((3, 30), 8, 4.476, NOISE, np.random.default_rng(seed), **contaminants)
    assert abs(fit.lock_in_rate - LOCK_IN) < 2.5 * fit.lock_in_rate_u
    assert fit.lock_in_rate_low_95 <= LOCK_IN <= fit.lock_in_rate_high_95


@pytest.mark.parametrize("seed, phase", [(10, 6.004), (12, 1.575), (16, 3.56)])
def test_no_solution_is_locked_where_the_gyro_beat(seed, phase):
    """1.2, 2 and 4 times lock-in in much noise: by their ratios alone some lie at four times it."""
    fit = drawn((1.2, 2, 4), 2, phase, 100 * NOISE, np.random.default_rng(seed), gain_time=times(30))
    assert fit.lock_in_rate_low_95 <= LOCK_IN <= fit.lock_in_rate_high_95 <= 1.5 * 1.2 * LOCK_IN
    assert all(one.lock_in_rate < 1.5 * 1.2 * LOCK_IN for one in fit.alternatives)


def test_rates_that_are_not_those_of_the_axis_forbid_no_solution():
    """As those of a table whose axis is tilted: they serve for the sense."""
    phase, rate = 2.50764, np.array([1.2, 2, 4, 1.2, 2, 4]) * LOCK_IN
    frequency, noise = K * np.sqrt(rate**2 - LOCK_IN**2), np.random.default_rng(18).normal(size=(2, 6))
    ratio = np.tan(np.arcsin(LOCK_IN / rate) / 2) * np.exp(1j * phase) / (1 - 1j * frequency / 3000)
    ratio += 0.015 * (noise[0] + 1j * noise[1])
    known, tilted = (
        fit_rate_ratios(given, ratio, np.eye(2) * 0.015**2, frequency, scale_factor=K, reference="beat")
        for given in (rate, 3 * rate)
    )
    assert known.lock_in_rate_high_95 < 1.5 * 1.2 * LOCK_IN < tilted.lock_in_rate_high_95


def test_a_narrow_valley_is_not_missed():
    """One sense of 8 to 60 times lock-in, where a false minimum lies 5 % lower."""
    rng = np.random.default_rng(1)
    for _ in range(49):  # the fiftieth draw has it
        rng.uniform()
        rng.normal(size=3 * 4 * 8)
    fit = drawn((8, 15, 30, 60), 8, rng.uniform(0, 2 * np.pi), NOISE, rng)
    assert fit.p_value > 1e-3
    assert abs(fit.lock_in_rate - LOCK_IN) < 4 * fit.lock_in_rate_u


def test_a_statement_that_the_records_contradict_is_not_used():
    rng = np.random.default_rng(2)
    rates = both_senses(3, 5.3, 9.5, 17, 30)
    true, false = (BenchKnowledge(distortion_limit=limit) for limit in (0.02, 1e-4))
    believed = drawn(tuple(rates), 3, 1.0, NOISE, rng, receiver=true, distortion=0.01)
    assert not believed.flags & RatesFlag.STATED_LIMITS_EXCEEDED
    contradicted = drawn(tuple(rates), 3, 1.0, NOISE, rng, receiver=false, distortion=0.01)
    assert contradicted.flags & RatesFlag.STATED_LIMITS_EXCEEDED
    for fit in (believed, contradicted):
        assert fit.distortion == pytest.approx(0.01, abs=5 * fit.distortion_u)
        assert abs(fit.lock_in_rate - LOCK_IN) < 5 * fit.lock_in_rate_u < 0.01 * LOCK_IN


@pytest.mark.parametrize("ratio", [0.02, 0.17, 0.4, 0.6])
def test_what_a_cubic_law_leaves_beyond_the_series(ratio):
    """The lines of Y^3 by a discrete transform, less the nearest change of the series by plain least squares."""
    circle = np.exp(2j * np.pi * np.arange(512) / 512)
    light = (circle - ratio) / (1 - ratio * circle)
    lines = np.fft.fft(light**3)[1:200] / 512
    order = np.arange(199)
    changes = np.stack([ratio**order, order * ratio ** np.maximum(order - 1.0, 0)], axis=-1)
    left = lines.real - changes @ np.linalg.lstsq(changes, lines.real, rcond=None)[0]
    assert float(third_harmonic_share(np.array(ratio**2))) == pytest.approx(left[2], abs=1e-12)


def test_a_wrong_scale_factor_does_not_refuse_given_rates():
    rng = np.random.default_rng(3)
    made = estimates(both_senses(3, 8, 20), 2, rng)
    rate, beat = (
        np.concatenate([getattr(one, name) for one in made]) for name in ("input_rate", "beat_frequency")
    )
    ratio, covariance = (
        np.concatenate([getattr(one, name) for one in made])
        for name in ("complex_ratio", "complex_ratio_covariance")
    )
    right = fit_rates(made, reference="rate")
    for share in (0.98, 1.02):
        fit = fit_rate_ratios(rate, ratio, covariance, beat, scale_factor=share * K, reference="rate")
        assert fit.used.all()
        assert fit.flags & RatesFlag.RATE_AND_BEAT_DISAGREE
        assert fit.scale_factor == pytest.approx(K, rel=2e-3)
        assert fit.lock_in_rate == pytest.approx(right.lock_in_rate, rel=2e-3)


@pytest.mark.parametrize("multiples", [(3, 5.3, 9.5, 17, 30), (8, 15, 30, 60)])
@pytest.mark.parametrize("noise, seed", [(1e-4, 5), (3e-4, 4)])
def test_120_degrees_between_the_beams_lie_inside_the_interval(multiples, noise, seed):
    """The intensity equations, integrated, with a gain corner at half the fastest beat: ratios 2 to 20 % off."""
    rng = np.random.default_rng(seed)  # of 24 benches of the first kind one is 2.7 u off, the pull is 1.1
    corner = 0.5 * K * WL * max(multiples)
    rates, ratios, beats = ratios_of_slow_gain(both_senses(*multiples), corner, 2 * np.pi / 3)
    shaken = ratios + noise * (rng.normal(size=ratios.size) + 1j * rng.normal(size=ratios.size))
    fit = fit_rate_ratios(rates, shaken, np.eye(2) * noise**2, beats, scale_factor=K, reference="beat")
    by_ratios = next(model.lock_in_rate for model in fit.models if model.model == "all") / WL - 1
    assert abs(fit.lock_in_rate / WL - 1) < 0.7 * by_ratios and by_ratios > 0.02
    assert fit.flags & (RatesFlag.MISFIT | RatesFlag.RATE_AND_BEAT_DISAGREE)
    assert fit.lock_in_rate_low_95 < WL < fit.lock_in_rate_high_95


def nearest_series(samples, circle):
    """Fundamental and ratio of the geometric series nearest to one period, by least squares, and what is left."""

    def left(parameters):
        first, ratio = complex(*parameters[:2]), complex(*parameters[2:4])
        return (first * circle / (1 - ratio * circle)).real + parameters[4] - samples

    lines = 2 * np.fft.rfft(samples) / samples.size
    start = [
        lines[1].real,
        lines[1].imag,
        (lines[2] / lines[1]).real,
        (lines[2] / lines[1]).imag,
        lines[0].real / 2,
    ]
    found = scipy.optimize.least_squares(left, start, xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    return complex(*found[:2]), complex(*found[2:4]), -left(found)


def distorted(own, third_order, slowness=0.0, second_order=0.0, lag=0.0):
    """Ratio, third harmonic and amplitude of a beat of rho0 = `own` for fast gain, behind a curved law and a pole.

    `slowness` is 2 pi f T: the light I of both beams is 1/(M psi'), M being 1/psi' behind one pole; `lag` that of
    the channel.
    """
    circle = np.exp(2j * np.pi * np.arange(512) / 512)
    r, turn = abs(own), np.conj(own) / abs(own)
    per_speed = 1 + r**2 - 2 * r * circle.real  # 1/psi', but for a constant
    behind_pole = 1 + r**2 - 2 * r * (circle / (1 + 1j * slowness)).real
    light = turn * per_speed / behind_pole * (circle - r) / (1 - r * circle)
    first, ratio, _ = nearest_series(light.real, circle)
    clean = light.real * (1 - abs(ratio) ** 2) / abs(first)
    h = third_order / (1 - 3 * third_order)
    lines = np.fft.rfft((clean + 4 * h * clean**3) / (1 + 3 * h) + 2 * second_order * clean**2)
    samples = np.fft.irfft(lines / (1 + 1j * lag * np.arange(lines.size)))
    first, ratio, left = nearest_series(samples, circle)
    line = 2 * np.mean(left / circle**3) * (np.conj(first) / abs(first)) ** 3
    amplitude = abs(first) / (1 - abs(ratio) ** 2)
    return ratio * abs(first) / first, line.real / amplitude, amplitude


@pytest.mark.parametrize(("slow", "second", "lag"), [(0, 0, 0), (0.3, 0, 0), (2, 0, 0), (0.3, 0.01, 0.2)])
@pytest.mark.parametrize("third_order", [0.01, -0.02])
@pytest.mark.parametrize("phase", [0.4, 1.9, 4.4])
def test_a_receiver_beyond_first_order(third_order, slow, second, lag, phase):
    rate = WL * np.array([1.1, 1.5, 3.0, 20.0])
    beat = np.sqrt(rate**2 - WL**2)
    nothing = np.zeros(rate.size)
    whole = (np.zeros((1, 4, 2, 2)), np.full(4, (1 + lag**2) ** -0.5), nothing, nothing, nothing, "beat")
    data = RatioData(rate, beat, np.ones(4), nothing + 0j, *whole)
    receiver = second, slow, lag**2, third_order
    truth = np.array([[WL * np.cos(phase), WL * np.sin(phase), *receiver, 0.0, 0.0, 0.0, 0.0]])
    own = -np.exp(1j * phase) * WL / (rate + beat)
    exact = np.array([distorted(one, third_order, slow, second, lag) for one in own]).T
    first, more = predicted(truth, data), beyond_first_order(truth, data)
    assert np.abs(exact[0] - first[0]).max() > third_order**2 * np.abs(own).max()
    np.testing.assert_allclose((first[0] + more[0])[0], exact[0], rtol=1e-6)
    np.testing.assert_allclose((first[1] + more[1])[0], exact[1].real, atol=1e-7)


def test_no_lock_in_is_not_changed_by_a_cubic_law():
    nothing = np.zeros(2)
    whole = (np.zeros((1, 2, 2, 2)), np.ones(2), nothing, nothing, nothing, "rate")
    data = RatioData(np.array([1.0, 1.0]), nothing, np.ones(2), nothing + 0j, *whole)
    for lock_in in (0.0, 1.0):
        ratio, third = beyond_first_order(np.array([[lock_in, *(0.0,) * 4, 0.01, *(0.0,) * 4]]), data)
        assert np.all(ratio == 0) and np.all(third == 0)


@pytest.mark.parametrize("corner", [np.inf, 15.0])
def test_third_order_distortion_that_is_seen_leaves_nothing(corner):
    """-34 dBc on the beat itself, without noise: (1) alone is 0.08 % off, with the gain corner at 15 WL 0.4 %."""
    rates = WL * both_senses(3, 5, 9, 17, 30)
    beat = K * np.sqrt(rates**2 - WL**2)
    r = WL / (np.abs(rates) + beat / K)
    own = np.where(rates > 0, -r * np.exp(0.9j), r * np.exp(-0.9j))
    slowness = beat / K / WL / corner
    ratio, third, amplitude = np.array(
        [distorted(one, 0.02, slow) for one, slow in zip(own, slowness, strict=True)]
    ).T
    known = {"third_harmonic": third.real, "third_harmonic_u": 1e-6}
    uneven = 0.0
    if np.isfinite(corner):  # a laser says how much light makes the amplitude; H is of the mean of all
        known["amplitude"], uneven = 1e3 * amplitude.real, np.ptp(amplitude.real)
    for reference in ("rate", "beat"):
        fit = fit_rate_ratios(rates, ratio, np.eye(2) * 1e-12, beat, scale_factor=K, reference=reference, **known)
        assert fit.third_order == pytest.approx(0.02, rel=1e-4 + uneven)
        assert fit.lock_in_rate == pytest.approx(WL, rel=3e-5)
        assert fit.gain_time == pytest.approx(1 / (2 * np.pi * corner * K * WL), rel=1e-3, abs=1e-9)
