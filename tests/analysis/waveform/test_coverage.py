"""How often the 95 % interval holds the truth. Limits: three binomial standard deviations, and 1 % where said.

A few hundred records each; `python -m benchmarks.estimator` asks ten thousands.
"""

import numpy as np
import pytest
from reference import adler_beat
from scipy.signal import lfilter

from analysis import combine_estimates, estimate_lock_in

N = 2500
TIMES = np.arange(N, dtype=float)


def draw(
    rng, n_records, *, x_range=(1.02, 100), noise_range=(0.3, 4), periods_range=(2.5, 590), ratio_over_u=None
):
    """Truths of random gyros as columns (R, 1) for `adler_beat`, scale factor 1; and the noise (R, 1)."""

    def spread(low, high):
        return np.exp(rng.uniform(np.log(low), np.log(high), (n_records, 1)))

    noise = rng.uniform(*noise_range, (n_records, 1))
    amplitude = rng.uniform(20, 100, (n_records, 1))
    frequency = spread(*periods_range) / N
    wl = frequency / np.sqrt(spread(*x_range) ** 2 - 1)
    if ratio_over_u is not None:
        ratio = ratio_over_u * np.hypot(noise, 12**-0.5) / amplitude * np.sqrt(2 / N)
        wl = frequency * 2 * ratio / (1 - ratio**2)
    truth = {
        "f_over_k": frequency,
        "wl": wl,
        "k": 1.0,
        "theta": rng.uniform(0, np.pi, (n_records, 1)),
        "delta": rng.uniform(-np.pi, np.pi, (n_records, 1)),
        "amplitude": amplitude,
        "offset": rng.uniform(-3, 3, (n_records, 1)),
    }
    return truth, noise


def white(rng, shape):
    return rng.normal(size=shape)


def first_order(memory):
    def noise(rng, shape):
        drive = rng.normal(size=(shape[0], shape[1] + 300)) * np.sqrt(1 - memory**2)
        return lfilter([1.0], [1.0, -memory], drive, axis=-1)[:, 300:]

    return noise


def one_over_f(rng, shape):
    length = 4 * shape[1]
    spectrum = np.fft.rfft(rng.normal(size=(shape[0], length)))
    weight = np.concatenate([[0.0], np.arange(1, spectrum.shape[1]) ** -0.5])
    return np.fft.irfft(spectrum * weight / np.sqrt(2 * np.sum(weight**2) / length), length)[:, : shape[1]]


def covered(truth, noise, estimates):
    wl = truth["wl"][:, 0]
    return (estimates.lock_in_rate_low_95 <= wl) & (wl <= estimates.lock_in_rate_high_95)


def share(rng, n_records, noise_of=white, **ranges):
    truth, noise = draw(rng, n_records, **ranges)
    codes = np.rint(adler_beat(TIMES, **truth) + noise * noise_of(rng, (n_records, N)))
    return covered(truth, noise, estimate_lock_in(codes, 1.0, scale_factor=1.0)).mean()


def chance(n_records):
    return 3 * np.sqrt(0.95 * 0.05 / n_records)


def test_over_the_grid():
    assert abs(share(np.random.default_rng(50), 1500) - 0.95) < chance(1500)


@pytest.mark.parametrize(
    "ranges",
    [
        {"x_range": (1.02, 1.2)},
        {"x_range": (50, 100)},
        {"periods_range": (2.5, 4)},
        {"periods_range": (400, 590)},
        {"noise_range": (3, 4)},
    ],
    ids=lambda ranges: next(iter(ranges)) + str(next(iter(ranges.values()))),
)
@pytest.mark.slow
def test_at_the_edges_of_the_grid(ranges):
    assert abs(share(np.random.default_rng(51), 400, **ranges) - 0.95) < chance(400)


@pytest.mark.parametrize("ratio_over_u", [0.0, 0.5, 1.0, 2.0, 3.0, 5.0])
@pytest.mark.slow
def test_where_the_ratio_is_like_its_noise(ratio_over_u):
    rng = np.random.default_rng([52, int(2 * ratio_over_u)])
    found = share(rng, 400, ratio_over_u=ratio_over_u, periods_range=(5, 500))
    assert abs(found - 0.95) < chance(400)


@pytest.mark.parametrize("noise_range", [(0.0, 0.0), (0.0, 0.1), (0.1, 0.2), (0.2, 0.3)])
@pytest.mark.slow
def test_where_rounding_is_larger_than_the_noise(noise_range):
    """The rounding error repeats with the beat, so it is not white and does not average out by itself."""
    found = share(np.random.default_rng(53), 400, noise_range=noise_range)
    assert abs(found - 0.95) < 0.01 + chance(400)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("noise_of", "periods_range"),
    [
        pytest.param(first_order(0.5), (5, 590), marks=pytest.mark.slow),
        pytest.param(first_order(0.9), (5, 590), marks=pytest.mark.slow),
        pytest.param(one_over_f, (5, 590), marks=pytest.mark.slow),
        (first_order(0.9), (2.5, 5)),
        (one_over_f, (2.5, 5)),
    ],
    ids=["ar1-0.5", "ar1-0.9", "1/f", "ar1-0.9-few-periods", "1/f-few-periods"],
)
def test_in_coloured_noise(noise_of, periods_range):
    found = share(np.random.default_rng(54), 200, noise_of, noise_range=(0.5, 3), periods_range=periods_range)
    assert abs(found - 0.95) < 0.01 + chance(200)


@pytest.mark.parametrize("ratio_over_u", [None, pytest.param(1.0, marks=pytest.mark.slow)])
def test_after_combining_ten_records(ratio_over_u):
    rng = np.random.default_rng(55)
    n_groups = 120
    truth, noise = draw(rng, n_groups, ratio_over_u=ratio_over_u)
    hits = []
    for number in range(n_groups):
        same = {name: value if name == "k" else value[number, 0] for name, value in truth.items()}
        same["theta"] = rng.uniform(0, np.pi, (10, 1))
        codes = np.rint(adler_beat(TIMES, **same) + noise[number] * rng.normal(size=(10, N)))
        e = combine_estimates(estimate_lock_in(codes, 1.0, scale_factor=1.0))
        hits.append(float(e.lock_in_rate_low_95) <= same["wl"] <= float(e.lock_in_rate_high_95))
    assert abs(np.mean(hits) - 0.95) < chance(n_groups)
