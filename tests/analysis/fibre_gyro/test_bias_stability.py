"""The deviation of means over 10 and 100 s, and what is told of noise that is none of the five terms."""

import numpy as np
import pytest
from scipy.signal import lfilter

from analysis.fibre_gyro import deviation_of_means, fit_noise

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


def test_noise_of_a_markov_process_is_no_random_walk() -> None:
    rng = np.random.default_rng(3)
    keep = np.exp(-1 / 3000)
    slow = lfilter([np.sqrt(1 - keep**2)], [1, -keep], rng.standard_normal(360_000))
    fit = fit_noise(8e-4 * rng.standard_normal(slow.size) + 1.7e-4 * slow, 0.01)
    assert fit.bands and min(power for _, _, power in fit.bands) < 0.1
