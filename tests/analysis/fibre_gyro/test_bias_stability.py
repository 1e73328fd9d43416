"""The deviation of means over 10 and 100 s, and what is told of noise that is none of the five terms."""

import numpy as np
import pytest
from scipy.signal import lfilter

from analysis.fibre_gyro import (
    allan_variance,
    averaged_periodogram,
    deviation_of_means,
    fit_noise,
    noise_spectrum,
    window_covariance,
)

RATE, TAU, COUNT = 10.0, 10.0, 360


def correlated(rng: np.random.Generator, memory_s: float) -> tuple[np.ndarray, float]:
    """Noise of variance 1 that is forgotten after so many seconds, and the deviation of its means."""
    keep, width = np.exp(-1 / (memory_s * RATE)), round(TAU * RATE)
    words = lfilter([np.sqrt(1 - keep**2)], [1, -keep], rng.standard_normal(4000 + COUNT * width))[4000:]
    lags = np.arange(1, width)
    return words, float(np.sqrt((1 + 2 * np.sum((1 - lags / width) * keep**lags)) / width))


@pytest.mark.parametrize("memory_s", [0.01, 30.0])
def test_the_deviation_of_means_holds_its_interval(memory_s: float) -> None:
    rng = np.random.default_rng(1)
    off = []
    for _ in range(200):
        words, truth = correlated(rng, memory_s)
        value, u = deviation_of_means(words, 1 / RATE, TAU)
        off.append((value - truth) / u)
    assert 0.9 <= np.mean(np.abs(off) < 1.96) <= 0.99
    assert abs(np.mean(off)) < 0.5


def test_missing_words_and_short_records() -> None:
    words, truth = correlated(np.random.default_rng(2), 1.0)
    words[np.random.default_rng(3).random(words.size) < 0.1] = np.nan
    value, u = deviation_of_means(words, 1 / RATE, TAU)
    assert abs(value - truth) < 4 * u
    assert np.isnan(deviation_of_means(words[:500], 1 / RATE, TAU)).all()
    assert np.isnan(deviation_of_means(words, 100.0, TAU)).all()


@pytest.mark.slow
def test_clean_noise_shows_no_misfit() -> None:
    """Of sixty records of all terms none; twelve of them here."""
    for seed in range(12):
        rng = np.random.default_rng(seed)
        words = 8e-4 * rng.standard_normal(20_000)
        if seed % 2:
            words += np.cumsum(rng.standard_normal(words.size)) * 10 ** rng.uniform(-7, -5)
        if seed % 3 == 0:
            words += np.diff(rng.uniform(-1, 1, words.size + 1)) * 1e-3
        fit = fit_noise(words, 0.01)
        assert not fit.lines_hz and not fit.bands and np.isnan([fit.loudness, fit.slow_loudness]).all()


@pytest.mark.slow
def test_noise_of_a_markov_process_is_no_random_walk() -> None:
    rng = np.random.default_rng(3)
    keep = np.exp(-1 / 3000)
    slow = lfilter([np.sqrt(1 - keep**2)], [1, -keep], rng.standard_normal(360_000))
    fit = fit_noise(8e-4 * rng.standard_normal(slow.size) + 1.7e-4 * slow, 0.01)
    assert fit.chosen == ("angle_random_walk", "correlated_noise") and not fit.bands
    truth = {"angle_random_walk": 8e-5, "correlated_noise": 1.7e-4, "correlation_time": 30.0}
    for name, value in truth.items():
        assert fit.low_95[name] < value < fit.high_95[name]
        assert fit.coefficients_u[name] < 0.2 * value


@pytest.mark.slow
def test_a_steady_line_is_taken_out_and_one_that_is_not_is_told() -> None:
    rng = np.random.default_rng(4)
    at, words = np.arange(60_000) * 0.02, 8e-4 * rng.standard_normal(60_000)
    words[1000:1020] = np.nan
    steady = fit_noise(words + 3e-4 * np.cos(2 * np.pi * 1.2345 * at) + 2e-4 * np.sin(2 * np.pi * 11.1 * at), 0.02)
    assert [line.frequency_hz for line in steady.sinusoids] == pytest.approx([1.2345, 11.1], abs=4e-5)
    for line, size in zip(steady.sinusoids, (3e-4, 2e-4), strict=True):
        assert abs(line.amplitude - size) < 3 * line.amplitude_u < 0.1 * size
    assert not steady.lines_hz and not steady.bands
    assert abs(steady.coefficients["angle_random_walk"] - 8e-4 * 0.02**0.5) < 3e-7
    wanders = fit_noise(words + 4e-4 * np.sin(2 * np.pi * 7.3 * at + 5 * np.sin(2 * np.pi * at / 100)), 0.02)
    assert wanders.lines_hz and not wanders.sinusoids


def test_the_spectrum_and_the_allan_variance_of_correlated_noise_are_those_of_a_long_run() -> None:
    """Of words that are means over 0.5 s of a process of 8 s, made in steps of 0.05 s."""
    rng, keep = np.random.default_rng(6), np.exp(-0.05 / 8)
    fine = lfilter([np.sqrt(1 - keep**2)], [1, -keep], rng.standard_normal(4_000_000))
    words = fine.reshape(-1, 10).mean(axis=1)
    terms = {"correlated_noise": 1.0, "correlation_time": 8.0}
    at, level, u = averaged_periodogram(words, 0.5)
    seen = at > 0.002  # below it the bands are as wide as the window
    assert np.all(abs(level / noise_spectrum(terms, at, 0.5) - 1)[seen] < 5 * (u / level)[seen])
    for tau in (0.5, 4.0, 16.0, 64.0):
        means = words[: words.size // int(2 * tau) * int(2 * tau)].reshape(-1, int(2 * tau)).mean(axis=1)
        apart = np.mean(np.diff(means) ** 2)
        assert 0.5 * apart == pytest.approx(float(allan_variance(terms, tau)), rel=0.04)
        both = window_covariance(terms, [0.0, tau], [tau, 2 * tau])
        assert apart == pytest.approx(both[0, 0] + both[1, 1] - 2 * both[0, 1], rel=0.04)
